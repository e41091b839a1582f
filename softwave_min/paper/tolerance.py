"""How far a number may be off and still count as the paper's."""

from __future__ import annotations

SHARE = 0.15
"""Of the paper's number; ..."""
POINTS = 3.0
"""... or, of a number in per cent, percentage points."""


def tolerance(paper: float, unit: str) -> float:
    """The widest tolerance of a number, in its unit: the larger of the two."""
    return max(SHARE * abs(paper), POINTS if unit == "%" else 0.0)
