"""What a closed-loop run is about: an arm, a sea over the whole run, and the tip's desired path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softwave_min.arm import Arm, pack_flow
from softwave_min.control.baseline import InnerLoop, KinematicPlanner
from softwave_min.parameters import ParameterSet
from softwave_min.waves import Sea

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scenario:
    """An arm, a sea over the whole run, and the tip's desired path."""

    parameters: ParameterSet
    arm: Arm
    targets: Floats
    """(steps + 1 + K, 2), desired tip at every control instant, in m."""
    flow: Floats
    """(steps + K, F), packed flow of every control period."""
    initial_angles: Floats
    """(n,), bending angles of the arm at rest at t = 0, in rad."""

    @classmethod
    def build(
        cls,
        parameters: ParameterSet,
        sea: Sea,
        target: ArrayLike,
        initial_angles: ArrayLike | None = None,
    ) -> Scenario:
        """Bring the tip to ``target`` from rest, straight unless ``initial_angles`` say else.

        ``target`` is one point (x, z), in m, or the desired point at every control
        instant, (steps + 1 + K, 2); a shorter path stays at its last point.
        """
        arm = Arm(parameters.arm, parameters.fluid)
        steps, horizon = _steps(parameters), parameters.nmpc.horizon
        path = np.atleast_2d(np.asarray(target, dtype=float))
        targets = path[np.minimum(np.arange(steps + 1 + horizon), len(path) - 1)]
        return cls(
            parameters,
            arm,
            targets,
            expanded_flow(parameters, arm, sea),
            np.zeros(arm.segments) if initial_angles is None else np.asarray(initial_angles, float),
        )

    @property
    def initial_state(self) -> Floats:
        """(q, qd) at rest at t = 0, (2 n,)."""
        return np.concatenate([self.initial_angles, np.zeros(self.arm.segments)])

    @property
    def gains(self) -> Floats:
        """Packed inner loop of the plant, with the failure if there is one."""
        return InnerLoop.packed(self.parameters.baseline, self.parameters.failure)

    @property
    def believed_gains(self) -> Floats:
        """Packed inner loop as the NMPC's model has it."""
        failure = self.parameters.failure
        return InnerLoop.packed(self.parameters.baseline, failure if failure.known else None)

    @property
    def period(self) -> float:
        """Control period, in s."""
        return self.parameters.nmpc.control_period

    @property
    def steps(self) -> int:
        """Control periods in the run."""
        return _steps(self.parameters)

    @property
    def times(self) -> Floats:
        """Control instants, (steps + 1,) in s."""
        instants: Floats = self.period * np.arange(self.steps + 1, dtype=float)
        return instants

    @cached_property
    def planned_angles(self) -> Floats:
        """The kinematic planner's commands, (steps + K, n) in rad."""
        planner = KinematicPlanner(self.arm, self.parameters.baseline, self.period)
        return planner.path(self.initial_angles, self.targets[1:])

    @cached_property
    def held_loads(self) -> Floats:
        """Wave loads on an arm held still at the planned angles, (steps, n) in N m.

        The signal that the preview's signal-to-noise ratio refers to: it depends
        on sea and target, and on no controller's success.
        """
        angles = self.planned_angles[: self.steps]
        return self.arm.fluid_load(angles, np.zeros_like(angles), self.flow[: self.steps])


def _steps(parameters: ParameterSet) -> int:
    return round(parameters.simulation.duration / parameters.nmpc.control_period)


def expanded_flow(parameters: ParameterSet, arm: Arm, sea: Sea) -> Floats:
    """Packed flow about the arm in every control period, horizon included.

    Row i is expanded about the base and the middle of period i, and is what plant
    and preview both read.
    """
    period = parameters.nmpc.control_period
    count = _steps(parameters) + parameters.nmpc.horizon
    middles = period * (np.arange(count) + 0.5)
    structure = arm.structure
    coefficients = sea.taylor_velocity(
        parameters.arm.base_position, middles, structure.space_order, structure.time_order
    )
    return pack_flow(coefficients)
