"""The paper's Fig. error_bar: both controllers at six poses in eighteen seas (C30-C43).

A cell of the grid is a wave case, a pose, a significant height and a random sea. The error
of a controller is the RMSE of the tip over the whole run, its start included; beside it
stands the error after the start. What the paper says about the causes is tested with the
loads of the water: on the controlled arm, and on an arm that is held still.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.arm import Arm, pack_flow
from softwave_min.control.baseline import KinematicPlanner
from softwave_min.experiments.closed_loop import (
    TRANSIENT,
    LoopRun,
    closed_loops,
    failed_solves,
    fallbacks,
    prepare,
    settled_error,
    whole_error,
)
from softwave_min.experiments.places import in_sea, realisations
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet, Real, load_data
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables
from softwave_min.runs.statistics import over_seas
from softwave_min.simulation import root_mean_square_error
from softwave_min.waves import Sea, wave_number

Floats = NDArray[np.float64]
Point = tuple[float, float]
Row = dict[str, float | int | str]

RISES = (0.6, 0.0, -0.6, -1.2, -2.4, -4.8)
"""How far the held arm's base is raised, in m; the first takes a target at -4.3 m to -3.7 m."""
SAMPLING = 0.4
"""Time between two loads on the held arm, in s: short against the shortest wave."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Reduction:
    """Extreme reductions of the error in a wave case, in per cent, with their poses."""

    largest: Real
    largest_pose: str
    smallest: Real
    smallest_pose: str


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Statements:
    """What data/paper/error_ratio.toml quotes."""

    reduction: dict[str, Reduction]
    cells: dict[str, Real]


@cache
def paper() -> Statements:
    """The paper's numbers."""
    return load_data(Statements, "paper/error_ratio.toml")


@dataclass(frozen=True)
class Cell:
    """One place of the grid, in one random sea."""

    wave: str
    pose: str
    loop: LoopRun

    @property
    def labels(self) -> Row:
        """Leading columns of its row."""
        sea = self.loop.parameters.sea
        return {
            "wave": self.wave,
            "pose": self.pose,
            "Hs": sea.significant_height,
            "seed": sea.seed,
        }

    @property
    def run(self) -> Run:
        """Both controllers at this place."""
        return Run(self.name, closed_loops, self.loop)

    @property
    def name(self) -> str:
        """Name of its run."""
        sea = self.loop.parameters.sea
        return f"{self.wave}-{self.pose}-{100 * sea.significant_height:03.0f}cm-{sea.seed}"


@dataclass(frozen=True)
class HeldArm:
    """All that determines the loads on an arm held still in one sea."""

    parameters: ParameterSet
    targets: tuple[Point, ...]
    """The arm is held where the kinematic planner ends for each of these, in m."""
    rises: tuple[float, ...]
    """How far it is then raised as a whole, in m."""


def cells(parameters: ParameterSet) -> list[Cell]:
    """The grid: wave, pose, height and realisation, the last changing fastest."""
    places = poses()
    found: list[Cell] = []
    for wave, case in wave_cases().items():
        seas = [
            one
            for height in case.significant_height
            for one in realisations(in_sea(parameters, wave, height))
        ]
        found += [
            Cell(wave, pose, LoopRun(one, (place,)))
            for pose, place in places.items()
            for one in seas
        ]
    return found


def held_arms(parameters: ParameterSet) -> Iterator[tuple[str, Run]]:
    """One run per wave case and realisation at the greatest height, after the case's name."""
    bed = -parameters.sea.depth + sum(parameters.arm.length)
    rises = tuple(rise for rise in RISES if parameters.arm.base_position[1] + rise > bed)
    targets = tuple(poses().values())
    for wave, case in wave_cases().items():
        for one in realisations(in_sea(parameters, wave, max(case.significant_height))):
            held = HeldArm(one, targets, rises)
            yield wave, Run(f"held-{wave}-{one.sea.seed}", held_loads, held)


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """Both controllers at every place of the grid, and the arm held still."""
    loops = [cell.run for cell in cells(parameters)]
    return [*loops, *(run for _, run in held_arms(parameters))]


def held_loads(held: HeldArm) -> dict[str, NDArray[Any]]:
    """Loads of the water on the arm held still, sampled over the whole run.

    Returns
    -------
    dict of ndarray
        ``angles`` (P, n): the postures, in rad. ``torque`` (P, Z, n): root mean square of
        the generalised load, in N m. ``torque_uniform`` (P, n): the same at the operating
        depth if the whole arm met the flow at its base. ``speed`` (Z,): root mean square
        of the water's speed at the base, in m/s. P targets, Z rises.
    """
    parameters = held.parameters
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    angles = np.array([_planned_posture(parameters, target) for target in held.targets])
    arms = [_raised(parameters, rise) for rise in held.rises]
    flows = [_sampled_flow(parameters, arm, sea) for arm in arms]
    operating = held.rises.index(0.0)
    arm, uniform = arms[operating], _uniform(arms[operating], flows[operating])
    return {
        "angles": angles,
        "torque": np.array(
            [
                [_held_torque(*place, posture) for place in zip(arms, flows, strict=True)]
                for posture in angles
            ]
        ),
        "torque_uniform": np.array([_held_torque(arm, uniform, posture) for posture in angles]),
        "speed": np.array([_speed_at_base(*place) for place in zip(arms, flows, strict=True)]),
    }


def _planned_posture(parameters: ParameterSet, target: Point) -> Floats:
    """Where the kinematic planner ends, (n,) in rad."""
    period, duration = parameters.nmpc.control_period, parameters.simulation.duration
    planner = KinematicPlanner(_raised(parameters, 0.0), parameters.baseline, period)
    path = np.tile(target, (round(duration / period), 1))
    posture: Floats = planner.path(np.zeros(parameters.arm.segments), path)[-1]
    return posture


def _raised(parameters: ParameterSet, rise: float) -> Arm:
    x, z = parameters.arm.base_position
    return Arm(replace(parameters.arm, base_position=(x, z + rise)), parameters.fluid)


def _sampled_flow(parameters: ParameterSet, arm: Arm, sea: Sea) -> Floats:
    """Packed flow about the arm at instants ``SAMPLING`` apart, (T, F)."""
    times = np.arange(0.0, parameters.simulation.duration, SAMPLING)
    structure = arm.structure
    return pack_flow(
        sea.taylor_velocity(
            arm.parameters.base_position, times, structure.space_order, structure.time_order
        )
    )


def _held_torque(arm: Arm, flow: Floats, posture: Floats) -> Floats:
    q = np.tile(posture, (len(flow), 1))
    return _rms(arm.fluid_load(q, np.zeros_like(q), flow))


def _coefficients(arm: Arm, flow: Floats) -> Floats:
    """The flow unpacked: instant, real and imaginary part, power in space, power in time."""
    orders = arm.structure.space_order + 1, arm.structure.time_order + 1
    return flow.reshape(len(flow), 2, *orders)


def _uniform(arm: Arm, flow: Floats) -> Floats:
    """The flow without its variation in space: only the constant of its expansion."""
    coefficients = _coefficients(arm, flow).copy()
    coefficients[:, :, 1:] = 0
    return coefficients.reshape(flow.shape)


def _speed_at_base(arm: Arm, flow: Floats) -> float:
    velocity = _coefficients(arm, flow)[:, :, 0, 0]
    return root_mean_square_error(np.linalg.norm(velocity, axis=1))


def _rms(series: Floats) -> Floats:
    """Root mean square of every column."""
    level: Floats = np.sqrt(np.mean(series**2, axis=0))
    return level


# --- tables -----------------------------------------------------------------------------


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """The grid, its extremes and trends, and the loads that are to explain them."""
    table = cell_table(parameters, arrays)
    torques = torque_table(parameters, arrays)
    return {
        "error_ratio": table,
        "extremes": extremes(table),
        "headline": headline(table),
        "trends": trends(table),
        "periods": period_spread(table, parameters.arm.base_position),
        "torques": torques,
        "curvature": curvature_correlations(torques, table),
        "pairs": depth_pairs(torques, table),
        "postures": posture_table(parameters, arrays),
        "depth": depth_table(parameters, arrays),
    }


def cell_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """One row per cell: errors in m, their ratios, and the solves that failed.

    ``ratio`` is e_mpc / e_pd over the whole run; ``_settled`` is without the start.
    ``solves_failed`` did not converge, ``fallbacks`` commands came from the fallback.
    """
    return pd.DataFrame(
        [{**cell.labels, **_errors(cell, arrays[cell.name])} for cell in cells(parameters)]
    )


def _errors(cell: Cell, data: Mapping[str, NDArray[Any]]) -> Row:
    period = cell.loop.parameters.nmpc.control_period
    mpc, pd_ = (whole_error(data, name) for name in ("nmpc", "baseline"))
    late_mpc, late_pd = (settled_error(data, name, period) for name in ("nmpc", "baseline"))
    return {
        "e_mpc": mpc,
        "e_pd": pd_,
        "ratio": mpc / pd_,
        "solves_failed": failed_solves(data, "nmpc"),
        "fallbacks": fallbacks(data, "nmpc"),
        "e_mpc_settled": late_mpc,
        "e_pd_settled": late_pd,
        "ratio_settled": late_mpc / late_pd,
    }


def extremes(table: pd.DataFrame) -> pd.DataFrame:
    """Largest and smallest reduction of the error per wave and sea, beside the paper's.

    In per cent, 100 (1 - ratio), with pose and height of the cell.
    """
    rows: list[Row] = []
    for _, group in table.groupby(["wave", "seed"], sort=False):
        by_ratio = group.sort_values("ratio", kind="stable")
        for extreme, cell in (("largest", by_ratio.iloc[0]), ("smallest", by_ratio.iloc[-1])):
            quoted = paper().reduction[cell["wave"]]
            reduction, published = 100 * (1 - cell["ratio"]), getattr(quoted, extreme)
            rows.append(
                {
                    "wave": cell["wave"],
                    "extreme": extreme,
                    "seed": cell["seed"],
                    "reduction": reduction,
                    "pose": cell["pose"],
                    "Hs": cell["Hs"],
                    "paper": published,
                    "paper_pose": getattr(quoted, f"{extreme}_pose"),
                    "difference": reduction - published,
                    "failed": int(cell["solves_failed"] + cell["fallbacks"]),
                }
            )
    return pd.DataFrame(rows)


def headline(table: pd.DataFrame, column: str = "ratio") -> pd.DataFrame:
    """Median and 90 % interval over the seas of what the paper puts into its text.

    Parameters
    ----------
    table : DataFrame
        With columns ``wave``, ``seed`` and ``column``, one row per cell.
    column : str
        The ratio e_mpc / e_pd that is meant.

    Returns
    -------
    DataFrame
        Per wave, and for ``all`` of them: ``largest`` and ``smallest`` reduction, and the
        share of cells ``below_one``, in per cent; number of ``seeds``, ``low``,
        ``median``, ``high`` and the paper's value.
    """
    grids = {**{str(wave): rows for wave, rows in table.groupby("wave")}, "all": table}
    rows: list[Row] = []
    for wave, grid in grids.items():
        published = _published(wave)
        for quantity, values in _per_seed(grid, column).items():
            low, median, high = over_seas(values)
            rows.append(
                {
                    "wave": wave,
                    "quantity": quantity,
                    "seeds": len(values),
                    "low": low,
                    "median": median,
                    "high": high,
                    "paper": published[quantity],
                }
            )
    return pd.DataFrame(rows)


def _per_seed(grid: pd.DataFrame, column: str) -> dict[str, Floats]:
    ratios = [rows[column].to_numpy(float) for _, rows in grid.groupby("seed")]
    return {
        "largest": np.array([100 * (1 - ratio.min()) for ratio in ratios]),
        "smallest": np.array([100 * (1 - ratio.max()) for ratio in ratios]),
        "below_one": np.array([100 * np.mean(ratio < 1) for ratio in ratios]),
    }


def _published(wave: str) -> dict[str, float]:
    reductions = paper().reduction
    quoted = list(reductions.values()) if wave == "all" else [reductions[wave]]
    return {
        "largest": max(one.largest for one in quoted),
        "smallest": min(one.smallest for one in quoted),
        "below_one": paper().cells["below_one"],
    }


def trends(table: pd.DataFrame) -> pd.DataFrame:
    """Rank correlation of the ratio with the height, per wave, pose and sea (C33).

    -1 where the reduction grows with every step of the height.
    """
    return pd.DataFrame(
        [
            {
                "wave": wave,
                "pose": pose,
                "seed": seed,
                "correlation": _rank_correlation(rows.Hs, rows.ratio),
                "correlation_settled": _rank_correlation(rows.Hs, rows.ratio_settled),
            }
            for (wave, pose, seed), rows in table.groupby(["wave", "pose", "seed"], sort=False)
        ]
    )


def _rank_correlation(first: pd.Series, second: pd.Series) -> float:
    """Spearman's coefficient, between -1 and 1; NaN where one of the two is constant."""
    return float(first.rank().corr(second.rank()))


def period_spread(table: pd.DataFrame, base: Point) -> pd.DataFrame:
    """How far the ratio differs between the wave cases, per pose and sea (C34).

    At each height the largest less the smallest ratio of the cases; mean and largest over
    the heights. ``distance`` of the pose from the base, in m.
    """
    places = poses()
    rows: list[Row] = []
    for _, group in table.groupby(["pose", "seed"], sort=False):
        pose, seed = group.iloc[0][["pose", "seed"]]
        by_height = group.groupby("Hs")[["ratio", "ratio_settled"]]
        spread = by_height.max() - by_height.min()
        rows.append(
            {
                "pose": pose,
                "seed": seed,
                "distance": float(np.hypot(*np.subtract(places[pose], base))),
                "spread": spread.ratio.mean(),
                "spread_largest": spread.ratio.max(),
                "spread_settled": spread.ratio_settled.mean(),
            }
        )
    return pd.DataFrame(rows)


def torque_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """Posture of the controlled arm and load of the water on it after the start (C41).

    One row per cell and controller. ``curvature``: sum |q_i| / sum L_i of the mean
    posture, in 1/m. ``torque_i``: root mean square of the load on segment i's angle, in
    N m; ``torque``: of the norm over the segments.
    """
    controllers: tuple[str, ...] = ("baseline", "nmpc")
    return pd.DataFrame(
        [
            {**cell.labels, "controller": controller, **_load(cell, arrays[cell.name], controller)}
            for cell in cells(parameters)
            for controller in controllers
        ]
    )


def _load(cell: Cell, data: Mapping[str, NDArray[Any]], controller: str) -> Row:
    start = round(TRANSIENT / cell.loop.parameters.nmpc.control_period)
    posture = data[f"{controller}_q"][start:].mean(axis=0)
    return {
        "curvature": _curvature(posture, cell.loop.parameters),
        **_torque_columns(_rms(data[f"{controller}_wave_torque"][start:])),
    }


def _curvature(posture: Floats, parameters: ParameterSet) -> float:
    return float(np.abs(posture).sum() / sum(parameters.arm.length))


def _torque_columns(levels: Floats) -> Row:
    each: Row = {f"torque_{i}": float(level) for i, level in enumerate(levels, start=1)}
    return {"torque": float(np.linalg.norm(levels)), **each}


def curvature_correlations(torques: pd.DataFrame, table: pd.DataFrame) -> pd.DataFrame:
    """Rank correlations over the poses that the paper's explanation asks for (C41).

    ``curvature_torque``: is the torque lower where the arm is more curved?
    ``torque_reduction``: is the reduction of the error larger where the torque is?
    """
    place = ["wave", "pose", "Hs", "seed"]
    joined = torques.merge(table[[*place, "ratio"]], on=place)
    return pd.DataFrame(
        [
            {
                "wave": wave,
                "Hs": height,
                "seed": seed,
                "controller": controller,
                "curvature_torque": _rank_correlation(rows.curvature, rows.torque),
                "torque_reduction": _rank_correlation(rows.torque, 1 - rows.ratio),
            }
            for (wave, height, seed, controller), rows in joined.groupby(
                ["wave", "Hs", "seed", "controller"], sort=False
            )
        ]
    )


def depth_pairs(torques: pd.DataFrame, table: pd.DataFrame) -> pd.DataFrame:
    """Each pose beside the one at the same x and the other depth (C43).

    ``ratio_difference``: ratio of the lower pose less that of the upper one, positive
    where the reduction is larger near the surface. ``torque_quotient``: rms torque at the
    upper pose over that at the lower one, under the baseline.
    """
    place = ["wave", "Hs", "seed"]
    loads = torques[torques.controller == "baseline"][[*place, "pose", "torque"]]
    by_pose = dict(iter(table.merge(loads, on=[*place, "pose"]).groupby("pose")))
    pairs = []
    for upper, lower in _above_one_another():
        both = by_pose[upper].merge(by_pose[lower], on=place, suffixes=("_upper", "_lower"))
        pair = both[place].assign(
            upper=upper,
            lower=lower,
            ratio_difference=both.ratio_lower - both.ratio_upper,
            torque_quotient=both.torque_upper / both.torque_lower,
        )
        pairs.append(pair)
    return pd.concat(pairs, ignore_index=True)


def _above_one_another() -> list[tuple[str, str]]:
    """Pairs of poses at the same x, the upper one first."""
    places = poses()
    return [
        (upper, lower)
        for upper, (x, z) in places.items()
        for lower, (other_x, other_z) in places.items()
        if x == other_x and z > other_z
    ]


def posture_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """Loads on the arm held still at each pose (C41).

    ``curvature`` and ``torque`` as in ``torque_table``; ``torque_uniform``: without the
    variation of the flow along the arm, in N m.
    """
    rows: list[Row] = []
    for wave, run in held_arms(parameters):
        held, data = run.parameters, arrays[run.name]
        operating = held.rises.index(0.0)
        for number, pose in enumerate(poses()):
            rows.append(
                {
                    **_held_labels(wave, pose, held),
                    "curvature": _curvature(data["angles"][number], held.parameters),
                    **_torque_columns(data["torque"][number, operating]),
                    "torque_uniform": float(np.linalg.norm(data["torque_uniform"][number])),
                }
            )
    return pd.DataFrame(rows)


def depth_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """Loads on the arm held still at several depths, beside linear theory's decay (C42, C43).

    One row per wave, pose, sea and depth ``z`` of the base, in m. ``speed`` of the water
    at the base, in m/s; ``decay``: exp(k (z - z_0)) for the wave number k of the peak and
    the operating depth z_0.
    """
    rows: list[Row] = []
    for wave, run in held_arms(parameters):
        held, data = run.parameters, arrays[run.name]
        number = _peak_wave_number(held.parameters)
        for posture, pose in enumerate(poses()):
            for place, rise in enumerate(held.rises):
                rows.append(
                    {
                        **_held_labels(wave, pose, held),
                        "z": round(held.parameters.arm.base_position[1] + rise, 6),
                        **_torque_columns(data["torque"][posture, place]),
                        "speed": float(data["speed"][place]),
                        "decay": float(np.exp(number * rise)),
                    }
                )
    return pd.DataFrame(rows)


def _held_labels(wave: str, pose: str, held: HeldArm) -> Row:
    sea = held.parameters.sea
    return {"wave": wave, "pose": pose, "Hs": sea.significant_height, "seed": sea.seed}


def _peak_wave_number(parameters: ParameterSet) -> float:
    frequency = 2 * np.pi / parameters.sea.peak_period
    return float(wave_number(frequency, parameters.sea.depth, parameters.fluid.gravity))


EXPERIMENT = Experiment(
    name="error_ratio",
    title="Set-point regulation: both controllers at six poses in eighteen seas",
    claims=("C01", *(f"C{number}" for number in range(30, 44))),
    runs=runs,
    tabulate=tabulate,
    prepare=prepare,
)
