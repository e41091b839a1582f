"""What every experiment states: its runs, and the tables made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from numpy.typing import NDArray

from softwave_min.parameters import ParameterSet
from softwave_min.store import Run

__all__ = ["Experiment", "RunArrays", "Tables"]

Tables = Mapping[str, pd.DataFrame]
RunArrays = Mapping[str, Mapping[str, NDArray[Any]]]


def _nothing(_: Run) -> None:
    """Prepare nothing."""


@dataclass(frozen=True)
class Experiment:
    """A set of independent runs and the summary tables made of their results."""

    name: str
    """Stem of its module, results folder and figure module."""
    title: str
    """One line for lists and captions."""
    claims: tuple[str, ...]
    """Ids of the paper's claims that it answers."""
    runs: Callable[[ParameterSet], Sequence[Run]]
    """The runs under a parameter set."""
    tabulate: Callable[[ParameterSet, RunArrays], Tables]
    """Summary tables by stem, from the arrays of all runs by name."""
    prepare: Callable[[Run], object] = _nothing
    """Called once with the first run, before processes share the work: compiles what
    all of them need."""
