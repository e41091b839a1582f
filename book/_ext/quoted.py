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

import csv
import json
import tomllib
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.nodes import Node, system_message
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective, SphinxRole

logger = logging.getLogger(__name__)

MINUS = "\N{MINUS SIGN}"
NONE = "\N{EN DASH}"


def cell(table: Path, row: str, column: str) -> str:
    """Find the cell of a CSV table by its row's leading columns and its column.

    Raises
    ------
    LookupError
        If there is no such column, or not exactly one such row.
    """
    with table.open(encoding="utf-8", newline="") as stream:
        reader = csv.DictReader(stream)
        names = list(reader.fieldnames or ())
        if column not in names:
            raise LookupError(f"no column {column!r}; there are: {', '.join(names)}")
        key = row.split("/")
        found = [line for line in reader if [line[name] for name in names[: len(key)]] == key]
    if len(found) != 1:
        raise LookupError(f"{len(found)} rows begin with {row!r}, not one")
    return found[0][column]


def entry(parameters: Path, name: str) -> Any:
    """Find an entry of a TOML file by its dotted name; positions in lists count from 0.

    Raises
    ------
    LookupError
        If there is no such entry.
    """
    with parameters.open("rb") as stream:
        found = tomllib.load(stream)
    for part in name.split("."):
        found = found[int(part) if isinstance(found, list) else part]
    return found


def formatted(quantity: Any, specification: str) -> str:
    """Format a quantity: as a number where a format is given, else as it stands."""
    if not specification:
        return str(quantity)
    return format(float(quantity), specification).replace("-", MINUS)


def columns_of(
    table: Path, columns: list[tuple[str, str, str]], where: str = ""
) -> list[list[str]]:
    """Read a CSV table as text, its headings first; a dash stands for an empty cell.

    Parameters
    ----------
    table : Path
    columns : list of (name, heading, format)
    where : str, optional
        ``column=value`` that every row must have.

    Raises
    ------
    LookupError
        If there is no such column, or no row is left.
    """
    with table.open(encoding="utf-8", newline="") as stream:
        reader = csv.DictReader(stream)
        known, lines = list(reader.fieldnames or ()), list(reader)
    kept, _, value = where.partition("=")
    for name in [name for name, _, _ in columns] + [kept] * bool(where):
        if name not in known:
            raise LookupError(f"no column {name!r}; there are: {', '.join(known)}")
    lines = [line for line in lines if not where or line[kept] == value]
    if not lines:
        raise LookupError(f"no row of {table.name} {where}")
    rows = [
        [formatted(line[name], how) if line[name] else NONE for name, _, how in columns]
        for line in lines
    ]
    return [[heading for _, heading, _ in columns], *rows]


def entries_of(file: Path) -> list[list[str]]:
    """Read a flat JSON file as rows of two."""
    found = json.loads(file.read_text(encoding="utf-8"))
    yes_or_no = {True: "yes", False: "no"}
    rows = [
        [name, yes_or_no[value] if isinstance(value, bool) else str(value)]
        for name, value in found.items()
    ]
    return [["", ""], *rows]


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
            if path.suffix == ".json":
                rows = entries_of(path)
            else:
                columns = [self._column(line) for line in self.content]
                rows = columns_of(path, columns, self.options.get("where", ""))
        except (OSError, TypeError, ValueError, LookupError) as error:
            logger.warning("quoted-table: %s", error, location=self.get_location())
            return []
        table = self._table(rows)
        self.set_source_info(table)
        self.add_name(table)
        return [table]

    def _column(self, line: str) -> tuple[str, str, str]:
        name, heading, specification = (part.strip() for part in line.split("|"))
        return name, heading, specification

    def _table(self, rows: list[list[str]]) -> Node:
        group = nodes.tgroup("", cols=len(rows[0]))
        group += [nodes.colspec(colwidth=1) for _ in rows[0]]
        heading, *body = (
            nodes.row("", *(nodes.entry("", nodes.paragraph(text=text)) for text in row))
            for row in rows
        )
        if any(rows[0]):
            group += nodes.thead("", heading)
        group += nodes.tbody("", *body)
        title = [nodes.title("", "", *self.parse_inline(self.options.get("caption", ""))[0])]
        return nodes.table("", *(title if "caption" in self.options else []), group)


class QuotingRole(SphinxRole):
    """Looks a quantity up and puts it into the text."""

    def run(self) -> tuple[list[Node], list[system_message]]:
        """Look the quantity up; warn where it cannot be had."""
        try:
            *place, specification = self.text.split(":")
            text = formatted(self.look_up(*place), specification)
        except (OSError, TypeError, ValueError, LookupError) as error:
            logger.warning("%s %r: %s", self.name, self.text, error, location=self.get_location())
            return [], []
        return [nodes.inline(self.rawtext, text, classes=["quoted"])], []

    def look_up(self, *place: str) -> Any:
        """Find the quantity at a place."""
        raise NotImplementedError


class ValueRole(QuotingRole):
    """Quotes a cell of a table in ``results/``."""

    def look_up(self, *place: str) -> Any:
        """Find table, row and column."""
        table, row, column = place
        return cell(Path(self.env.srcdir, "results", table), row, column)


class ParameterRole(QuotingRole):
    """Quotes an entry of a file in ``data/``."""

    def look_up(self, *place: str) -> Any:
        """Find file and entry."""
        file, name = place
        return entry(Path(self.env.srcdir).parent / "data" / file, name)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_role("value", ValueRole())
    app.add_role("parameter", ParameterRole())
    app.add_directive("quoted-table", TableDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
