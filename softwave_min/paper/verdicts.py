"""The verdicts: the paper's claims, judged by the tables in ``results/``.

A verdict is

- of a number: *reproduced* if the paper's number lies in our 90 % interval over random seas, or
  as close to ours as the tolerance says, and everything else that the paper says of it holds;
  *trend reproduced* if only the latter;
- of a trend: *reproduced* if all checks hold, *trend reproduced* if some only hold weakly;
- of an artefact: *regenerated* if it is there and shows what the paper says that it shows;
- of an explanation: *supported* or *not supported*, by runs without the cause that it names;
- *not reproduced* otherwise, and *not decidable* where nothing was computed that could tell.

A claim that is not reproduced or not supported is printed with its reason: our words, with numbers
from the same tables.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, get_args

import pandas as pd

from softwave_min.paper.checks import FAILS, HOLDS, UNKNOWN, WEAKLY, Outcome, Sources, outcome
from softwave_min.paper.claims import (
    Claim,
    ClaimError,
    Kind,
    Reason,
    claims,
    missing_tables,
    read_claims,
    reasons,
)
from softwave_min.paper.queries import Measured, Tables
from softwave_min.paper.tolerance import PERCENT
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store, table_text

FOLDER = "claims"
"""Of the verdicts, below ``results/``, and the stem of their table."""
DIGITS = 6
"""Significant digits of the numbers in the table of verdicts."""

Verdict = Literal[
    "reproduced",
    "regenerated",
    "supported",
    "trend reproduced",
    "not reproduced",
    "not supported",
    "not decidable",
]
FAILED: tuple[Verdict, ...] = ("not reproduced", "not supported")
"""Verdicts that need a reason."""
_SAID = {WEAKLY: "holds weakly", FAILS: "does not hold", UNKNOWN: "no number for"}


@dataclass(frozen=True)
class _Judged:
    """A claim with all that was found."""

    claim: Claim
    outcomes: Sequence[Outcome]
    ours: Measured
    """Our number: that of the claim, or else of the first check that has one to tell."""

    @cached_property
    def level(self) -> int:
        """The least of its checks: one that fails decides, whatever is unknown."""
        levels = {one.level for one in self.outcomes}
        return FAILS if FAILS in levels else min(levels, default=HOLDS)

    @cached_property
    def distance(self) -> float:
        """How far our number is from the paper's, on the wrong side if that is a bound."""
        if self.claim.paper is None:
            return math.nan
        away = self.ours.number - self.claim.paper
        return away if self.claim.test == "at_most" else abs(away)

    @property
    def agrees(self) -> bool:
        """Whether the paper's number is ours."""
        return self.claim.in_interval(self.ours) or self.distance <= self.claim.tolerance

    @property
    def verdict(self) -> Verdict:
        kind, level = self.claim.kind, self.level
        unknown = kind == "number" and math.isnan(self.distance)
        if self.claim.missing or unknown or level == UNKNOWN:
            return "not decidable"
        if kind == "explanation":
            return "supported" if level == HOLDS else "not supported"
        if level == HOLDS and kind == "artefact":
            return "regenerated"
        if level == HOLDS and (kind == "trend" or self.agrees):
            return "reproduced"
        partly = level == (HOLDS if kind == "number" else WEAKLY) and bool(self.outcomes)
        return "trend reproduced" if partly and kind != "artefact" else "not reproduced"

    @property
    def note(self) -> str:
        """How it is read, and what decided."""
        said = (
            f"{_SAID[one.level]}: {one.check.says}" for one in self.outcomes if one.level != HOLDS
        )
        missing = f"missing: {self.claim.missing}" if self.claim.missing else ""
        return _sentences(self.claim.reading, missing, *self._agreement(), *said)

    def _agreement(self) -> Iterator[str]:
        claim = self.claim
        if claim.paper is None:
            return
        inside, distance = claim.in_interval(self.ours), _amount(self.distance, claim)
        if claim.test == "at_most":
            beyond = f"{distance} beyond the bound"
            beyond += ", which lies in the interval over seas" * inside
            yield beyond if self.distance > claim.tolerance else "the bound is kept"
        elif inside:
            yield "the paper's number lies in the interval over seas"
            if claim.in_wide_interval(self.ours):
                tolerance = _amount(claim.tolerance, claim)
                yield f"that interval is wider than the tolerance of {tolerance}"
        else:
            yield f"{distance} off; the tolerance is {_amount(claim.tolerance, claim)}"

    @property
    def row(self) -> dict[str, Any]:
        """What the table has of it."""
        claim = self.claim
        compared = self._compared()
        paper = "; ".join(_shown(one.wanted) for one in compared)
        ours = "; ".join(_shown(one.found) for one in compared if one.found is not None)
        if claim.paper is not None:
            paper = "< " * (claim.test == "at_most") + _shown(claim.paper)
        if not ours and (claim.value or self._told()):
            ours = _shown(self.ours.number)
        return {
            "id": claim.id,
            "kind": claim.kind,
            "paper_value": paper,
            "our_value": ours,
            "unit": claim.unit,
            "low": float(_shown(self.ours.low)),
            "high": float(_shown(self.ours.high)),
            "verdict": self.verdict,
            "experiment": claim.experiment,
            "note": self.note,
        }

    def _told(self) -> list[Outcome]:
        return [one for one in self.outcomes if one.tells]

    def _compared(self) -> list[Outcome]:
        """Checks of inputs, or else the first if it asks for equality: they have the paper's."""
        inputs = [one for one in self.outcomes if one.found is not None]
        if inputs or self.claim.value:
            return inputs
        return [one for one in self._told()[:1] if one.check.test == "equals"]


def _amount(number: float, claim: Claim) -> str:
    unit = "points" if claim.unit == PERCENT else claim.unit
    return f"{number:.3g} {unit}".strip()


def _sentences(*parts: str) -> str:
    return " ".join(f"{part[0].upper()}{part[1:].rstrip('.')}." for part in parts if part)


def _shown(entry: Any) -> str:
    if isinstance(entry, tuple | list):
        return f"({', '.join(_shown(one) for one in entry)})"
    return f"{entry:.{DIGITS}g}" if isinstance(entry, float) else str(entry)


def _judge(claim: Claim, sources: Sources) -> _Judged:
    try:
        outcomes = [outcome(check, sources) for check in claim.checks]
        told = (one.measured for one in outcomes if one.tells and one.measured)
        ours = sources.tables.measured(claim.value) if claim.value else next(told, None)
    except LookupError as error:
        raise ClaimError(f"{claim.id}: {error.args[0]}") from None
    return _Judged(claim, outcomes, ours or Measured(math.nan))


# --- the table --------------------------------------------------------------------------


def evaluate(
    root: Path, parameters: ParameterSet, asked: Sequence[Claim] | None = None
) -> pd.DataFrame:
    """Judge every claim.

    Parameters
    ----------
    root : Path
        The results: ``results/``, or the folder that stands for it.
    parameters : ParameterSet
        Those that the results were computed with.
    asked : sequence of Claim, optional
        The paper's, unless others are given.

    Returns
    -------
    DataFrame
        One row per claim: ``id``, ``kind``, ``paper_value``, ``our_value``, ``unit``, the
        90 % interval over random seas from ``low`` to ``high``, ``verdict``,
        ``experiment``, ``note``, and ``why`` where it is not reproduced or not supported.

    Raises
    ------
    ClaimError
        If a table, a row or a column that a claim needs is not there.
    """
    asked = claims() if asked is None else asked
    if absent := missing_tables(root, asked):
        raise ClaimError(f"claims: not computed: {', '.join(f'{name}.csv' for name in absent)}")
    sources = Sources(Tables(root), parameters)
    judged, known = [_judge(claim, sources) for claim in asked], reasons()
    return pd.DataFrame([one.row | {"why": _why(one, known, sources.tables)} for one in judged])


def _why(judged: _Judged, known: Mapping[str, Reason], tables: Tables) -> str:
    """Reason of a claim that fails and has one."""
    name = judged.claim.why
    if judged.verdict not in FAILED or not name:
        return ""
    try:
        return known[name].with_numbers(tables)
    except LookupError as error:
        raise ClaimError(f"{judged.claim.id}: reason {name!r}: {error.args[0]}") from None


def unexplained(table: pd.DataFrame) -> list[str]:
    """Ids of the claims that are not reproduced or not supported, and have no reason."""
    failed = table["verdict"].isin(FAILED) & (table["why"] == "")
    return list(table["id"][failed])


def summary(table: pd.DataFrame) -> str:
    """How many claims have which verdict, a line for each kind."""
    lines = []
    for kind in get_args(Kind):
        counts = table[table["kind"] == kind]["verdict"].value_counts()
        found = (f"{counts[one]} {one}" for one in get_args(Verdict) if one in counts)
        lines.append(f"{kind:12} {', '.join(found)}")
    return "\n".join(lines)


# --- on disk ----------------------------------------------------------------------------


def write(table: pd.DataFrame, root: Path) -> Path:
    """Write the verdicts with what they came from; the table's path."""
    store, file = Store(FOLDER, root), read_claims()
    readers: list[Claim | Reason] = [*file.claim, *file.reason.values()]
    named = sorted({table for one in readers for table in one.tables()})
    paths = {name: root / f"{name}.csv" for name in named}
    store.write_table(FOLDER, table)
    store.write_provenance(
        {
            "tables": {
                name: sha256(path.read_bytes()).hexdigest()
                for name, path in paths.items()
                if path.is_file()
            },
        }
    )
    return verdicts_path(root)


def verdicts_path(root: Path) -> Path:
    """Table of the verdicts in a results folder."""
    return Store(FOLDER, root).folder / f"{FOLDER}.csv"


def are_fresh(root: Path, parameters: ParameterSet) -> bool:
    """Whether the verdicts in a results folder are those of the tables beside them."""
    try:
        written = verdicts_path(root).read_text(encoding="utf-8")
        return written == table_text(evaluate(root, parameters))
    except (OSError, ClaimError):
        return False
