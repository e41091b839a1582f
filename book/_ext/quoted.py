"""Roles that put a number of the project into the text, so that nobody types it.

``{value}`example_case/summary.csv:W3/nmpc:rmse:.3f` `` is the cell of
``results/example_case/summary.csv`` in column ``rmse`` and in the one row whose leading
columns read ``W3``, ``nmpc``. ``{parameter}`parameters/physical.toml:nmpc.horizon:.0f` `` is
that entry of ``data/parameters/physical.toml``. The last part is the format; left empty, the
quantity is quoted as it stands. What is not there is a warning, and a warning fails the
build.
"""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.nodes import Node, system_message
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxRole

logger = logging.getLogger(__name__)

MINUS = "\N{MINUS SIGN}"


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
    return {"parallel_read_safe": True, "parallel_write_safe": True}
