"""The directive ``{register}``: what the paper leaves open and how it is read here, as a table.

The points are those of ``data/paper/ambiguities.toml``. Each row has the readings, the one that
is taken marked, the reason, the parameter that selects the others, what they do to the headline
numbers, and a link to the place where the point is treated. Sorting and filtering are those of
the table of claims.

The effects are those of ``results/open_points/points.csv``. The directive
``{register-summary}`` says in two sentences which reading matters most and how many do not.
The role ``{points}`` counts the points: ``all`` of them, those of a kind, or those with a
``switch``.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.nodes import Node, system_message
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective, SphinxRole
from tables import MINUS, aside, entry, links, rows_of, sentence, table

logger = logging.getLogger(__name__)

HEADINGS = ("Point", "The paper", "Readings", "Why", "Switch", "Effect", "Treated in")
NO_SWITCH = "none"
EVERY = "all"
"""Stands for every point."""
SWITCHED = "switch"
"""Stands for those with a switch."""
MEASURED = "measured"
"""Status of a switch of which every value could be run."""

Effect = Mapping[str, str]


@dataclass(frozen=True)
class Group:
    """How to speak of a group of headline numbers and of a change of them."""

    short: str
    long: str
    unit: str
    decimals: int


GROUPS: Mapping[str, Group] = {
    "largest_reduction": Group(
        "largest reduction", "the largest reduction of the error", "points", 1
    ),
    "lowest_reduction": Group(
        "smallest reduction", "the smallest reduction of the error", "points", 1
    ),
    "rise": Group("rise", "the rise of the error after the failure", "points", 1),
    "star": Group("star", "the error on the star", "m", 4),
}


def points(source: Path) -> list[dict[str, Any]]:
    """The open points, from the folder of the book's sources."""
    path = source.parent / "data" / "paper" / "ambiguities.toml"
    with path.open("rb") as stream:
        return sorted(tomllib.load(stream)["point"], key=lambda one: one["id"])


def effects(source: Path) -> list[dict[str, str]]:
    """A row for each switch that was measured; none where nothing was."""
    path = source / "results" / "open_points" / "points.csv"
    return rows_of(path) if path.is_file() else []


class RegisterDirective(SphinxDirective):
    """Makes the table."""

    def run(self) -> list[Node]:
        """Build the table; warn where the register cannot be read."""
        source = Path(self.env.srcdir)
        try:
            found = effects(source)
            rows = [
                self._row(point, [one for one in found if one["point"] == point["id"]])
                for point in points(source)
            ]
        except (OSError, LookupError, ValueError) as error:
            logger.warning("register: %s", error, location=self.get_location())
            return []
        return [table(HEADINGS, rows, "register")]

    def _row(self, point: dict[str, Any], measured: Sequence[Effect]) -> nodes.row:
        return nodes.row(
            "",
            entry(nodes.Text(point["id"]), aside(point["kind"])),
            entry(nodes.Text(point["says"]), aside(sentence(point["place"]))),
            entry(*_readings(point)),
            entry(nodes.Text(point["reason"])),
            entry(*_switches(point)),
            entry(*_effects(point, measured)),
            entry(*links(self.env.docname, point)),
            ids=[point["id"].lower()],
        )


def _readings(point: dict[str, Any]) -> list[Node]:
    taken = point["choice"]
    return [
        nodes.inline("", reading, classes=["reading-taken"] if number == taken else [])
        for number, reading in enumerate(point["readings"], start=1)
    ]


def _switches(point: dict[str, Any]) -> list[Node]:
    switches = point.get("switches", [])
    names = ", ".join(one["field"] for one in switches) or NO_SWITCH
    elsewhere = [aside(f"See {point['elsewhere']}.")] if point.get("elsewhere") else []
    return [nodes.Text(names), *(aside(_values(one)) for one in switches), *elsewhere]


def _values(switch: dict[str, Any]) -> str:
    fields = {switch["field"]: switch["values"], **switch.get("along", {})}
    return ", with ".join(
        f"{field.split('.')[1]} = {' or '.join(map(_written, values))}"
        for field, values in fields.items()
    )


def _written(value: Any) -> str:
    """A value as in a parameter file, to four digits."""
    if isinstance(value, list):
        return f"[{', '.join(map(_written, value))}]"
    return f"{value:.4g}" if isinstance(value, float) else json.dumps(value)


# --- effects ----------------------------------------------------------------------------


def _effects(point: dict[str, Any], measured: Sequence[Effect]) -> list[Node]:
    """First the largest change as a multiple of what is allowed for; then each change."""
    if not point.get("switches"):
        return [nodes.Text("")]
    if not measured:
        return [nodes.Text("not measured")]
    times = max(float(one["times"]) for one in measured)
    mark = nodes.strong if _any(measured, "matters") else nodes.inline
    return [mark("", _times(times)), *(aside(_changes(one)) for one in measured)]


def _any(measured: Iterable[Effect], column: str) -> bool:
    return any(one[column] == "yes" for one in measured)


def _times(times: float) -> str:
    return f"{times:.2f} \N{MULTIPLICATION SIGN}"


def _changes(one: Effect) -> str:
    """What a switch does to each group of numbers; in brackets what another sea does as well."""
    found = [
        f"{words.short} {_change(one, group)}"
        if one[f"{group}_exceeds"] == "yes"
        else f"{words.short} ({_change(one, group)})"
        for group, words in GROUPS.items()
        if one[group]
    ]
    status = [] if one["status"] == MEASURED else [one["status"]]
    return f"{one['field'].split('.')[1]}: {', '.join([*found, *status])}"


def _change(one: Effect, group: str) -> str:
    words = GROUPS[group]
    text = f"{float(one[group]):+.{words.decimals}f}"
    if not float(text):
        return "0"
    return f"{text.replace('-', MINUS)} {words.unit}"


def summary(found: Sequence[Effect]) -> tuple[str, str]:
    """Which reading matters most; how many do not matter."""
    first = max(found, key=lambda one: float(one["times"]))
    group = max(GROUPS, key=lambda name: float(first[f"{name}_times"] or 0))
    by_point: dict[str, list[Effect]] = {}
    for one in found:
        by_point.setdefault(one["point"], []).append(one)
    matter = [name for name, own in by_point.items() if _any(own, "matters")]
    failed = [
        name
        for name, own in by_point.items()
        if name not in matter and any(one["status"] != MEASURED for one in own)
    ]
    idle = {name: own for name, own in by_point.items() if name not in {*matter, *failed}}
    hidden = [name for name, own in idle.items() if not _any(own, "exceeds")]
    most = (
        f"The reading that matters most is one of {first['point']}: {first['field']} = "
        f"{_rounded_value(first[f'{group}_at'])} changes {GROUPS[group].long} by "
        f"{_change(first, group)}, {_times(float(first['times']))} what is allowed for."
    )
    least = (
        f"Of the {len(by_point)} points with a switch {len(idle)} do not matter: "
        f"with {len(hidden)} of them no headline number moves by more than another random sea "
        f"moves it{_listed(hidden)}, with {len(idle) - len(hidden)} some number does, but within "
        "the tolerance of the claims"
        + f"; {len(failed)} could not be run{_listed(failed)}" * bool(failed)
        + "."
    )
    return most, least


def _listed(names: Sequence[str]) -> str:
    return f" ({', '.join(names)})" if names else ""


def _rounded_value(text: str) -> str:
    try:
        return _written(json.loads(text))
    except ValueError:
        return text


class SummaryDirective(SphinxDirective):
    """Says what the effects come to."""

    def run(self) -> list[Node]:
        """Make a paragraph; warn where the table of effects is not as expected."""
        try:
            found = effects(Path(self.env.srcdir))
            text = " ".join(summary(found)) if found else "The effects are not measured."
        except (OSError, LookupError, ValueError) as error:
            logger.warning("register-summary: %s", error, location=self.get_location())
            return []
        return [nodes.paragraph("", text)]


class PointsRole(SphinxRole):
    """Counts open points."""

    def run(self) -> tuple[list[Node], list[system_message]]:
        """Count; warn where there is no register."""
        try:
            found = points(Path(self.env.srcdir))
        except (OSError, LookupError, ValueError) as error:
            logger.warning("points: %s", error, location=self.get_location())
            return [], []
        return [nodes.inline(self.rawtext, str(_count(found, self.text)), classes=["quoted"])], []


def _count(found: Iterable[dict[str, Any]], of: str) -> int:
    return sum(
        of in {EVERY, one["kind"]} or (of == SWITCHED and "switches" in one) for one in found
    )


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_directive("register", RegisterDirective)
    app.add_directive("register-summary", SummaryDirective)
    app.add_role("points", PointsRole())
    return {"parallel_read_safe": True, "parallel_write_safe": True}
