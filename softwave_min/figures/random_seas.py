"""The headline numbers over many random seas, beside the paper's."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes

from softwave_min.experiments.actuator_failure import PAPERS_CASE
from softwave_min.figures.style import INK, ORANGE, SKY, Drawing
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:  # noqa: ARG001
    """Reductions, rises and errors on the star, each with its interval."""
    reductions, rises = store.read_table("reductions"), store.read_table("rises")
    stars, grid = store.read_table("star_errors"), store.read_table("error_ratio")
    failed = int(grid["solves_failed"].sum())
    seeds = grid["seed"].nunique()
    figure, axes = plt.subplots(1, 4, figsize=(7.0, 2.9))
    for one, quantity in zip(axes, ("largest", "smallest"), strict=False):
        rows = reductions[(reductions["quantity"] == quantity) & (reductions["wave"] != "all")]
        _intervals(one, rows["wave"], rows)
        one.set_title(f"({'ab'[quantity == 'smallest']}) {quantity}\nreduction, %")
    failing = rises[
        (rises["case"] == PAPERS_CASE) & (rises["reading"] == "mean") & (rises["window"] == "whole")
    ]
    _intervals(axes[2], failing["wave"], failing.rename(columns={"rise": "median"}))
    axes[2].set_title("(c) rise with failed\nsegment, %")
    followed = stars[(stars["controller"] == "nmpc") & (stars["measure"] == "rmse")]
    _intervals(axes[3], followed["wave"], followed)
    axes[3].set_title("(d) error on\nthe star, m")
    caption = (
        f"The paper's headline numbers over {seeds} random seas with the calibrated set: median "
        "(square) and 90 % interval (bar) over the seas, and the paper's number (cross), which "
        "is of one sea. (a), (b) Largest and smallest reduction of the error in the grid of six "
        "poses and six heights; (c) mean rise of the error when the middle segment fails; "
        "(d) root-mean-square error on the star. "
        f"{failed} of the solves in the grid did not converge; their runs count."
    )
    alt = (
        "Four panels with a square, a bar and mostly a cross for each wave case. In the last the "
        "crosses lie far above the bars."
    )
    return {"random_seas": Drawing(figure, caption, alt)}


def _intervals(axes: Axes, labels: pd.Series[str], rows: pd.DataFrame) -> None:
    places = range(len(rows))
    axes.vlines(places, rows["low"], rows["high"], color=SKY, linewidth=6)
    axes.plot(places, rows["median"], "s", color=INK, markersize=4)
    axes.plot(places, rows["paper"], "x", color=ORANGE, markersize=7, markeredgewidth=2)
    axes.set_xticks(places, list(labels))
    axes.set_xlim(-0.6, len(rows) - 0.4)
    axes.grid(visible=False, axis="x")
