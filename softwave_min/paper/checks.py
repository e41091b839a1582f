"""What comes of a claim's checks: of numbers, parameters, entries of a file, and drawings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import Any, get_args, get_type_hints

from softwave_min.paper.claims import Check
from softwave_min.paper.entries import paper_entry
from softwave_min.paper.queries import Measured, Tables
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store

EQUAL = 1e-9
"""Relative difference of numbers that are the same but for the way they were written."""
HOLDS, WEAKLY, FAILS, UNKNOWN = 2, 1, 0, -1


@dataclass(frozen=True)
class Sources:
    """All that a verdict may rest on."""

    tables: Tables
    parameters: ParameterSet


@dataclass(frozen=True)
class Outcome:
    """What came of a check."""

    check: Check
    level: int
    measured: Measured | None = None
    found: Any = None
    """The parameter or entry that it looked at."""

    @property
    def wanted(self) -> Any:
        """What the paper has; an entry of its tables is what the experiments take from there."""
        return self.found if self.check.entry else self.check.limit

    @property
    def tells(self) -> bool:
        """Whether its number tells a reader something: a count of rows does only if it is due."""
        query = self.check.value or ""
        counts = query.lstrip().startswith("select count(*)")
        return bool(query) and (not counts or self.check.test == "equals")


def outcome(check: Check, sources: Sources) -> Outcome:
    """Check it.

    Raises
    ------
    LookupError
        If there is no such table, row, column or entry.
    """
    if check.value:
        measured = sources.tables.measured(check.value)
        return Outcome(check, _level(check, measured.number), measured)
    if check.figure or check.drawing:
        there = _is_drawn(check.figure, sources) if check.figure else _can_be_drawn(check.drawing)
        return Outcome(check, HOLDS if there else FAILS)
    if check.option:
        options = get_args(_annotation(check.option))
        return Outcome(check, HOLDS if check.limit in options else FAILS, found=check.limit)
    if check.entry:
        return Outcome(check, HOLDS, found=paper_entry(check.entry))
    found: Any = sources.parameters
    for part in check.parameter.split("."):
        found = getattr(found, part)
    return Outcome(check, _level(check, found), found=found)


def _level(check: Check, found: Any) -> int:
    if isinstance(found, float) and math.isnan(found):
        return UNKNOWN
    if _holds(check, found, check.limit):
        return HOLDS
    return WEAKLY if check.weak is not None and _holds(check, found, check.weak) else FAILS


def _holds(check: Check, found: Any, limit: Any) -> bool:
    match check.test:
        case "at_least":
            return bool(found >= limit)
        case "at_most":
            return bool(found <= limit)
        case "one_of":
            return found in limit
    if isinstance(limit, int | float) and not isinstance(limit, bool):
        return math.isclose(found, limit, rel_tol=EQUAL)
    return bool(found == limit)


def _is_drawn(figure: str, sources: Sources) -> bool:
    experiment, stem = figure.split("/")
    store = Store(experiment, sources.tables.root)
    described = stem in store.provenance().get("figures", {})
    return described and (store.folder / f"{stem}.svg").is_file()


def _can_be_drawn(name: str) -> bool:
    """Whether a schematic has its function, and the code every signal that it shows."""
    module = import_module(f"softwave_min.figures.{name}")
    signals = getattr(module, "SIGNALS", ())
    return callable(getattr(module, name, None)) and all(one.exists() for one in signals)


def _annotation(name: str) -> Any:
    """Type of a parameter."""
    kind: Any = ParameterSet
    for part in name.split("."):
        kind = get_type_hints(kind)[part]
    return kind
