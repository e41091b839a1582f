"""The directive ``{claims}``: what the paper claims, and the verdict on each claim, as a table.

Each row leads to the figure, the section or cell, and the experiment that answer the claim, and
unfolds why it fails if it does. A claim that fails without a reason is a warning.
``book/_static/claims.js`` lets a reader sort and filter the rows; without it the table is whole.

The role ``{verdicts}`` counts the claims that have a verdict, or a kind and a verdict
(``trend/reproduced``); ``all`` stands for every verdict. After a colon the words for one and for
several may follow: ``{verdicts}`supported: explanation is supported; explanations are` ``.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import myst

from softwave_min.paper.claims import Claim, Reason, read_claims
from softwave_min.paper.verdicts import FAILED, verdicts_path

HEADINGS = ("Claim", "The paper says", "Paper", "Here", "Verdict", "Shown in")
EVERY = "all"
"""Stands for every verdict."""


def judged(results: Path) -> list[tuple[Any, Claim, Reason | None]]:
    """Each row of the table of verdicts, with its claim and the reason if that has one."""
    file = read_claims()
    stated = {one.id: one for one in file.claim}
    rows = myst.texts(verdicts_path(results)).itertuples()
    return [(row, stated[row.id], file.reason.get(stated[row.id].why)) for row in rows]


def claim_link(row: Any) -> str:
    """A link to a claim."""
    return myst.link(f"claim-{row.id.lower()}", row.id)


def verdict_mark(verdict: str) -> str:
    """A verdict with the mark that the style sheet gives it."""
    return myst.classed(verdict, f"verdict-{verdict.replace(' ', '-')}")


def interval(row: Any) -> str:
    """Both ends of the interval over random seas; nothing where there is none."""
    return f"{myst.rounded(row.low)} to {myst.rounded(row.high)}" if row.low else ""


def with_unit(number: str, row: Any) -> str:
    """A number of the table with its unit."""
    return myst.plain(f"{myst.rounded(number)} {row.unit}".rstrip()) if number else ""


def evidence(reason: Reason) -> str:
    """Links to what a reason rests on."""
    places = "; ".join(myst.link(place.partition("#")[2]) for place in reason.evidence)
    return f"[Computed in: {places}.]{{.claim-note}}"


def claims_table(results: Path) -> str:
    """All claims with their verdicts."""
    rows = [
        (
            [myst.target(f"claim-{row.id.lower()}", row.id), myst.aside(row.kind)],
            [
                myst.plain(claim.statement),
                myst.aside(f"{myst.sentence(claim.place)} {row.note}"),
                *_why(row, reason),
            ],
            with_unit(row.paper_value, row),
            [with_unit(row.our_value, row), myst.aside(interval(row))],
            verdict_mark(row.verdict),
            _links(claim),
        )
        for row, claim, reason in judged(results)
    ]
    return myst.table(HEADINGS, rows, class_="claims")


def _why(row: Any, reason: Reason | None) -> Iterator[str]:
    """What a reader unfolds; open where there is no HTML."""
    if row.verdict not in FAILED:
        return
    if reason is None or not row.why:
        myst.logger.warning("claims: %s is %s, without a reason", row.id, row.verdict)
        return
    summary = escape(f"Why {row.verdict}")
    yield f'<details class="claim-why"><summary>{summary}</summary>'
    yield from (myst.plain(row.why), evidence(reason), "</details>")


def _links(claim: Claim) -> list[str]:
    experiment = claim.experiment
    found = [myst.link(f"experiment-{experiment}", experiment)] if experiment else []
    return [*myst.links(claim), myst.link(claim.cell), *found]


def count(results: Path, text: str) -> tuple[str, str]:
    """How many claims have a verdict, and the words for so many."""
    what, _, forms = text.partition(":")
    *kind, verdict = what.split("/")
    rows = myst.texts(verdicts_path(results))
    found = rows[rows["kind"] == kind[0]] if kind else rows
    number = len(found) if verdict == EVERY else int((found["verdict"] == verdict).sum())
    one, _, several = (part.strip() for part in forms.partition(";"))
    return str(number), one if number == 1 else several


setup = myst.extension({"claims": myst.directive(claims_table)}, {"verdicts": myst.role(count)})
