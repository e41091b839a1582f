"""The directive ``{report}``: the parts of the reproducibility report that are computed.

``{report} verdicts`` counts the claims by kind and verdict, ``headline`` sets the paper's numbers
against ours, ``agreement`` and ``disagreement`` list the claims that hold and those that do not,
these with their reasons; ``assumptions`` counts the open points and names those that matter most,
``wanted`` lists what the authors would have to state; ``experiments`` and ``environment`` say what
was run, and on what. All of it is read from ``results/`` and ``data/`` when the book is built;
what is not there is a warning.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import myst
import pandas as pd
from claims import claim_link, evidence, interval, judged, verdict_mark, with_unit
from open_points import effects, point_link

from softwave_min.paper.claims import Claim
from softwave_min.paper.open_points import OpenPoint, open_points
from softwave_min.paper.queries import Measured
from softwave_min.paper.verdicts import FAILED, Verdict, verdicts_path
from softwave_min.parameters import ParameterSet, parameter_set
from softwave_min.runs.store import Store
from softwave_min.studies.ranges import PlausibleRange, plausible_ranges

HOLD = ("reproduced", "supported", "trend reproduced")
"""Verdicts of what agrees, apart from artefacts."""
CONVERGED = "CONVERGED"
MOST = 8
"""How many of the open points that matter are named."""


# --- claims -----------------------------------------------------------------------------


def _verdicts(results: Path) -> str:
    rows = myst.texts(verdicts_path(results))
    count = pd.crosstab(rows["kind"], rows["verdict"], margins=True, margins_name="all")
    used = [one for one in get_args(Verdict) if one in count]
    table = [
        [kind, *(str(count.loc[kind, one] or myst.NONE) for one in used)]
        for kind in (*rows["kind"].unique(), "all")
    ]
    return _table(["Kind", *map(verdict_mark, used)], table)


def _headline(results: Path) -> str:
    rows = [
        [
            claim_link(row),
            myst.plain(claim.statement),
            with_unit(row.paper_value, row),
            with_unit(row.our_value, row),
            myst.plain(interval(row)) or myst.NONE,
            verdict_mark(row.verdict),
        ]
        for row, claim, _ in judged(results)
        if claim.kind == "number"
    ]
    return _table(("Claim", "The paper says", "Paper", "Here", "Over the seas", "Verdict"), rows)


def _agreement(results: Path) -> str:
    return myst.bullets(
        f"{claim_link(row)} {myst.plain(claim.statement)} {_size(row, claim)}"
        for row, claim, _ in judged(results)
        if row.verdict in HOLD and claim.kind != "artefact"
    )


def _size(row: Any, claim: Claim) -> str:
    """Our number beside the paper's, or else the verdict where it holds in part alone."""
    if claim.kind != "number":
        return myst.aside("(trend reproduced)") if row.verdict == "trend reproduced" else ""
    ours = Measured(float(row.our_value), *(float(one or "nan") for one in (row.low, row.high)))
    wide = ", by an interval that is wider than the tolerance" * claim.in_wide_interval(ours)
    return f"[Here {with_unit(row.our_value, row)}{wide}.]{{.claim-note}}"


def _disagreement(results: Path) -> str:
    """Reasons, each with the claims that fail for it."""
    failed = [one for one in judged(results) if one[0].verdict in FAILED]
    if bare := [row.id for row, _, reason in failed if reason is None]:
        raise LookupError(f"{', '.join(bare)}: failed, without a reason")
    reasons = {claim.why: (row, reason) for row, claim, reason in failed if reason}
    parts = [
        part
        for why, (row, reason) in reasons.items()
        for part in (
            myst.bullets(_failed(other, claim) for other, claim, _ in failed if claim.why == why),
            f"> {myst.plain(row.why)}\n>\n> {evidence(reason)}",
        )
    ]
    return "\n\n".join(parts) or "Nothing."


def _failed(row: Any, claim: Claim) -> str:
    here = f" Here {with_unit(row.our_value, row)}." if claim.kind == "number" else ""
    return f"{claim_link(row)} {myst.plain(claim.statement)}{here} {verdict_mark(row.verdict)}"


# --- what is open -----------------------------------------------------------------------


def _assumptions(results: Path) -> str:
    points = open_points()
    count = Counter(one.kind for one in points)
    switched = Counter(one.kind for one in points if one.switches)
    rows = [[kind, str(count[kind]), str(switched[kind])] for kind in count]
    rows.append(["all", str(count.total()), str(switched.total())])
    counted = _table(("Kind", "Open points", "With a switch"), rows)
    return f"{counted}\n\n{_what_matters(results, {one.id: one for one in points})}"


def _what_matters(results: Path, points: Mapping[str, OpenPoint]) -> str:
    """The points that matter most, each with the reading that is taken."""
    times = measured_times(results)
    if not times:
        return "What each of them does to the numbers is not among the results."
    first = sorted(times, key=lambda name: times[name], reverse=True)[:MOST]
    rows = [
        (point_link(one), myst.plain(points[one].says), _taken(points[one]), _multiple(times[one]))
        for one in first
    ]
    return (
        f"The {len(rows)} that matter most, by what their other readings do to a headline number, "
        "as a multiple of what another random sea does to it:\n\n"
        + _table(("Point", "The paper", "Read here", "Effect"), rows)
    )


def _taken(point: OpenPoint) -> str:
    return myst.plain(point.readings[point.choice - 1])


def measured_times(results: Path) -> dict[str, float]:
    """Largest effect of each point that was measured, over the scatter between seas."""
    found = sorted((float(row["times"]), row["point"]) for row in effects(results))
    return {point: times for times, point in found}


def _multiple(times: float) -> str:
    return f"{times:.1f} \N{MULTIPLICATION SIGN}"


def _wanted(results: Path) -> str:
    """What is missing: open parameters and gaps, those with the largest effect first."""
    times, chosen, values = measured_times(results), parameter_set("calibrated"), plausible_ranges()
    asked = {one.open_point for one in values}
    gaps = [one for one in open_points() if one.kind == "gap" or one.id in asked]
    gaps.sort(key=lambda one: (-times.get(one.id, -1.0), one.id))
    rows = [
        [
            point_link(gap.id),
            myst.plain(gap.says),
            [myst.plain(_value(one, chosen)) for one in values if one.open_point == gap.id]
            or _taken(gap),
            _multiple(times[gap.id]) if gap.id in times else myst.NONE,
        ]
        for gap in gaps
    ]
    return _table(("Point", "What is not stated", "Assumed here", "Effect"), rows)


def _value(value: PlausibleRange, chosen: ParameterSet) -> str:
    """An open parameter with its plausible range and what the calibrated set has."""
    section, _, name = value.field.partition(".")
    found = getattr(getattr(chosen, section, None), name, ())
    several = found if isinstance(found, tuple) else (found,)
    here = ", ".join(dict.fromkeys(myst.rounded(one) for one in several))
    unit = "" if value.unit == "-" else f" {value.unit}"
    ends = f"{myst.rounded(value.low)} to {myst.rounded(value.high)}{unit}"
    return f"{value.symbol}: {here} ({ends})" if here else f"{value.symbol}: {ends}"


# --- how it was done --------------------------------------------------------------------


def _provenances(results: Path) -> dict[str, dict[str, Any]]:
    """What was written beside the results of every experiment, by its name."""
    names = sorted(path.parent.name for path in results.glob("*/provenance.json"))
    written = {name: Store(name, results).provenance() for name in names}
    found = {name: one for name, one in written.items() if "experiment" in one}
    if not found:
        raise LookupError("no experiment among the results")
    return found


def _experiments(results: Path) -> str:
    rows = []
    for name, written in _provenances(results).items():
        runs = written["runs"].values()
        solves = sum((Counter(run.get("solver_statuses", {})) for run in runs), Counter[str]())
        failed = f"{solves.total() - solves[CONVERGED]} of {solves.total()}"
        title = [myst.target(f"experiment-{name}", f"`{name}`"), myst.plain(written["title"])]
        time = _duration(sum(run["seconds"] for run in runs))
        rows.append([*title, str(len(runs)), time, failed if solves else myst.NONE])
    return _table(("Experiment", "What", "Runs", "Processor time", "Solves not converged"), rows)


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def _environment(results: Path) -> str:
    found = pd.DataFrame(
        {
            "Python": one["machine"]["python"],
            "Platform": "{platform}, {processors} processors".format(**one["machine"]),
            "Solver and plant": one["engine"],
            "Commit": one["commit"][:12],
            **one["machine"]["libraries"],
        }
        for one in _provenances(results).values()
    )
    rows = {name: ", ".join(map(str, column.dropna().unique())) for name, column in found.items()}
    return _table((), [[myst.plain(str(name)), myst.plain(what)] for name, what in rows.items()])


_PARTS: tuple[Callable[[Path], str], ...] = (
    _verdicts, _headline, _agreement, _disagreement,
    _assumptions, _wanted, _experiments, _environment,
)  # fmt: skip
PARTS = {part.__name__.strip("_"): part for part in _PARTS}


def _table(headings: Any, rows: Any) -> str:
    return myst.table(headings, rows, class_="report")


def report(results: Path, part: str) -> str:
    """A part of the report."""
    return PARTS[part](results)


setup = myst.extension({"report": myst.directive(report, arguments=1)})
