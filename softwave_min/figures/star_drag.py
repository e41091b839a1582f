"""Errors on the star with and without drag."""

from __future__ import annotations

import matplotlib.pyplot as plt

from softwave_min.experiments.star_drag import LOADS
from softwave_min.figures.marks import beside, failure_sentence, name_groups
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
        means = table.groupby(["load", "wave"], sort=False)[column].mean().unstack("load")
        for place, (load, colour) in enumerate(zip(LOADS, (SKY, INK), strict=True)):
            bars = means[load]
            axes.bar(beside(len(bars), place, 2, WIDTH), bars, WIDTH, color=colour, label=load)
            spreads.append(f"{load} {100 * (bars.max() - bars.min()) / bars.mean():.0f} %")
        axes.set_title(title)
        name_groups(axes, means.index)
    panels[0].set_ylabel("RMSE, m")
    handles, _ = panels[0].get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside lower center", ncols=len(LOADS))
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
