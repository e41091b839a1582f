"""The directive ``{report}``: the parts of the reproducibility report that are computed.

``{report} verdicts`` counts the claims by kind and verdict, ``headline`` sets the paper's numbers
against ours, ``agreement`` and ``disagreement`` list the claims that hold and those that do not,
these with their reasons; ``assumptions`` counts the open points and names those that matter most,
``wanted`` lists what the authors would have to state; ``experiments`` and ``environment`` say what
was run, and on what; ``chapters`` leads to the pages on sensitivity. All of it is read from
``results/`` and ``data/`` when the book is built; what is not there is a warning.
"""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from claims import (
    FAILED,
    evidence_links,
    interval,
    judged,
    note_target,
    verdict_mark,
    verdicts,
    with_unit,
)
from docutils import nodes
from docutils.nodes import Node
from register import effects, points
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from tables import entry, reference, rounded

logger = logging.getLogger(__name__)

VERDICTS = (
    "reproduced",
    "regenerated",
    "supported",
    "trend reproduced",
    "not reproduced",
    "not supported",
    "not decidable",
)
HOLD = ("reproduced", "supported", "trend reproduced")
"""Verdicts of what agrees, apart from artefacts."""
WIDE = "wider than the tolerance"
"""In the note of a number that agrees because the seas differ."""
CONVERGED = "CONVERGED"
CHAPTERS = ("notebooks/sensitivity", "notebooks/ablations", "notebooks/parameters", "register")
"""Pages on how much the conclusions hang on, as far as the book has them."""
MOST = 8
"""How many of the open points that matter are named."""
NONE = "\N{EN DASH}"

Row = Mapping[str, str]


class ReportDirective(SphinxDirective):
    """Makes a part of the report."""

    required_arguments = 1

    def run(self) -> list[Node]:
        """Build the part; warn where something that it needs is missing."""
        try:
            return list(PARTS[self.arguments[0]](self))
        except (OSError, LookupError, ValueError) as error:
            logger.warning("report: %s", error, location=self.get_location())
            return []

    @property
    def source(self) -> Path:
        """Folder of the book's sources."""
        return Path(self.env.srcdir)

    def link(self, kind: str, target: str) -> Node:
        """A link from this page."""
        return reference(self.env.docname, kind, target)

    def claim(self, name: str) -> Node:
        """A link to a claim."""
        return self.link("ref", f"claim-{name.lower()}")

    def point(self, name: str) -> Node:
        """A link to an open point."""
        return self.link("ref", f"point-{name.lower()}")


# --- claims -----------------------------------------------------------------------------


def _verdicts(page: ReportDirective) -> Iterator[Node]:
    found = verdicts(page.source)
    count = Counter((row["kind"], row["verdict"]) for row in found)
    kinds = list(dict.fromkeys(row["kind"] for row in found))
    used = [one for one in VERDICTS if any(row["verdict"] == one for row in found)]
    rows = [
        [_text(kind), *(_text(str(count[kind, one] or NONE)) for one in used)] for kind in kinds
    ]
    rows.append(
        [_text("all"), *(_text(str(sum(count[kind, one] for kind in kinds))) for one in used)]
    )
    yield _table([_text("Kind"), *map(verdict_mark, used)], rows)


def _headline(page: ReportDirective) -> Iterator[Node]:
    stated = judged(page.source)["claim"]
    rows = [
        [
            page.claim(row["id"]),
            _text(stated[row["id"]]["statement"]),
            _text(with_unit(row, "paper_value")),
            _text(with_unit(row, "our_value")),
            _text(interval(row) or NONE),
            verdict_mark(row["verdict"]),
        ]
        for row in verdicts(page.source)
        if row["kind"] == "number"
    ]
    headings = ("Claim", "The paper says", "Paper", "Here", "Over the seas", "Verdict")
    yield _table(map(_text, headings), rows)


def _agreement(page: ReportDirective) -> Iterator[Node]:
    stated = judged(page.source)["claim"]
    found = [
        row for row in verdicts(page.source) if row["verdict"] in HOLD and row["kind"] != "artefact"
    ]
    items = [
        [page.claim(row["id"]), _text(f" {stated[row['id']]['statement']} "), _size(row)]
        for row in found
    ]
    yield _bullets(items) if items else nodes.paragraph("", "Nothing.")


def _size(row: Row) -> Node:
    """Our number beside the paper's, or else the verdict where it holds in part alone."""
    if row["kind"] == "number":
        wide = ", by an interval that is wider than the tolerance" if WIDE in row["note"] else ""
        note = f"Here {with_unit(row, 'our_value')}{wide}."
    else:
        note = f"({row['verdict']})" if row["verdict"] == "trend reproduced" else ""
    return nodes.inline("", note, classes=["claim-note"])


def _disagreement(page: ReportDirective) -> Iterator[Node]:
    """Reasons, each with the claims that fail for it."""
    stated = judged(page.source)
    groups: dict[str, list[Row]] = {}
    for row in verdicts(page.source):
        if row["verdict"] in FAILED:
            groups.setdefault(stated["claim"][row["id"]].get("why", ""), []).append(row)
    if not groups:
        yield nodes.paragraph("", "Nothing.")
    for name, rows in groups.items():
        claims = [_failed(page, row, stated["claim"][row["id"]]) for row in rows]
        reason = stated["reason"][name]
        yield _bullets(claims)
        yield nodes.block_quote(
            "",
            nodes.paragraph("", rows[0]["why"]),
            evidence_links(page.env.docname, reason),
            classes=["claim-reason"],
        )


def _failed(page: ReportDirective, row: Row, claim: Mapping[str, Any]) -> list[Node]:
    here = f" Here {with_unit(row, 'our_value')}." if row["kind"] == "number" else ""
    return [
        page.claim(row["id"]),
        _text(f" {claim['statement']}{here} "),
        verdict_mark(row["verdict"]),
    ]


# --- what is open -----------------------------------------------------------------------


def _assumptions(page: ReportDirective) -> Iterator[Node]:
    register = points(page.source)
    kinds = list(dict.fromkeys(one["kind"] for one in register))
    rows = [
        [
            _text(kind),
            _text(str(sum(one["kind"] == kind for one in register))),
            _text(str(sum(one["kind"] == kind and "switches" in one for one in register))),
        ]
        for kind in kinds
    ]
    rows.append(
        [
            _text("all"),
            _text(str(len(register))),
            _text(str(sum("switches" in one for one in register))),
        ]
    )
    yield _table(map(_text, ("Kind", "Open points", "With a switch")), rows)
    yield from _what_matters(page, register)


def _what_matters(page: ReportDirective, register: Sequence[Mapping[str, Any]]) -> Iterator[Node]:
    """The points that matter most, each with the reading that is taken."""
    times = measured_times(page.source)
    if not times:
        yield nodes.paragraph("", "What each of them does to the numbers is not among the results.")
        return
    first = sorted(times, key=lambda name: times[name], reverse=True)[:MOST]
    taken = {one["id"]: one for one in register}
    rows = [
        [
            page.point(name),
            _text(taken[name]["says"]),
            _text(taken[name]["readings"][taken[name]["choice"] - 1]),
            _text(_multiple(times[name])),
        ]
        for name in first
    ]
    yield nodes.paragraph(
        "",
        f"The {len(rows)} that matter most, by what their other readings do to a headline "
        "number, as a multiple of what another random sea does to it:",
    )
    yield _table(map(_text, ("Point", "The paper", "Read here", "Effect")), rows)


def measured_times(source: Path) -> dict[str, float]:
    """Largest effect of each point that was measured, over the scatter between seas."""
    times: dict[str, float] = {}
    for row in effects(source):
        times[row["point"]] = max(times.get(row["point"], 0.0), float(row["times"]))
    return times


def _multiple(times: float) -> str:
    return f"{times:.1f} \N{MULTIPLICATION SIGN}"


def _wanted(page: ReportDirective) -> Iterator[Node]:
    """What is missing: open parameters and gaps, those with the largest effect first."""
    data = page.source.parent / "data"
    times = measured_times(page.source)
    chosen = _toml(data / "parameters" / "calibrated.toml")
    values = _toml(data / "studies" / "plausible_ranges.toml")["range"]
    asked = {one["open_point"] for one in values}
    gaps = [one for one in points(page.source) if one["kind"] == "gap" or one["id"] in asked]
    gaps.sort(key=lambda one: (-times.get(one["id"], -1.0), one["id"]))
    rows = []
    for gap in gaps:
        own = [one for one in values if one["open_point"] == gap["id"]]
        wanted = [_value(one, chosen) for one in own]
        effect = _multiple(times[gap["id"]]) if gap["id"] in times else NONE
        taken = [_text(gap["readings"][gap["choice"] - 1])]
        rows.append([page.point(gap["id"]), _text(gap["says"]), wanted or taken, _text(effect)])
    yield _table(map(_text, ("Point", "What is not stated", "Assumed here", "Effect")), rows)


def _value(value: Mapping[str, Any], chosen: Mapping[str, Any]) -> Node:
    """An open parameter with its plausible range and what the calibrated set has."""
    section, _, name = value["field"].partition(".")
    found = chosen.get(section, {}).get(name)
    several = found if isinstance(found, list) else [found] * (found is not None)
    here = ", ".join(dict.fromkeys(rounded(str(one)) for one in several))
    unit = "" if value["unit"] == "-" else f" {value['unit']}"
    ends = f"{rounded(str(value['low']))} to {rounded(str(value['high']))}{unit}"
    return _text(f"{value['symbol']}: {here} ({ends})" if here else f"{value['symbol']}: {ends}")


# --- how it was done --------------------------------------------------------------------


def _provenances(source: Path) -> dict[str, dict[str, Any]]:
    """What was written beside the results of every experiment, by its name."""
    found = {}
    for path in sorted((source / "results").glob("*/provenance.json")):
        written = json.loads(path.read_text(encoding="utf-8"))
        if "experiment" in written:
            found[written["experiment"]] = written
    if not found:
        raise LookupError("no experiment among the results")
    return found


def _experiments(page: ReportDirective) -> Iterator[Node]:
    rows = []
    for name, written in _provenances(page.source).items():
        runs = written["runs"].values()
        solves: Counter[str] = Counter()
        for run in runs:
            solves.update(run.get("solver_statuses", {}))
        failed = sum(count for status, count in solves.items() if status != CONVERGED)
        rows.append(
            [
                nodes.literal("", name),
                _text(written["title"]),
                _text(str(len(runs))),
                _text(_duration(sum(run["seconds"] for run in runs))),
                _text(f"{failed} of {solves.total()}" if solves else NONE),
            ]
        )
    headings = ("Experiment", "What", "Runs", "Processor time", "Solves not converged")
    made = _table(map(_text, headings), rows)
    body = next(iter(made.findall(nodes.tbody)))
    for name, row in zip(_provenances(page.source), body.children, strict=True):
        anchor = f"experiment-{name.replace('_', '-')}"
        row["ids"] = [anchor]
        note_target(page.env, f"experiment-{name}", (page.env.docname, anchor), name)
    yield made


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def _environment(page: ReportDirective) -> Iterator[Node]:
    written = _provenances(page.source).values()
    rows: dict[str, list[str]] = {}
    for one in written:
        machine = one["machine"]
        said = {
            "Python": machine["python"],
            "Platform": f"{machine['platform']}, {machine['processors']} processors",
            "Solver and plant": one["engine"],
            "Commit": one["commit"][:12],
            "Lock file (SHA-256)": one["lock"][:12],
            **machine["libraries"],
        }
        for name, what in said.items():
            rows.setdefault(name, []).append(str(what))
    yield _table(
        None,
        [[_text(name), _text(", ".join(dict.fromkeys(what)))] for name, what in rows.items()],
    )


def _chapters(page: ReportDirective) -> Iterator[Node]:
    there = [name for name in CHAPTERS if name in page.env.found_docs]
    if not there:
        raise LookupError("no page on sensitivity")
    yield _bullets([[page.link("doc", f"/{name}")] for name in there])


PARTS: Mapping[str, Callable[[ReportDirective], Iterator[Node]]] = {
    "verdicts": _verdicts,
    "headline": _headline,
    "agreement": _agreement,
    "disagreement": _disagreement,
    "assumptions": _assumptions,
    "wanted": _wanted,
    "experiments": _experiments,
    "environment": _environment,
    "chapters": _chapters,
}


# --- nodes ------------------------------------------------------------------------------


def _text(words: str) -> Node:
    return nodes.Text(words)


def _bullets(items: Sequence[Sequence[Node]]) -> Node:
    return nodes.bullet_list(
        "", *(nodes.list_item("", nodes.paragraph("", "", *item)) for item in items)
    )


def _table(headings: Any, rows: Sequence[Sequence[Any]]) -> nodes.table:
    """A table; a cell is a node, or a list of them with a paragraph for each."""
    body = [nodes.row("", *(_cell(cell) for cell in row)) for row in rows]
    group = nodes.tgroup("", cols=len(rows[0]))
    group += [nodes.colspec(colwidth=1) for _ in rows[0]]
    if headings is not None:
        group += nodes.thead("", nodes.row("", *(_cell(heading) for heading in headings)))
    group += nodes.tbody("", *body)
    return nodes.table("", group, classes=["report"])


def _cell(cell: Node | list[Node]) -> nodes.entry:
    return entry(*cell) if isinstance(cell, list) else entry(cell)


def _toml(path: Path) -> dict[str, Any]:
    with path.open("rb") as stream:
        return tomllib.load(stream)


def _note_points(app: Sphinx, env: BuildEnvironment) -> list[str]:  # noqa: ARG001
    """Make the rows of the register known to links, by the name of the point."""
    if "register" in env.found_docs:
        for one in points(Path(env.srcdir)):
            anchor = one["id"].lower()
            note_target(env, f"point-{anchor}", ("register", anchor), one["id"])
    return []


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_directive("report", ReportDirective)
    app.connect("env-updated", _note_points)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
