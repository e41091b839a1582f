"""The paper's Fig. actuation_failure_rmse, and what stands beside it, for each controller."""

from __future__ import annotations

from collections.abc import Sequence
from string import ascii_lowercase
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from softwave_min.experiments.actuator_failure import ALL
from softwave_min.experiments.closed_loop import others
from softwave_min.experiments.failures import INTACT, PAPERS_CASE, Case, failure_cases
from softwave_min.figures.marks import (
    beside,
    failure_sentence,
    look,
    name_groups,
    seas_sentence,
    stem_for,
    whiskers,
)
from softwave_min.figures.style import BLUE, GREY, INK, ORANGE, SKY, Drawing
from softwave_min.parameters import ParameterSet
from softwave_min.runs.statistics import intervals_of
from softwave_min.runs.store import Store
from softwave_min.simulation import REFERENCE

Cases = dict[str, Case]
Floats = NDArray[np.float64]

FACES = {
    INTACT: (INK, ""),
    PAPERS_CASE: (ORANGE, "////"),
    "tip_passive": (SKY, "--"),
    "mid_locked": (GREY, "\\\\"),
    "tip_locked": ("#ffffff", "xx"),
}
"""Face and hatch of each case: they differ in grey as well."""


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """The paper's six panels, all cases, the rises and the passive joint's motion."""
    cases = failure_cases(parameters)
    grid, rises, joints = map(store.read_table, ("actuator_failure", "rises", "passive_motion"))
    drawings: dict[str, Drawing] = {}
    for name in others():
        own_rises, own_joints = (one[one["controller"] == name] for one in (rises, joints))
        drawings |= {
            stem_for("actuator_failure", name): _papers(grid, cases, name),
            stem_for("all_cases", name): _all_cases(grid, cases, name),
            stem_for("rises", name): _rises(own_rises, cases, name, grid["seed"].nunique()),
            stem_for("passive_motion", name): _motion(own_joints, cases, name),
        }
    return drawings


def _papers(grid: pd.DataFrame, cases: Cases, name: str) -> Drawing:
    shown = {case: cases[case] for case in (INTACT, PAPERS_CASE)}
    figure, panels = _panels(grid, shown, f"e_{name}")
    figure.legend(handles=_handles(shown), loc="outside lower center", ncols=3)
    rises = grid[grid["case"] == PAPERS_CASE][f"rise_percent_{name}"]
    return Drawing(
        figure,
        caption=(
            f"RMSE of the tip over the whole run under the {look(name).label}, start-up included, "
            f"with all segments and with the {cases[PAPERS_CASE].words}: {', '.join(panels)}"
            f". {_seas_and_failures(grid[grid['case'].isin(shown)])}"
        ),
        alt=(
            f"{len(panels)} panels of paired bars over {grid['Hs'].nunique()} significant "
            f"heights. The failed arm's bar is between {rises.min():.0f} % and {rises.max():.0f} % "
            "above that of the intact arm."
        ),
    )


def _all_cases(grid: pd.DataFrame, cases: Cases, name: str) -> Drawing:
    of_reference = f"e_{REFERENCE}_intact_settled"
    figure, panels = _panels(grid, cases, f"e_{name}_settled")
    intact = grid[grid["case"] == INTACT].groupby(["wave", "pose"], sort=False)
    for axes, (_, here) in zip(panels.values(), intact, strict=True):
        axes.set_yscale("log")
        errors = here.groupby("Hs")[of_reference].median()
        places = np.arange(len(errors))
        axes.hlines(errors, places - 0.45, places + 0.45, color=BLUE, linewidth=2)
    line = Line2D([], [], color=BLUE, marker="_", linestyle="", markersize=14, mew=2)
    line.set_label(f"all segments, {look(REFERENCE).label}")
    figure.legend(handles=[*_handles(cases), line], loc="outside lower center", ncols=3)
    ratio = (grid[f"e_{name}_settled"] / grid[of_reference])[grid["case"] != INTACT]
    return Drawing(
        figure,
        caption=(
            f"The same places under the {look(name).label} after the start-up transient, for "
            "either segment failed in either manner, on a logarithmic scale. Blue bars: the intact "
            f"arm under {look(REFERENCE).label}. {_seas_and_failures(grid)}"
        ),
        alt=(
            f"{len(panels)} panels of {len(cases)} bars at each significant height, with a blue "
            "mark for the intact arm under the baseline. The errors of the failed arms are between "
            f"{ratio.min():.2g} and {ratio.max():.2g} times that of the baseline."
        ),
    )


def _panels(grid: pd.DataFrame, cases: Cases, column: str) -> tuple[Figure, dict[str, Axes]]:
    """A panel of bars for each spectrum and pose, by its title."""
    shape = grid["wave"].nunique(), grid["pose"].nunique()
    figure, axes = plt.subplots(*shape, figsize=(7.4, 7.0), sharex=True, sharey=True, squeeze=False)
    panels: dict[str, Axes] = {}
    groups = grid.groupby(["wave", "pose"], sort=False)
    for one, letter, ((wave, pose), rows) in zip(axes.flat, ascii_lowercase, groups, strict=False):
        title = f"({letter}) {wave}, {pose}"
        one.set_title(title)
        _bars(one, rows, tuple(cases), column)
        panels[title] = one
    for one in axes[:, 0]:
        one.set_ylabel("RMSE, m")
    for one in axes[-1]:
        one.set_xlabel("significant height, m")
    return figure, panels


def _bars(axes: Axes, here: pd.DataFrame, cases: Sequence[str], column: str) -> None:
    heights = sorted(here["Hs"].unique())
    width = 0.8 / len(cases)
    for index, case in enumerate(cases):
        by_height = here[here["case"] == case].groupby("Hs")
        errors = intervals_of(by_height[column])
        places = beside(len(heights), index, len(cases), width)
        _case_bars(axes, case, places, errors["median"], width)
        if np.any(errors["high"] > errors["low"]):
            whiskers(axes, places, errors["low"], errors["median"], errors["high"], BLUE)
        failed = by_height[["solves_failed", "fallbacks"]].sum().sum(axis=1).to_numpy() > 0
        axes.plot(places[failed], errors["median"][failed], "*", color=BLUE, markersize=9)
    name_groups(axes, [f"{height:g}" for height in heights])


def _case_bars(axes: Axes, case: str, places: Floats, heights: pd.Series, width: float) -> None:
    face, hatch = FACES[case]
    axes.bar(places, heights, width, facecolor=face, hatch=hatch, edgecolor=INK, lw=0.7)


def _handles(cases: Cases) -> list[Patch]:
    return [
        Patch(facecolor=FACES[name][0], hatch=FACES[name][1], edgecolor=INK, label=case.words)
        for name, case in cases.items()
    ]


def _seas_and_failures(grid: pd.DataFrame) -> str:
    sentence = failure_sentence(grid, "A star marks the bars that they touch.")
    return f"{seas_sentence(grid['seed'].nunique())} {sentence}"


def _rises(rises: pd.DataFrame, cases: Cases, name: str, seas: int) -> Drawing:
    waves = list(rises["wave"].unique())
    failures = {case: state for case, state in cases.items() if state.segment}
    width = 0.76 / len(failures)
    quoted = rises.drop_duplicates("wave").set_index("wave")["paper"].dropna()
    figure, axes = plt.subplots(1, 2, figsize=(7.6, 3.6))
    titles = {"whole": "(a) whole run", "settled": "(b) after the transient"}
    for one, (window, title) in zip(axes, titles.items(), strict=True):
        here = rises[rises["window"] == window].set_index(["case", "reading", "wave"]).sort_index()
        for index, case in enumerate(failures):
            places = beside(len(waves), index, len(failures), width)
            mean, largest = (here.xs((case, reading)).loc[waves] for reading in ("mean", "maximum"))
            _case_bars(one, case, places, mean["rise"], width)
            if seas > 1:
                whiskers(one, places, mean["low"], mean["rise"], mean["high"], BLUE)
            one.plot(places, largest["rise"], "^", color=INK, markersize=5)
        for wave, rise in quoted.items():
            place = waves.index(wave)
            one.hlines(rise, place - 0.45, place + 0.45, color=BLUE, linewidth=2, zorder=5)
        one.axhline(0, color=INK, linewidth=0.8)
        one.set_title(title)
        name_groups(one, waves)
    axes[0].set_ylabel("rise of the RMSE, %")
    handles = [
        *_handles(failures),
        Line2D([], [], color=INK, marker="^", linestyle="", label="maximum"),
        Line2D([], [], color=BLUE, linewidth=2, label="the paper's number"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    papers = rises[(rises["case"] == PAPERS_CASE) & (rises["wave"] == ALL)]
    whole = papers[papers["window"] == "whole"].set_index("reading")["rise"]
    return Drawing(
        figure,
        caption=(
            "Rise of the RMSE over that of the intact arm in the same seas, both under the "
            f"{look(name).label}: mean over poses and heights (bars) and maximum (triangles), for "
            "each spectrum and over all. Blue: the paper's numbers for the "
            f"{cases[PAPERS_CASE].words}. {seas_sentence(seas)}"
        ),
        alt=(
            f"Two bar charts, over the whole run and after the transient, {len(failures)} bars for "
            f"each spectrum. The paper's case rises by {whole['mean']:.0f} % on the mean and "
            f"{whole['maximum']:.0f} % at most over the whole run."
        ),
    )


def _motion(joints: pd.DataFrame, cases: Cases, name: str) -> Drawing:
    passive = [case for case in cases if case in set(joints["case"]) - {INTACT}]
    figure, axes = plt.subplots(1, len(passive), figsize=(7.4, 3.2), sharey=True, squeeze=False)
    waves = list(joints["wave"].unique())
    splits = {"rms_below": (-0.09, ""), "rms_above": (0.09, "////")}
    medians = joints.groupby(["segment", "case", "wave"])[list(splits)].median()
    for one, case in zip(axes[0], passive, strict=True):
        segment = cases[case].segment
        for side, (arm, face) in enumerate(((INTACT, GREY), (case, ORANGE))):
            here = medians.xs((segment, arm)).loc[waves]
            places = beside(len(waves), side, 2, 0.4)
            for column, (shift, hatch) in splits.items():
                look_of: Any = {"facecolor": face, "hatch": hatch, "edgecolor": INK}
                one.bar(places + shift, here[column], 0.18, **look_of)
        one.set_title(f"segment {segment}")
        name_groups(one, waves)
    axes[0, 0].set_ylabel("rms of the angle, rad")
    handles = [
        Patch(facecolor=GREY, edgecolor=INK, label="actuated"),
        Patch(facecolor=ORANGE, edgecolor=INK, label="passive"),
        Patch(facecolor="white", edgecolor=INK, label="below the peak frequency"),
        Patch(facecolor="white", edgecolor=INK, hatch="////", label="above it"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    share = joints[joints["case"] != INTACT].groupby("wave", sort=False)["share_above"].median()
    shares = ", ".join(f"{wave} {100 * one:.0f} %" for wave, one in share.items())
    return Drawing(
        figure,
        caption=(
            "Motion of a segment's bending angle about its mean, after the transient, split at "
            f"the peak frequency of the waves: under the {look(name).label} with the segment "
            "actuated, and with it passive. Medians over poses, heights and seas."
        ),
        alt=(
            f"Bars of the rms angle for {len(waves)} spectra and {len(passive)} segments. Share of "
            f"the variance of the passive angle above the peak frequency: {shares}."
        ),
    )
