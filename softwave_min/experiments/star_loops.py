"""The arm on a star: its closed loops, and measures of their error.

These functions compute the runs of `star`, `star_sweep` and `star_drag`; they read no file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.experiments.closed_loop import TRANSIENT, controllers
from softwave_min.experiments.star_path import StarParameters, distance_to_star, star_path
from softwave_min.experiments.zero_order_hold import hold_reference, simulate_with_hold
from softwave_min.parameters import ParameterSet
from softwave_min.simulation import ClosedLoop, Scenario, root_mean_square_error, simulate
from softwave_min.waves import Sea

Floats = NDArray[np.float64]

STILL = "still"
"""Name of the run without waves."""


# --- the closed loops -------------------------------------------------------------------


@dataclass(frozen=True)
class StarRun:
    """All that determines the closed loops on one star in one sea."""

    parameters: ParameterSet
    star: StarParameters
    controllers: tuple[str, ...] = field(default_factory=controllers)


@dataclass(frozen=True)
class SweepSea:
    """A sea of the sweep."""

    case: str
    parameters: ParameterSet
    paper: float
    """The paper's RMSE, in m."""


@dataclass(frozen=True)
class SweepRun:
    """All that determines the closed loops of one star of the sweep."""

    parameters: ParameterSet
    star: StarParameters
    previewed: bool
    """Whether the NMPC knows the reference of its whole horizon."""
    seas: tuple[SweepSea, ...]
    """The first is always run."""
    tolerance: float
    """Share of the paper's number within which a measure agrees with it."""


def scenario_on_star(parameters: ParameterSet, star: StarParameters) -> Scenario:
    """Arm, sea and path, from the fully extended arm."""
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    period = parameters.nmpc.control_period
    instants = round(parameters.simulation.duration / period) + 1 + parameters.nmpc.horizon
    return Scenario.build(parameters, sea, star_path(star, period * np.arange(instants)))


def in_still_water(parameters: ParameterSet) -> ParameterSet:
    """The parameters with a flat calm."""
    return replace(parameters, sea=replace(parameters.sea, significant_height=0.0))


def follow(run: StarRun) -> dict[str, NDArray[Any]]:
    """Simulate each controller; ``time`` and ``<controller>_<field>``.

    The fields are ``error`` (T + 1,) in m; ``tip`` and ``target`` (T + 1, 2) in m; ``q``
    (T + 1, n) in rad; ``status`` and ``source`` (T,); and the loads of ``_loads``.
    """
    scenario = scenario_on_star(run.parameters, run.star)
    found: dict[str, NDArray[Any]] = {"time": scenario.times}
    for controller in run.controllers:
        loop = simulate(scenario, controller)
        arrays = {one: getattr(loop, one) for one in ("error", "target", "q", "status", "source")}
        arrays |= {"tip": loop.tips[:, -1], **_loads(scenario, loop)}
        found |= {f"{controller}_{name}": array for name, array in arrays.items()}
    return found


def _loads(scenario: Scenario, loop: ClosedLoop) -> dict[str, Floats]:
    """Generalised loads on the moving arm by kind, (T, n) in N m.

    Drag; the fluid's acceleration with C_m, as in the textbook, whatever the plant has; and
    the added mass on the body's own acceleration.
    """
    arm = scenario.arm
    textbook = Arm(arm.parameters, replace(arm.fluid, morison="textbook"))
    # a row of the flow is expanded about the middle of its period
    moving = loop.q[:-1], loop.qd[:-1], scenario.flow[: scenario.steps], -scenario.period / 2
    terms = {name: term.sum(axis=-1) for name, term in arm.load_terms(*moving).items()}
    rate = np.gradient(loop.qd, scenario.period, axis=0)[:-1]
    return {
        "drag": terms["drag_normal"] + terms["drag_tangential"],
        "fluid_inertia": textbook.load_terms(*moving)["fluid_inertia"].sum(axis=-1),
        "added_mass": np.einsum("tij,tj->ti", arm.added_inertia(loop.q[:-1]), rate),
    }


def follow_swept(run: SweepRun) -> dict[str, NDArray[Any]]:
    """Follow a star of the sweep under NMPC: ``target``, ``<case>_tip`` and ``<case>_status``.

    In still water and in the first of the seas; in the others only if some measure agrees with
    the paper's number in that one, because no measure can otherwise do so in all. Points are
    (T + 1, 2) in m.
    """
    first, *others = run.seas
    found = _swept(run, STILL, in_still_water(run.parameters))
    found |= _swept(run, first.case, first.parameters)
    tips = found["target"], found[f"{first.case}_tip"], found[f"{STILL}_tip"]
    values = measures(run.star, *tips, run.parameters.nmpc.control_period).values()
    if any(deviation(value, first.paper) <= run.tolerance for value in values):
        for sea in others:
            found |= _swept(run, sea.case, sea.parameters)
    return found


def _swept(run: SweepRun, name: str, parameters: ParameterSet) -> dict[str, NDArray[Any]]:
    scenario = scenario_on_star(parameters, run.star)
    if run.previewed:
        loop = simulate(scenario, "nmpc")
    else:
        loop = simulate_with_hold(scenario, hold_reference)
    return {"target": loop.target, f"{name}_tip": loop.tips[:, -1], f"{name}_status": loop.status}


# --- measures ---------------------------------------------------------------------------

METRICS = (
    "rmse",
    "rmse_settled",
    "rmse_x",
    "rmse_z",
    "cross_track",
    "waves_alone",
    "largest",
    "largest_settled",
    "root_integral_square",
    "root_sum_square",
)
"""Measures of the error, as ``measures`` has them."""


def measures(
    star: StarParameters, target: Floats, tip: Floats, calm_tip: Floats, period: float
) -> dict[str, float]:
    r"""What an RMSE might be the measure of.

    With e the distance of the tip from its target, at N instants ``period`` apart:

    - ``rmse``: :math:`\sqrt{\sum e^2/N}` over the whole run, ``rmse_settled`` after
      ``TRANSIENT``; ``rmse_x``, ``rmse_z``: of one coordinate
    - ``cross_track``: the same of the distance to the star, wherever on it the target is
    - ``waves_alone``: of the distance between the tips with and without waves
    - ``largest``, ``largest_settled``: of e, over the same times
    - ``root_integral_square``: :math:`\sqrt{\sum e^2 \Delta t}`, in m s^(1/2)
    - ``root_sum_square``: :math:`\sqrt{\sum e^2}`, without the mean

    ``target``, ``tip`` and ``calm_tip``, the tip in still water, are (N, 2) in m.
    """
    offset = tip - target
    error = _length(offset)
    late = slice(round(TRANSIENT / period), None)
    total = float(np.sum(error**2))
    return {
        "rmse": root_mean_square_error(error),
        "rmse_settled": root_mean_square_error(error[late]),
        "rmse_x": root_mean_square_error(offset[:, 0]),
        "rmse_z": root_mean_square_error(offset[:, 1]),
        "cross_track": root_mean_square_error(distance_to_star(star, tip)),
        "waves_alone": root_mean_square_error(_length(tip - calm_tip)),
        "largest": float(error.max()),
        "largest_settled": float(error[late].max()),
        "root_integral_square": math.sqrt(total * period),
        "root_sum_square": math.sqrt(total),
    }


def _length(offset: Floats) -> Floats:
    return np.asarray(np.hypot(*offset.T))


def deviation(value: float, paper: float) -> float:
    """Relative distance from the paper's number."""
    return abs(value - paper) / paper


def closing_time(offset: Floats, period: float) -> float:
    """Time in which a distance falls below 1/e of its first value, in s; NaN if it never does."""
    error = _length(offset)
    below = np.flatnonzero(error < error[0] / math.e)
    return period * int(below[0]) if below.size else math.nan


def inner_loop_time(parameters: ParameterSet, posture: Floats) -> float:
    r"""Slowest time constant of the arm under feed-forward + PD about a posture, in s.

    Of :math:`(M + M_A)\ddot\delta + (D + \beta)\dot\delta + (K + \alpha + \partial G/\partial q)
    \delta = 0`, that is, -1 over the largest real part of its eigenvalues.
    """
    arm = Arm(parameters.arm, parameters.fluid)
    n, width = arm.segments, 1e-6
    slopes = [
        (arm.gravity_vector(posture + step) - arm.gravity_vector(posture - step)) / (2 * width)
        for step in width * np.eye(n)
    ]
    baseline = parameters.baseline
    stiffness = np.diag(np.add(parameters.arm.stiffness, baseline.proportional_gain)) + slopes
    damping = np.diag(np.add(parameters.arm.damping, baseline.derivative_gain))
    inertia = arm.body_inertia(posture) + arm.added_inertia(posture)
    lower = -np.linalg.solve(inertia, np.hstack([stiffness, damping]))
    system = np.vstack([np.eye(n, 2 * n, n), lower])
    return float(-1 / np.linalg.eigvals(system).real.max())
