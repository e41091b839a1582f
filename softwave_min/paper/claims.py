"""The paper's claims, judged by the tables in ``results/``.

``data/paper/claims.toml`` says of each claim where it stands in the paper, what our number is
and how far it may be off; nothing here knows a claim by its name. A verdict is

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
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from string import Formatter
from typing import Annotated, Any, Literal, Self, get_args, get_type_hints

import pandas as pd
from pydantic import ConfigDict, Field, Strict, model_validator
from pydantic.dataclasses import dataclass as validated

from softwave_min.data import ParameterError, data_folder, read_toml
from softwave_min.paper.queries import Entry, Measured, Query, Tables
from softwave_min.parameters import NonNegative, ParameterSet, Real, validate
from softwave_min.runs.source import source_digest
from softwave_min.runs.store import Store, table_text

FOLDER = "claims"
"""Of the verdicts, below ``results/``, and the stem of their table."""
WIDEST_SHARE = 0.15
"""Largest tolerance of a number, as a share of the paper's; or, where that is wider, ..."""
WIDEST_POINTS = 3.0
"""... in percentage points."""
PERCENT = "%"
EQUAL = 1e-9
"""Relative difference of numbers that are the same but for the way they were written."""
DIGITS = 6
"""Significant digits of the numbers in the table of verdicts."""
MINUS = "\N{MINUS SIGN}"
NOT_COMPUTED = "(not computed)"
"""Stands in a reason for a number whose table is not there."""

Kind = Literal["number", "trend", "artefact", "explanation"]
Verdict = Literal[
    "reproduced",
    "trend reproduced",
    "regenerated",
    "supported",
    "not reproduced",
    "not supported",
    "not decidable",
]
FAILED: tuple[Verdict, ...] = ("not reproduced", "not supported")
"""Verdicts that need a reason."""
Text = Annotated[str, Field(min_length=1)]

_FROZEN = ConfigDict(extra="forbid")


class ClaimError(RuntimeError):
    """A claim asks for what the results do not have."""


@validated(frozen=True, config=_FROZEN)
class Check:
    """A condition on a number, a parameter, an entry of a file, or a drawing."""

    says: Text
    """What holds if it holds."""
    value: Query | None = None
    parameter: str = ""
    """Dotted name in the parameter set."""
    entry: str = ""
    """``paper/poses.toml:P1``: an entry of a file in ``data/``."""
    option: str = ""
    """``simulation.integrator``: the parameter can take the value."""
    figure: str = ""
    """``experiment/stem`` of a figure in ``results/``."""
    drawing: str = ""
    """``block_diagram``: a schematic, by the name of its module and function."""
    test: Literal["exists", "equals", "one_of", "at_least", "at_most"] = "exists"
    limit: Entry | tuple[Entry, ...] | None = None
    weak: Real | None = None
    """The limit with which it still holds weakly."""
    ablation: Annotated[bool, Strict()] = False
    """Whether the cause that an explanation names is taken away, or changed alone, in the runs
    that it looks at."""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        named = (self.parameter, self.entry, self.option, self.figure, self.drawing)
        if sum(map(bool, named)) + (self.value is not None) != 1:
            raise ValueError("one of value, parameter, entry, option, figure, drawing")
        if bool(self.figure or self.drawing) != (self.test == "exists"):
            raise ValueError("test 'exists' for figure and drawing, and only there")
        if (self.limit is None) != (self.test == "exists"):
            raise ValueError("a limit, unless it is tested whether something exists")
        if self.weak is not None and self.test not in {"at_least", "at_most"}:
            raise ValueError("a weak limit with 'at_least' and 'at_most' only")
        return self


@validated(frozen=True, config=_FROZEN)
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
    relative_tolerance: NonNegative = 0.0
    """As a share of the paper's number."""
    absolute_tolerance: NonNegative = 0.0
    """In the claim's unit."""
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
        if self.missing:
            return self
        if (self.kind == "number") != (self.paper is not None and self.value is not None):
            raise ValueError("a number of the paper and one of ours if it is a number, else not")
        if self.kind == "explanation" and not any(check.ablation for check in self.checks):
            raise ValueError("an explanation is tested by an ablation")
        if self.tolerance > self.widest_tolerance:
            raise ValueError(f"a tolerance of at most {self.widest_tolerance:g} {self.unit}")
        return self

    @property
    def tolerance(self) -> float:
        """How far our number may be off, in the claim's unit."""
        return max(self.absolute_tolerance, self.relative_tolerance * abs(self.paper or 0.0))

    @property
    def widest_tolerance(self) -> float:
        """More than this is no agreement, whatever the claim."""
        points = WIDEST_POINTS if self.unit == PERCENT else 0.0
        return max(WIDEST_SHARE * abs(self.paper or 0.0), points) * (1 + 1e-12)

    def tables(self) -> set[str]:
        """The tables that it reads."""
        queries = [self.value, *(check.value for check in self.checks)]
        return {table for query in queries if query for table in query.tables()}


class _Shown(float):
    """A number with the ends of its interval; ``%`` has a space before it."""

    low: _Shown
    high: _Shown

    @classmethod
    def of(cls, measured: Measured) -> Self:
        """A number as it was taken from a table."""
        shown, shown.low, shown.high = map(cls, (measured.number, measured.low, measured.high))
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


@validated(frozen=True, config=_FROZEN)
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
        return {table for query in self.numbers.values() for table in query.tables()}

    def with_numbers(self, tables: Tables) -> str:
        """The text with its numbers.

        Raises
        ------
        LookupError
            If a table has no such row or column.
        """
        return self.text.format(
            **{name: _shown_number(query, tables) for name, query in self.numbers.items()}
        )


def _shown_number(query: Query, tables: Tables) -> _Shown | _NotComputed:
    if not all((tables.root / f"{name}.csv").is_file() for name in query.tables()):
        return _NotComputed()
    return _Shown.of(tables.measured(query))


@validated(frozen=True, config=_FROZEN)
class _File:
    """``data/paper/claims.toml``."""

    claim: tuple[Claim, ...]
    reason: dict[str, Reason]


def _file() -> _File:
    return validate(_File, read_toml(_path()), source=_path())


def _path() -> Path:
    return data_folder() / "paper" / "claims.toml"


def reasons() -> dict[str, Reason]:
    """Why claims are not reproduced, by the names that the claims give."""
    return _file().reason


def claims() -> tuple[Claim, ...]:
    """The paper's claims, in the order of their ids.

    Raises
    ------
    ParameterError
        If the file is not valid, an id stands there twice, or a reason is not there.
    """
    file = _file()
    twice = [name for name, count in Counter(one.id for one in file.claim).items() if count > 1]
    if twice:
        raise ParameterError(f"{_path()}: twice: {', '.join(twice)}")
    for one in file.claim:
        if one.why and one.why not in file.reason:
            raise ParameterError(f"{_path()}: {one.id}: no reason {one.why!r}")
    return tuple(sorted(file.claim, key=lambda one: one.id))


# --- verdicts ---------------------------------------------------------------------------

HOLDS, WEAKLY, FAILS, UNKNOWN = 2, 1, 0, -1
_SAID = {WEAKLY: "holds weakly", FAILS: "does not hold", UNKNOWN: "no number for"}


@dataclass(frozen=True)
class _Sources:
    """All that a verdict may rest on."""

    tables: Tables
    parameters: ParameterSet


@dataclass(frozen=True)
class _Outcome:
    """What came of a check."""

    check: Check
    level: int
    measured: Measured | None = None
    found: Any = None
    """The parameter or entry that it looked at."""

    @property
    def tells(self) -> bool:
        """Whether its number tells a reader something: a count of rows does only if it is due."""
        query = self.check.value
        return query is not None and (query.aggregate != "rows" or self.check.test == "equals")


@dataclass(frozen=True)
class _Judged:
    """A claim with all that was found."""

    claim: Claim
    outcomes: Sequence[_Outcome]
    measured: Measured | None

    @cached_property
    def level(self) -> int:
        """The least of its checks: one that fails decides, whatever is unknown."""
        levels = {one.level for one in self.outcomes}
        return FAILS if FAILS in levels else min(levels, default=FAILS)

    @cached_property
    def distance(self) -> float:
        """How far our number is from the paper's, on the wrong side if that is a bound."""
        claim = self.claim
        if self.measured is None or claim.paper is None:
            return math.nan
        away = self.measured.number - claim.paper
        return max(away, 0.0) if claim.test == "at_most" else abs(away)

    @property
    def in_interval(self) -> bool:
        """Whether the paper's number lies in our interval over seas, or bounds a part of it."""
        claim, measured = self.claim, self.measured
        if claim.paper is None or measured is None or not measured.has_interval:
            return False
        below = measured.low <= claim.paper
        return below and (claim.test == "at_most" or claim.paper <= measured.high)

    @property
    def in_tolerance(self) -> bool:
        return self.distance <= self.claim.tolerance

    @property
    def verdict(self) -> Verdict:
        unknown = self.claim.kind == "number" and math.isnan(self.distance)
        if self.claim.missing or unknown or self.level == UNKNOWN:
            return "not decidable"
        return _VERDICTS[self.claim.kind](self)

    @property
    def note(self) -> str:
        """How it is read, and what decided."""
        claim = self.claim
        if claim.missing:
            return _sentences(claim.reading, f"missing: {claim.missing}")
        said = (
            f"{_SAID[one.level]}: {one.check.says}" for one in self.outcomes if one.level != HOLDS
        )
        return _sentences(claim.reading, *self._agreement(), *said)

    def _agreement(self) -> Iterator[str]:
        claim, measured = self.claim, self.measured
        if claim.paper is None or measured is None:
            return
        tolerance = _amount(claim.tolerance, claim)
        if claim.test == "at_most":
            yield (
                "the bound is kept"
                if self.in_tolerance
                else (
                    f"{_amount(self.distance, claim)} beyond the bound"
                    + ", which lies in the interval over seas" * self.in_interval
                )
            )
        elif self.in_interval:
            yield "the paper's number lies in the interval over seas"
            reach = max(measured.high - measured.number, measured.number - measured.low)
            if reach > claim.tolerance:
                yield f"that interval is wider than the tolerance of {tolerance}"
        else:
            yield f"{_amount(self.distance, claim)} off; the tolerance is {tolerance}"


def _amount(number: float, claim: Claim) -> str:
    unit = "points" if claim.unit == PERCENT else claim.unit
    return f"{number:.3g} {unit}".strip()


def _sentences(*parts: str) -> str:
    return " ".join(f"{part[0].upper()}{part[1:].rstrip('.')}." for part in parts if part)


def _of_number(judged: _Judged) -> Verdict:
    stated = bool(judged.outcomes)
    right = not stated or judged.level == HOLDS
    if right and (judged.in_interval or judged.in_tolerance):
        return "reproduced"
    return "trend reproduced" if stated and right else "not reproduced"


def _of_trend(judged: _Judged) -> Verdict:
    if judged.level == HOLDS:
        return "reproduced"
    return "trend reproduced" if judged.level == WEAKLY else "not reproduced"


_VERDICTS: Mapping[str, Callable[[_Judged], Verdict]] = {
    "number": _of_number,
    "trend": _of_trend,
    "artefact": lambda one: "regenerated" if one.level == HOLDS else "not reproduced",
    "explanation": lambda one: "supported" if one.level == HOLDS else "not supported",
}


def _judge(claim: Claim, sources: _Sources) -> _Judged:
    try:
        outcomes = [_outcome(check, sources) for check in claim.checks]
        measured = sources.tables.measured(claim.value) if claim.value else None
    except LookupError as error:
        raise ClaimError(f"{claim.id}: {error.args[0]}") from None
    if measured is None:
        measured = next((one.measured for one in outcomes if one.tells), None)
    return _Judged(claim, outcomes, measured)


def _outcome(check: Check, sources: _Sources) -> _Outcome:
    if check.value:
        measured = sources.tables.measured(check.value)
        return _Outcome(check, _level(check, measured.number), measured)
    if check.figure or check.drawing:
        there = _is_drawn(check.figure, sources) if check.figure else _can_be_drawn(check.drawing)
        return _Outcome(check, HOLDS if there else FAILS)
    if check.option:
        options = _options(check.option)
        return _Outcome(check, HOLDS if check.limit in options else FAILS, found=check.limit)
    found = _parameter(check.parameter, sources) if check.parameter else _entry(check.entry)
    return _Outcome(check, _level(check, found), found=found)


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
    return bool(_plain(found) == _plain(limit))


def _plain(entry: Any) -> Any:
    return list(entry) if isinstance(entry, tuple | list) else entry


def _is_drawn(figure: str, sources: _Sources) -> bool:
    experiment, stem = figure.split("/")
    store = Store(experiment, sources.tables.root)
    described = stem in store.provenance().get("figures", {})
    return described and (store.folder / f"{stem}.svg").is_file()


def _can_be_drawn(name: str) -> bool:
    """Whether a schematic has its function, and the code every signal that it shows."""
    module = import_module(f"softwave_min.figures.{name}")
    signals = getattr(module, "SIGNALS", ())
    return callable(getattr(module, name, None)) and all(one.exists() for one in signals)


def _parameter(name: str, sources: _Sources) -> Any:
    found: Any = sources.parameters
    for part in name.split("."):
        found = getattr(found, part)
    return found


def _entry(place: str) -> Any:
    file, name = place.split(":")
    found: Any = read_toml(data_folder() / file)
    for part in name.split("."):
        found = found[part]
    return found


def _options(name: str) -> tuple[Any, ...]:
    """Values that a parameter can take."""
    kind: Any = ParameterSet
    for part in name.split("."):
        kind = get_type_hints(kind)[part]
    return get_args(kind)


# --- the table --------------------------------------------------------------------------


def missing_tables(root: Path, asked: Sequence[Claim] | None = None) -> list[str]:
    """Tables that the claims rest on and that are not in a results folder."""
    wanted = {table for claim in asked or claims() for table in claim.tables()}
    return sorted(name for name in wanted if not (root / f"{name}.csv").is_file())


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
    sources = _Sources(Tables(root), parameters)
    judged = [_judge(claim, sources) for claim in asked]
    why = _explained(judged, sources.tables)
    return pd.DataFrame([_row(one) | {"why": why.get(one.claim.id, "")} for one in judged])


def _explained(judged: Sequence[_Judged], tables: Tables) -> dict[str, str]:
    """Reasons of the claims that fail and have one, by id."""
    known = reasons()
    asked = {one.claim.id: one.claim.why for one in judged if one.verdict in FAILED}
    found = {}
    for name, why in asked.items():
        if not why:
            continue
        try:
            found[name] = known[why].with_numbers(tables)
        except LookupError as error:
            raise ClaimError(f"{name}: reason {why!r}: {error.args[0]}") from None
    return found


def unexplained(table: pd.DataFrame) -> list[str]:
    """Ids of the claims that are not reproduced or not supported, and have no reason."""
    failed = table["verdict"].isin(FAILED) & (table["why"] == "")
    return list(table["id"][failed])


def _row(judged: _Judged) -> dict[str, Any]:
    claim, measured = judged.claim, judged.measured
    return {
        "id": claim.id,
        "kind": claim.kind,
        "paper_value": _paper_value(judged),
        "our_value": _our_value(judged),
        "unit": claim.unit,
        "low": _rounded(measured.low) if measured else math.nan,
        "high": _rounded(measured.high) if measured else math.nan,
        "verdict": judged.verdict,
        "experiment": claim.experiment,
        "note": judged.note,
    }


def _paper_value(judged: _Judged) -> str:
    claim = judged.claim
    if claim.paper is not None:
        return ("< " if claim.test == "at_most" else "") + _shown(claim.paper)
    return "; ".join(_shown(one.check.limit) for one in _compared(judged))


def _our_value(judged: _Judged) -> str:
    compared = [one for one in _compared(judged) if one.measured is None]
    if judged.measured and not compared:
        return _shown(judged.measured.number)
    return "; ".join(_shown(one.found) for one in compared)


def _compared(judged: _Judged) -> list[_Outcome]:
    """Checks of inputs, or else the first, if it asks for equality: they have the paper's value."""
    inputs = [one for one in judged.outcomes if one.found is not None]
    if inputs or judged.claim.value:
        return inputs
    numbers = [one for one in judged.outcomes if one.tells]
    return [one for one in numbers[:1] if one.check.test == "equals"]


def _shown(entry: Any) -> str:
    if isinstance(entry, tuple | list):
        return f"({', '.join(_shown(one) for one in entry)})"
    if isinstance(entry, float):
        return f"{entry:.{DIGITS}g}"
    return str(entry)


def _rounded(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")


def summary(table: pd.DataFrame) -> str:
    """How many claims have which verdict, a line for each kind."""
    lines = []
    for kind in get_args(Kind):
        counts = table[table["kind"] == kind]["verdict"].value_counts()
        found = (f"{counts[one]} {one}" for one in get_args(Verdict) if one in counts)
        lines.append(f"{kind:12} {', '.join(found)}")
    return "\n".join(lines)


def write(table: pd.DataFrame, root: Path) -> Path:
    """Write the verdicts with what they came from; the table's path."""
    store = Store(FOLDER, root)
    readers: list[Claim | Reason] = [*claims(), *reasons().values()]
    named = sorted({name for reader in readers for name in reader.tables()})
    paths = {name: root / f"{name}.csv" for name in named}
    store.write_table(FOLDER, table)
    store.write_provenance(
        {
            "claims": _digest(_path()),
            "source": source_digest(__name__),
            "tables": {name: _digest(path) for name, path in paths.items() if path.is_file()},
        }
    )
    return verdicts_path(root)


def verdicts_path(root: Path) -> Path:
    """Table of the verdicts in a results folder."""
    return Store(FOLDER, root).folder / f"{FOLDER}.csv"


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def are_fresh(root: Path, parameters: ParameterSet) -> bool:
    """Whether the verdicts in a results folder are those of the tables beside them."""
    try:
        written = verdicts_path(root).read_text(encoding="utf-8")
        return written == table_text(evaluate(root, parameters))
    except (OSError, ClaimError):
        return False
