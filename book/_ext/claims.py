"""The directive ``{claims}``: what the paper claims, and the verdict on each claim, as a table.

The statements are those of ``data/paper/claims.toml``, the numbers, verdicts and reasons those of
``results/claims/claims.csv``; each row leads to the figure, the section or cell, and the
experiment that answer the claim, and unfolds why it fails if it does. A claim that fails without
a reason is a warning. ``book/_static/claims.js`` lets a reader sort and filter the rows; without
it the table is whole.

The role ``{verdicts}`` counts the claims that have a verdict, or a kind and a verdict
(``trend/reproduced``); ``all`` stands for every verdict. After a colon the words for one and for
several may follow: ``{verdicts}`supported: explanation is supported; explanations are` ``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any, cast

from docutils import nodes
from docutils.nodes import Node, system_message
from sphinx.application import Sphinx
from sphinx.domains.std import StandardDomain
from sphinx.environment import BuildEnvironment
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective, SphinxRole
from tables import aside, entry, links, reference, rounded, rows_of, sentence, table

logger = logging.getLogger(__name__)

HEADINGS = ("Claim", "The paper says", "Paper", "Here", "Verdict", "Shown in")
EVERY = "all"
"""Stands for every verdict."""
FAILED = ("not reproduced", "not supported")
"""Verdicts that need a reason."""


def verdicts(source: Path) -> list[dict[str, str]]:
    """Rows of the table of verdicts, from the folder of the book's sources."""
    return rows_of(source / "results" / "claims" / "claims.csv")


def judged(source: Path) -> dict[str, Any]:
    """Claims by id and reasons by name, as stated in the project's data."""
    path = source.parent / "data" / "paper" / "claims.toml"
    with path.open("rb") as stream:
        found = tomllib.load(stream)
    return {"claim": {one["id"]: one for one in found["claim"]}, "reason": found["reason"]}


def interval(row: Mapping[str, str]) -> str:
    """Both ends of the interval over random seas; nothing where there is none."""
    return f"{rounded(row['low'])} to {rounded(row['high'])}" if row["low"] else ""


def with_unit(row: Mapping[str, str], column: str) -> str:
    """A number of the table with its unit."""
    return f"{rounded(row[column])} {row['unit']}".rstrip() if row[column] else ""


def counted(count: int, forms: str = "") -> list[Node]:
    """A number and what is counted: the words for one and, after a semicolon, for several."""
    one, _, several = (part.strip() for part in forms.partition(";"))
    words = one if count == 1 else several
    number = nodes.inline("", str(count), classes=["quoted"])
    return [number, nodes.Text(f" {words}")] if words else [number]


def note_target(env: BuildEnvironment, name: str, place: tuple[str, str], title: str) -> None:
    """Let a link of kind 'ref' find a place, a page and an anchor on it, by a name."""
    standard = cast(StandardDomain, env.get_domain("std"))
    standard.note_hyperlink_target(name, *place, title)


def verdict_mark(verdict: str) -> Node:
    """A verdict with the mark that the style sheet gives it."""
    return nodes.inline("", verdict, classes=[f"verdict-{verdict.replace(' ', '-')}"])


def evidence_links(page: str, reason: Mapping[str, Any]) -> nodes.paragraph:
    """Links from a page to what a reason rests on."""
    paragraph = nodes.paragraph("", "Computed in: ", classes=["claim-note"])
    for place in reason["evidence"]:
        label = place.partition("#")[2]
        kind = "ref" if label.startswith("sec-") else "numref"
        paragraph += [reference(page, kind, label), nodes.Text("; ")]
    paragraph[-1] = nodes.Text(".")
    return paragraph


def folded(summary: str, contents: Iterable[Node]) -> list[Node]:
    """What a reader unfolds; open where there is no HTML."""
    opening = f'<details class="claim-why"><summary>{escape(summary)}</summary>'
    return [_html(opening), *contents, _html("</details>")]


def _html(text: str) -> Node:
    return nodes.raw("", text, format="html")


class ClaimsDirective(SphinxDirective):
    """Makes the table."""

    def run(self) -> list[Node]:
        """Build the table; warn where a part of it is missing."""
        source = Path(self.env.srcdir)
        try:
            stated = judged(source)
            rows = [self._row(row, stated) for row in verdicts(source)]
        except (OSError, LookupError, ValueError) as error:
            logger.warning("claims: %s", error, location=self.get_location())
            return []
        return [table(HEADINGS, rows)]

    def _row(self, row: Mapping[str, str], stated: Mapping[str, Any]) -> nodes.row:
        claim, anchor = stated["claim"][row["id"]], row["id"].lower()
        note_target(self.env, f"claim-{anchor}", (self.env.docname, anchor), row["id"])
        says = entry(
            nodes.Text(claim["statement"]), aside(f"{sentence(claim['place'])} {row['note']}")
        )
        if row["verdict"] in FAILED:
            says += self._why(row, stated["reason"].get(claim.get("why", "")))
        return nodes.row(
            "",
            entry(nodes.Text(row["id"]), aside(row["kind"])),
            says,
            entry(nodes.Text(with_unit(row, "paper_value"))),
            entry(nodes.Text(with_unit(row, "our_value")), aside(interval(row))),
            entry(verdict_mark(row["verdict"])),
            entry(*self._links(claim)),
            ids=[anchor],
        )

    def _why(self, row: Mapping[str, str], reason: Mapping[str, Any] | None) -> list[Node]:
        if reason is None or not row["why"]:
            words = f"claims: {row['id']} is {row['verdict']}, without a reason"
            logger.warning(words, location=self.get_location())
            return []
        why = nodes.paragraph("", row["why"])
        return folded(f"Why {row['verdict']}", [why, evidence_links(self.env.docname, reason)])

    def _links(self, claim: Mapping[str, Any]) -> list[Node]:
        page = self.env.docname
        found = links(page, claim)
        cell = claim["cell"]
        found.append(reference(page, "ref" if cell.startswith("sec-") else "numref", cell))
        if experiment := claim.get("experiment", ""):
            found.append(reference(page, "ref", f"experiment-{experiment}"))
        return found


class VerdictsRole(SphinxRole):
    """Counts claims."""

    def run(self) -> tuple[list[Node], list[system_message]]:
        """Count; warn where there are no verdicts."""
        what, _, forms = self.text.partition(":")
        *kind, verdict = what.split("/")
        try:
            rows = verdicts(Path(self.env.srcdir))
        except OSError as error:
            logger.warning("verdicts: %s", error, location=self.get_location())
            return [], []
        found = [row for row in rows if not kind or row["kind"] == kind[0]]
        count = sum(verdict in {row["verdict"], EVERY} for row in found)
        return counted(count, forms), []


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_directive("claims", ClaimsDirective)
    app.add_role("verdicts", VerdictsRole())
    return {"parallel_read_safe": True, "parallel_write_safe": True}
