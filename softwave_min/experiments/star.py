"""The paper's star: the tip follows a path, in three seas and in still water (C61-C69).

The paper prints neither the path nor what its RMSE is the error of. One star is
taken as nominal, and several measures of its error stand beside the RMSE; `star_sweep`
has other stars.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.arm import Arm
from softwave_min.experiments.closed_loop import (
    TRANSIENT,
    failed_solves,
    fallbacks,
    prepare,
)
from softwave_min.experiments.places import in_sea, realisations
from softwave_min.experiments.star_path import StarParameters, distance_to_star, star_path
from softwave_min.paper.cases import wave_cases
from softwave_min.parameters import ParameterSet, Positive, load_data
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables
from softwave_min.runs.statistics import over_seas
from softwave_min.simulation import ClosedLoop, Scenario, root_mean_square_error, simulate
from softwave_min.waves import Sea

Floats = NDArray[np.float64]
Row = Mapping[str, Any]

CONTROLLERS: tuple[str, ...] = ("baseline", "nmpc")
STILL = "still"
"""Name of the run without waves."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Choice:
    """What data/paper/star.toml fixes."""

    case: str
    significant_height: Positive
    path: StarParameters
    rmse: dict[str, Positive]
    """The paper's numbers by wave case, in m."""


@dataclass(frozen=True)
class StarRun:
    """All that determines the closed loops on one star in one sea."""

    parameters: ParameterSet
    star: StarParameters


def choice() -> Choice:
    """The nominal star and the paper's numbers."""
    return load_data(Choice, "paper/star.toml")


def scenario_of(parameters: ParameterSet, star: StarParameters) -> Scenario:
    """Arm, sea and path, from the fully extended arm."""
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    period = parameters.nmpc.control_period
    instants = round(parameters.simulation.duration / period) + 1 + parameters.nmpc.horizon
    return Scenario.build(parameters, sea, star_path(star, period * np.arange(instants)))


def in_still_water(parameters: ParameterSet) -> ParameterSet:
    """The parameters with a flat calm."""
    return replace(parameters, sea=replace(parameters.sea, significant_height=0.0))


def follow(run: StarRun) -> dict[str, NDArray[Any]]:
    """Simulate both controllers; ``<controller>_<field>`` with the fields of ``_kept``."""
    scenario = scenario_of(run.parameters, run.star)
    found: dict[str, NDArray[Any]] = {"time": scenario.times}
    for controller in CONTROLLERS:
        kept = _kept(scenario, simulate(scenario, controller))
        found |= {f"{controller}_{name}": array for name, array in kept.items()}
    return found


def _kept(scenario: Scenario, loop: ClosedLoop) -> dict[str, NDArray[Any]]:
    return {
        "tip": loop.tips[:, -1],
        "q": loop.q,
        "target": loop.target,
        "status": loop.status,
        "source": loop.source,
        **_loads(scenario, loop),
    }


def _loads(scenario: Scenario, loop: ClosedLoop) -> dict[str, Floats]:
    """Generalised loads on the moving arm by kind, (T, n) in N m.

    Drag; the fluid's acceleration with C_m, as the textbook has it, whatever the plant
    has; and the added mass on the body's own acceleration.
    """
    arm, steps = scenario.arm, scenario.steps
    textbook = Arm(arm.parameters, replace(arm.fluid, morison="textbook"))
    q, qd, flow = loop.q[:-1], loop.qd[:-1], scenario.flow[:steps]
    # a row of the flow is expanded about the middle of its period
    terms = {
        name: term.sum(axis=-1)
        for name, term in arm.load_terms(q, qd, flow, -scenario.period / 2).items()
    }
    fluid = textbook.load_terms(q, qd, flow, -scenario.period / 2)["fluid_inertia"].sum(axis=-1)
    rate = np.gradient(loop.qd, scenario.period, axis=0)[:-1]
    return {
        "drag": terms["drag_normal"] + terms["drag_tangential"],
        "fluid_inertia": fluid,
        "added_mass": np.einsum("tij,tj->ti", arm.added_inertia(q), rate),
    }


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
    star: StarParameters, found: Mapping[str, NDArray[Any]], case: str, period: float
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

    Parameters
    ----------
    star : StarParameters
    found : mapping of arrays
        With ``target``, ``<case>_tip`` and ``still_tip``.
    case : str
    period : float
        Time between two instants, in s.
    """
    tip = found[f"{case}_tip"]
    offset = tip - found["target"]
    error = np.hypot(offset[:, 0], offset[:, 1])
    apart = np.hypot(*(tip - found[f"{STILL}_tip"]).T)
    late = slice(round(TRANSIENT / period), None)
    total = float(np.sum(error**2))
    return {
        "rmse": root_mean_square_error(error),
        "rmse_settled": root_mean_square_error(error[late]),
        "rmse_x": root_mean_square_error(offset[:, 0]),
        "rmse_z": root_mean_square_error(offset[:, 1]),
        "cross_track": root_mean_square_error(distance_to_star(star, tip)),
        "waves_alone": root_mean_square_error(apart),
        "largest": float(error.max()),
        "largest_settled": float(error[late].max()),
        "root_integral_square": math.sqrt(total * period),
        "root_sum_square": math.sqrt(total),
    }


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """The star in still water and in every sea in every realisation."""
    chosen = choice()
    first = next(realisations(parameters))
    calm = StarRun(in_still_water(in_sea(first, chosen.case, 0.0)), chosen.path)
    seas = [
        Run(_sea_name(case, one), follow, StarRun(one, chosen.path))
        for case, one in _seas(parameters, chosen)
    ]
    return [Run(STILL, follow, calm), *seas]


def _seas(parameters: ParameterSet, chosen: Choice) -> Iterator[tuple[str, ParameterSet]]:
    for one in realisations(parameters):
        for case in wave_cases():
            yield case, in_sea(one, case, chosen.significant_height)


def _sea_name(case: str, parameters: ParameterSet) -> str:
    return f"{case}-{parameters.sea.seed}"


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Tables ``star``, ``headline``, ``spread`` and ``time_scales``."""
    table = star_table(parameters, arrays)
    return {
        "star": table,
        "headline": headline(table),
        "spread": period_spread(table),
        "time_scales": _time_scales(parameters, arrays),
    }


def star_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """Errors on the nominal star, from the arrays of ``runs``.

    One row per sea, still water included (without a seed), and controller.
    """
    chosen = choice()
    rows: list[Row] = [
        _star_row(chosen, parameters, arrays, STILL, STILL, controller)
        for controller in CONTROLLERS
    ]
    rows += [
        {"seed": one.sea.seed}
        | _star_row(chosen, parameters, arrays, case, _sea_name(case, one), controller)
        for case, one in _seas(parameters, chosen)
        for controller in CONTROLLERS
    ]
    table = pd.DataFrame(rows)
    table.insert(1, "seed", table.pop("seed").astype("Int64"))
    return table


def _star_row(
    chosen: Choice,
    parameters: ParameterSet,
    arrays: RunArrays,
    case: str,
    run: str,
    controller: str,
) -> dict[str, Any]:
    found, calm = arrays[run], arrays[STILL]
    series = {
        "target": found[f"{controller}_target"],
        f"{case}_tip": found[f"{controller}_tip"],
        f"{STILL}_tip": calm[f"{controller}_tip"],
    }
    return {
        "wave": case,
        "controller": controller,
        **measures(chosen.path, series, case, parameters.nmpc.control_period),
        "paper": chosen.rmse.get(case) if controller == "nmpc" else None,
        "solves_failed": failed_solves(found, controller),
        "fallbacks": fallbacks(found, controller),
    }


def headline(table: pd.DataFrame) -> pd.DataFrame:
    """Median and 5 and 95 % quantiles over the seas, beside the paper's number.

    Parameters
    ----------
    table : DataFrame
        The table ``star``.

    Returns
    -------
    DataFrame
        One row per wave case, controller and measure; ``seas`` counts the realisations.
    """
    rows: list[Row] = []
    waves = table[table.wave != STILL]
    for (wave, controller), group in waves.groupby(["wave", "controller"], sort=False):
        for metric in METRICS:
            low, median, high = over_seas(group[metric])
            rows.append(
                {
                    "wave": wave,
                    "controller": controller,
                    "measure": metric,
                    "seas": len(group),
                    "low": low,
                    "median": median,
                    "high": high,
                    "paper": group.paper.iloc[0] if metric == "rmse" else None,
                }
            )
    return pd.DataFrame(rows)


def period_spread(table: pd.DataFrame) -> pd.DataFrame:
    """How much each measure differs between the wave cases, relative to their mean (C68).

    (largest - smallest) / mean over the cases, in each sea; median and quantiles over the
    seas, and the paper's own spread. The seas of one seed share their phases.
    """
    rows: list[Row] = []
    waves = table[table.wave != STILL]
    for controller, group in waves.groupby("controller", sort=False):
        for metric in METRICS:
            by_sea = group.pivot_table(index="seed", columns="wave", values=metric)
            low, median, high = over_seas(_relative_range(by_sea))
            rows.append(
                {
                    "controller": controller,
                    "measure": metric,
                    "seas": len(by_sea),
                    "low": low,
                    "median": median,
                    "high": high,
                    "paper": _paper_spread(group) if metric == "rmse" else None,
                }
            )
    return pd.DataFrame(rows)


def _relative_range(by_sea: pd.DataFrame) -> pd.Series:
    return (by_sea.max(axis=1) - by_sea.min(axis=1)) / by_sea.mean(axis=1)


def _paper_spread(group: pd.DataFrame) -> float | None:
    quoted = group.paper.dropna().unique()
    return float(np.ptp(quoted) / quoted.mean()) if len(quoted) else None


def _time_scales(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """Time scales of waves and control, and drag against inertia on the moving arm (C69).

    In the first sea, under NMPC. ``inner_loop``: slowest time constant of the arm under
    feed-forward + PD in still water; ``closing``: time in which the NMPC brings the error
    in still water below 1/e of its first value. Loads as root mean square of their norm
    over the segments.
    """
    chosen, calm = choice(), arrays[STILL]
    first = next(realisations(parameters))
    period = parameters.nmpc.control_period
    inner = inner_loop_time(parameters, calm["nmpc_q"][-1])
    closing = period * _closing_steps(calm["nmpc_tip"] - calm["nmpc_target"])
    rows: list[Row] = []
    for case in chosen.rmse:
        peak_period = wave_cases()[case].peak_period
        found = arrays[_sea_name(case, first)]
        drag, fluid, added = (
            root_mean_square_error(np.linalg.norm(found[f"nmpc_{kind}"], axis=1))
            for kind in ("drag", "fluid_inertia", "added_mass")
        )
        rows.append(
            {
                "wave": case,
                "peak_period": peak_period,
                "control_period": period,
                "horizon": period * parameters.nmpc.horizon,
                "inner_loop": inner,
                "closing": closing,
                "peak_period_over_control_period": peak_period / period,
                "peak_period_over_inner_loop": peak_period / inner,
                "peak_period_over_closing": peak_period / closing,
                "drag": drag,
                "fluid_inertia": fluid,
                "added_mass": added,
                "drag_over_fluid_inertia": drag / fluid,
                "drag_over_added_mass": drag / added,
            }
        )
    return pd.DataFrame(rows)


def _closing_steps(offset: Floats) -> int:
    error = np.hypot(offset[:, 0], offset[:, 1])
    return int(np.argmax(error < error[0] / math.e))


def inner_loop_time(parameters: ParameterSet, posture: Floats) -> float:
    r"""Slowest time constant of the arm under feed-forward + PD about a posture, in s.

    Of :math:`(M + M_A)\ddot\delta + (D + \beta)\dot\delta + (K + \alpha + \partial G/\partial q)
    \delta = 0`, that is, -1 over the largest real part of its eigenvalues.
    """
    arm = Arm(parameters.arm, parameters.fluid)
    n, width = arm.segments, 1e-6
    slope = np.array(
        [
            (arm.gravity_vector(posture + step) - arm.gravity_vector(posture - step)) / (2 * width)
            for step in width * np.eye(n)
        ]
    )
    baseline = parameters.baseline
    stiffness = np.diag(np.add(parameters.arm.stiffness, baseline.proportional_gain)) + slope
    damping = np.diag(np.add(parameters.arm.damping, baseline.derivative_gain))
    inertia = arm.body_inertia(posture) + arm.added_inertia(posture)
    system = np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-np.linalg.solve(inertia, stiffness), -np.linalg.solve(inertia, damping)],
        ]
    )
    return float(-1 / np.linalg.eigvals(system).real.max())


EXPERIMENT = Experiment(
    name="star",
    title="The star: a path followed in three seas and in still water",
    claims=tuple(f"C{number}" for number in range(61, 70)),
    runs=runs,
    tabulate=tabulate,
    prepare=prepare,
)
