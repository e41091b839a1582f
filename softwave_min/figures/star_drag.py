"""Errors on the star with and without drag."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pandas as pd

from softwave_min.experiments.star_drag import LOADS
from softwave_min.figures.marks import failure_sentence
from softwave_min.figures.style import INK, SKY, Drawing
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store

WIDTH = 0.38


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:  # noqa: ARG001
    """Both errors over the three seas."""
    table = store.read_table("star_drag")
    columns = {"rmse": "(a) whole run", "rmse_settled": "(b) after the start"}
    figure, panels = plt.subplots(1, 2, figsize=(7.0, 2.8))
    spreads = []
    for axes, (column, title) in zip(panels, columns.items(), strict=True):
        means = table.groupby(["load", "wave"], sort=False)[column].mean()
        for place, (load, colour) in enumerate(zip(LOADS, (SKY, INK), strict=True)):
            bars = means[load]
            centres = [index + (place - 0.5) * WIDTH for index in range(len(bars))]
            axes.bar(centres, bars, WIDTH, color=colour, label=load)
            spreads.append(f"{load} {_spread(bars):.0f} %")
        axes.set_xticks(range(len(bars)), list(bars.index))
        axes.set_title(title)
        axes.grid(visible=False, axis="x")
    panels[0].set_ylabel("RMSE, m")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(LOADS)
    )
    caption = (
        "Error on the nominal star under NMPC with the textbook's load, with its drag and friction "
        "and without: (a) over the whole run, (b) after the start. If drag were why the error does "
        "not depend on the period, it should without. "
        f"{failure_sentence(table)}"
    )
    alt = (
        "Two panels of bars, three seas with two bars each. The range over the seas, as a share of "
        f"the mean, is {spreads[0]} and {spreads[1]} in the whole run, and {spreads[2]} and "
        f"{spreads[3]} after the start."
    )
    return {"star_drag": Drawing(figure, caption, alt)}


def _spread(values: pd.Series[float]) -> float:
    return 100 * float((values.max() - values.min()) / values.mean())
