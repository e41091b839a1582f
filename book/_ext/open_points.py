"""The directive ``{open-points}``: what the paper leaves open and how it is read here, as a table.

Each row has the readings, the one that is taken marked, the reason, the parameter that selects
the others, what they do to the headline numbers, and a link to the place where the point is
treated. Sorting and filtering are those of the table of claims.

The effects are those of ``results/open_points/points.csv``. The directive
``{open-points-summary}`` says in two sentences which reading matters most and how many do not.
The role ``{open-points}`` counts the points: ``all`` of them, those of a kind, or those with a
``switch``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import myst

from softwave_min.paper.claims import MINUS
from softwave_min.paper.open_points import OpenPoint, Switch, open_points
from softwave_min.studies.open_points import GROUPS as UNITS
from softwave_min.studies.open_points import MEASURED

HEADINGS = ("Point", "The paper", "Readings", "Why", "Switch", "Effect", "Treated in")
NO_SWITCH = "none"
EVERY = "all"
"""Stands for every point."""
SWITCHED = "switch"
"""Stands for those with a switch."""

Effect = Mapping[str, str]


GROUPS = {
    "largest_reduction": ("largest reduction", "the largest reduction of the error"),
    "lowest_reduction": ("smallest reduction", "the smallest reduction of the error"),
    "rise": ("rise", "the rise of the error after the failure"),
    "star": ("star", "the error on the star"),
}
"""A group of headline numbers in short, and in a sentence."""


def effects(results: Path) -> list[dict[str, str]]:
    """A row for each switch that was measured; none where nothing was."""
    path = results / "open_points" / "points.csv"
    return myst.texts(path).to_dict("records") if path.is_file() else []


def point_link(name: str) -> str:
    """A link to an open point."""
    return myst.link(f"point-{name.lower()}", name)


def points_table(results: Path) -> str:
    """All open points with their effects."""
    found = effects(results)
    rows = [
        (
            [myst.target(f"point-{point.id.lower()}", point.id), myst.aside(point.kind)],
            [myst.plain(point.says), myst.aside(myst.sentence(point.place))],
            _readings(point),
            myst.plain(point.reason),
            _switches(point),
            _effects(point, [one for one in found if one["point"] == point.id]),
            myst.links(point),
        )
        for point in open_points()
    ]
    return myst.table(HEADINGS, rows, class_="claims open-points")


def _readings(point: OpenPoint) -> list[str]:
    return [
        myst.classed(reading, "reading-taken") if number == point.choice else myst.plain(reading)
        for number, reading in enumerate(point.readings, start=1)
    ]


def _switches(point: OpenPoint) -> list[str]:
    names = ", ".join(one.field for one in point.switches) or NO_SWITCH
    notes = [_values(one) for one in point.switches]
    notes += [f"See {point.elsewhere}."] if point.elsewhere else []
    return [myst.plain(names), *map(myst.aside, notes)]


def _values(switch: Switch) -> str:
    fields = {switch.field: switch.values, **switch.along}
    return ", with ".join(
        f"{field.split('.')[1]} = {' or '.join(map(_written, values))}"
        for field, values in fields.items()
    )


def _written(value: Any) -> str:
    """A value as in a parameter file, to four digits."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_written, value))}]"
    return f"{value:.4g}" if isinstance(value, float) else json.dumps(value)


# --- effects ----------------------------------------------------------------------------


def _effects(point: OpenPoint, measured: Sequence[Effect]) -> list[str]:
    """First the largest change as a multiple of what is allowed for; then each change."""
    if not point.switches:
        return []
    if not measured:
        return ["not measured"]
    times = _times(max(float(one["times"]) for one in measured))
    mark = f"**{times}**" if _any(measured, "matters") else times
    return [mark, *(myst.aside(_changes(one)) for one in measured)]


def _any(measured: Iterable[Effect], column: str) -> bool:
    return any(one[column] == "yes" for one in measured)


def _times(times: float) -> str:
    return f"{times:.2f} \N{MULTIPLICATION SIGN}"


def _changes(one: Effect) -> str:
    """What a switch does to each group of numbers; in brackets what another sea does as well."""
    found = [
        f"{short} {_change(one, group)}"
        if one[f"{group}_exceeds"] == "yes"
        else f"{short} ({_change(one, group)})"
        for group, (short, _) in GROUPS.items()
        if one[group]
    ]
    status = [] if one["status"] == MEASURED else [one["status"]]
    return f"{one['field'].split('.')[1]}: {', '.join([*found, *status])}"


def _change(one: Effect, group: str) -> str:
    unit = UNITS[group]
    text = f"{float(one[group]):+.{4 if unit == 'm' else 1}f}"
    return f"{text.replace('-', MINUS)} {unit}" if float(text) else "0"


def summary(results: Path) -> str:
    """Which reading matters most; how many do not matter."""
    found = effects(results)
    if not found:
        return "The effects are not measured."
    first = max(found, key=lambda one: float(one["times"]))
    group = max(GROUPS, key=lambda name: float(first[f"{name}_times"] or 0))
    by_point: dict[str, list[Effect]] = {}
    for one in found:
        by_point.setdefault(one["point"], []).append(one)
    idle = {name: own for name, own in by_point.items() if not _any(own, "matters")}
    failed = [name for name, own in idle.items() if any(one["status"] != MEASURED for one in own)]
    ran = [name for name in idle if name not in failed]
    hidden = [name for name in ran if not _any(idle[name], "exceeds")]
    return myst.plain(
        f"The reading that matters most is one of {first['point']}: {first['field']} = "
        f"{myst.rounded(first[f'{group}_at'])} changes {GROUPS[group][1]} by "
        f"{_change(first, group)}, {_times(float(first['times']))} what is allowed for. "
        f"Of the {len(by_point)} points with a switch {len(ran)} do not matter: "
        f"with {len(hidden)} of them no headline number moves by more than another random sea "
        f"moves it{_listed(hidden)}, with {len(ran) - len(hidden)} some number does, but within "
        "the tolerance of the claims"
        + f"; {len(failed)} could not be run{_listed(failed)}" * bool(failed)
        + "."
    )


def _listed(names: Sequence[str]) -> str:
    return f" ({', '.join(names)})" if names else ""


def count(_: Path, of: str) -> tuple[str, str]:
    """How many points there are, of a kind, or with a switch."""
    found = open_points()
    if of == SWITCHED:
        return str(sum(bool(one.switches) for one in found)), ""
    return str(sum(of in {EVERY, one.kind} for one in found)), ""


setup = myst.extension(
    {
        "open-points": myst.directive(points_table),
        "open-points-summary": myst.directive(summary),
    },
    {"open-points": myst.role(count)},
)
