"""The directive ``{notation}``: one group of ``data/notation.toml`` as a table."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.nodes import Node
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

logger = logging.getLogger(__name__)

HEADINGS = ("Symbol", "Meaning", "Unit", "Name in the code")
WIDTHS = (16, 40, 12, 32)


class NotationDirective(SphinxDirective):
    """Makes a table of the entries of one group."""

    required_arguments = 1

    def run(self) -> list[Node]:
        """Build the table; warn where there is no such group."""
        group = self.arguments[0]
        with (Path(self.env.srcdir).parent / "data" / "notation.toml").open("rb") as stream:
            notation = tomllib.load(stream)
        if group not in notation:
            logger.warning("notation: no group %r", group, location=self.get_location())
            return []
        body = nodes.tbody("", *(self._row(symbol) for symbol in notation[group]))
        head = nodes.thead("", _row(*(nodes.Text(heading) for heading in HEADINGS)))
        columns = (nodes.colspec(colwidth=width) for width in WIDTHS)
        inner = nodes.tgroup("", *columns, head, body, cols=len(WIDTHS))
        return [nodes.table("", inner, classes=["notation"])]

    def _row(self, symbol: dict[str, str]) -> nodes.row:
        return _row(
            _formula(symbol["symbol"]),
            nodes.inline("", "", *self.parse_inline(_meaning(symbol))[0]),
            _formula(_unit(symbol["unit"])),
            _name(symbol.get("where", ""), symbol.get("code", "")),
        )


def _row(*contents: Node) -> nodes.row:
    cells = (nodes.entry("", nodes.paragraph("", "", content)) for content in contents)
    return nodes.row("", *cells)


def _meaning(symbol: dict[str, str]) -> str:
    """Meaning, and how the paper writes the symbol where it does so otherwise."""
    match symbol.get("paper"):
        case None:
            return symbol["meaning"]
        case "":
            return f"{symbol['meaning']} (not in the paper)"
        case other:
            return f"{symbol['meaning']} (in the paper ${other}$)"


def _formula(tex: str) -> Node:
    return nodes.math(tex, tex) if tex else nodes.Text("")


def _unit(unit: str) -> str:
    """TeX of a unit written as 'kg/m^3' or 'N m s/rad'."""
    spaced = unit.replace(" ", r"\,")
    return rf"\mathrm{{{spaced}}}" if unit else ""


def _name(where: str, code: str) -> Node:
    """Name in the code, after the place where it lives."""
    if not code:
        return nodes.Text("")
    place = nodes.inline("", f"{where}.", classes=["notation-place"])
    return nodes.literal("", "", place, nodes.Text(code))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_directive("notation", NotationDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
