"""States of the actuation: all segments, or one of them passive or locked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from softwave_min.data import ParameterError
from softwave_min.experiments.closed_loop import with_failure
from softwave_min.parameters import ParameterSet

INTACT = "intact"
PAPERS_CASE = "mid_passive"
ORDINALS = ("no", "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")


@dataclass(frozen=True)
class Case:
    """A state of the actuation."""

    segment: int
    """Number of the failed segment, from 1; 0 for none."""
    manner: Literal["passive", "locked"]

    @property
    def words(self) -> str:
        """For legends."""
        return f"{ordinal(self.segment)} segment {self.manner}" if self.segment else "all segments"

    def of(self, parameters: ParameterSet) -> ParameterSet:
        """The parameters with this failure."""
        return with_failure(parameters, self.segment, self.manner)


def ordinal(segment: int) -> str:
    """Number of a segment in words."""
    return ORDINALS[segment] if segment < len(ORDINALS) else f"{segment}th"


def failure_cases(parameters: ParameterSet) -> dict[str, Case]:
    """The intact arm, and each failure of the second segment (``mid``) and of the last (``tip``).

    The paper's is the second of three. Where the second is the last, it is called ``mid``.

    Raises
    ------
    ParameterError
        If the arm has one segment: none is left to move it.
    """
    last = parameters.arm.segments
    if last < 2:
        raise ParameterError("arm.length: a failed segment needs an arm of at least two segments")
    failed: dict[str, int] = {"mid": 2} | ({"tip": last} if last > 2 else {})
    manners: tuple[Literal["passive", "locked"], ...] = ("passive", "locked")
    cases = {f"{name}_{how}": Case(one, how) for how in manners for name, one in failed.items()}
    return {INTACT: Case(0, "passive"), **cases}
