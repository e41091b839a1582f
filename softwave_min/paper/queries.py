"""Numbers taken from the tables in ``results/``, as a file says how.

A query names a table, its rows and a column, and what is made of them: one number, with its
90 % interval over random seas where there is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import ConfigDict, Strict, model_validator
from pydantic.dataclasses import dataclass as validated

from softwave_min.parameters import Real
from softwave_min.runs.statistics import over_seas
from softwave_min.runs.store import Store

Floats = NDArray[np.float64]
Entry = Annotated[bool, Strict()] | Annotated[int, Strict()] | Annotated[float, Strict()] | str
"""Of a table or a parameter file; in this order, because True is no 1."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Query:
    """How a number is taken from a table."""

    table: str
    """``experiment/stem``, below ``results/``."""
    column: str
    where: dict[str, Entry | tuple[Entry, ...]] = field(default_factory=dict)
    """What the columns of a row must have: an entry, or one of several."""
    divided_by: str = ""
    """Column by which the first one is divided, row by row."""
    by: tuple[str, ...] = ()
    """Columns whose entries make a group of rows; each group becomes one number."""
    within: Literal["mean", "range", "relative_range", "rank_correlation"] = "mean"
    """How: ``relative_range`` is the range over the mean, ``rank_correlation``
    Spearman's coefficient with the column ``against``."""
    against: str = ""
    aggregate: Literal[
        "only",
        "mean",
        "median",
        "smallest",
        "largest",
        "sum",
        "rows",
        "share_below",
        "share_above",
    ] = "only"
    """Of these numbers; ``only``: there is just one; ``rows``: how many there are."""
    limit: Real = 0.0
    """For the shares."""
    low: str = ""
    high: str = ""
    """Columns of the same row with the 5 % and 95 % quantiles over random seas."""
    per: str = ""
    """Column with the random sea: the number is then taken in each sea by itself, and the
    median with these quantiles is what counts."""
    minus: Query | None = None
    """This one is subtracted from the number, ..."""
    over: Query | None = None
    """... which is then divided by this one."""

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if bool(self.against) != (self.within == "rank_correlation"):
            raise ValueError("'against' with 'rank_correlation', and only there")
        if bool(self.low) != bool(self.high) or (self.low and self.per):
            raise ValueError("'low' with 'high', and not with 'per'")
        return self

    @property
    def ends(self) -> tuple[str, str]:
        """Columns of the interval."""
        return self.low, self.high

    def tables(self) -> Iterator[str]:
        """The tables that it reads."""
        yield self.table
        for other in (self.over, self.minus):
            if other:
                yield from other.tables()


@dataclass(frozen=True)
class Measured:
    """A number, and its interval over random seas if there is one."""

    number: float
    low: float = math.nan
    high: float = math.nan

    @property
    def has_interval(self) -> bool:
        """Whether it was taken in many seas."""
        return not math.isnan(self.low)


@dataclass(frozen=True)
class Tables:
    """The tables of a results folder, each read once."""

    root: Path
    _read: dict[str, pd.DataFrame] = field(default_factory=dict, repr=False)

    def measured(self, query: Query) -> Measured:
        """Take the number that a query asks for; not a number if no row answers it.

        Raises
        ------
        LookupError
            If there is no such column, or not just one row where one is asked for.
        """
        if query.per:
            seas = _column(self._rows(query, {}), query, query.per).dropna().unique()
            values = [self._number(query, {query.per: sea}) for sea in seas] or [math.nan]
            low, middle, high = over_seas(values)
            return Measured(middle, low, high)
        number = self._number(query, {})
        if not query.low:
            return Measured(number)
        rows = self._rows(query, {})
        return Measured(number, *(_only(_floats(rows, query, end), query) for end in query.ends))

    def _table(self, name: str) -> pd.DataFrame:
        if name not in self._read:
            experiment, stem = name.split("/")
            self._read[name] = Store(experiment, self.root).read_table(stem)
        return self._read[name]

    def _number(self, query: Query, sea: Mapping[str, Any]) -> float:
        number = _aggregated(query, self._rows(query, sea))
        if query.minus:
            number -= self._number(query.minus, sea)
        if query.over:
            divisor = self._number(query.over, sea)
            number = number / divisor if divisor else math.nan
        return number

    def _rows(self, query: Query, sea: Mapping[str, Any]) -> pd.DataFrame:
        rows = self._table(query.table)
        for name, wanted in {**query.where, **sea}.items():
            several = wanted if isinstance(wanted, tuple) else (wanted,)
            rows = rows[_column(rows, query, name).isin(list(several))]
        return rows


def _aggregated(query: Query, rows: pd.DataFrame) -> float:
    if query.aggregate == "rows":
        return float(len(rows))
    values = _values(query, rows)
    if query.aggregate == "only":
        return _only(values, query)
    if not len(values) and query.aggregate != "sum":
        return math.nan
    return float(_AGGREGATES[query.aggregate](values, query.limit))


def _values(query: Query, rows: pd.DataFrame) -> Floats:
    values = _floats(rows, query, query.column)
    if query.divided_by:
        values = values / _floats(rows, query, query.divided_by)
    if not query.by:
        return values
    keys = [_column(rows, query, name) for name in query.by]
    other = _floats(rows, query, query.against) if query.against else values
    pairs = pd.DataFrame({"value": values, "other": other}, index=rows.index)
    return np.array([_WITHIN[query.within](pair) for _, pair in pairs.groupby(keys, sort=False)])


def _column(table: pd.DataFrame, query: Query, name: str) -> pd.Series:
    if name not in table.columns:
        raise LookupError(f"{query.table}.csv has no column {name!r}")
    return table[name]


def _floats(table: pd.DataFrame, query: Query, name: str) -> Floats:
    values: Floats = _column(table, query, name).to_numpy(float)
    return values


def _only(values: Floats, query: Query) -> float:
    if len(values) != 1:
        raise LookupError(f"{len(values)} rows of {query.table}.csv with {query.where}, not one")
    return float(values[0])


def _range(group: pd.DataFrame) -> float:
    return float(group["value"].max() - group["value"].min())


def _rank_correlation(group: pd.DataFrame) -> float:
    return float(group["value"].rank().corr(group["other"].rank()))


_WITHIN: Mapping[str, Callable[[pd.DataFrame], float]] = {
    "mean": lambda group: float(group["value"].mean()),
    "range": _range,
    "relative_range": lambda group: _range(group) / float(group["value"].mean()),
    "rank_correlation": _rank_correlation,
}
_AGGREGATES: Mapping[str, Callable[[Floats, float], Any]] = {
    "mean": lambda values, _: np.mean(values),
    "median": lambda values, _: np.median(values),
    "smallest": lambda values, _: np.min(values),
    "largest": lambda values, _: np.max(values),
    "sum": lambda values, _: np.sum(values),
    "share_below": lambda values, limit: np.mean(values < limit),
    "share_above": lambda values, limit: np.mean(values > limit),
}
