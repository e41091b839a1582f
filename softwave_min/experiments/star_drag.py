"""The star with and without drag: is drag why its error hardly depends on the period (C69)?

An explanation is tested by taking its cause away. The load is the textbook's in both cases,
because the paper's without its drag would be none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import pandas as pd

from softwave_min.experiments.closed_loop import (
    failed_solves,
    fallbacks,
    settled_error,
    whole_error,
)
from softwave_min.experiments.star import choice, seas_of
from softwave_min.experiments.star_loops import StarRun, follow
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables

LOADS = ("with drag", "without drag")


def loaded(parameters: ParameterSet, load: str) -> ParameterSet:
    """The parameters with the textbook's load, whole or without its drag and friction."""
    fluid = replace(parameters.fluid, morison="textbook")
    if load == LOADS[1]:
        fluid = replace(fluid, drag_coefficient=0.0, friction_coefficient=0.0)
    return replace(parameters, fluid=fluid)


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """The nominal star under NMPC in each sea, under each load."""
    path = choice().path
    return [
        Run(name, follow, StarRun(one, path, ("nmpc",))) for name, _, _, one in _cases(parameters)
    ]


def _cases(parameters: ParameterSet) -> Iterator[tuple[str, str, str, ParameterSet]]:
    """Name of the run, load, wave case, and the parameters with both, for every random sea."""
    for load in LOADS:
        for case, one in seas_of(loaded(parameters, load)):
            yield f"{load.replace(' ', '-')}-{case}-{one.sea.seed}", load, case, one


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """One row per load, wave case and sea: RMSE in m, over the run and after the start."""
    table = pd.DataFrame(
        {
            "load": load,
            "wave": case,
            "seed": one.sea.seed,
            "rmse": whole_error(arrays[name], "nmpc"),
            "rmse_settled": settled_error(arrays[name], "nmpc", one.nmpc.control_period),
            "solves_failed": failed_solves(arrays[name], "nmpc"),
            "fallbacks": fallbacks(arrays[name], "nmpc"),
        }
        for name, load, case, one in _cases(parameters)
    )
    return {"star_drag": table}


EXPERIMENT = Experiment(
    name="star_drag",
    title="The star under NMPC with and without drag, in three seas",
    claims=("C69",),
    runs=runs,
    tabulate=tabulate,
    on_request=True,
)
