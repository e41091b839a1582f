"""The sets that the study judges: its settings, and how they sample the open parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated
from SALib.sample import morris
from scipy.stats import qmc

from softwave_min.experiments.places import in_realisation
from softwave_min.parameters import Count, Positive, Seed, load_data, parameter_set
from softwave_min.runs.experiment import Run
from softwave_min.studies.cells import headline_cells, with_bounded_solves
from softwave_min.studies.headlines import HeadlineRun, attempted_numbers
from softwave_min.studies.ranges import (
    open_fields,
    plausible_ranges,
    rounded,
    value_in,
    with_values,
)
from softwave_min.studies.sensitivity.emulator import problem_in_shares

Floats = NDArray[np.float64]

SEA = "random_sea"
"""The factor beside the open parameters: by how much the seeds of the sea and of the preview's
noise exceed those of the base set."""
DRAWN = ALONE, ALL, OTHER_SEA = "important", "all", "all_other_sea"
"""What is drawn: the important values, all of them, or all of them and a sea not seen before."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Screening:
    """How elementary effects are sampled."""

    trajectories: Count
    candidates: Count
    levels: Count
    resamples: Count


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Design:
    """What the emulators are fitted to, and how."""

    sets: Count
    degrees: tuple[Count, ...]
    resamples: Count
    indices_sample: Count


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Study:
    """What data/studies/sensitivity.toml fixes."""

    seed: Seed
    base: str
    confidence: Positive
    important: Count
    """How many values count as important."""
    draws: Count
    """Sets on which the conclusion is tested."""
    screening: Screening
    design: Design

    def generator(self, step: int) -> np.random.Generator:
        """Random numbers of one step of the study."""
        return np.random.default_rng([self.seed, step])

    @property
    def quantiles(self) -> tuple[float, float]:
        """Ends of an interval of the confidence asked for."""
        return (1 - self.confidence) / 2, (1 + self.confidence) / 2


def study_settings() -> Study:
    """How the study goes."""
    return load_data(Study, "studies/sensitivity.toml")


@dataclass(frozen=True)
class Sample:
    """A set to be judged."""

    name: str
    values: Mapping[str, float] = field(hash=False)
    """Of all open fields."""
    sea: int = 0
    """Offset of the seeds."""
    drawn: str = ""

    def run(self, settings: Study) -> Run:
        """Its run: the base set with these values, in this sea."""
        parameters = with_bounded_solves(with_values(parameter_set(settings.base), self.values))
        parameters = in_realisation(parameters, self.sea)
        return Run(self.name, attempted_numbers, HeadlineRun(parameters, headline_cells()))


def screening(settings: Study) -> list[Sample]:
    """Trajectories through the levels of all values and seas.

    A level is the middle of one of as many equal parts of the range: the corners of all
    ranges at once, where many closed loops are unstable, stand for none of them.
    """
    chosen = settings.screening
    fields = open_fields()
    grid = morris.sample(
        problem_in_shares(len(fields) + 1),
        chosen.candidates,
        num_levels=chosen.levels,
        optimal_trajectories=chosen.trajectories,
        seed=settings.seed,
    )
    found = []
    for index, row in enumerate(np.round(grid * (chosen.levels - 1))):
        values = _values(settings, fields, (row[:-1] + 0.5) / chosen.levels)
        found.append(Sample(f"screening-{index:03d}", values, int(row[-1])))
    return found


def design(settings: Study, fields: Sequence[str]) -> list[Sample]:
    """Sets that fill the ranges of the given values: a scrambled Sobol sequence."""
    sequence = qmc.Sobol(len(fields), rng=settings.generator(1))
    return [
        Sample(f"design-{index:03d}", _values(settings, fields, row))
        for index, row in enumerate(sequence.random(settings.design.sets))
    ]


def draws(settings: Study, fields: Sequence[str]) -> list[Sample]:
    """Draws of all values, each judged three times: so that one sees whence an error comes.

    With the values of ``fields`` alone, the others those of the base set; with all; and with
    all in a sea that is none of the screening's.
    """
    every = open_fields()
    shares = settings.generator(2).random((settings.draws, len(every)))
    found = []
    for index, row in enumerate(shares):
        alone = _values(settings, fields, [row[every.index(one)] for one in fields])
        whole = _values(settings, every, row)
        unseen = settings.screening.levels + index
        for drawn, values, sea in ((ALONE, alone, 0), (ALL, whole, 0), (OTHER_SEA, whole, unseen)):
            found.append(Sample(f"draw-{index:03d}-{drawn}", values, sea, drawn))
    return found


def _values(
    settings: Study, fields: Sequence[str], shares: Sequence[float] | Floats
) -> dict[str, float]:
    """All open parameters: those of the base set, but for the given fields at shares of a range."""
    base = parameter_set(settings.base)
    of = dict(zip(fields, shares, strict=True))
    return {
        value.field: rounded(value.at(float(of[value.field])))
        if value.field in of
        else value_in(base, value.field)
        for value in plausible_ranges()
    }
