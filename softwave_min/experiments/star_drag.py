"""The star with and without drag: is drag why its error hardly depends on the period (C69)?

An explanation is tested by taking its cause away. The load is the textbook's in both cases,
because the paper's without its drag would be none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd
from numpy.typing import NDArray

from softwave_min.experiments.closed_loop import (
    failed_solves,
    fallbacks,
    prepare,
    settled_error,
    summary_arrays,
    whole_error,
)
from softwave_min.experiments.places import in_sea, realisations
from softwave_min.experiments.star import StarRun, choice, scenario_of
from softwave_min.paper.cases import wave_cases
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables
from softwave_min.simulation import simulate

LOADS = ("with drag", "without drag")


def loaded(parameters: ParameterSet, load: str) -> ParameterSet:
    """The parameters with the textbook's load, whole or without its drag and friction."""
    fluid = replace(parameters.fluid, morison="textbook")
    if load == LOADS[1]:
        fluid = replace(fluid, drag_coefficient=0.0, friction_coefficient=0.0)
    return replace(parameters, fluid=fluid)


def follow(run: StarRun) -> dict[str, NDArray[Any]]:
    """Follow the star under NMPC; what ``nmpc`` is ``judged`` by."""
    return summary_arrays(simulate(scenario_of(run.parameters, run.star), "nmpc"), "nmpc")


def _cases(parameters: ParameterSet) -> Iterator[tuple[str, str, ParameterSet]]:
    """Load, wave case, and the parameters with both, for every random sea."""
    height = choice().significant_height
    for one in realisations(parameters):
        for load in LOADS:
            for case in wave_cases():
                yield load, case, in_sea(loaded(one, load), case, height)


def _name(load: str, case: str, parameters: ParameterSet) -> str:
    return f"{load.replace(' ', '-')}-{case}-{parameters.sea.seed}"


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """The nominal star in each sea, under each load."""
    path = choice().path
    return [
        Run(_name(load, case, one), follow, StarRun(one, path))
        for load, case, one in _cases(parameters)
    ]


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """One row per load, wave case and sea: RMSE in m, over the run and after the start."""
    period = parameters.nmpc.control_period
    rows = []
    for load, case, one in _cases(parameters):
        found = arrays[_name(load, case, one)]
        rows.append(
            {
                "load": load,
                "wave": case,
                "seed": one.sea.seed,
                "rmse": whole_error(found, "nmpc"),
                "rmse_settled": settled_error(found, "nmpc", period),
                "solves_failed": failed_solves(found, "nmpc"),
                "fallbacks": fallbacks(found, "nmpc"),
            }
        )
    return {"star_drag": pd.DataFrame(rows)}


EXPERIMENT = Experiment(
    name="star_drag",
    title="The star under NMPC with and without drag, in three seas",
    claims=("C69",),
    runs=runs,
    tabulate=tabulate,
    prepare=prepare,
    on_request=True,
)
