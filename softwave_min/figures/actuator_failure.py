"""The paper's Fig. actuation_failure_rmse, and what stands beside it."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from softwave_min.experiments.actuator_failure import ALL, PAPERS_CASE, choice
from softwave_min.experiments.setpoints import CASES
from softwave_min.figures.style import BLUE, GREY, INK, ORANGE, SKY, Drawing
from softwave_min.parameters import ParameterSet
from softwave_min.runs.statistics import INTERVAL
from softwave_min.runs.store import Store

FAILURES = tuple(name for name, case in CASES.items() if case.segment)
LOOK = {
    "intact": (INK, ""),
    "mid_passive": (ORANGE, "////"),
    "tip_passive": (SKY, "--"),
    "mid_locked": (GREY, "\\\\"),
    "tip_locked": ("#ffffff", "xx"),
}
"""Face and hatch of each case: they differ in grey as well."""


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:  # noqa: ARG001
    """The paper's six panels, all cases, the rises and the passive joint's motion."""
    grid = store.read_table("actuator_failure")
    rises = store.read_table("rises")
    return {
        "actuator_failure": _papers(grid),
        "all_cases": _all_cases(grid),
        "rises": _rises(rises, _seeds(grid)),
        "passive_motion": _motion(store.read_table("passive_motion")),
    }


def _papers(grid: pd.DataFrame) -> Drawing:
    figure, axes = _panels(grid, ("intact", PAPERS_CASE), "e_mpc")
    figure.legend(handles=_handles(("intact", PAPERS_CASE)), loc="outside lower center", ncols=3)
    rises = grid[grid["case"] == PAPERS_CASE]["rise_percent"]
    for one, title in zip(axes.flat, _titles(grid), strict=True):
        one.set_title(title)
    return Drawing(
        figure,
        caption=(
            "RMSE of the tip over the whole run under the NMPC, start-up included, with all "
            f"segments and with the {CASES[PAPERS_CASE].words}: (a, b) W1, (c, d) W2, (e, f) W3, "
            f"poses {' (left) and '.join(choice().pose)} (right). {_seas(grid)} "
            f"{_failures(grid[grid['case'].isin(['intact', PAPERS_CASE])])}"
        ),
        alt=(
            "Six panels of paired bars over four significant heights. The failed arm's bar is "
            f"between {rises.min():.0f} % and {rises.max():.0f} % above that of the intact arm."
        ),
    )


def _all_cases(grid: pd.DataFrame) -> Drawing:
    figure, axes = _panels(grid, tuple(CASES), "e_mpc_settled", baseline=True)
    for one, title in zip(axes.flat, _titles(grid), strict=True):
        one.set_title(title)
        one.set_yscale("log")
    line = Line2D([], [], color=BLUE, marker="_", linestyle="", markersize=14, mew=2)
    line.set_label("all segments, feed-forward + PD")
    figure.legend(handles=[*_handles(tuple(CASES)), line], loc="outside lower center", ncols=3)
    ratio = grid["e_mpc_settled"] / grid["e_pd_intact_settled"]
    return Drawing(
        figure,
        caption=(
            "The same places after the start-up transient, for either segment failed in either "
            "manner, on a logarithmic scale. Blue bars: the intact arm under feed-forward + PD. "
            f"{_seas(grid)} {_failures(grid)}"
        ),
        alt=(
            "Six panels of five bars at each of four significant heights, with a blue mark for "
            "the intact arm under the baseline. The errors of the failed arms are between "
            f"{ratio[grid['case'] != 'intact'].min():.2g} and "
            f"{ratio[grid['case'] != 'intact'].max():.2g} times that of the baseline."
        ),
    )


def _panels(
    grid: pd.DataFrame, cases: Sequence[str], column: str, *, baseline: bool = False
) -> tuple[Figure, np.ndarray]:
    waves, names = list(dict.fromkeys(grid["wave"])), list(dict.fromkeys(grid["pose"]))
    figure, axes = plt.subplots(
        len(waves), len(names), figsize=(7.4, 7.0), sharex=True, sharey=True, squeeze=False
    )
    for row, wave in zip(axes, waves, strict=True):
        for one, pose in zip(row, names, strict=True):
            here = grid[(grid["wave"] == wave) & (grid["pose"] == pose)]
            _bars(one, here, cases, column)
            if baseline:
                _marks(one, here, column.replace("e_mpc", "e_pd_intact"))
        row[0].set_ylabel("RMSE, m")
    for one in axes[-1]:
        one.set_xlabel("significant height, m")
    return figure, axes


def _bars(axes: Axes, here: pd.DataFrame, cases: Sequence[str], column: str) -> None:
    heights = sorted(here["Hs"].unique())
    width = 0.8 / len(cases)
    for index, case in enumerate(cases):
        over_seas = here[here["case"] == case].groupby("Hs")
        low, middle, high = (over_seas[column].quantile(level) for level in INTERVAL)
        places = np.arange(len(heights)) + (index - (len(cases) - 1) / 2) * width
        face, hatch = LOOK[case]
        axes.bar(places, middle, width, facecolor=face, hatch=hatch, edgecolor=INK, linewidth=0.7)
        if _seeds(here) > 1:
            spread = np.array([middle - low, high - middle])
            axes.errorbar(places, middle, spread, fmt="none", ecolor=BLUE, elinewidth=1.2)
        touched = (over_seas["solves_failed"].sum() + over_seas["fallbacks"].sum()).to_numpy() > 0
        axes.plot(places[touched], middle.to_numpy()[touched], "*", color=BLUE, markersize=9)
    axes.set_xticks(np.arange(len(heights)), [f"{height:g}" for height in heights])
    axes.grid(visible=False, axis="x")


def _marks(axes: Axes, here: pd.DataFrame, column: str) -> None:
    over_seas = here[here["case"] == "intact"].groupby("Hs")[column].median()
    places = np.arange(len(over_seas))
    axes.hlines(over_seas, places - 0.45, places + 0.45, color=BLUE, linewidth=2)


def _handles(cases: Sequence[str]) -> list[Patch]:
    return [
        Patch(facecolor=LOOK[case][0], hatch=LOOK[case][1], edgecolor=INK, label=CASES[case].words)
        for case in cases
    ]


def _titles(grid: pd.DataFrame) -> list[str]:
    pairs = dict.fromkeys(zip(grid["wave"], grid["pose"], strict=True))
    return [f"({letter}) {wave}, {pose}" for letter, (wave, pose) in zip("abcdef", pairs)]  # noqa: B905


def _seeds(grid: pd.DataFrame) -> int:
    return len(set(grid["seed"]))


def _seas(grid: pd.DataFrame) -> str:
    count = _seeds(grid)
    if count == 1:
        return "One random sea."
    return f"Medians of {count} random seas with their 5 % and 95 % quantiles."


def _failures(grid: pd.DataFrame) -> str:
    solves, fallbacks = int(grid["solves_failed"].sum()), int(grid["fallbacks"].sum())
    where = " A star marks the bars that they touch." if solves + fallbacks else ""
    return f"Solves without convergence: {solves}; fallbacks: {fallbacks}.{where}"


def _rises(rises: pd.DataFrame, seas: int) -> Drawing:
    waves = list(dict.fromkeys(rises["wave"]))
    figure, axes = plt.subplots(1, 2, figsize=(7.6, 3.6))
    for one, window, title in zip(
        axes, ("whole", "settled"), ("(a) whole run", "(b) after the transient"), strict=True
    ):
        for index, case in enumerate(FAILURES):
            here = rises[(rises["case"] == case) & (rises["window"] == window)]
            places = np.arange(len(waves)) + (index - 1.5) * 0.19
            mean = here[here["reading"] == "mean"].set_index("wave").loc[waves]
            largest = here[here["reading"] == "maximum"].set_index("wave").loc[waves]
            face, hatch = LOOK[case]
            one.bar(
                places,
                mean["rise"],
                0.19,
                facecolor=face,
                hatch=hatch,
                edgecolor=INK,
                linewidth=0.7,
            )
            if seas > 1:
                spread = np.array([mean["rise"] - mean["low"], mean["high"] - mean["rise"]])
                one.errorbar(places, mean["rise"], spread, fmt="none", ecolor=BLUE)
            one.plot(places, largest["rise"], "^", color=INK, markersize=5)
        _quoted(one, rises, waves)
        one.axhline(0, color=INK, linewidth=0.8)
        one.set_xticks(np.arange(len(waves)), waves)
        one.set_title(title)
        one.grid(visible=False, axis="x")
    axes[0].set_ylabel("rise of the RMSE, %")
    handles = [
        *_handles(FAILURES),
        Line2D([], [], color=INK, marker="^", linestyle="", label="maximum"),
        Line2D([], [], color=BLUE, linewidth=2, label="the paper's number"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    papers = rises[(rises["case"] == PAPERS_CASE) & (rises["wave"] == ALL)]
    whole = papers[papers["window"] == "whole"].set_index("reading")["rise"]
    return Drawing(
        figure,
        caption=(
            "Rise of the RMSE over that of the intact arm in the same seas, both under the NMPC: "
            "mean over poses and heights (bars) and maximum (triangles), for each spectrum and "
            "over all. Blue: the paper's numbers for the "
            f"{CASES[PAPERS_CASE].words}. "
            + ("One random sea." if seas == 1 else f"Medians of {seas} seas, 5 % to 95 %.")
        ),
        alt=(
            "Two bar charts, over the whole run and after the transient, with four bars for each "
            f"spectrum. The paper's case rises by {whole['mean']:.0f} % on the mean and "
            f"{whole['maximum']:.0f} % at most over the whole run."
        ),
    )


def _quoted(axes: Axes, rises: pd.DataFrame, waves: Sequence[str]) -> None:
    papers = rises.dropna(subset="paper").drop_duplicates("wave").set_index("wave")["paper"]
    for index, wave in enumerate(waves):
        if wave in papers:
            axes.hlines(papers[wave], index - 0.45, index + 0.45, color=BLUE, linewidth=2, zorder=5)


def _motion(joints: pd.DataFrame) -> Drawing:
    segments = sorted(joints["segment"].unique())
    figure, axes = plt.subplots(1, len(segments), figsize=(7.4, 3.2), sharey=True, squeeze=False)
    waves = list(dict.fromkeys(joints["wave"]))
    for one, segment in zip(axes[0], segments, strict=True):
        for side, (case, face) in enumerate(
            zip(("intact", _passive_case(segment)), (GREY, ORANGE), strict=True)
        ):
            here = joints[(joints["segment"] == segment) & (joints["case"] == case)]
            of_wave = here.groupby("wave")[["rms_below", "rms_above"]].median().loc[waves]
            places = np.arange(len(waves)) + (side - 0.5) * 0.4
            one.bar(places - 0.09, of_wave["rms_below"], 0.18, facecolor=face, edgecolor=INK)
            one.bar(
                places + 0.09,
                of_wave["rms_above"],
                0.18,
                facecolor=face,
                hatch="////",
                edgecolor=INK,
            )
        one.set_xticks(np.arange(len(waves)), waves)
        one.set_title(f"segment {segment}")
        one.grid(visible=False, axis="x")
    axes[0, 0].set_ylabel("rms of the angle, rad")
    handles = [
        Patch(facecolor=GREY, edgecolor=INK, label="actuated"),
        Patch(facecolor=ORANGE, edgecolor=INK, label="passive"),
        Patch(facecolor="white", edgecolor=INK, label="below the peak frequency"),
        Patch(facecolor="white", edgecolor=INK, hatch="////", label="above it"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    passive = joints[joints["case"] != "intact"].groupby("wave")["share_above"].median()
    shares = ", ".join(f"{wave} {100 * passive[wave]:.0f} %" for wave in waves)
    return Drawing(
        figure,
        caption=(
            "Motion of a segment's bending angle about its mean, after the transient, split at "
            "the peak frequency of the waves: under the NMPC with the segment actuated, and with "
            "it passive. Medians over poses, heights and seas."
        ),
        alt=(
            "Bars of the rms angle for three spectra and two segments. Share of the variance of "
            f"the passive angle above the peak frequency: {shares}."
        ),
    )


def _passive_case(segment: int) -> str:
    return next(
        name for name, case in CASES.items() if case.segment == segment and case.manner == "passive"
    )
