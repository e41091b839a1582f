"""What other readings do to the headline numbers, ranked, beside what another sea does."""

from __future__ import annotations

import math
from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter

from softwave_min.figures.style import GREY, INK, ORANGE, SKY, Drawing
from softwave_min.paper.tolerance import POINTS, SHARE
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store

APART = 5.0
"""Ratio of neighbouring ticks at least."""
PANELS: Mapping[str, tuple[str, float]] = {
    "largest_reduction": ("(a) largest\nreduction, points", 1.0),
    "lowest_reduction": ("(b) smallest\nreduction, points", 1.0),
    "rise": ("(c) rise after\nfailure, points", 1.0),
    "star": ("(d) error on\nthe star, cm", 100.0),
}
"""Title of each group, and what its numbers are multiplied with."""
ROW = 0.19
"""Height of a switch, in inches."""


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:  # noqa: ARG001
    """A row for each switch, a panel for each group of numbers."""
    effects, scatter, points = map(store.read_table, ("effects", "scatter", "points"))
    ranked = ranking(points)
    usual = scatter.groupby("group")[["scatter", "allowance"]].max()
    figure, axes = plt.subplots(1, len(PANELS), sharey=True, figsize=(7.0, 1.3 + ROW * len(ranked)))
    for one, (group, (title, scale)) in zip(axes, PANELS.items(), strict=True):
        changes = effects[effects["group"] == group].groupby("field")["difference"]
        _panel(one, scale * changes.agg(["min", "max"]), list(ranked), *(scale * usual.loc[group]))
        one.set_title(title)
    axes[0].set_yticks(range(len(ranked)), list(ranked.values()), fontsize=7)
    axes[0].set_ylim(len(ranked) - 0.4, -0.6)
    matter = points.groupby("field")["matters"].first().eq("yes").sum()
    seas = int(scatter["seas"].max())
    caption = (
        "What other readings of the paper do to its headline numbers: for each switch of the "
        "open points the range of the change over its values and the three wave cases, with a "
        "point at the largest. The band is what another sea does, half the 90 % interval of the "
        f"nominal numbers over {seas} seas; within it the point is open. The dashed lines are "
        f"how far a number may be off and count as reproduced, {100 * SHARE:g} % of "
        f"the paper's or {POINTS:g} points, or the band where that is wider; beyond "
        "them the point is dark. Ranked by the largest change as a multiple of that distance. "
        "The scale is linear within the band and logarithmic beyond."
    )
    first = next(iter(ranked.values()))
    alt = (
        f"Four panels with a bar for each of {len(ranked)} switches around a band about zero, the "
        f"longest at the top. The bars of {matter} switches reach beyond the dashed lines in some "
        f"panel; {first} is at the top."
    )
    return {"open_points": Drawing(figure, caption, alt)}


def ranking(points: pd.DataFrame) -> dict[str, str]:
    """Label of each switch by its field, that with the largest change first.

    A switch of several points is one row, with the ids of all.
    """
    points = points.sort_values("times", ascending=False, kind="stable")
    return {
        str(field): f"{', '.join(own['point'])} {str(field).split('.')[1].replace('_', ' ')}"
        for field, own in points.groupby("field", sort=False)
    }


def _panel(
    axes: Axes, changes: pd.DataFrame, fields: list[str], scatter: float, allowance: float
) -> None:
    axes.axvspan(-scatter, scatter, color=SKY, alpha=0.35, linewidth=0)
    axes.axvline(0.0, color=GREY, linewidth=0.8, linestyle="-")
    for limit in (-allowance, allowance):
        axes.axvline(limit, color=GREY, linewidth=0.8, linestyle=(0, (4, 2)))
    ends = changes.loc[fields, ["min", "max"]].to_numpy(float)
    for row, (low, high) in enumerate(ends):
        if np.isnan(low):
            axes.plot(0.0, row, "x", color=ORANGE, markersize=5)
            continue
        axes.hlines(row, min(low, 0.0), max(high, 0.0), color=INK, linewidth=1.2)
        largest = max(low, high, key=abs)
        beyond = sum(abs(largest) > limit for limit in (scatter, allowance))
        fill = ("white", ORANGE, INK)[beyond]
        axes.plot(largest, row, "o", color=INK, markerfacecolor=fill, markersize=4)
    axes.set_xscale("symlog", linthresh=scatter, linscale=0.8)
    axes.xaxis.set_major_locator(FixedLocator(_ticks(scatter, float(np.nanmax(np.abs(ends))))))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.tick_params(axis="x", labelsize=7)
    axes.minorticks_off()
    axes.grid(visible=False, axis="y")


def _ticks(scatter: float, largest: float) -> list[float]:
    """Zero, a round number within the linear part of the scale, and some far enough beyond."""
    powers = [math.floor(math.log10(one)) for one in (scatter, max(largest, scatter))]
    decades = range(powers[0], powers[1] + 1)
    round_numbers = [part * 10.0**power for power in decades for part in (1, 2, 5)]
    ticks = [max(one for one in round_numbers if one <= scatter)]
    for one in round_numbers:
        if APART * ticks[-1] <= one <= largest:
            ticks.append(one)
    return sorted([0.0, *ticks, *(-one for one in ticks)])
