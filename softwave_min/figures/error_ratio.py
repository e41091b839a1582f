"""The paper's Fig. error_bar, and the same after the start: one of each for every controller."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from softwave_min.experiments.closed_loop import TRANSIENT, others
from softwave_min.figures.marks import (
    beside,
    failure_sentence,
    look,
    name_groups,
    seas_sentence,
    stem_for,
    whiskers,
)  # fmt: skip
from softwave_min.figures.style import DASHES, GREY, INK, ORANGE, Drawing
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.paper.numbers import CONTROLLER, error_ratio
from softwave_min.parameters import ParameterSet
from softwave_min.runs.statistics import intervals_of
from softwave_min.runs.store import Store
from softwave_min.simulation import REFERENCE

LIGHTEST, DARKEST = np.array([0.80, 0.88, 0.95]), np.array([0.03, 0.19, 0.42])
"""Colours of the smallest and the greatest height; lightness falls between them."""
GROUP = 0.84
"""Width of the bars of one pose, of the distance between poses."""


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:  # noqa: ARG001
    """The grid as bars, over the whole run and settled, for each controller."""
    table = store.read_table("error_ratio")
    drawings: dict[str, Drawing] = {}
    for name in others():
        drawings[stem_for("error_ratio", name)] = _whole(table, name)
        drawings[stem_for("settled", name)] = _settled(table, name)
    return drawings


def _whole(table: pd.DataFrame, name: str) -> Drawing:
    cells = _over_seas(table, f"ratio_{name}")
    reductions = 100 * (1 - cells["median"])
    quoted = name == CONTROLLER
    return Drawing(
        _bars(cells, quoted=quoted),
        caption=(
            f"RMSE of the tip under the {look(name).label} over that under "
            f"{look(REFERENCE).label}, over the whole run, for {_grid_in_words(table)}. Grey line: "
            "equal performance. "
            + "Orange: the smallest and the largest ratio that the paper's text "
            "has for the wave case, at the pose that it names. "
            * quoted
            + _seas_and_failures(table, cells)
        ),
        alt=(
            f"{_panels_in_words(cells)} {np.count_nonzero(reductions > 0)} of {len(cells)} bars "
            "are below one. The reductions of the error run "
            f"from {reductions.min():.0f} to {reductions.max():.0f} per cent. "
            + failure_sentence(table)
        ),
    )


def _settled(table: pd.DataFrame, name: str) -> Drawing:
    cells = _over_seas(table, f"ratio_{name}_settled")
    return Drawing(
        _bars(cells, quoted=False),
        caption=(
            f"The same ratio without the first {TRANSIENT:g} s of every run: "
            f"{_grid_in_words(table)}. The scale differs from that of the figure over the whole "
            "run. " + _seas_and_failures(table, cells)
        ),
        alt=(
            f"{_panels_in_words(cells)} Ratios of the errors after the start, from "
            f"{cells['median'].min():.2f} to {cells['median'].max():.2f}. "
            + failure_sentence(table)
        ),
    )


def _over_seas(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """``low``, ``median`` and ``high`` over the seas, and whether a solve ``failed`` in any.

    By wave, pose and height; in that order of the paper's tables.
    """
    marked = table.assign(failed=table.solves_failed + table.fallbacks > 0)
    groups = marked.groupby(["wave", "pose", "Hs"])
    cells = intervals_of(groups[column]).assign(failed=groups.failed.any())
    grid = [list(wave_cases()), list(poses()), sorted(table.Hs.unique())]
    return cells.reindex(pd.MultiIndex.from_product(grid))


def _bars(cells: pd.DataFrame, *, quoted: bool) -> Figure:
    """One panel per wave case; ``quoted`` adds what the paper's text has."""
    heights = cells.index.unique(2)
    steps = np.linspace(0, 1, len(heights))[:, None]
    colours = [to_hex(shade) for shade in (1 - steps) * LIGHTEST + steps * DARKEST]
    cases = wave_cases()
    figure, panels = plt.subplots(len(cases), 1, sharex=True, sharey=True, figsize=(7.0, 6.4))
    highest = cells["high"].max()
    top = max(highest, 1.0) if quoted else highest
    for letter, wave, axes in zip("abc", cases.values(), panels, strict=True):
        _panel(axes, cells.loc[[wave.name]], colours)
        if quoted:
            _paper_marks(axes, wave.name)
        if top >= 1.0:
            axes.axhline(1.0, color=GREY, linestyle="-", linewidth=1.0)
        axes.set(title=f"({letter}) {wave.name}, $T_p$ = {wave.peak_period:g} s")
        axes.set_ylabel("ratio of errors")
        name_groups(axes, poses())
    panels[-1].set_ylim(0, 1.08 * top)
    figure.legend(
        [Patch(facecolor=colour, edgecolor=INK) for colour in colours],
        [f"{height:g} m" for height in heights],
        title="significant height",
        ncols=len(heights),
        loc="outside upper center",
        columnspacing=1.2,
        handlelength=1.4,
    )
    return figure


def _panel(axes: Axes, cells: pd.DataFrame, colours: Sequence[str]) -> None:
    """Bars by pose and height, their spread over the seas, and a cross where solves failed."""
    width = GROUP / len(colours)
    for number, (colour, (_, rows)) in enumerate(zip(colours, cells.groupby(level=2), strict=True)):
        places = beside(len(rows), number, len(colours), width)
        axes.bar(places, rows["median"], width, color=colour, edgecolor=INK, linewidth=0.4)
        if np.any(rows["high"] > rows["low"]):
            whiskers(axes, places, rows["low"], rows["median"], rows["high"])
        failed = rows["failed"].to_numpy(bool)
        axes.plot(places[failed], rows["high"][failed], "x", color=ORANGE, markersize=5)


def _paper_marks(axes: Axes, wave: str) -> None:
    quoted, names = error_ratio().reduction[wave], list(poses())
    for pose, reduction in (
        (quoted.largest_pose, quoted.largest),
        (quoted.smallest_pose, quoted.smallest),
    ):
        place, ratio = names.index(pose), 1 - reduction / 100
        ends = [place - GROUP / 2, place + GROUP / 2]
        axes.plot(ends, [ratio, ratio], color=ORANGE, linestyle=DASHES[1], linewidth=1.4)


def _grid_in_words(table: pd.DataFrame) -> str:
    waves = [f"({letter}) {wave}" for letter, wave in zip("abc", wave_cases(), strict=True)]
    return (
        f"the wave cases {', '.join(waves)}, the poses {', '.join(poses())} and significant "
        f"heights {table.Hs.min():g} m to {table.Hs.max():g} m, from light to dark"
    )


def _panels_in_words(cells: pd.DataFrame) -> str:
    waves, names, heights = (len(cells.index.unique(level)) for level in range(3))
    return f"{waves} panels of bars, one per wave case, {names} groups of {heights}."


def _seas_and_failures(table: pd.DataFrame, cells: pd.DataFrame) -> str:
    mark = f"Crosses: places with failures, {cells['failed'].sum()} of {len(cells)}."
    return f"{seas_sentence(table.seed.nunique())} {failure_sentence(table, mark)}"
