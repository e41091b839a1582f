r"""Search for the parameter set that comes closest to the paper's numbers.

The paper leaves open what decides its numbers. This is a global search (CMA-ES) within the
ranges of ``data/parameters/open_values.toml`` for the values that minimise

.. math:: \sum_i \rho\big((y_i - y_i^{\text{paper}}) / \sigma_i\big),
   \qquad \rho(e) = 2 (\sqrt{1 + e^2} - 1),

with the numbers and scales of ``data/parameters/calibration.toml``. The loss grows
linearly, so that a number which no set can reach does not decide the others. Agreement
found in this way shows that the paper is consistent with the model, and proves no more.

Each evaluation is a run of the store: the search takes the same steps again from those that
are there, and goes on where it was interrupted.
"""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.experiments import Experiment
from softwave_min.experiments import star as star_experiment
from softwave_min.experiments.closed_loop import (
    Controller,
    LoopRun,
    in_sea,
    prepare,
    scenario_of,
    simulated,
    with_failure,
)
from softwave_min.experiments.experiment import RunArrays, Tables
from softwave_min.experiments.paper import poses, wave_cases
from softwave_min.parameters import (
    Count,
    ParameterError,
    ParameterSet,
    Positive,
    Real,
    Seed,
    data_folder,
    parameter_set,
    read_toml,
    validate,
)
from softwave_min.simulation import root_mean_square_error
from softwave_min.store import Run, Store
from softwave_min.sweep import compute
from softwave_min.workers import Workers

__all__ = [
    "START",
    "Candidate",
    "Number",
    "OpenValue",
    "Search",
    "best_set_text",
    "calibrate",
    "evaluate",
    "flatness",
    "objective",
    "open_values",
    "search_settings",
    "set_text",
    "value_in",
    "with_values",
]

Floats = NDArray[np.float64]

START = "physical"
"""The set that the search starts from."""
GRADATION = "gradation"
"""Ratio of the proportional gains of neighbouring segments, base over tip."""
GAIN = "baseline.proportional_gain"
NEAR = 1.0
"""A set counts as about as good as the best if its objective is larger by no more."""
SIGNIFICANT_DIGITS = 4
COMMENT = 38
"""Column of the comments in a set's file."""
CALIBRATED_HEADER = """# The calibrated parameter set, made by
# `python -m softwave_min calibrate --write`: the physical set with those of its open values
# that come closest to the paper's numbers."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class OpenValue:
    """A value that the paper does not state."""

    field: str
    """Section and name in the parameter set, or 'gradation'."""
    symbol: str
    unit: str
    low: Positive
    high: Positive
    scale: Literal["linear", "log"]
    ambiguity: str
    argument: str
    """Why the range is plausible."""

    def at(self, share: float) -> float:
        """Value at a share of the range, 0 to 1."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + share * (self.high - self.low))

    def share(self, value: float) -> float:
        """Share of the range at a value."""
        if self.scale == "log":
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)


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
    """What data/parameters/calibration.toml fixes."""

    seed: Seed
    population: Count
    generations: Count
    first_spread: Positive
    grid: tuple[tuple[str, Positive], ...]
    """Cells, pose and significant height in m, that stand for the whole grid."""
    failure_poses: tuple[str, ...]
    failure_heights: tuple[Positive, ...]
    failed_segment: Count
    number: tuple[Number, ...]


@dataclass(frozen=True)
class Candidate:
    """A parameter set to be judged."""

    parameters: ParameterSet
    search: Search


def open_values() -> tuple[OpenValue, ...]:
    """The values that are searched, with their ranges."""
    path = data_folder() / "parameters" / "open_values.toml"
    return validate(dict[str, tuple[OpenValue, ...]], read_toml(path), source=path)["value"]


def search_settings() -> Search:
    """How the search goes and what it compares."""
    path = data_folder() / "parameters" / "calibration.toml"
    return validate(Search, read_toml(path), source=path)


# --- parameter sets ---------------------------------------------------------------------


def value_in(parameters: ParameterSet, field: str) -> float:
    """Value of an open field: that of a plain number, or the geometric mean over segments."""
    if field == GRADATION:
        gains = parameters.baseline.proportional_gain
        return float((gains[0] / gains[-1]) ** (1 / max(len(gains) - 1, 1)))
    section, name = field.split(".")
    found = getattr(getattr(parameters, section), name)
    if isinstance(found, tuple):
        return float(found[0] if len(set(found)) == 1 else np.exp(np.mean(np.log(found))))
    return float(found)


def with_values(parameters: ParameterSet, values: Mapping[str, float]) -> ParameterSet:
    """The parameters with other values of open fields, alike in all segments.

    The proportional gains fall geometrically from the base to the tip by ``gradation``.
    """
    for field, value in values.items():
        if field == GRADATION:
            continue
        section, name = field.split(".")
        part = getattr(parameters, section)
        entry: Any = value
        if isinstance(getattr(part, name), tuple):
            entry = (value,) * parameters.arm.segments
        parameters = replace(parameters, **{section: replace(part, **{name: entry})})
    if GRADATION in values or GAIN in values:
        steps = (parameters.arm.segments - 1) / 2 - np.arange(parameters.arm.segments)
        ratio = values.get(GRADATION, 1.0)
        gains = tuple(_rounded(value_in(parameters, GAIN) * ratio**step) for step in steps)
        parameters = replace(
            parameters, baseline=replace(parameters.baseline, proportional_gain=gains)
        )
    return parameters


def _rounded(value: float) -> float:
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")


def set_text(text: str, parameters: ParameterSet, fields: Sequence[str]) -> str:
    """TOML text of a set with the given fields replaced; they are marked, other comments stay.

    Raises
    ------
    ParameterError
        If a field has no line of its own in the text.
    """
    for field in fields:
        section, name = (GAIN if field == GRADATION else field).split(".")
        found = getattr(getattr(parameters, section), name)
        entry = f"[{', '.join(map(repr, found))}]" if isinstance(found, tuple) else repr(found)
        line = re.compile(rf"(\[{section}\]\n(?:(?!\[)[^\n]*\n)*?)({name} = )[^\n]*")
        match = line.search(text)
        if match is None:
            raise ParameterError(f"{field}: no such line in the set")
        written = f"{match[2]}{entry}".ljust(COMMENT) + "# open: calibrated"
        text = f"{text[: match.start()]}{match[1]}{written}{text[match.end() :]}"
    return text


def best_set_text(evaluations: pd.DataFrame, folder: Path) -> str:
    """TOML text of the best set of the record: that of the starting set in ``folder``, with
    the values found.
    """
    best = evaluations.iloc[int(evaluations["objective"].to_numpy().argmin())]
    fields = [value.field for value in open_values()]
    found = with_values(parameter_set(START), {field: float(best[field]) for field in fields})
    text = set_text((folder / f"{START}.toml").read_text(encoding="utf-8"), found, fields)
    return text.replace(f"# The {START} parameter set.", CALIBRATED_HEADER, 1)


# --- one evaluation ---------------------------------------------------------------------


def evaluate(candidate: Candidate) -> dict[str, NDArray[Any]]:
    """The numbers of a candidate by name, and the solves that did not converge."""
    tally = _Tally()
    numbers: dict[str, float] = {}
    ratios: dict[str, list[float]] = {}
    for case in wave_cases():
        ratios[case] = list(_ratios(candidate, case, tally))
        numbers[f"largest_reduction_{case}"] = 100 * (1 - min(ratios[case]))
        numbers[f"lowest_reduction_{case}"] = 100 * (1 - max(ratios[case]))
        numbers[f"rise_{case}"] = float(np.mean(list(_rises(candidate, case, tally))))
        numbers[f"star_{case}"] = _star_error(candidate, case, tally)
    rises = [numbers[f"rise_{case}"] for case in wave_cases()]
    numbers["rise"] = float(np.mean(rises))
    numbers["rise_spread"] = max(rises) - min(rises)
    numbers["cells_below_one"] = 100 * float(np.mean(np.concatenate(list(ratios.values())) < 1))
    found: dict[str, NDArray[Any]] = {name: np.array(value) for name, value in numbers.items()}
    return {**found, "solves_failed": np.array(tally.failed)}


@dataclass
class _Tally:
    """Closed loops so far, each run once, and the solves that did not converge."""

    failed: int = 0
    errors: dict[tuple[LoopRun, Controller], float] = dataclasses.field(default_factory=dict)

    def error(self, run: LoopRun, controller: Controller) -> float:
        """RMSE of a closed loop over the whole run, in m."""
        key = (run, controller)
        if key not in self.errors:
            loop = simulated(scenario_of(run), controller)
            self.failed += int(np.count_nonzero(loop.status > 0))
            self.errors[key] = root_mean_square_error(loop.error)
        return self.errors[key]


def _ratios(candidate: Candidate, case: str, tally: _Tally) -> Iterator[float]:
    for pose, height in candidate.search.grid:
        run = LoopRun(in_sea(candidate.parameters, case, height), (poses()[pose],))
        yield tally.error(run, "nmpc") / tally.error(run, "baseline")


def _rises(candidate: Candidate, case: str, tally: _Tally) -> Iterator[float]:
    search = candidate.search
    for height in search.failure_heights:
        intact = in_sea(candidate.parameters, case, height)
        failed = with_failure(intact, search.failed_segment, "passive")
        for pose in search.failure_poses:
            run = LoopRun(intact, (poses()[pose],))
            before = tally.error(run, "nmpc")
            yield 100 * (tally.error(replace(run, parameters=failed), "nmpc") / before - 1)


def _star_error(candidate: Candidate, case: str, tally: _Tally) -> float:
    chosen = star_experiment.choice()
    parameters = in_sea(candidate.parameters, case, chosen.significant_height)
    loop = simulated(star_experiment.scenario_of(parameters, chosen.path), "nmpc")
    tally.failed += int(np.count_nonzero(loop.status > 0))
    return root_mean_square_error(loop.error)


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


def calibrate(store: Store, workers: Workers, search: Search) -> pd.DataFrame:
    """Search, and write the tables ``evaluations`` and ``flatness``; the evaluations.

    Generation 0 is the starting set alone.
    """
    # Imported here: it takes a second, and only the search needs it.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma  # noqa: PLC0415

    values, start = open_values(), parameter_set(START)
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
    runs = [Run("0-0", evaluate, Candidate(start, search))]
    table = _evaluated(runs, store, workers, search)
    for generation in range(1, search.generations + 1):
        shares = strategy.ask()
        runs += [
            Run(f"{generation}-{index}", evaluate, Candidate(_at(one, start, values), search))
            for index, one in enumerate(shares)
        ]
        table = _evaluated(runs, store, workers, search)
        strategy.tell(shares, table["objective"].to_list()[-len(shares) :])
    return table


def _at(shares: Floats, start: ParameterSet, values: Sequence[OpenValue]) -> ParameterSet:
    chosen = {
        value.field: _rounded(value.at(share)) for value, share in zip(values, shares, strict=True)
    }
    return with_values(start, chosen)


def _evaluated(runs: Sequence[Run], store: Store, workers: Workers, search: Search) -> pd.DataFrame:
    """The evaluations, of which those that are missing are computed."""
    generation = Experiment(
        name=store.experiment,
        title="Search for the set that comes closest to the paper's numbers",
        claims=tuple(one.claim for one in search.number),
        runs=lambda _: runs,
        tabulate=lambda _, arrays: _tables(runs, search, arrays),
        prepare=_prepare,
    )
    compute(generation, parameter_set(START), store, workers)
    return store.read_table("evaluations")


def _prepare(run: Run) -> None:
    target = (next(iter(poses().values())),)
    prepare(Run(run.name, run.compute, LoopRun(run.parameters.parameters, target)))


def _tables(runs: Sequence[Run], search: Search, arrays: RunArrays) -> Tables:
    rows: list[dict[str, float | int]] = []
    for run in runs:
        generation, index = map(int, run.name.split("-"))
        numbers = {name: float(value) for name, value in arrays[run.name].items()}
        failed = int(numbers.pop("solves_failed"))
        rows.append(
            {
                "generation": generation,
                "index": index,
                "objective": objective(numbers, search),
                **{
                    value.field: value_in(run.parameters.parameters, value.field)
                    for value in open_values()
                },
                **numbers,
                "solves_failed": failed,
            }
        )
    evaluations = pd.DataFrame(rows)
    return {"evaluations": evaluations, "flatness": flatness(evaluations, open_values())}


def flatness(evaluations: pd.DataFrame, values: Sequence[OpenValue]) -> pd.DataFrame:
    """How far each value may go while the objective stays within ``NEAR`` of the best.

    ``share`` is the width of that interval as a share of the plausible range: near 1, the
    paper's numbers do not pin the value down.
    """
    objectives = evaluations["objective"].to_numpy(float)
    best = evaluations.iloc[int(objectives.argmin())]
    near = evaluations[objectives <= objectives.min() + NEAR]
    rows = []
    for value in values:
        low, high = float(near[value.field].min()), float(near[value.field].max())
        rows.append(
            {
                "field": value.field,
                "unit": value.unit,
                "range_low": value.low,
                "range_high": value.high,
                "start": float(evaluations[value.field].iloc[0]),
                "best": float(best[value.field]),
                "near_low": low,
                "near_high": high,
                "share": value.share(high) - value.share(low),
                "near": len(near),
            }
        )
    return pd.DataFrame(rows)
