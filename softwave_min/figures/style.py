"""One style for every figure, and how a figure becomes a file.

Lines differ in colour, in lightness and in dash pattern, so that they can be told
apart in grey and by colour-blind readers; the colours are Okabe and Ito's.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from xml.sax.saxutils import escape

import matplotlib as mpl
from cycler import cycler
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK = "#222222"
GREY = "#8a8a8a"
BLUE = "#0072b2"
ORANGE = "#d55e00"
SKY = "#56b4e9"
SERIES = (INK, ORANGE, SKY)
"""Dark, middle and light: a series keeps its order in grey."""
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)))
"""Dash patterns that go with SERIES."""

SETTINGS: Any = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.prop_cycle": cycler(color=list(SERIES), linestyle=list(DASHES)),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": "medium",
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "figure.figsize": (7.0, 3.6),
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.dpi": 200,
    "svg.hashsalt": "softwave_min",
}


@dataclass(frozen=True)
class Drawing:
    """A figure with what has to be said of it."""

    figure: Figure
    caption: str
    """Can be read without the text around it."""
    alt: str
    """What a reader who cannot see the figure should know."""
    media: Mapping[str, bytes] = field(default_factory=dict)
    """Films of the same scene, by the suffix of their file."""


def apply() -> None:
    """Make the style the default of this process, and of what it starts.

    A figure that somebody else writes as SVG, such as a notebook, has no day in it either.
    """
    mpl.rcParams.update(SETTINGS)
    os.environ["SOURCE_DATE_EPOCH"] = "0"


def svg(drawing: Drawing) -> bytes:
    """The figure as SVG, the same bytes for the same figure, with its alt text inside."""
    buffer, figure = io.StringIO(), drawing.figure
    with mpl.rc_context(SETTINGS):
        _lay_out(figure)
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    described = f"<title>{escape(drawing.alt)}</title>\n <metadata>"
    return re.sub("<metadata>", lambda _: described, buffer.getvalue(), count=1).encode()


def _lay_out(figure: Figure) -> None:
    """Give the axes their places; `savefig` would draw all of the figure to that end alone."""
    layout = figure.get_layout_engine()
    if layout is None:
        return
    FigureCanvasSVG(figure)
    figure.set_dpi(72)  # of SVG, in which texts are measured
    layout.execute(figure)
    with mpl.rc_context({"figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)
