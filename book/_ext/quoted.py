"""Roles and a directive that put numbers of the project into the text, so that nobody types
them.

``{value}`example_case/summary.csv:W3/nmpc:rmse:.3f` `` is the cell of
``results/example_case/summary.csv`` in column ``rmse`` and in the one row whose leading
columns read ``W3``, ``nmpc``. ``{parameter}`parameters/physical.toml:nmpc.horizon:.0f` `` is
that entry of ``data/parameters/physical.toml``. The last part is the format; left empty, the
quantity is quoted as it stands.

``{quoted-table} bench/results/growth.csv`` shows a CSV table, found from the project's root. Each
line of its content is a column: its name in the file, its heading, its format. The option
``where`` keeps the rows that have a value in a column (``axis=horizon``). A flat JSON file is
shown entry by entry.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import myst
import pandas as pd

from softwave_min.paper.claims import MINUS
from softwave_min.paper.entries import data_entry


def cell(path: Path, row: str, column: str) -> str:
    """Find the cell of a CSV table by its row's leading columns and its column.

    Raises
    ------
    LookupError
        If there is no such column, or not exactly one such row.
    """
    found = _columns(path, [column])
    key = row.split("/")
    found = found[(found.iloc[:, : len(key)] == key).all(axis=1)]
    if len(found) != 1:
        raise LookupError(f"{len(found)} rows begin with {row!r}, not one")
    return str(found[column].iloc[0])


def formatted(quantity: Any, specification: str) -> str:
    """Format a quantity: as a number where a format is given, else as it stands."""
    if not specification:
        return str(quantity)
    return format(float(quantity), specification).replace("-", MINUS)


def _columns(path: Path, needed: Sequence[str]) -> pd.DataFrame:
    """A table that has the columns."""
    found = myst.texts(path)
    if absent := [name for name in needed if name not in found]:
        raise LookupError(f"no column {absent[0]!r}; there are: {', '.join(found)}")
    return found


def _value(results: Path, text: str) -> tuple[str, str]:
    name, row, column, specification = text.split(":")
    return formatted(cell(results / name, row, column), specification), ""


def _parameter(_: Path, text: str) -> tuple[str, str]:
    file, name, specification = text.split(":")
    return formatted(data_entry(file, name), specification), ""


def quoted_table(
    results: Path, file: str, columns: list[str], caption: str = "", where: str = "", **named: str
) -> str:
    """A file of the project as a table; a dash stands for an empty cell."""
    path = results.parents[1] / file
    if path.suffix == ".json":
        yes_or_no = {True: "yes", False: "no"}
        entries = json.loads(path.read_text(encoding="utf-8")).items()
        rows = [[n, yes_or_no[v] if isinstance(v, bool) else str(v)] for n, v in entries]
        return _table((), rows, caption, **named)
    named_columns = [[part.strip() for part in line.split("|")] for line in columns]
    kept, _, value = where.partition("=")
    found = _columns(path, [name for name, _, _ in named_columns])
    found = found[found[kept] == value] if kept else found
    if found.empty:
        raise LookupError(f"no row of {path.name} {where}")
    rows = [
        [formatted(line[name], how) if line[name] else myst.NONE for name, _, how in named_columns]
        for line in found.to_dict("records")
    ]
    return _table([heading for _, heading, _ in named_columns], rows, caption, **named)


def _table(headings: Sequence[str], rows: list[list[str]], caption: str, **named: str) -> str:
    cells = [[myst.plain(text) for text in row] for row in rows]
    return myst.table([myst.plain(text) for text in headings], cells, caption, **named)


setup = myst.extension(
    {"quoted-table": myst.directive(quoted_table, 1, "caption", "name", "where", content=True)},
    {"value": myst.role(_value), "parameter": myst.role(_parameter)},
)
