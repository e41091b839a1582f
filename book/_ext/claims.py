"""The directive ``{claims}``: what the paper claims, and the verdict on each claim, as a table.

The statements are those of ``data/paper/claims.toml``, the numbers and verdicts those of
``results/claims/claims.csv``; each row leads to the page and the figure where the claim is
examined. ``book/_static/claims.js`` lets a reader sort and filter the rows; without it the
table is whole. The role ``{verdicts}`` counts the claims that have a verdict, or a kind and a
verdict (``trend/reproduced``); ``all`` stands for every verdict.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.nodes import Node, system_message
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective, SphinxRole

logger = logging.getLogger(__name__)

HEADINGS = ("Claim", "The paper says", "Paper", "Here", "Verdict", "Shown in")
MINUS = "\N{MINUS SIGN}"
DIGITS = 4
EVERY = "all"
"""Stands for every verdict."""


def verdicts(source: Path) -> list[dict[str, str]]:
    """Rows of the table of verdicts, from the folder of the book's sources."""
    table = source / "results" / "claims" / "claims.csv"
    with table.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def statements(source: Path) -> dict[str, dict[str, Any]]:
    """What the claims say, by id."""
    path = source.parent / "data" / "paper" / "claims.toml"
    with path.open("rb") as stream:
        return {one["id"]: one for one in tomllib.load(stream)["claim"]}


def rounded(number: str) -> str:
    """A number to be read; what is none stays as it is."""
    try:
        text = f"{float(number):.{DIGITS}g}"
    except ValueError:
        text = number
    return text.replace("-", MINUS)


def interval(row: dict[str, str]) -> str:
    """Both ends of the interval over random seas; nothing where there is none."""
    return f"{rounded(row['low'])} to {rounded(row['high'])}" if row["low"] else ""


class ClaimsDirective(SphinxDirective):
    """Makes the table."""

    def run(self) -> list[Node]:
        """Build the table; warn where a part of it is missing."""
        source = Path(self.env.srcdir)
        try:
            said = statements(source)
            rows = [self._row(row, said[row["id"]]) for row in verdicts(source)]
        except (OSError, LookupError, ValueError) as error:
            logger.warning("claims: %s", error, location=self.get_location())
            return []
        return [table(HEADINGS, rows)]

    def _row(self, row: dict[str, str], claim: dict[str, Any]) -> nodes.row:
        place = f"{claim['place'][0].upper()}{claim['place'][1:]}."
        verdict = row["verdict"]
        return nodes.row(
            "",
            entry(nodes.Text(row["id"]), aside(row["kind"])),
            entry(nodes.Text(claim["statement"]), aside(f"{place} {row['note']}")),
            entry(nodes.Text(_with_unit(row, "paper_value"))),
            entry(nodes.Text(_with_unit(row, "our_value")), aside(interval(row))),
            entry(nodes.inline("", verdict, classes=[f"verdict-{verdict.replace(' ', '-')}"])),
            entry(*self._links(claim)),
            ids=[row["id"].lower()],
        )

    def _links(self, claim: dict[str, Any]) -> list[Node]:
        links: list[Node] = [reference(self.env.docname, "doc", f"/{claim['page']}")]
        if claim.get("label"):
            links.append(reference(self.env.docname, "numref", claim["label"]))
        return links


def _with_unit(row: dict[str, str], column: str) -> str:
    return f"{rounded(row[column])} {row['unit']}".rstrip() if row[column] else ""


def table(headings: Sequence[str], rows: Sequence[nodes.row], *classes: str) -> nodes.table:
    """A table that ``claims.js`` lets a reader sort and filter.

    Its first column has an id and, aside, a kind; its fifth what can be chosen beside the kind.
    """
    head = nodes.row("", *(entry(nodes.Text(heading)) for heading in headings))
    group = nodes.tgroup(
        "",
        *(nodes.colspec(colwidth=1) for _ in headings),
        nodes.thead("", head),
        nodes.tbody("", *rows),
        cols=len(headings),
    )
    return nodes.table("", group, classes=["claims", *classes])


def aside(text: str) -> Node:
    """A note in smaller letters."""
    return nodes.inline("", text, classes=["claim-note"])


def entry(*contents: Node) -> nodes.entry:
    """A cell, with a paragraph for each of its contents."""
    return nodes.entry("", *(nodes.paragraph("", "", content) for content in contents))


def reference(page: str, kind: str, target: str) -> Node:
    """A link from a page to a page ('doc'), a numbered thing ('numref') or a section ('ref')."""
    return addnodes.pending_xref(
        "",
        nodes.inline(),
        refdoc=page,
        refdomain="std",
        reftype=kind,
        reftarget=target,
        refexplicit=False,
        refwarn=True,
    )


class VerdictsRole(SphinxRole):
    """Counts claims."""

    def run(self) -> tuple[list[Node], list[system_message]]:
        """Count; warn where there are no verdicts."""
        *kind, verdict = self.text.split("/")
        try:
            rows = verdicts(Path(self.env.srcdir))
        except OSError as error:
            logger.warning("verdicts: %s", error, location=self.get_location())
            return [], []
        found = [row for row in rows if not kind or row["kind"] == kind[0]]
        count = sum(verdict in {row["verdict"], EVERY} for row in found)
        return [nodes.inline(self.rawtext, str(count), classes=["quoted"])], []


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_directive("claims", ClaimsDirective)
    app.add_role("verdicts", VerdictsRole())
    return {"parallel_read_safe": True, "parallel_write_safe": True}
