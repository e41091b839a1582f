"""The paper's Fig. error_bar, the same after the start, and the loads that are to explain it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from softwave_min.experiments.closed_loop import TRANSIENT
from softwave_min.experiments.error_ratio import paper
from softwave_min.figures.style import DASHES, GREY, INK, ORANGE, SERIES, Drawing
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet
from softwave_min.runs.statistics import INTERVAL
from softwave_min.runs.store import Store

Floats = NDArray[np.float64]

LIGHTEST, DARKEST = (0.80, 0.88, 0.95), (0.03, 0.19, 0.42)
"""Colours of the smallest and the greatest height; lightness falls between them."""
GROUP = 0.84
"""Width of the bars of one pose, of the distance between poses."""


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """The grid as bars, whole and settled, and the loads on the arm held still."""
    table = store.read_table("error_ratio")
    return {
        "error_ratio": _whole(table),
        "settled": _settled(table),
        "loads": _loads(store.read_table("postures"), store.read_table("depth"), parameters),
    }


def _whole(table: pd.DataFrame) -> Drawing:
    figure = _bars(table, "ratio", quoted=True)
    reductions = 100 * (1 - _over_seeds(table, "ratio")[:, :, :, 1])
    below = int(np.count_nonzero(reductions > 0))
    return Drawing(
        figure,
        caption=(
            "RMSE of the tip under the NMPC over that under feed-forward + PD, "
            "$e_{mpc}/e_{pd}$, over the whole run, for the wave cases (a) W1, (b) W2 and (c) W3, "
            f"six poses and significant heights {_heights(table)}, from light to dark. Grey line: "
            "equal performance. Orange: the smallest and the largest ratio that the paper's text "
            "has for the wave case, at the pose that it names. " + _spread(table) + _failures(table)
        ),
        alt=(
            "Three panels of bars, one per wave case, six groups of six. "
            f"{below} of {reductions.size} bars are below one. The reductions of the error run "
            f"from {reductions.min():.0f} to {reductions.max():.0f} per cent. " + _failures(table)
        ),
    )


def _settled(table: pd.DataFrame) -> Drawing:
    figure = _bars(table, "ratio_settled", quoted=False)
    ratios = _over_seeds(table, "ratio_settled")[:, :, :, 1]
    return Drawing(
        figure,
        caption=(
            f"The same ratio without the first {TRANSIENT:g} s of every run: wave cases (a) W1, "
            f"(b) W2 and (c) W3, six poses, significant heights {_heights(table)}, from light to "
            "dark. The scale differs from that of the figure over the whole run. "
            + _spread(table)
            + _failures(table)
        ),
        alt=(
            "Three panels of bars, one per wave case, six groups of six: ratios of the errors "
            f"after the start, from {ratios.min():.2f} to {ratios.max():.2f}. " + _failures(table)
        ),
    )


def _bars(table: pd.DataFrame, column: str, *, quoted: bool) -> Figure:
    """One panel per wave case; ``quoted`` adds what the paper's text has."""
    found, failed = _over_seeds(table, column), _failed_cells(table)
    heights = sorted(table.Hs.unique())
    colours = _shades(len(heights))
    figure = Figure(figsize=(7.0, 6.4))
    panels: Sequence[Axes] = figure.subplots(len(found), 1, sharex=True, sharey=True)
    top = max(found.max(), 1.0) if quoted else found.max()
    for letter, wave, axes, ratios, marks in zip(
        "abc", wave_cases().values(), panels, found, failed, strict=True
    ):
        _panel(axes, ratios, marks, colours)
        if quoted:
            _paper_marks(axes, wave.name)
        if top >= 1.0:
            axes.axhline(1.0, color=GREY, linestyle="-", linewidth=1.0)
        axes.set_title(f"({letter}) {wave.name}, $T_p$ = {wave.peak_period:g} s")
        axes.set_ylabel("$e_{mpc}/e_{pd}$")
        axes.grid(visible=False, axis="x")
    panels[-1].set_xticks(range(len(poses())), list(poses()))
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


def _panel(axes: Axes, ratios: Floats, failed: NDArray[np.bool_], colours: Sequence[str]) -> None:
    """Bars by pose and height, their spread over the seas, and a cross where solves failed."""
    width = GROUP / len(colours)
    for height, colour in enumerate(colours):
        places = np.arange(len(ratios)) + width * (height + 0.5) - GROUP / 2
        low, median, high = ratios[:, height].T
        axes.bar(places, median, width, color=colour, edgecolor=INK, linewidth=0.4)
        if np.any(high > low):
            spread = np.array([median - low, high - median])
            axes.errorbar(
                places, median, spread, fmt="none", ecolor=INK, elinewidth=0.7, capsize=1.2
            )
        marked = failed[:, height]
        axes.plot(places[marked], high[marked], "x", color=ORANGE, markersize=5)


def _paper_marks(axes: Axes, wave: str) -> None:
    quoted, names = paper().reduction[wave], list(poses())
    for pose, reduction in (
        (quoted.largest_pose, quoted.largest),
        (quoted.smallest_pose, quoted.smallest),
    ):
        place = names.index(pose)
        axes.plot(
            [place - GROUP / 2, place + GROUP / 2],
            [1 - reduction / 100] * 2,
            color=ORANGE,
            linestyle=DASHES[1],
            linewidth=1.4,
        )


def _shades(count: int) -> list[str]:
    steps = np.linspace(0, 1, count)[:, None]
    shades = (1 - steps) * np.array(LIGHTEST) + steps * np.array(DARKEST)
    return [to_hex(tuple(shade)) for shade in shades]


def _over_seeds(table: pd.DataFrame, column: str) -> Floats:
    """Low, median and high over the seas: (waves, poses, heights, 3)."""
    levels = table.groupby(["wave", "pose", "Hs"])[column].quantile(np.array(INTERVAL))
    return levels.to_numpy(float).reshape(len(wave_cases()), len(poses()), -1, len(INTERVAL))


def _failed_cells(table: pd.DataFrame) -> NDArray[np.bool_]:
    """Whether a solve failed in any sea: (waves, poses, heights)."""
    marked = table.assign(failed=table.solves_failed + table.fallbacks > 0)
    found = marked.groupby(["wave", "pose", "Hs"]).failed.any()
    return found.to_numpy(bool).reshape(len(wave_cases()), len(poses()), -1)


def _heights(table: pd.DataFrame) -> str:
    return f"{table.Hs.min():g} m to {table.Hs.max():g} m"


def _spread(table: pd.DataFrame) -> str:
    seas = table.seed.nunique()
    if seas == 1:
        return "One random sea per wave case. "
    low, _, high = (f"{100 * quantile:g}" for quantile in INTERVAL)
    return f"Bars: median over {seas} random seas; whiskers: {low} % to {high} %. "


def _failures(table: pd.DataFrame) -> str:
    solves, fallbacks = int(table.solves_failed.sum()), int(table.fallbacks.sum())
    if not solves and not fallbacks:
        return "Every solve of the NMPC converged."
    marked = _failed_cells(table)
    return (
        f"Crosses: cells with failures, {marked.sum()} of {marked.size}; solves of the NMPC that "
        f"did not converge: {solves}; commands from its fallback: {fallbacks}."
    )


def _loads(postures: pd.DataFrame, depth: pd.DataFrame, parameters: ParameterSet) -> Drawing:
    figure = Figure(figsize=(7.0, 3.4))
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.1))
    pose, base = paper().reduction["W1"].largest_pose, parameters.arm.base_position[1]
    _decay(left, depth[(depth.pose == pose) & (depth.seed == depth.seed.min())], base)
    _by_curvature(right, postures[postures.seed == postures.seed.min()])
    ratio = postures.torque_uniform / postures.torque
    return Drawing(
        figure,
        caption=(
            "Rms torque of the water on the arm held still, norm over the segments, at "
            f"significant height {depth.Hs.max():g} m. (a) In the posture of {pose}, base raised "
            "and lowered, relative to the operating depth: lines the torque, dots the square of "
            "the water's speed at the base, crosses exp(2kz) for the peak's wave number. Grey "
            "lines: the depths of the paper's targets. (b) In the postures of the six poses, over "
            "their mean curvature: filled at z = "
            f"{max(z for _, z in poses().values()):g} m, open at "
            f"{min(z for _, z in poses().values()):g} m, crosses if the whole arm met "
            "the flow at its base; marks of the wave cases are shifted apart."
        ),
        alt=(
            "Left: relative torque against depth for three wave cases, falling with depth, "
            "fastest for the shortest waves, with dots and crosses beside the lines. Right: torque "
            f"against curvature, from {postures.torque.min():.1f} to {postures.torque.max():.1f} "
            f"N m; the crosses are at {ratio.min():.2f} to {ratio.max():.2f} of the marks."
        ),
    )


def _decay(axes: Axes, depth: pd.DataFrame, base: float) -> None:
    for number, (wave, rows) in enumerate(depth.groupby("wave")):
        here = rows[rows.z == base].iloc[0]
        colour = SERIES[number]
        axes.semilogx(
            rows.torque / here.torque, rows.z, color=colour, linestyle=DASHES[number], label=wave
        )
        axes.semilogx((rows.speed / here.speed) ** 2, rows.z, ".", color=colour)
        axes.semilogx(rows.decay**2, rows.z, "x", color=colour, markersize=4)
    for z in sorted({z for _, z in poses().values()}):
        axes.axhline(z, color=GREY, linestyle="-", linewidth=0.8)
    ticks = [tick for tick in (0.05, 0.1, 0.2, 0.5, 1, 2) if tick > depth.decay.min() ** 2]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set(title="(a) one posture", xlabel="relative torque", ylabel="z of the base, m")
    axes.legend(loc="lower right")


def _by_curvature(axes: Axes, postures: pd.DataFrame) -> None:
    upper = max(z for _, z in poses().values())
    apart = 0.04 * float(np.ptp(postures.curvature))
    for number, (wave, rows) in enumerate(postures.groupby("wave")):
        colour, shift = SERIES[number], apart * (number - 1)
        above = rows.pose.map(lambda pose: poses()[pose][1] == upper)
        for shown, face, label in ((rows[above], colour, wave), (rows[~above], "white", None)):
            axes.plot(
                shown.curvature + shift,
                shown.torque,
                "os^"[number],
                color=colour,
                markerfacecolor=face,
                markersize=5,
                label=label,
            )
        axes.plot(rows.curvature + shift, rows.torque_uniform, "x", color=colour, markersize=4)
    axes.set_ylim(bottom=0)
    axes.set(title="(b) the six poses", xlabel="mean curvature, 1/m", ylabel="rms torque, N m")
    axes.legend()
