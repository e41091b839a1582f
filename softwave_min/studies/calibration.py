r"""Search for the parameter set that comes closest to the paper's numbers.

The paper leaves open what decides its numbers. This is a global search (CMA-ES) within the
ranges of ``data/studies/plausible_ranges.toml`` for the values that minimise

.. math:: \sum_i \rho\big((y_i - y_i^{\text{paper}}) / \sigma_i\big),
   \qquad \rho(e) = 2 (\sqrt{1 + e^2} - 1),

with the numbers and scales of ``data/studies/calibration.toml``. The loss grows
linearly, so that a number which no set can reach does not decide the others. Agreement
found in this way shows that the paper is consistent with the model, and proves no more.

Each evaluation is a run of the store: the search takes the same steps again from those that
are there, and goes on where it was interrupted.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import tomlkit
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.data import ParameterError, data_folder, read_toml
from softwave_min.paper.entries import paper_entry
from softwave_min.parameters import (
    Count,
    ParameterSet,
    Positive,
    Real,
    Seed,
    parameter_set,
    validate,
)
from softwave_min.runs.executor import Executor
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables
from softwave_min.runs.store import Store
from softwave_min.runs.sweep import compute
from softwave_min.studies.cells import headline_cells
from softwave_min.studies.headlines import HeadlineRun, headline_numbers
from softwave_min.studies.ranges import (
    GAIN,
    GRADATION,
    PlausibleRange,
    open_fields,
    plausible_ranges,
    rounded,
    value_in,
    with_values,
)

START = "physical"
"""The set that the search starts from."""
NEAR = 1.0
"""A set counts as about as good as the best if its objective is larger by no more."""
COMMENT = 38
"""Column of the comments in a set's file."""
CALIBRATED_HEADER = """# The calibrated parameter set, made by
# `python -m softwave_min calibrate --write`: the physical set, its open parameters those
# that come closest to the paper's numbers."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Number:
    """One of the paper's numbers."""

    name: str
    claim: str
    paper: Real
    scale: Positive
    at_most: bool = False
    """Whether only what exceeds it counts."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Search:
    """How the search goes and what it compares."""

    seed: Seed
    population: Count
    generations: Count
    first_spread: Positive
    number: tuple[Number, ...]


def search_settings() -> Search:
    """What data/studies/calibration.toml fixes, with the paper's numbers that it refers to."""
    path = data_folder() / "studies" / "calibration.toml"
    entries = read_toml(path)
    for number in entries["number"]:
        number["paper"] = paper_entry(number["paper"])
    return validate(Search, entries, source=path)


# --- parameter sets ---------------------------------------------------------------------


def set_text(text: str, parameters: ParameterSet, fields: Sequence[str]) -> str:
    """TOML text of a set with the given fields replaced; they are marked, other comments stay.

    Raises
    ------
    ParameterError
        If a field does not stand in the text.
    """
    document = tomlkit.parse(text)
    for field in fields:
        section, name = (GAIN if field == GRADATION else field).split(".")
        if name not in document.get(section, {}):
            raise ParameterError(f"{field}: not in the set")
        found = getattr(getattr(parameters, section), name)
        entry = tomlkit.item(list(found) if isinstance(found, tuple) else found)
        entry.comment("open: calibrated")
        written = len(f"{name} = {entry.as_string()} ")
        entry.trivia.comment_ws = " " * (1 + max(COMMENT - written, 0))
        document[section][name] = entry
    return tomlkit.dumps(document)


def best_of(evaluations: pd.DataFrame) -> pd.Series:
    """The evaluation with the least objective."""
    return evaluations.iloc[int(evaluations["objective"].to_numpy().argmin())]


def best_set_text(evaluations: pd.DataFrame, folder: Path) -> str:
    """TOML text of the record's best set: that of the start in ``folder``, with its values."""
    best, fields = best_of(evaluations), open_fields()
    found = with_values(parameter_set(START), {field: float(best[field]) for field in fields})
    text = set_text((folder / f"{START}.toml").read_text(encoding="utf-8"), found, fields)
    return text.replace(f"# The {START} parameter set.", CALIBRATED_HEADER, 1)


def objective(numbers: Mapping[str, float], search: Search) -> float:
    """Distance of the numbers from the paper's."""
    total = 0.0
    for one in search.number:
        excess = (numbers[one.name] - one.paper) / one.scale
        if one.at_most:
            excess = max(excess, 0.0)
        total += 2 * (np.sqrt(1 + excess**2) - 1)
    return float(total)


# --- the search -------------------------------------------------------------------------


def calibrate(store: Store, workers: Executor, search: Search) -> pd.DataFrame:
    """Search, and write the tables ``evaluations`` and ``flatness``; the evaluations.

    Generation 0 is the starting set alone.
    """
    # Imported here: it takes a second, and only the search needs it.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma  # noqa: PLC0415

    values, start = plausible_ranges(), parameter_set(START)
    first = np.array([value.share(value_in(start, value.field)) for value in values])
    strategy = cma.CMAEvolutionStrategy(
        np.clip(first, 0, 1),
        search.first_spread,
        {
            "bounds": [0, 1],
            "seed": search.seed,
            "popsize": search.population,
            "verbose": -9,
            "verb_log": 0,
        },
    )
    runs = [_run("0-0", start)]
    table = _evaluated(runs, store, workers, search)
    for generation in range(1, search.generations + 1):
        population = strategy.ask()
        for index, shares in enumerate(population):
            chosen = {
                value.field: rounded(value.at(share))
                for value, share in zip(values, shares, strict=True)
            }
            runs.append(_run(f"{generation}-{index}", with_values(start, chosen)))
        table = _evaluated(runs, store, workers, search)
        strategy.tell(population, table["objective"].to_list()[-len(population) :])
    return table


def _run(name: str, parameters: ParameterSet) -> Run:
    return Run(name, headline_numbers, HeadlineRun(parameters, headline_cells()))


def _evaluated(
    runs: Sequence[Run], store: Store, workers: Executor, search: Search
) -> pd.DataFrame:
    """The evaluations, of which those that are missing are computed."""
    generation = Experiment(
        name=store.experiment,
        title="Search for the set that comes closest to the paper's numbers",
        claims=tuple(one.claim for one in search.number),
        runs=lambda _: runs,
        tabulate=lambda _, arrays: _tables(runs, search, arrays),
    )
    compute(generation, parameter_set(START), store, workers)
    return store.read_table("evaluations")


def _tables(runs: Sequence[Run], search: Search, arrays: RunArrays) -> Tables:
    rows = []
    for run in runs:
        generation, index = map(int, run.name.split("-"))
        numbers = {name: float(value) for name, value in arrays[run.name].items()}
        failed = int(numbers.pop("solves_failed"))
        rows.append(
            {"generation": generation, "index": index, "objective": objective(numbers, search)}
            | {name: value_in(run.parameters.parameters, name) for name in open_fields()}
            | {**numbers, "solves_failed": failed}
        )
    evaluations = pd.DataFrame(rows)
    return {"evaluations": evaluations, "flatness": flatness(evaluations, plausible_ranges())}


def flatness(evaluations: pd.DataFrame, values: Sequence[PlausibleRange]) -> pd.DataFrame:
    """How far each value may go while the objective stays within ``NEAR`` of the best.

    ``share`` is the width of that interval as a share of the plausible range: near 1, the
    paper's numbers do not pin the value down.
    """
    best = best_of(evaluations)
    near = evaluations[evaluations["objective"] <= best["objective"] + NEAR]
    rows = []
    for value in values:
        low, high = near[value.field].min(), near[value.field].max()
        rows.append(
            {
                "field": value.field,
                "unit": value.unit,
                "range_low": value.low,
                "range_high": value.high,
                "start": evaluations[value.field].iloc[0],
                "best": best[value.field],
                "near_low": low,
                "near_high": high,
                "share": value.share(high) - value.share(low),
                "near": len(near),
            }
        )
    return pd.DataFrame(rows)
