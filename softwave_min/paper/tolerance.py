"""How far a number may be off from the paper's and still count as reproduced."""

from __future__ import annotations

SHARE = 0.15
"""Largest tolerance of a number, as a share of the paper's; or, where that is wider, ..."""
POINTS = 3.0
"""... in percentage points."""
PERCENT = "%"


def tolerance(paper: float, unit: str) -> float:
    """Widest tolerance of one of the paper's numbers, in its ``unit``."""
    return max(SHARE * abs(paper), POINTS if unit == PERCENT else 0.0)
