"""The paper's headline numbers over many random seas: medians and 90 % intervals.

The paper shows one sea per case. Here the grid, the failed middle segment and the star are
run in `SEEDS` seas each (or as many as are asked for), which share nothing but their spectra;
noise differs as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from softwave_min.experiments import actuator_failure, error_ratio, star
from softwave_min.experiments.closed_loop import LoopRun, errors_alone
from softwave_min.experiments.failures import INTACT, PAPERS_CASE
from softwave_min.experiments.places import at_least
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables

SEEDS = 20
"""Random seas, unless the parameters ask for more than one."""
CASES = (INTACT, PAPERS_CASE)


def _distinct(parameters: ParameterSet) -> tuple[list[Run], dict[str, str]]:
    """The runs, each once, and the name of the run for each name that the tables' makers know."""
    many = at_least(parameters, SEEDS)
    failed = [
        actuator_failure.run_at(place, case)
        for place in actuator_failure.places(many)
        for case in CASES
    ]
    named = [(run.name, run) for run in (*error_ratio.runs(many), *failed)]
    named += [(f"star-{run.name}", run) for run in star.runs(many)]
    by_parameters: dict[Any, Run] = {}
    aliases: dict[str, str] = {}
    for name, run in named:
        compute = errors_alone if isinstance(run.parameters, LoopRun) else run.compute
        kept = by_parameters.setdefault(run.parameters, Run(name, compute, run.parameters))
        aliases[name] = kept.name
    return list(by_parameters.values()), aliases


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """Every closed loop that the headline numbers need, once."""
    return _distinct(parameters)[0]


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """The three experiments' tables over all seas, and the headline numbers of each."""
    _, aliases = _distinct(parameters)
    of = {name: arrays[run] for name, run in aliases.items()}
    stars = {name.removeprefix("star-"): of[name] for name in of if name.startswith("star-")}
    many = at_least(parameters, SEEDS)
    grid = error_ratio.grid_table(many, of)
    failure = actuator_failure.grid_table(many, of, CASES)
    followed = star.star_table(many, stars)
    return {
        "error_ratio": grid,
        "actuator_failure": failure,
        "star": followed,
        "reductions": error_ratio.headline(grid),
        "reductions_settled": error_ratio.headline(grid, "settled"),
        "rises": actuator_failure.headline(failure),
        "rise_spread": actuator_failure.spread(failure),
        "star_errors": star.headline(followed),
        "places": _places(grid),
    }


def _places(grid: pd.DataFrame) -> pd.DataFrame:
    """In how many seas the largest and the smallest reduction occur at each pose."""
    found = error_ratio.extremes(grid)
    keys = ["wave", "controller", "extreme", "pose", "paper_pose"]
    table = found.groupby(keys, sort=False).size().reset_index(name="seas")
    table["share"] = table["seas"] / grid["seed"].nunique()
    return table


EXPERIMENT = Experiment(
    name="random_seas",
    title="The headline numbers over twenty random seas",
    claims=(),
    runs=runs,
    tabulate=tabulate,
    on_request=True,
)
