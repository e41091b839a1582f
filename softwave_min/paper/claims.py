"""The paper's claims: what is claimed, and what each claim is judged by.

``data/paper/claims.toml`` says of each claim where it stands in the paper, what our number is,
and what must hold; nothing here knows a claim by its name. The paper's numbers stand in the other
files of ``data/paper/``, and a claim names the entry. `softwave_min.paper.verdicts` judges.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from string import Formatter
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, Strict, model_validator
from pydantic.dataclasses import dataclass

from softwave_min.data import ParameterError, data_folder, read_toml
from softwave_min.paper.entries import paper_entry
from softwave_min.paper.queries import Measured, Query, Tables, tables_of
from softwave_min.paper.tolerance import PERCENT, POINTS, SHARE
from softwave_min.parameters import Real, validate

MINUS = "\N{MINUS SIGN}"
NOT_COMPUTED = "(not computed)"
"""Stands in a reason for a number whose table is not there."""

Kind = Literal["number", "trend", "artefact", "explanation"]
Text = Annotated[str, Field(min_length=1)]
Value = Annotated[bool, Strict()] | Annotated[int, Strict()] | Annotated[float, Strict()] | str
"""Of a parameter or an entry; in this order, because True is no 1."""

_FROZEN = ConfigDict(extra="forbid")
_REFERENCE = re.compile(r"\w+:[\w.]+")


class ClaimError(RuntimeError):
    """A claim asks for what the results do not have."""


@dataclass(frozen=True, config=_FROZEN)
class Check:
    """A condition on a number, a parameter, an entry of a file, or a drawing."""

    says: Text
    """What holds if it holds."""
    value: Query | None = None
    parameter: str = ""
    """Dotted name in the parameter set."""
    entry: str = ""
    """``poses:P1``: an entry of a file in ``data/paper/``, which the experiments use."""
    option: str = ""
    """``simulation.integrator``: the parameter can take the value."""
    figure: str = ""
    """``experiment/stem`` of a figure in ``results/``."""
    drawing: str = ""
    """``block_diagram``: a schematic, by the name of its module and function."""
    test: Literal["exists", "equals", "one_of", "at_least", "at_most"] = "exists"
    limit: Value | tuple[Value, ...] | None = None
    weak: Real | None = None
    """The limit with which it still holds weakly."""
    ablation: Annotated[bool, Strict()] = False
    """Whether the cause that an explanation names is taken away, or changed alone, in the runs
    that it looks at."""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        drawn = bool(self.entry or self.figure or self.drawing)
        if drawn + sum(map(bool, (self.value, self.parameter, self.option))) != 1:
            raise ValueError("one of value, parameter, entry, option, figure, drawing")
        if drawn != (self.test == "exists") or drawn != (self.limit is None):
            raise ValueError("a limit, unless it is tested whether an entry or drawing exists")
        if self.weak is not None and self.test not in {"at_least", "at_most"}:
            raise ValueError("a weak limit with 'at_least' and 'at_most' only")
        return self


@dataclass(frozen=True, config=_FROZEN)
class Claim:
    """A statement of the paper, and how it is judged."""

    id: Annotated[str, Field(pattern=r"^C\d\d$")]
    kind: Kind
    place: Text
    """Where in the paper."""
    statement: Text
    """In our words."""
    experiment: str = ""
    """The one that answers it; empty: parameters and drawings do."""
    page: Text = "index"
    """Page of the book that shows it."""
    label: str = ""
    """Of the figure or table there."""
    cell: str = ""
    """Label of the section, or of the output of a cell, that has the answer there."""
    why: str = ""
    """Name of the reason that holds if it is not reproduced or not supported."""
    paper: Real | None = None
    """The paper's number."""
    unit: str = ""
    """Of all its numbers."""
    value: Query | None = None
    """Our number."""
    test: Literal["equals", "at_most"] = "equals"
    """'at_most': the paper's number is a bound."""
    checks: tuple[Check, ...] = ()
    """Of a number: direction and place. Else: all that is claimed."""
    reading: str = ""
    """What the paper leaves open, and how it is read here."""
    missing: str = ""
    """What it would take to decide it."""

    @model_validator(mode="after")
    def _can_be_judged(self) -> Self:
        judged = self.value is not None or bool(self.checks)
        if judged == bool(self.missing):
            raise ValueError("a value or checks, or else what is missing")
        number = self.paper is not None and self.value is not None
        if judged and (self.kind == "number") != number:
            raise ValueError("a number of the paper and one of ours if it is a number, else not")
        if judged and self.kind == "explanation" and not any(one.ablation for one in self.checks):
            raise ValueError("an explanation is tested by an ablation")
        return self

    @property
    def tolerance(self) -> float:
        """How far our number may be off, in the claim's unit; a bound has none."""
        if self.paper is None or self.test == "at_most":
            return 0.0
        return POINTS if self.unit == PERCENT else SHARE * abs(self.paper)

    def in_interval(self, ours: Measured) -> bool:
        """Whether the paper's number lies in our interval over seas, or bounds a part of it."""
        if self.paper is None or not ours.has_interval or ours.low > self.paper:
            return False
        return self.test == "at_most" or self.paper <= ours.high

    def in_wide_interval(self, ours: Measured) -> bool:
        """Whether it lies in an interval that is wider than the tolerance."""
        reach = max(ours.high - ours.number, ours.number - ours.low)
        return self.test == "equals" and self.in_interval(ours) and reach > self.tolerance

    def tables(self) -> set[str]:
        """The tables that it reads."""
        return _tables(self.value, *(check.value for check in self.checks))


class _Shown(float):
    """A number with the ends of its interval; ``%`` has a space before it."""

    low: _Shown
    high: _Shown

    @classmethod
    def of(cls, measured: Measured) -> Self:
        """A number as it was taken from a table."""
        shown, shown.low, shown.high = map(cls, measured)
        return shown

    def __format__(self, specification: str) -> str:
        text = super().__format__(specification)
        return text.replace("-", MINUS).replace("%", " %")


class _NotComputed:
    """Stands for a number whose table is not there."""

    @property
    def low(self) -> Self:
        return self

    high = low

    def __format__(self, _: str) -> str:
        return NOT_COMPUTED


@dataclass(frozen=True, config=_FROZEN)
class Reason:
    """Why claims are not reproduced, or not supported."""

    text: Text
    """In our words; ``{name:.2f}`` is one of the numbers, ``{name.low:.2f}`` the lower end of its
    interval over seas."""
    evidence: Annotated[
        tuple[Annotated[str, Field(pattern=r"^[\w/]+#[\w-]+$")], ...], Field(min_length=1)
    ]
    """What it rests on: ``page#label`` of figures, tables and sections of the book."""
    numbers: dict[str, Query]

    @model_validator(mode="after")
    def _uses_its_numbers(self) -> Self:
        fields = (name for _, name, _, _ in Formatter().parse(self.text) if name is not None)
        used = {name.split(".")[0] for name in fields}
        if used != set(self.numbers):
            odd = ", ".join(sorted(used ^ set(self.numbers)))
            raise ValueError(f"every number in the text, and no other: {odd}")
        return self

    def tables(self) -> set[str]:
        """The tables that its numbers are taken from."""
        return _tables(*self.numbers.values())

    def with_numbers(self, tables: Tables) -> str:
        """The text with its numbers.

        Raises
        ------
        LookupError
            If a table has no such row or column.
        """
        return self.text.format(
            **{
                name: _Shown.of(tables.measured(query)) if tables.has(query) else _NotComputed()
                for name, query in self.numbers.items()
            }
        )


def _tables(*queries: str | None) -> set[str]:
    return {table for query in queries if query for table in tables_of(query)}


@dataclass(frozen=True, config=_FROZEN)
class Claims:
    """``data/paper/claims.toml``."""

    claim: tuple[Claim, ...]
    reason: dict[str, Reason]


def read_claims() -> Claims:
    """The paper's claims in the order of their ids, and why some do not hold.

    Raises
    ------
    ParameterError
        If the file is not valid, an id stands there twice, or a reason is not there.
    """
    path = data_folder() / "paper" / "claims.toml"
    written = read_toml(path)
    stated = [_with_paper_numbers(one) for one in written.get("claim", ())]
    found = validate(Claims, {**written, "claim": stated}, source=path)
    twice = [name for name, count in Counter(one.id for one in found.claim).items() if count > 1]
    if twice:
        raise ParameterError(f"{path}: twice: {', '.join(twice)}")
    for one in found.claim:
        if one.why and one.why not in found.reason:
            raise ParameterError(f"{path}: {one.id}: no reason {one.why!r}")
    return Claims(tuple(sorted(found.claim, key=lambda one: one.id)), found.reason)


def claims() -> tuple[Claim, ...]:
    """The paper's claims, in the order of their ids."""
    return read_claims().claim


def reasons() -> dict[str, Reason]:
    """Why claims are not reproduced, by the names that the claims give."""
    return read_claims().reason


def missing_tables(root: Path, asked: Iterable[Claim] | None = None) -> list[str]:
    """Tables that the claims rest on and that are not in a results folder."""
    wanted = {table for claim in asked or claims() for table in claim.tables()}
    return sorted(name for name in wanted if not (root / f"{name}.csv").is_file())


def _with_paper_numbers(written: dict[str, Any]) -> dict[str, Any]:
    """A claim with the numbers that it refers to, in its statement as well."""
    stated = _looked_up(written, "paper")
    if "paper" in stated:
        stated["statement"] = stated["statement"].format(paper=stated["paper"])
    checks: Iterable[dict[str, Any]] = stated.get("checks", ())
    return stated | {"checks": [_looked_up(check, "limit") for check in checks]}


def _looked_up(table: dict[str, Any], key: str) -> dict[str, Any]:
    place = table.get(key)
    if not isinstance(place, str) or not _REFERENCE.fullmatch(place):
        return dict(table)
    try:
        return table | {key: paper_entry(place)}
    except LookupError:
        raise ParameterError(f"claims.toml: {key}: no entry {place!r} in data/paper") from None
