"""The paper's Fig. star_trajectory, and the errors in all seas."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.experiments.closed_loop import TRANSIENT
from softwave_min.experiments.star import EXPERIMENT, choice
from softwave_min.experiments.star_loops import STILL
from softwave_min.experiments.star_path import star_vertices
from softwave_min.figures.marks import beside, failure_sentence, legend_above, look, seas_sentence
from softwave_min.figures.style import BLUE, DASHES, GREY, INK, ORANGE, SKY, Drawing
from softwave_min.paper.numbers import CONTROLLER
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store

RunData = Mapping[str, NDArray[Any]]

SHOWN_EVERY = 12.0
"""Time between two postures of the arm, in s."""
LEGEND: Any = {"handlelength": 1.8, "handletextpad": 0.4, "columnspacing": 0.9}


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """The paper's four panels, and the errors over the seas."""
    runs = {run.name: run for run in EXPERIMENT.runs(parameters)}
    with_waves = store.load_run(runs[f"{choice().case}-{parameters.sea.seed}"])
    calm = store.load_run(runs[STILL])
    return {
        "star_trajectory": _trajectory(with_waves, calm, parameters),
        "errors": _errors(store.read_table("star"), store.read_table("headline")),
    }


def _trajectory(with_waves: RunData, calm: RunData, parameters: ParameterSet) -> Drawing:
    figure = plt.figure(figsize=(7.0, 5.4))
    halves = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.25))
    column = halves[0].subgridspec(3, 1)
    top = figure.add_subplot(column[0])
    second, third = (figure.add_subplot(column[row], sharex=top) for row in (1, 2))
    plane = figure.add_subplot(halves[1])
    for axes, axis, panel in ((top, 0, "(a)"), (second, 1, "(b)")):
        _coordinate(axes, with_waves, calm, axis, parameters.arm.base_position[axis])
        axes.set(ylabel=f"{'xz'[axis]} from the base, m", title=panel)
        axes.tick_params(labelbottom=False)
    failed = _distances(third, with_waves, calm)
    _plane(plane, with_waves, calm, Arm(parameters.arm, parameters.fluid))
    chosen, settled = choice(), with_waves["time"] >= TRANSIENT
    waves, still = (1000 * np.median(_error(data)[settled]) for data in (with_waves, calm))
    return Drawing(
        figure,
        caption=(
            f"The star under NMPC in the sea {chosen.case} at a significant height of "
            f"{chosen.significant_height:.0f} m (subscript $\\tau$) and in still water "
            "(subscript 0), from the fully extended arm. Coordinates of the tip relative to the "
            "base: (a) along the waves, (b) upwards; (c) distance of the tip from where it should "
            "be, on a logarithmic scale, "
            + (
                f"with crosses at the {failed} solves that did not converge; "
                if failed
                else "and no solve failed; "
            )
            + f"(d) the path, with the arm in the waves every {SHOWN_EVERY:.0f} s. Size, speed and "
            "centre of the star are our choice, because the paper states none."
        ),
        alt=(
            "Three time series and a picture of the plane. The tip starts right of the star at the "
            "arm's full length, swings over to its upper point, and then goes round. The median "
            f"distance after the start is {waves:.1f} mm with waves and {still:.1f} mm without."
        ),
    )


def _coordinate(axes: Axes, with_waves: RunData, calm: RunData, axis: int, base: float) -> None:
    time, letter = with_waves["time"], "xz"[axis]
    axes.plot(time, with_waves["nmpc_target"][:, axis] - base, color=GREY, lw=3.0, label="desired")
    series = ((with_waves, r"\tau", INK, DASHES[0]), (calm, "0", ORANGE, DASHES[2]))
    for data, subscript, colour, dash in series:
        label = f"${letter}_{subscript}$"
        axes.plot(time, data["nmpc_tip"][:, axis] - base, color=colour, linestyle=dash, label=label)
    legend_above(axes, **LEGEND)
    axes.set_xlim(0, time[-1])


def _error(data: RunData) -> NDArray[np.float64]:
    distance: NDArray[np.float64] = np.hypot(*(data["nmpc_tip"] - data["nmpc_target"]).T)
    return distance


def _distances(axes: Axes, with_waves: RunData, calm: RunData) -> int:
    """Draw the distances from the target, and count the failed solves, which are marked."""
    time = with_waves["time"]
    series = ((with_waves, r"$e_\tau$", INK, "-"), (calm, "$e_0$", ORANGE, DASHES[2]))
    for data, label, colour, dash in series:
        error, failed = _error(data), np.flatnonzero(data["nmpc_status"] > 0)
        axes.semilogy(time, error, color=colour, linestyle=dash, label=label)
        axes.plot(time[failed], error[failed], "x", linestyle="none", color=colour)
    legend_above(axes, **LEGEND)
    axes.set_ylim(bottom=1e-5)
    axes.set(xlabel="time, s", ylabel="distance, m", title="(c)")
    return sum(int(np.sum(data["nmpc_status"] > 0)) for data in (with_waves, calm))


def _plane(axes: Axes, with_waves: RunData, calm: RunData, arm: Arm) -> None:
    base = np.array(arm.parameters.base_position)
    star = star_vertices(choice().path)
    closed = np.vstack([star, star[:1]]) - base
    shown = with_waves["nmpc_q"][:: round(SHOWN_EVERY / float(with_waves["time"][1]))]
    for axis in arm.axis(shown) - base:
        axes.plot(*axis.T, color=SKY, linestyle="-", linewidth=1.0, zorder=1)
    for tips in arm.segment_tips(shown) - base:
        axes.plot(*tips.T, ".", linestyle="none", color=SKY, markersize=4)
    axes.plot(*closed.T, color=GREY, lw=3.0, label="desired")
    for data, label, colour, dash in (
        (with_waves, r"with waves, $\tau$", INK, DASHES[0]),
        (calm, "without, 0", ORANGE, DASHES[2]),
    ):
        axes.plot(*(data["nmpc_tip"] - base).T, color=colour, linestyle=dash, label=label)
    axes.plot(0, 0, marker="s", color=INK, markersize=5)
    axes.set_aspect("equal")
    axes.set(xlabel="x from the base, m", ylabel="z from the base, m", title="(d)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=1)


def _errors(table: pd.DataFrame, headline: pd.DataFrame) -> Drawing:
    """RMSE of every sea, whole run and settled, beside the paper's."""
    chosen = choice()
    waves, names = list(chosen.rmse), list(table["controller"].unique())
    figure, panels = plt.subplots(1, 2, sharey=True, figsize=(7.0, 3.4))
    of_seas = headline.set_index(["measure", "controller", "wave"]).sort_index()
    calm = table[table.wave == STILL].groupby("controller").first()
    words: list[str] = []
    for axes, measure in zip(panels, ("rmse", "rmse_settled"), strict=True):
        found: list[str] = []
        for place, (name, marker) in enumerate(zip(names, cycle("soDv^"), strict=False)):
            label, colour = look(name).label, look(name).colour
            x = beside(len(waves), place, len(names), 0.24)
            rows = of_seas.xs((measure, name)).loc[waves]
            axes.vlines(x, rows["low"], rows["high"], color=colour, linewidth=2.2)
            axes.plot(x, rows["median"], marker, color=colour, linestyle="none", label=label)
            dots: Any = {"linestyle": DASHES[2], "linewidth": 1.0, "label": f"{label}, still water"}
            axes.axhline(calm[measure][name], color=colour, **dots)
            found.append(f"{label} {' / '.join(f'{one:.3f}' for one in rows['median'])}")
        words.append(", ".join(found))
        if measure == "rmse":
            bars: Any = {"color": BLUE, "linewidth": 2.0, "linestyle": DASHES[1]}
            x, label = beside(len(waves), 0, 1, 0), f"paper, {look(CONTROLLER).label}"
            axes.hlines(list(chosen.rmse.values()), x - 0.3, x + 0.3, label=label, **bars)
        axes.set_yscale("log")
        axes.set_xlim(-0.5, len(waves) - 0.5)
        axes.set_xticks(range(len(waves)), waves)
    panels[0].set(ylabel="RMSE of the distance, m", title="(a) whole run")
    panels[1].set_title(f"(b) after {TRANSIENT:.0f} s")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return Drawing(
        figure,
        caption=(
            f"Error on the star in the three seas, significant height "
            f"{chosen.significant_height:.0f} m, and still water (dotted). (a) Over the whole "
            f"run, beside the paper's numbers; (b) without the first {TRANSIENT:.0f} s. "
            f"{seas_sentence(int(headline.seas.max()))} {failure_sentence(table)}"
        ),
        alt=(
            "Two panels with the seas W1, W2 and W3 on a logarithmic axis, each with a mark for "
            f"every controller. Medians in metres, whole run: {words[0]}; after "
            f"{TRANSIENT:.0f} s: {words[1]}."
        ),
    )
