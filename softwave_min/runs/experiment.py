"""What every experiment states: its runs, and the tables made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from softwave_min.parameters import ParameterSet
from softwave_min.runs.identity import run_identity

if TYPE_CHECKING:
    import pandas as pd

Arrays = Mapping[str, NDArray[Any]]
Tables = Mapping[str, "pd.DataFrame"]
RunArrays = Mapping[str, Arrays]


@dataclass(frozen=True)
class Run:
    """One independent computation: a function of its parameters alone."""

    name: str
    """Unique in its experiment; letters, digits, '-' and '_'."""
    compute: Callable[[Any], Arrays]
    """Module-level function from the parameters to named arrays."""
    parameters: Any = field(hash=False)
    """Frozen dataclass: all that the function reads, seeds included."""

    @cached_property
    def identity(self) -> str:
        """Hash over what determines the run."""
        return run_identity(self.compute, self.parameters).digest


@dataclass(frozen=True)
class Tolerance:
    """How far a number may be off and count as reproduced: by the larger of the two."""

    relative: float = 1e-4
    absolute: float = 1e-6


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
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)
    """Within which a column of its tables is reproduced on another machine, by
    ``column`` or, for one table alone, ``table.column``. Elsewhere a number with a
    fraction has `Tolerance()`, which leaves room for other processors and compilers;
    whole numbers and text must be equal."""
    on_request: bool = False
    """Whether it is computed only when named: it takes longer than a reader waits."""
