"""The paper's star: the tip follows a path, in three seas and in still water (C61-C69).

The paper prints neither the path nor what its RMSE is the error of. One star is
taken as nominal, and several measures of its error stand beside the RMSE; `star_sweep`
has other stars.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
import pandas as pd
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.experiments.closed_loop import failed_solves, fallbacks, others
from softwave_min.experiments.places import in_sea, realisations
from softwave_min.experiments.star_loops import (
    METRICS,
    STILL,
    StarRun,
    closing_time,
    follow,
    in_still_water,
    inner_loop_time,
    measures,
)
from softwave_min.experiments.star_path import StarParameters
from softwave_min.paper.cases import wave_cases
from softwave_min.paper.numbers import CONTROLLER
from softwave_min.parameters import ParameterSet, Positive, load_data
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables
from softwave_min.runs.statistics import interval
from softwave_min.simulation import CONTROLLERS, root_mean_square_error


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Choice:
    """What data/paper/star.toml fixes."""

    case: str
    significant_height: Positive
    path: StarParameters
    rmse: dict[str, Positive]
    """The paper's numbers by wave case, in m."""


def choice() -> Choice:
    """The nominal star and the paper's numbers."""
    return load_data(Choice, "paper/star.toml")


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """The star in still water and in every sea in every realisation."""
    chosen = choice()
    first = next(realisations(parameters))
    calm = in_still_water(in_sea(first, chosen.case, 0.0))
    named = [(STILL, calm), *((_name(*sea), sea[1]) for sea in seas_of(parameters))]
    return [Run(name, follow, StarRun(one, chosen.path)) for name, one in named]


def seas_of(parameters: ParameterSet) -> Iterator[tuple[str, ParameterSet]]:
    """The wave cases at the star's height, in every realisation."""
    height = choice().significant_height
    for one in realisations(parameters):
        for case in wave_cases():
            yield case, in_sea(one, case, height)


def _name(case: str, parameters: ParameterSet) -> str:
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
    chosen, period, calm = choice(), parameters.nmpc.control_period, arrays[STILL]
    seas = [(case, one.sea.seed, arrays[_name(case, one)]) for case, one in seas_of(parameters)]
    rows = []
    for case, seed, found in [(STILL, None, calm), *seas]:
        for name in CONTROLLERS:
            tips = found[f"{name}_target"], found[f"{name}_tip"], calm[f"{name}_tip"]
            rows.append(
                {
                    "wave": case,
                    "seed": seed,
                    "controller": name,
                    **measures(chosen.path, *tips, period),
                    "paper": chosen.rmse.get(case) if name == CONTROLLER else None,
                    "solves_failed": failed_solves(found, name),
                    "fallbacks": fallbacks(found, name),
                }
            )
    return pd.DataFrame(rows).astype({"seed": "Int64"})


def headline(table: pd.DataFrame) -> pd.DataFrame:
    """Median and 5 and 95 % quantiles over the seas, beside the paper's number.

    Of the table ``star``: one row per wave case, controller and measure; ``seas`` counts the
    realisations.
    """
    waves = table[table.wave != STILL]
    return pd.DataFrame(
        {
            "wave": wave,
            "controller": controller,
            "measure": metric,
            "seas": len(group),
            **interval(group[metric]),
            "paper": group.paper.iloc[0] if metric == "rmse" else None,
        }
        for (wave, controller), group in waves.groupby(["wave", "controller"], sort=False)
        for metric in METRICS
    )


def period_spread(table: pd.DataFrame) -> pd.DataFrame:
    """How much each measure differs between the wave cases, relative to their mean (C68).

    (largest - smallest) / mean over the cases, in each sea; median and quantiles over the
    seas, and the paper's own spread. The seas of one seed share their phases.
    """
    rows = []
    waves = table[table.wave != STILL]
    for controller, group in waves.groupby("controller", sort=False):
        quoted = group.paper.dropna().unique()
        paper = float(np.ptp(quoted) / quoted.mean()) if len(quoted) else None
        for metric in METRICS:
            by_sea = group.pivot_table(index="seed", columns="wave", values=metric)
            rows.append(
                {
                    "controller": controller,
                    "measure": metric,
                    "seas": len(by_sea),
                    **interval(relative_range(by_sea)),
                    "paper": paper if metric == "rmse" else None,
                }
            )
    return pd.DataFrame(rows)


def relative_range(by_sea: pd.DataFrame) -> pd.Series[float]:
    """Largest less smallest over the columns, as a share of their mean."""
    return (by_sea.max(axis=1) - by_sea.min(axis=1)) / by_sea.mean(axis=1)


def _time_scales(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """Time scales of waves and control, and drag against inertia on the moving arm (C69).

    In the first sea, for each controller but the reference. ``inner_loop``: slowest time
    constant of the arm under feed-forward + PD in still water; ``closing``: time in which the
    controller brings the error in still water below 1/e of its first value. Loads as root mean
    square of their norm over the segments.
    """
    calm, period = arrays[STILL], parameters.nmpc.control_period
    first = next(realisations(parameters))
    rows = []
    for case, name in product(choice().rmse, others()):
        peak_period = wave_cases()[case].peak_period
        times = {
            "control_period": period,
            "horizon": period * parameters.nmpc.horizon,
            "inner_loop": inner_loop_time(parameters, calm[f"{name}_q"][-1]),
            "closing": closing_time(calm[f"{name}_tip"] - calm[f"{name}_target"], period),
        }
        loads = {
            kind: root_mean_square_error(
                np.linalg.norm(arrays[_name(case, first)][f"{name}_{kind}"], axis=1)
            )
            for kind in ("drag", "fluid_inertia", "added_mass")
        }
        rows.append(
            {"wave": case, "controller": name, "peak_period": peak_period, **times}
            | {
                f"peak_period_over_{one}": peak_period / times[one]
                for one in ("control_period", "inner_loop", "closing")
            }
            | loads
            | {
                f"drag_over_{kind}": loads["drag"] / loads[kind]
                for kind in ("fluid_inertia", "added_mass")
            }
        )
    return pd.DataFrame(rows)


EXPERIMENT = Experiment(
    name="star",
    title="The star: a path followed in three seas and in still water",
    claims=tuple(f"C{number}" for number in range(61, 70)),
    runs=runs,
    tabulate=tabulate,
)
