"""What the tables of claims and of open points share: their rows, cells and links."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.nodes import Node
from sphinx import addnodes

MINUS = "\N{MINUS SIGN}"
DIGITS = 4


def rows_of(path: Path) -> list[dict[str, str]]:
    """Rows of a table of the results."""
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def rounded(number: str, digits: int = DIGITS) -> str:
    """A number to be read; what is none stays as it is."""
    try:
        text = f"{float(number):.{digits}g}"
    except ValueError:
        text = number
    return text.replace("-", MINUS)


def sentence(text: str) -> str:
    """The words as a sentence."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


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


def links(page: str, treated: Mapping[str, Any]) -> list[Node]:
    """Links from a page to where something is treated: to ``page`` and, if any, ``label``."""
    found = [reference(page, "doc", f"/{treated['page']}")]
    label = treated.get("label", "")
    if label:
        kind = "ref" if label.startswith("sec-") else "numref"
        found.append(reference(page, kind, label))
    return found


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
