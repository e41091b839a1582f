"""The directive ``{drawing}``: a figure of ``results/`` with the words that belong to it.

``{drawing} example_case/headline`` shows ``results/example_case/headline.svg`` as a numbered
figure, with the caption and the alternative text that the code wrote to ``provenance.json``
when it drew it. Where ``.webm`` and ``.mp4`` lie beside it they are shown, and the picture
stands for them until they have come. Such a film loops without sound, unless the reader asks
the system for reduced motion (``book/_static/film.js``). The option ``name`` is the label for
references.
"""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.nodes import Node
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from softwave_min.runs.store import Store

logger = logging.getLogger(__name__)

FILMS = {".webm": "video/webm", ".mp4": "video/mp4"}
PICTURE = ".svg"


class Film(nodes.General, nodes.Element):
    """Attributes ``alt`` and ``files``, from suffix to name among the downloads."""


class DrawingDirective(SphinxDirective):
    """Makes a figure of a drawing."""

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {"name": directives.unchanged_required}

    def run(self) -> list[Node]:
        """Build the figure; warn where a part of it is missing."""
        stem = f"results/{self.arguments[0]}"
        place = Path(self.env.srcdir, stem)
        try:
            words = described(place)
            content = self._film(stem, words["alt"]) or self._picture(stem, words["alt"])
        except (OSError, LookupError) as error:
            logger.warning("drawing: %s", error, location=self.get_location())
            return []
        caption = nodes.caption("", "", *self.parse_inline(words["caption"])[0])
        figure = nodes.figure("", content, caption)
        self.set_source_info(figure)
        self.add_name(figure)
        return [figure]

    def _picture(self, stem: str, alt: str) -> Node:
        if not Path(self.env.srcdir, stem + PICTURE).is_file():
            raise LookupError(f"no file {stem}{PICTURE}")
        return nodes.image(uri=f"/{stem}{PICTURE}", alt=alt)

    def _film(self, stem: str, alt: str) -> Node | None:
        names = [stem + suffix for suffix in (*FILMS, PICTURE)]
        if not all(Path(self.env.srcdir, name).is_file() for name in names):
            return None
        files = {
            Path(name).suffix: self.env.dlfiles.add_file(self.env.docname, name) for name in names
        }
        return Film("", files=files, alt=alt)


def described(place: Path) -> dict[str, str]:
    """Caption and alternative text of a drawing, from the provenance beside it.

    Raises
    ------
    LookupError
        If the provenance does not know the drawing.
    """
    record = Store(place.parent.name, place.parents[1]).provenance()
    figures: dict[str, dict[str, str]] = record.get("figures", {})
    if place.name not in figures:
        raise LookupError(f"no figure {place.name!r} of {place.parent.name}")
    return figures[place.name]


def visit_film(self: Any, node: Film) -> None:
    """Write the HTML of a film."""
    address = {
        suffix: "/".join((self.builder.dlpath, name)) for suffix, name in node["files"].items()
    }
    alt = html.escape(node["alt"])
    sources = "".join(
        f'<source src="{address[suffix]}" type="{kind}">' for suffix, kind in FILMS.items()
    )
    self.body.append(
        f'<video class="film" controls loop muted playsinline preload="metadata"'
        f' poster="{address[PICTURE]}" aria-label="{alt}">{sources}'
        f'<img src="{address[PICTURE]}" alt="{alt}"></video>'
    )


def depart_film(self: Any, node: Film) -> None:
    """Nothing is left open."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_node(Film, html=(visit_film, depart_film))
    app.add_directive("drawing", DrawingDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
