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

What is not there is a warning, and a warning fails the build.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd
from computed import NONE, NOT_THERE, logger, plain, role, table, texts
from docutils.nodes import Node
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from softwave_min.paper.claims import MINUS, data_entry


def cell(path: Path, row: str, column: str) -> str:
    """Find the cell of a CSV table by its row's leading columns and its column.

    Raises
    ------
    LookupError
        If there is no such column, or not exactly one such row.
    """
    found = texts(path)
    _check_columns(found, [column])
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


def _check_columns(found: pd.DataFrame, names: Sequence[str]) -> None:
    for name in names:
        if name not in found:
            raise LookupError(f"no column {name!r}; there are: {', '.join(found)}")


def _value(results: Path, text: str) -> tuple[str, str]:
    name, row, column, specification = text.split(":")
    return formatted(cell(results / name, row, column), specification), ""


def _parameter(_: Path, text: str) -> tuple[str, str]:
    file, name, specification = text.split(":")
    return formatted(data_entry(file, name), specification), ""


class TableDirective(SphinxDirective):
    """Shows a file of the project as a table."""

    required_arguments = 1
    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "caption": directives.unchanged_required,
        "where": directives.unchanged_required,
        "name": directives.unchanged_required,
    }

    def run(self) -> list[Node]:
        """Build the table; warn where a part of it is missing."""
        path = Path(self.env.srcdir).parent / self.arguments[0]
        try:
            headings, rows = self._entries(path) if path.suffix == ".json" else self._rows(path)
        except NOT_THERE as error:
            logger.warning("quoted-table: %s", error, location=self.get_location())
            return []
        cells = [[plain(text) for text in row] for row in (headings, *rows)]
        options = {"title": self.options.get("caption", ""), "name": self.options.get("name", "")}
        return self.parse_text_to_nodes(table(cells[0], cells[1:], **options))

    def _rows(self, path: Path) -> tuple[list[str], list[list[str]]]:
        """Cells of a CSV table; a dash stands for an empty one."""
        columns = [tuple(part.strip() for part in line.split("|")) for line in self.content]
        kept, _, value = self.options.get("where", "").partition("=")
        found = texts(path)
        _check_columns(found, [*(name for name, _, _ in columns), *([kept] if kept else [])])
        found = found[found[kept] == value] if kept else found
        if found.empty:
            raise LookupError(f"no row of {path.name} {self.options.get('where', '')}")
        rows = [
            [formatted(line[name], how) if line[name] else NONE for name, _, how in columns]
            for line in found.to_dict("records")
        ]
        return [heading for _, heading, _ in columns], rows

    def _entries(self, path: Path) -> tuple[list[str], list[list[str]]]:
        """Entries of a flat JSON file."""
        yes_or_no = {True: "yes", False: "no"}
        found = json.loads(path.read_text(encoding="utf-8"))
        return ["", ""], [
            [name, yes_or_no[value] if isinstance(value, bool) else str(value)]
            for name, value in found.items()
        ]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_role("value", role(_value))
    app.add_role("parameter", role(_parameter))
    app.add_directive("quoted-table", TableDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
