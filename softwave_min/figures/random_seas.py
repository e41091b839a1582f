"""The headline numbers over many random seas, beside the paper's: a figure per controller."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes

from softwave_min.experiments.closed_loop import others
from softwave_min.experiments.failures import PAPERS_CASE
from softwave_min.figures.marks import (
    failure_sentence,
    intervals,
    look,
    name_groups,
    seas_sentence,
    stem_for,
)
from softwave_min.figures.style import ORANGE, Drawing
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:  # noqa: ARG001
    """Reductions, rises and errors on the star, each with its interval."""
    return {stem_for("random_seas", name): _drawn(store, name) for name in others()}


def _drawn(store: Store, name: str) -> Drawing:
    def of(stem: str, chosen: str) -> pd.DataFrame:
        return store.read_table(stem).query(f"controller == '{name}' and {chosen}")

    grid = store.read_table("error_ratio")
    rises = of("rises", f"case == '{PAPERS_CASE}' and reading == 'mean' and window == 'whole'")
    reductions = of("reductions", "wave != 'all'").groupby("quantity")
    panels = [
        ("(a) largest\nreduction, %", reductions.get_group("largest")),
        ("(b) smallest\nreduction, %", reductions.get_group("smallest")),
        ("(c) rise with failed\nsegment, %", rises.rename(columns={"rise": "median"})),
        ("(d) error on\nthe star, m", of("star_errors", "measure == 'rmse'")),
    ]
    figure, axes = plt.subplots(1, len(panels), figsize=(7.0, 2.9))
    for one, (title, rows) in zip(axes, panels, strict=True):
        _panel(one, rows)
        one.set_title(title)
    return Drawing(
        figure,
        caption=(
            f"The paper's headline numbers under the {look(name).label} with the calibrated set: "
            "squares and bars, and the paper's number (cross), which is of one sea. "
            f"{seas_sentence(grid['seed'].nunique())} (a), (b) Largest and smallest reduction of "
            "the error in the grid of six poses and six heights; (c) mean rise of the error when "
            "the second segment fails; (d) root-mean-square error on the star. In the grid: "
            + failure_sentence(grid)
        ),
        alt=(
            "Four panels with a square, a bar and mostly a cross for each wave case. In the last "
            "the crosses lie far above the bars."
        ),
    )


def _panel(axes: Axes, rows: pd.DataFrame) -> None:
    places = range(len(rows))
    intervals(axes, places, rows)
    axes.plot(places, rows["paper"], "x", color=ORANGE, markersize=7, markeredgewidth=2)
    name_groups(axes, rows["wave"])
    axes.set_xlim(-0.6, len(rows) - 0.4)
