"""Numbers taken from the tables in ``results/`` by SQL.

A query names tables as ``experiment.stem`` and answers with one row: a number, or a number with
the ends of its 90 % interval over random seas. DuckDB reads ``results/<experiment>/<stem>.csv``
for it, and no file outside that folder. Beside DuckDB's own functions a query has

- ``share(condition)``: of the rows, those in which the condition holds;
- ``rank_correlation(x, y)``: Spearman's coefficient, where equal values share their mean rank;
- ``over_seas(x)``: the median of a number taken in each sea, with its interval.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import AfterValidator

from softwave_min.data import note_read
from softwave_min.runs.statistics import INTERVAL

_TABLE = re.compile(r"\b(?:from|join)\s+(\w+)\.(\w+)")
_LOW, _MEDIAN, _HIGH = INTERVAL
_MACROS = f"""
create macro share(condition) as count_if(condition) / count(*);
create macro over_seas(x) as quantile_cont(x, [{_MEDIAN}, {_LOW}, {_HIGH}]);
-- mean ranks, less their mean: how many are smaller, and half of those that are equal
create macro centred_ranks(list) as list_transform(list, lambda one:
    len(list_filter(list, lambda other: other < one))
    + (len(list_filter(list, lambda other: other = one)) - len(list)) / 2);
create macro rank_correlation(x, y) as
    list_cosine_similarity(centred_ranks(list(x)), centred_ranks(list(y)));
"""


def tables_of(query: str) -> set[str]:
    """The tables that a query reads, as ``experiment/stem``."""
    return {"/".join(names) for names in _TABLE.findall(query)}


def _reads_tables(query: str) -> str:
    if not tables_of(query):
        raise ValueError("no table 'from experiment.stem'")
    return query


Query = Annotated[str, AfterValidator(_reads_tables)]


class Measured(NamedTuple):
    """A number, and its interval over random seas if there is one."""

    number: float
    low: float = math.nan
    high: float = math.nan

    @property
    def has_interval(self) -> bool:
        """Whether it was taken in many seas."""
        return not math.isnan(self.low)


class Tables:
    """The tables of a results folder, each read once."""

    def __init__(self, root: Path) -> None:
        import duckdb  # noqa: PLC0415 - only who judges claims waits for it

        self.root = root.resolve()
        self._read: set[str] = set()
        self._error = duckdb.Error
        self._database = duckdb.connect(config={"threads": 1})  # so that sums have one order
        self._database.execute(_MACROS)
        folder = self.root.as_posix().replace("'", "''")
        self._database.execute(f"set allowed_directories = ['{folder}']")
        self._database.execute("set enable_external_access = false; set lock_configuration = true")

    def has(self, query: str) -> bool:
        """Whether all tables that a query reads are there."""
        return all(self._path(name).is_file() for name in tables_of(query))

    def measured(self, query: str) -> Measured:
        """Take the number that a query asks for; not a number if nothing answers it.

        Raises
        ------
        LookupError
            If the query cannot be answered, or not by one row.
        """
        try:
            for name in sorted(tables_of(query) - self._read):
                self._add(name)
            rows = self._database.execute(query).fetchall()
        except self._error as error:
            raise LookupError(f"{str(error).splitlines()[0]}: {query.strip()}") from None
        if len(rows) != 1:
            raise LookupError(f"{len(rows)} rows, not one: {query.strip()}")
        (found,) = rows
        numbers = found[0] if isinstance(found[0], list) else found
        return Measured(*(math.nan if one is None else float(one) for one in numbers))

    def _path(self, name: str) -> Path:
        return self.root / f"{name}.csv"

    def _add(self, name: str) -> None:
        note_read(self._path(name))
        experiment, stem = name.split("/")
        self._database.execute(f"create schema if not exists {experiment}")
        table = f"create table {experiment}.{stem} as from read_csv(?, header = true, delim = ',')"
        self._database.execute(table, [str(self._path(name))])
        self._read.add(name)
