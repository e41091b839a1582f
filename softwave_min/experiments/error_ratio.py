"""The paper's Fig. error_bar: the controllers at six poses in eighteen seas (C30-C40).

The error of a controller is the RMSE of the tip over the whole run, its start included;
beside it stands the error after the start. The reference is the paper's feed-forward + PD;
each other controller is compared with it. What the paper says about the causes is tested with
the loads on the controlled arm here, and on a fixed arm in `fixed_arm`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Any

import numpy as np
import pandas as pd

from softwave_min.experiments.closed_loop import (
    TRANSIENT,
    WINDOWS,
    LoopRun,
    Window,
    closed_loops,
    controllers,
    errors,
    failed_solves,
    fallbacks,
    others,
)
from softwave_min.experiments.fixed_arm import curvature, torque_columns
from softwave_min.experiments.fixed_arm_loads import rms
from softwave_min.experiments.places import Place, places
from softwave_min.paper.cases import Point, poses
from softwave_min.paper.numbers import CONTROLLER, error_ratio
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Arrays, Experiment, Run, RunArrays, Tables
from softwave_min.runs.statistics import interval, rank_correlation
from softwave_min.simulation import REFERENCE

Row = dict[str, Any]

SEA = ["wave", "Hs", "seed"]
"""Columns that name a sea of the grid."""
PLACE = ["wave", "pose", "Hs", "seed"]


def run_at(place: Place) -> Run:
    """All controllers at a place of the grid."""
    return Run(place.run_name(), closed_loops, LoopRun(place.parameters, place.path))


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """All controllers at every place of the grid."""
    return [run_at(place) for place in places(parameters)]


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """The grid, its extremes and trends, and the loads on the controlled arm."""
    table = grid_table(parameters, arrays)
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
    }


def grid_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """One row per place: errors in m, their ratios, and the solves that failed.

    ``ratio_<name>`` is e_<name> / e_baseline over the whole run; ``_settled`` is without the
    start. ``solves_failed`` did not converge, ``fallbacks`` commands came from a fallback.
    """
    every = places(parameters)
    return pd.DataFrame(
        [{**place.labels, **_errors(place, arrays[place.run_name()])} for place in every]
    )


def _errors(place: Place, data: Arrays) -> Row:
    names = controllers()
    found = errors(data, names, place.parameters.nmpc.control_period)
    row: Row = {}
    for ending in WINDOWS.values():
        row |= {f"e_{name}{ending}": found[f"{name}{ending}"] for name in names}
        for name in others():
            row[f"ratio_{name}{ending}"] = found[f"{name}{ending}"] / found[f"{REFERENCE}{ending}"]
        if not ending:
            row["solves_failed"] = failed_solves(data, *names)
            row["fallbacks"] = fallbacks(data, *names)
    return row


def extremes(table: pd.DataFrame) -> pd.DataFrame:
    """Largest and smallest reduction of the error per wave and sea, beside the paper's.

    In per cent, 100 (1 - ratio), with pose and height of the place.
    """
    reductions = error_ratio().reduction
    rows: list[Row] = []
    for name in others():
        for (wave, seed), group in table.groupby(["wave", "seed"], sort=False):
            quoted = vars(reductions[str(wave)]) if name == CONTROLLER else {}
            by_ratio = group.sort_values(f"ratio_{name}", kind="stable")
            for extreme, place in (("largest", by_ratio.iloc[0]), ("smallest", by_ratio.iloc[-1])):
                reduction = 100 * (1 - place[f"ratio_{name}"])
                published = quoted.get(extreme, np.nan)
                rows.append(
                    {
                        "wave": wave,
                        "controller": name,
                        "extreme": extreme,
                        "seed": seed,
                        "reduction": reduction,
                        "pose": place["pose"],
                        "Hs": place["Hs"],
                        "paper": published,
                        "paper_pose": quoted.get(f"{extreme}_pose", ""),
                        "difference": reduction - published,
                        "failed": int(place["solves_failed"] + place["fallbacks"]),
                    }
                )
    return pd.DataFrame(rows)


def headline(table: pd.DataFrame, window: Window = "whole") -> pd.DataFrame:
    """Median and 90 % interval over the seas of what the paper puts into its text.

    Per controller and wave, and for ``all`` of them: ``largest`` and ``smallest`` reduction,
    and the share of places ``below_one``, in per cent; number of ``seeds``, ``low``,
    ``median``, ``high`` and the paper's value. ``table`` has one row per place with its
    ``wave``, ``seed`` and ratios; ``window`` is that of the errors.
    """
    grids = {**{str(wave): rows for wave, rows in table.groupby("wave")}, "all": table}
    return pd.DataFrame(
        [
            {
                "wave": wave,
                "controller": name,
                "quantity": quantity,
                "seeds": len(values),
                **interval(values),
                "paper": _published(wave)[quantity] if name == CONTROLLER else np.nan,
            }
            for name in others()
            for wave, grid in grids.items()
            for quantity, values in _per_seed(grid, f"ratio_{name}{WINDOWS[window]}").items()
        ]
    )


def _per_seed(grid: pd.DataFrame, column: str) -> dict[str, pd.Series]:
    ratios = grid.groupby("seed")[column]
    return {
        "largest": 100 * (1 - ratios.min()),
        "smallest": 100 * (1 - ratios.max()),
        "below_one": 100 * (grid[column] < 1).groupby(grid["seed"]).mean(),
    }


def _published(wave: str) -> dict[str, float]:
    paper = error_ratio()
    quoted = list(paper.reduction.values()) if wave == "all" else [paper.reduction[wave]]
    return {
        "largest": max(one.largest for one in quoted),
        "smallest": min(one.smallest for one in quoted),
        "below_one": paper.cells["below_one"],
    }


def trends(table: pd.DataFrame) -> pd.DataFrame:
    """Rank correlation of the ratio with the height, per wave, pose and sea (C33).

    -1 where the reduction grows with every step of the height.
    """
    endings = [f"{name}{ending}" for name in others() for ending in WINDOWS.values()]
    pairs = {f"correlation_{ending}": ("Hs", f"ratio_{ending}") for ending in endings}
    return _correlations(table, ["wave", "pose", "seed"], pairs)


def _correlations(
    table: pd.DataFrame, keys: list[str], pairs: Mapping[str, tuple[str, str]]
) -> pd.DataFrame:
    """Rank correlations of pairs of columns, by name, within each group of the keys."""
    groups = table.groupby(keys, sort=False)
    return pd.DataFrame(
        dict(zip(keys, key, strict=True))
        | {name: rank_correlation(rows[x], rows[y]) for name, (x, y) in pairs.items()}
        for key, rows in groups
    )


def period_spread(table: pd.DataFrame, base: Point) -> pd.DataFrame:
    """How far the ratio differs between the wave cases, per pose and sea (C34).

    At each height the largest less the smallest ratio of the cases; mean and largest over
    the heights. ``distance`` of the pose from the base, in m.
    """
    by_height = table.groupby(["pose", "seed", "Hs"], sort=False)
    differences = by_height.max(numeric_only=True) - by_height.min(numeric_only=True)
    by_place = differences.groupby(["pose", "seed"], sort=False)
    mean, largest = by_place.mean(), by_place.max()
    found = mean.index.to_frame(index=False)
    targets = np.array([poses()[pose] for pose in found["pose"]])
    found["distance"] = np.hypot(*(targets - base).T)
    for name in others():
        found[f"spread_{name}"] = mean[f"ratio_{name}"].array
        found[f"spread_{name}_largest"] = largest[f"ratio_{name}"].array
        found[f"spread_{name}_settled"] = mean[f"ratio_{name}_settled"].array
    return found


def torque_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """Posture of the controlled arm and load of the water on it after the start (C41).

    One row per place and controller: `curvature` of the mean posture, and `torque_columns`.
    """
    start = round(TRANSIENT / parameters.nmpc.control_period)
    rows: list[Row] = []
    for place in places(parameters):
        data = arrays[place.run_name()]
        for name in controllers():
            posture = data[f"{name}_q"][start:].mean(axis=0)
            rows.append(
                {
                    **place.labels,
                    "controller": name,
                    "curvature": curvature(posture, parameters),
                    **torque_columns(rms(data[f"{name}_wave_torque"][start:])),
                }
            )
    return pd.DataFrame(rows)


def curvature_correlations(torques: pd.DataFrame, table: pd.DataFrame) -> pd.DataFrame:
    """Rank correlations over the poses that the paper's explanation asks for (C41).

    ``curvature_torque``: is the torque lower where the arm is more curved?
    ``torque_reduction_<name>``: is the reduction of the error larger where the torque is?
    """
    joined = torques.merge(table, on=PLACE)
    pairs = {"curvature_torque": ("curvature", "torque")}
    for name in others():
        joined[f"reduction_{name}"] = 1 - joined[f"ratio_{name}"]
        pairs[f"torque_reduction_{name}"] = ("torque", f"reduction_{name}")
    return _correlations(joined, [*SEA, "controller"], pairs)


def depth_pairs(torques: pd.DataFrame, table: pd.DataFrame) -> pd.DataFrame:
    """Each pose beside the one at the same x and the other depth (C43).

    ``ratio_difference_<name>``: ratio of the lower pose less that of the upper one, positive
    where the reduction is larger near the surface. ``torque_quotient``: rms torque at the
    upper pose over that at the lower one, under the reference.
    """
    loads = torques[torques.controller == REFERENCE][[*PLACE, "torque"]]
    by_pose = dict(iter(table.merge(loads, on=PLACE).groupby("pose")))
    pairs = []
    for (upper, (x, z)), (lower, (other_x, other_z)) in permutations(poses().items(), 2):
        if x != other_x or z < other_z:
            continue
        both = by_pose[upper].merge(by_pose[lower], on=SEA, suffixes=("_upper", "_lower"))
        pair = both[SEA].assign(upper=upper, lower=lower)
        for name in others():
            ratio = f"ratio_{name}"
            pair[f"ratio_difference_{name}"] = both[f"{ratio}_lower"] - both[f"{ratio}_upper"]
        pairs.append(pair.assign(torque_quotient=both.torque_upper / both.torque_lower))
    return pd.concat(pairs, ignore_index=True)


EXPERIMENT = Experiment(
    name="error_ratio",
    title="Set-point regulation: all controllers at six poses in eighteen seas",
    claims=("C01", *(f"C{number}" for number in range(30, 41))),
    runs=runs,
    tabulate=tabulate,
)
