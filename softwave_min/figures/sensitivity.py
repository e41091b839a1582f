"""What the headline numbers hang on: elementary effects and variance-based indices."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from softwave_min.figures.style import INK, ORANGE, SKY
from softwave_min.studies.sensitivity import SEA, importance

DARK = 0.6
"""Shade from which on the text in it is white."""


def factor_label(factor: str) -> str:
    """Name of an open parameter or of the random sea, for an axis."""
    section, _, name = factor.rpartition(".")
    text = name.replace("_", " ")
    return f"{section}: {text}" if section else text


def number_label(number: str) -> str:
    """Name of a headline number, for an axis."""
    return number.replace("_", " ")


def by_kind(numbers: Iterable[str]) -> list[str]:
    """The headline numbers, each once, those of one kind for all wave cases beside each other."""
    found = list(dict.fromkeys(numbers))
    kinds = [one.partition("_W")[0] for one in found]
    return [one for _, one in sorted(zip(map(kinds.index, kinds), found, strict=True))]


def screening_matrix(table: pd.DataFrame) -> Figure:
    """Mean absolute elementary effect of each factor on each number, relative to the largest.

    Factors by their mean over the numbers; the sea, which is no open parameter, at the bottom.
    """
    means = importance(table)
    factors = [*means.drop(SEA).index, SEA]
    numbers = by_kind(table["number"])
    shades = table.pivot_table(index="field", columns="number", values="mu_star_normalised")
    shades = shades.loc[factors, numbers]
    figure, (axes, beside) = plt.subplots(
        1, 2, figsize=(7.0, 5.2), sharey=True, width_ratios=(len(numbers), 3)
    )
    axes.imshow(shades, cmap="Greys", vmin=0, vmax=1, aspect="auto")
    for (row, column), shade in np.ndenumerate(shades.to_numpy(float)):
        look: Any = {"color": "white" if shade > DARK else INK, "ha": "center", "va": "center"}
        axes.text(column, row, f"{shade:.2f}", fontsize=6, **look)
    axes.set_xticks(range(len(numbers)), map(number_label, numbers), rotation=90)
    axes.set_yticks(range(len(factors)), map(factor_label, factors))
    axes.set_title("(a) effect on each number")
    beside.barh(range(len(factors)), means.loc[factors], color=SKY)
    beside.set_title("(b) mean")
    beside.set_xlim(0, None)
    for one in (axes, beside):
        one.grid(visible=False)
        one.axhline(len(factors) - 1.5, color=INK, linewidth=1)
    return figure


def total_indices(table: pd.DataFrame) -> Figure:
    """First- and total-order indices of each number, the latter with their intervals."""
    numbers, fields = by_kind(table["number"]), list(table["field"].unique())
    columns = -(-len(fields) // 2)
    figure, panels = plt.subplots(
        2, columns, figsize=(7.0, 6.4), sharex=True, sharey=True, squeeze=False
    )
    places = range(len(numbers))
    for axes, one in zip(panels.flat, fields, strict=False):
        rows = table[table["field"] == one].set_index("number").loc[numbers]
        axes.hlines(places, rows["total_low"], rows["total_high"], color=SKY, linewidth=5)
        axes.plot(rows["total"], places, "|", color=INK, markersize=8, markeredgewidth=2)
        axes.plot(rows["first"], places, "o", color=ORANGE, markersize=3.5)
        axes.set_title(factor_label(one), fontsize=8)
    for axes in panels.flat[len(fields) :]:
        axes.set_axis_off()
    panels[0, 0].set_yticks(places, map(number_label, numbers))
    panels[0, 0].invert_yaxis()
    panels[0, 0].set_xlim(-0.05, 1.05)
    figure.supxlabel("share of the variance", fontsize=9)
    return figure
