"""What several figures share: the controllers' looks, interval bars, legends, words on seas."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from softwave_min.experiments.closed_loop import controllers
from softwave_min.figures.style import BLUE, DASHES, INK, ORANGE, SKY
from softwave_min.paper.numbers import CONTROLLER
from softwave_min.runs.statistics import INTERVAL


@dataclass(frozen=True)
class Look:
    """How a controller is drawn and called."""

    label: str
    colour: str
    """Of a line."""
    dash: Any
    face: str
    """Of an area or a body."""


LOOKS = {
    "baseline": Look("feed-forward + PD", ORANGE, DASHES[1], ORANGE),
    "nmpc": Look("NMPC", INK, DASHES[0], BLUE),
}
FURTHER = ("#009e73", "#cc79a7", SKY, "#e69f00")
"""Colours of the controllers that have no look of their own, from Okabe and Ito's as well."""


def look(name: str) -> Look:
    """How a controller is drawn; one that is not in ``LOOKS`` goes by its name."""
    new = (one for one in controllers() if one not in LOOKS)
    spare = {one: Look(one, hue, (0, (3, 1, 1, 1)), hue) for one, hue in zip(new, cycle(FURTHER))}
    return {**spare, **LOOKS}[name]


def stem_for(stem: str, controller: str) -> str:
    """Name of a figure of one controller: the paper's has the stem alone."""
    return stem if controller == CONTROLLER else f"{stem}_{controller}"


def intervals(axes: Axes, places: Sequence[float], rows: pd.DataFrame) -> None:
    """A mark at the median and a bar from ``low`` to ``high`` for each row."""
    axes.vlines(places, rows["low"], rows["high"], color=SKY, linewidth=6)
    axes.plot(places, rows["median"], "s", color=INK, markersize=4, linestyle="none")


def whiskers(
    axes: Axes, places: ArrayLike, low: Any, middle: Any, high: Any, colour: str = INK
) -> None:
    """Thin lines over bars from the lower to the upper end of an interval."""
    axes.errorbar(
        places, middle, [middle - low, high - middle], fmt="none", ecolor=colour, elinewidth=0.9
    )


def beside(groups: int, index: int, count: int, width: float) -> NDArray[np.float64]:
    """Middles of one bar of every group, the one at ``index`` of ``count`` side by side."""
    return np.arange(groups, dtype=float) + (index - (count - 1) / 2) * width


def name_groups(axes: Axes, names: Iterable[str]) -> None:
    """Write the groups' names under them, and leave out the lines of the grid there."""
    names = list(names)
    axes.set_xticks(range(len(names)), names)
    axes.grid(visible=False, axis="x")


def legend_above(axes: Axes, **options: Any) -> None:
    """Put the legend on the line of the title, where it hides no data."""
    usual = {"ncols": len(axes.get_legend_handles_labels()[0]), "loc": "lower right"}
    axes.legend(**{**usual, "bbox_to_anchor": (1.0, 0.97), "borderpad": 0, **options})


def failure_sentence(table: pd.DataFrame, mark: str = "") -> str:
    """How many solves of a table's loops did not converge; ``mark`` says how they are shown."""
    solves, fallbacks = int(table["solves_failed"].sum()), int(table["fallbacks"].sum())
    if not solves + fallbacks:
        return "Every solve converged."
    return (
        f"Solves that did not converge: {solves}; commands from a fallback: {fallbacks}; "
        f"their runs count.{' ' * bool(mark)}{mark}"
    )


def seas_sentence(seas: int) -> str:
    """Over how many random seas a figure's numbers are taken."""
    if seas == 1:
        return "One random sea."
    low, _, high = (f"{100 * quantile:g}" for quantile in INTERVAL)
    return f"Medians over {seas} random seas, with {low} % to {high} % of them."
