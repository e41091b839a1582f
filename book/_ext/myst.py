"""What the extensions share: directives and roles that are functions, and the MyST they write.

A directive is a function of the results folder and of the directive's argument, content and
options that returns MyST, which is then parsed where the directive stands. A role is one that
returns a quantity and the words after it. What they cannot find is a warning, and a warning
fails the build.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol

import pandas as pd
from docutils import nodes
from docutils.nodes import Node, system_message
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective, SphinxRole

from softwave_min.data import note_read
from softwave_min.paper.claims import MINUS

logger = logging.getLogger(__name__)

DIGITS = 4
NONE = "\N{EN DASH}"
NOT_THERE = (OSError, TypeError, ValueError, LookupError)
"""How a function says that it cannot find what it needs."""

Cell = str | Sequence[str]
"""MyST of a table's cell; of several, each is a paragraph."""


def directive(
    write: Callable[..., str], arguments: int = 0, *options: str, content: bool = False
) -> type[SphinxDirective]:
    """A directive that shows the MyST which a function writes."""

    class Computed(SphinxDirective):
        required_arguments = arguments
        has_content = content
        option_spec: ClassVar[Any] = dict.fromkeys(options, directives.unchanged_required)

        def run(self) -> list[Node]:
            given = [*self.arguments, *([list(self.content)] if content else [])]
            try:
                text = write(Path(self.env.srcdir, "results"), *given, **self.options)
            except NOT_THERE as error:
                logger.warning("%s: %s", self.name, error, location=self.get_location())
                return []
            return self.parse_text_to_nodes(text)

    return Computed


def role(find: Callable[[Path, str], tuple[str, str]]) -> SphinxRole:
    """A role that quotes the quantity which a function of results and text finds."""

    class Quoted(SphinxRole):
        def run(self) -> tuple[list[Node], list[system_message]]:
            try:
                quantity, words = find(Path(self.env.srcdir, "results"), self.text)
            except NOT_THERE as error:
                where = self.get_location()
                logger.warning("%s %r: %s", self.name, self.text, error, location=where)
                return [], []
            number = nodes.inline(self.rawtext, quantity, classes=["quoted"])
            return [number, nodes.Text(f" {words}")] if words else [number], []

    return Quoted()


def extension(
    directives: Mapping[str, type[SphinxDirective]], roles: Mapping[str, SphinxRole] | None = None
) -> Callable[[Sphinx], dict[str, Any]]:
    """What Sphinx calls to learn of directives and roles."""

    def setup(app: Sphinx) -> dict[str, Any]:
        for name, one in directives.items():
            app.add_directive(name, one)
        for name, found in (roles or {}).items():
            app.add_role(name, found)
        return {"parallel_read_safe": True, "parallel_write_safe": True}

    return setup


def texts(path: Path) -> pd.DataFrame:
    """A table as it is written: every cell is text."""
    note_read(path)
    return pd.read_csv(path, dtype=str, keep_default_na=False)


# --- words ------------------------------------------------------------------------------


def plain(text: str) -> str:
    """MyST that shows a text as it is, whatever characters it has."""
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", text.replace("\n", " "))


def classed(text: str, name: str) -> str:
    """A text that the style sheet knows by a class."""
    return f"[{plain(text)}]{{.{name}}}"


def aside(text: str) -> str:
    """A note in smaller letters."""
    return classed(text, "claim-note") if text else ""


def sentence(text: str) -> str:
    """The words as a sentence."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


def rounded(number: object) -> str:
    """A number to be read; what is none stays as it is."""
    try:
        text = f"{float(str(number)):.{DIGITS}g}"
    except ValueError:
        text = str(number)
    return text.replace("-", MINUS)


# --- links and tables -------------------------------------------------------------------


class Treated(Protocol):
    """What is treated on a page of the book, and may have a label there."""

    page: str
    label: str


def links(treated: Treated) -> list[str]:
    """Links to where something is treated: to ``page`` and, if any, ``label``."""
    found = [f"{{doc}}`/{treated.page}`"]
    return [*found, link(treated.label)] if treated.label else found


def link(label: str, title: str = "") -> str:
    """A link to a label: by a title, by the heading of a section, or by a number."""
    if title:
        return f"{{ref}}`{title} <{label}>`"
    return f"{{ref}}`{label}`" if label.startswith("sec-") else f"{{numref}}`{label}`"


def target(label: str, text: str) -> str:
    """A text that can be linked to."""
    return f"({label})=\n{text}"


def bullets(items: Iterable[str]) -> str:
    """A list; each item is one paragraph."""
    return "\n".join(f"- {item}" for item in items) or "Nothing."


def table(
    headings: Sequence[str], rows: Iterable[Sequence[Cell]], title: str = "", **options: str
) -> str:
    """A table; without headings if there are none."""
    lines = [*([headings] if any(headings) else []), *rows]
    settings = options | {"header-rows": "1" if any(headings) else "0"}
    return "\n".join(
        [
            f"::::{{list-table}} {title}",
            *(f":{name.rstrip('_')}: {value}" for name, value in settings.items()),
            "",
            *(_row(cells) for cells in lines),
            "::::",
        ]
    )


def _row(cells: Sequence[Cell]) -> str:
    written = []
    for cell in cells:
        blocks = [cell] if isinstance(cell, str) else [block for block in cell if block]
        text = "\n\n".join(blocks).replace("\n", "\n    ")
        written.append(f"- {text}".rstrip())
    return "* " + "\n  ".join(written)
