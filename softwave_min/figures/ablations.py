"""What each part is worth: all ablations, horizon and delay, fairer opponents, and slow control."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axis import Axis
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

from softwave_min.experiments.ablation_loops import BASELINE, NMPC
from softwave_min.experiments.closed_loop import TRANSIENT
from softwave_min.figures.marks import beside, failure_sentence, name_groups
from softwave_min.figures.style import DASHES, GREY, INK, ORANGE, SERIES, SKY, Drawing
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store

GROUPS = {
    "preview": "forecast: ",
    "load": "textbook's load: ",
    "horizon": "horizon ",
    "opponent": "baseline with ",
}
"""Groups of ablations in the order of the figure, with what is written before their labels."""
OPPONENTS = {
    BASELINE: ("baseline", INK, "-", "s"),
    "baseline_integral": ("with integral", GREY, DASHES[1], "^"),
    "baseline_feedforward": ("with load feed-forward", ORANGE, DASHES[2], "o"),
    "baseline_both": ("with both", SKY, "-", "v"),
}
"""Label, colour, dashes and marker of each loop that the NMPC is compared with."""


TITLES = {"whole": "(a) whole run", "settled": f"(b) without the first {TRANSIENT:g} s"}
"""Of panels with one window each."""


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """The four figures, from the tables."""
    cells, summary = store.read_table("ablations"), store.read_table("summary")
    heights, waves = store.read_table("by_height"), store.read_table("by_wave")
    return {
        "ablations": _forest(summary, failure_sentence(cells)),
        "horizon_and_delay": _curves(waves, parameters, failure_sentence(cells)),
        "opponents": _opponents(heights, summary),
        "control_speed": _speed(
            store.read_table("spreads"), failure_sentence(store.read_table("speed"))
        ),
    }


def _plain(axis: Axis, *digits: int) -> None:
    """Ticks of a logarithmic axis at these leading digits, without powers of ten."""
    axis.set_major_locator(LogLocator(subs=digits))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_locator(NullLocator())


def _forest(summary: pd.DataFrame, failures: str) -> Drawing:
    first = summary.iloc[0]
    rows = summary[summary["group"].isin(GROUPS)]
    rows = rows.sort_values("group", key=lambda one: one.map(list(GROUPS).index), kind="stable")
    figure, panels = plt.subplots(1, 2, sharey=True, figsize=(7.0, 6.0))
    for axes, (window, title) in zip(panels, TITLES.items(), strict=True):
        part = rows[rows["window"] == window].set_index("variant")
        at = -np.arange(len(part))
        axes.axvline(1.0, color=GREY, linestyle="-", linewidth=0.8)
        axes.hlines(at, part["ratio_low"], part["ratio_high"], color=SKY, linewidth=5)
        axes.plot(part["ratio"], at, "s", color=INK, markersize=4, linestyle="")
        axes.set(xscale="log", title=title, xlabel="error over that of the nominal loop")
        _plain(axes.xaxis, 1, 3)
        axes.set_yticks(at, part["group"].map(GROUPS) + part["label"])
    settled = rows[rows["window"] == "settled"].set_index("variant")["ratio"]
    return Drawing(
        figure,
        caption=(
            "One part changed at a time: RMSE of the tip over that of the nominal loop of the "
            f"same controller in the same cell, {first['cells']} cells in {first['seas']} "
            "seas of each wave case and height. Squares: medians; bars: 90 % of the cells. "
            f"{failures}"
        ),
        alt=(
            f"Two panels with {len(part)} rows, each a square and a bar on a logarithmic scale. "
            "After the start the medians run from "
            f"{settled.min():.2g} ({settled.idxmin()}) to {settled.max():.2g} ({settled.idxmax()})."
        ),
    )


def _curves(waves: pd.DataFrame, parameters: ParameterSet, failures: str) -> Drawing:
    period = parameters.nmpc.control_period
    series = {
        "horizon": ("(a) horizon", "horizon, s", {parameters.nmpc.horizon * period: NMPC}),
        "preview_late": ("(b) late forecast", "delay, s", {0.0: NMPC}),
    }
    figure, panels = plt.subplots(1, 2, figsize=(7.0, 3.0))
    settled = waves[waves["window"] == "settled"]
    for axes, (stem, (title, label, nominal)) in zip(panels, series.items(), strict=True):
        names = [name for name in waves["variant"].unique() if name.rpartition("_")[0] == stem]
        stepped = {int(name.rpartition("_")[2]) * period: name for name in names}
        places = dict(sorted({**nominal, **stepped}.items()))
        for wave, colour, dash in zip(waves["wave"].unique(), SERIES, DASHES, strict=False):
            ratio = settled[settled["wave"] == wave].set_index("variant")["ratio"]
            look: Any = {"color": colour, "linestyle": dash, "marker": "o", "markersize": 3.5}
            axes.plot(list(places), ratio[list(places.values())], label=wave, **look)
        axes.axhline(1.0, color=GREY, linestyle="-", linewidth=0.8)
        axes.set(title=title, xlabel=label, yscale="log")
        _plain(axes.yaxis, 1, 2, 5)
    panels[0].set_ylabel("settled error\nover nominal")
    panels[0].legend()
    return Drawing(
        figure,
        caption=(
            f"RMSE of the tip after {TRANSIENT:g} s over that of the nominal NMPC, median over the "
            "cells of each wave case, against (a) the horizon and (b) the delay of the forecast. "
            f"The grey line is the nominal loop. {failures}"
        ),
        alt=(
            "Two panels of three curves. (a) falls with the horizon and levels off. (b) rises "
            "with the delay, from about one at a tenth of a second."
        ),
    )


def _opponents(heights: pd.DataFrame, summary: pd.DataFrame) -> Drawing:
    figure, panels = plt.subplots(1, 2, sharey=True, figsize=(7.0, 3.0))
    for axes, (window, title) in zip(panels, TITLES.items(), strict=True):
        part = heights[heights["window"] == window]
        for name, (label, colour, dash, marker) in OPPONENTS.items():
            one = part[part["variant"] == name].sort_values("Hs")
            look: Any = {"color": colour, "linestyle": dash, "marker": marker, "markersize": 4}
            axes.plot(one["Hs"], one["against"], label=label, **look)
        axes.axhline(1.0, color=GREY, linestyle="-", linewidth=0.8)
        axes.set(title=title, xlabel="significant height, m", yscale="log")
        _plain(axes.yaxis, 1, 2, 5)
    panels[0].set_ylabel("error of the NMPC\nover the opponent's")
    handles, _ = panels[0].get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside lower center", ncols=len(OPPONENTS))
    settled = summary[summary["window"] == "settled"].set_index("variant")["against"]
    found = ", ".join(f"{OPPONENTS[name][0]} {settled[name]:.2g}" for name in OPPONENTS)
    return Drawing(
        figure,
        caption=(
            "RMSE of the tip under the nominal NMPC over that under the baseline as printed, with "
            "an integral action on the tip's offset, with a feed-forward of the load that the "
            "present flow makes, and with both. Medians over the cells of each height; below the "
            "grey line the NMPC is better."
        ),
        alt=f"Two panels of four curves over three heights. Medians after the start: {found}.",
    )


def _speed(spreads: pd.DataFrame, failures: str) -> Drawing:
    looks = {"whole": ("whole run", INK), "settled": (f"without the first {TRANSIENT:g} s", ORANGE)}
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 2.8))
    numbers = ["error", "spread", "spread_least", "spread_most"]
    found = spreads.pivot_table(index="control_period", columns="window", values=numbers)
    width = 0.8 / len(looks)
    for index, (window, (label, colour)) in enumerate(looks.items()):
        at = beside(len(found), index, len(looks), width)
        low, high = (100 * found[name, window] for name in ("spread_least", "spread_most"))
        left.bar(at, found["error", window], width, color=colour, label=label)
        right.bar(at, 100 * found["spread", window], width, color=colour)
        right.vlines(at, low, high, color=SKY, linewidth=2)
    left.set(title="(a) mean error", ylabel="RMSE, m")
    right.set(title="(b) range over the wave periods", ylabel="% of the mean")
    for axes in (left, right):
        name_groups(axes, [f"{period:g}" for period in found.index])
        axes.set_xlabel("control period, s")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    settled = ", ".join(f"{share:.0%}" for share in found["spread", "settled"])
    return Drawing(
        figure,
        caption=(
            "The NMPC on the star with slow control, and the same horizon in seconds. (a) RMSE, "
            "mean of W1, W2 and W3. (b) Range of the RMSE over W1, W2 and W3 in the same sea. "
            f"Bars: median over {spreads['seas'].iloc[0]} seas; lines: smallest and largest. "
            f"{failures}"
        ),
        alt=(
            "Two panels of paired bars for each control period, shortest first. Range after the "
            f"start: {settled} of the mean."
        ),
    )
