"""Loads of the water on an arm that is fixed in a posture: no controller, no motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm, pack_flow
from softwave_min.control.baseline import KinematicPlanner
from softwave_min.parameters import ParameterSet
from softwave_min.simulation import root_mean_square_error
from softwave_min.waves import Sea

Floats = NDArray[np.float64]
Point = tuple[float, float]

SAMPLING = 0.4
"""Time between two loads, in s: short against the shortest wave."""


@dataclass(frozen=True)
class FixedArm:
    """All that determines the loads on a fixed arm in one sea."""

    parameters: ParameterSet
    targets: tuple[Point, ...]
    """The arm is fixed where the kinematic planner ends for each of these, in m."""
    rises: tuple[float, ...]
    """How far it is then raised as a whole, in m; one of them is 0."""


def fixed_arm_loads(run: FixedArm) -> dict[str, NDArray[Any]]:
    """Loads of the water on the fixed arm, for P targets and Z rises, over the whole run.

    ``angles`` (P, n): the postures, in rad. ``torque`` (P, Z, n): root mean square of the
    generalised load, in N m. ``torque_uniform`` (P, n): the same at the operating depth if
    the whole arm met the flow at its base. ``speed`` (Z,): root mean square of the water's
    speed at the base, in m/s.
    """
    parameters = run.parameters
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    angles = np.array([_planned_posture(parameters, target) for target in run.targets])
    places = []
    for rise in run.rises:
        arm = _raised(parameters, rise)
        places.append((arm, _sampled_flow(parameters, arm, sea)))
    arm, flow = places[run.rises.index(0.0)]
    uniform = _coefficients(arm, flow).copy()
    uniform[:, :, 1:] = 0  # no variation in space: only the constant of the expansion
    uniform = uniform.reshape(flow.shape)
    return {
        "angles": angles,
        "torque": np.array([[_torque(*place, posture) for place in places] for posture in angles]),
        "torque_uniform": np.array([_torque(arm, uniform, posture) for posture in angles]),
        "speed": np.array([_speed_at_base(*place) for place in places]),
    }


def rms(series: Floats) -> Floats:
    """Root mean square of every column."""
    return np.asarray(np.sqrt(np.mean(series**2, axis=0)))


def _planned_posture(parameters: ParameterSet, target: Point) -> Floats:
    """Where the kinematic planner ends, (n,) in rad."""
    period, duration = parameters.nmpc.control_period, parameters.simulation.duration
    planner = KinematicPlanner(_raised(parameters, 0.0), parameters.baseline, period)
    path = np.tile(target, (round(duration / period), 1))
    return np.asarray(planner.path(np.zeros(parameters.arm.segments), path)[-1])


def _raised(parameters: ParameterSet, rise: float) -> Arm:
    x, z = parameters.arm.base_position
    return Arm(replace(parameters.arm, base_position=(x, z + rise)), parameters.fluid)


def _sampled_flow(parameters: ParameterSet, arm: Arm, sea: Sea) -> Floats:
    """Packed flow about the arm at instants ``SAMPLING`` apart, (T, F)."""
    times = np.arange(0.0, parameters.simulation.duration, SAMPLING)
    orders = arm.structure.space_order, arm.structure.time_order
    return pack_flow(sea.taylor_velocity(arm.parameters.base_position, times, *orders))


def _torque(arm: Arm, flow: Floats, posture: Floats) -> Floats:
    q = np.tile(posture, (len(flow), 1))
    return rms(arm.fluid_load(q, np.zeros_like(q), flow))


def _coefficients(arm: Arm, flow: Floats) -> Floats:
    """The flow unpacked: instant, real and imaginary part, power in space, power in time."""
    orders = arm.structure.space_order + 1, arm.structure.time_order + 1
    return flow.reshape(len(flow), 2, *orders)


def _speed_at_base(arm: Arm, flow: Floats) -> float:
    velocity = _coefficients(arm, flow)[:, :, 0, 0]
    return root_mean_square_error(np.linalg.norm(velocity, axis=1))
