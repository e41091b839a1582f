"""The directive ``{register}``: what the paper leaves open and how it is read here, as a table.

The points are those of ``data/paper/ambiguities.toml``. Each row has the readings, the one that
is taken marked, the reason, the parameter that selects the others, and a link to the place where
the point is treated. Sorting and filtering are those of the table of claims. The role
``{points}`` counts the points: ``all`` of them, those of a kind, or those with a ``switch``.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from claims import aside, entry, reference, table
from docutils import nodes
from docutils.nodes import Node, system_message
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective, SphinxRole

logger = logging.getLogger(__name__)

HEADINGS = ("Point", "The paper", "Readings", "Why", "Switch", "Treated in")
NO_SWITCH = "none"
EVERY = "all"
"""Stands for every point."""
SWITCHED = "switch"
"""Stands for those with a switch."""


def points(source: Path) -> list[dict[str, Any]]:
    """The open points, from the folder of the book's sources."""
    path = source.parent / "data" / "paper" / "ambiguities.toml"
    with path.open("rb") as stream:
        return sorted(tomllib.load(stream)["point"], key=lambda one: one["id"])


class RegisterDirective(SphinxDirective):
    """Makes the table."""

    def run(self) -> list[Node]:
        """Build the table; warn where the register cannot be read."""
        try:
            rows = [self._row(point) for point in points(Path(self.env.srcdir))]
        except (OSError, LookupError, ValueError) as error:
            logger.warning("register: %s", error, location=self.get_location())
            return []
        return [table(HEADINGS, rows, "register")]

    def _row(self, point: dict[str, Any]) -> nodes.row:
        place = f"{point['place'][0].upper()}{point['place'][1:]}."
        return nodes.row(
            "",
            entry(nodes.Text(point["id"]), aside(point["kind"])),
            entry(nodes.Text(point["says"]), aside(place)),
            entry(*_readings(point)),
            entry(nodes.Text(point["reason"])),
            entry(*_switches(point)),
            entry(*self._links(point)),
            ids=[point["id"].lower()],
        )

    def _links(self, point: dict[str, Any]) -> list[Node]:
        links: list[Node] = [reference(self.env.docname, "doc", f"/{point['page']}")]
        label = point.get("label", "")
        if label:
            kind = "ref" if label.startswith("sec-") else "numref"
            links.append(reference(self.env.docname, kind, label))
        return links


def _readings(point: dict[str, Any]) -> list[Node]:
    taken = point["choice"]
    return [
        nodes.inline("", reading, classes=["reading-taken"] if number == taken else [])
        for number, reading in enumerate(point["readings"], start=1)
    ]


def _switches(point: dict[str, Any]) -> list[Node]:
    switches = point.get("switches", [])
    names = ", ".join(one["field"] for one in switches) or NO_SWITCH
    values = [
        aside(f"{one['field'].split('.')[1]} = {' or '.join(map(_written, one['values']))}")
        for one in switches
    ]
    elsewhere = [aside(f"See {point['elsewhere']}.")] if point.get("elsewhere") else []
    return [nodes.Text(names), *values, *elsewhere]


def _written(value: Any) -> str:
    """A value as in a parameter file, to four digits."""
    if isinstance(value, list):
        return f"[{', '.join(map(_written, value))}]"
    return f"{value:.4g}" if isinstance(value, float) else json.dumps(value)


class PointsRole(SphinxRole):
    """Counts open points."""

    def run(self) -> tuple[list[Node], list[system_message]]:
        """Count; warn where there is no register."""
        try:
            found = points(Path(self.env.srcdir))
        except (OSError, LookupError, ValueError) as error:
            logger.warning("points: %s", error, location=self.get_location())
            return [], []
        count = sum(
            self.text in {EVERY, one["kind"]} or (self.text == SWITCHED and "switches" in one)
            for one in found
        )
        return [nodes.inline(self.rawtext, str(count), classes=["quoted"])], []


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_directive("register", RegisterDirective)
    app.add_role("points", PointsRole())
    return {"parallel_read_safe": True, "parallel_write_safe": True}
