"""The paper's Fig. example_case, in two seas, and both controllers side by side."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from softwave_min.arm import Arm
from softwave_min.control.problem import Status
from softwave_min.experiments.closed_loop import TRANSIENT
from softwave_min.experiments.example_case import (
    EXPERIMENT,
    SEAS,
    ExampleRun,
    key_moments,
    sea_of,
)
from softwave_min.figures.headline import Side, headline
from softwave_min.figures.style import BLUE, DASHES, GREY, INK, ORANGE, SERIES, Drawing
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Run
from softwave_min.runs.store import Store
from softwave_min.simulation import ClosedLoop, Source
from softwave_min.waves import Sea

SEA_NAMES = {"jonswap": "JONSWAP sea W3", "measured": "measured sea, NDBC 41010"}


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """The paper's four panels for each sea, and the errors of both controllers."""
    runs = {run.name: run for run in EXPERIMENT.runs(parameters)}
    loops = {name: ClosedLoop(**store.load_run(run)) for name, run in runs.items()}
    drawings = {
        f"example_case_{sea}": _panels(sea, runs[f"{sea}-nmpc"], loops[f"{sea}-nmpc"])
        for sea in SEAS
    }
    return {**drawings, "errors": _errors(loops), "headline": _headline(runs, loops)}


def _panels(name: str, run: Run, loop: ClosedLoop) -> Drawing:
    case: ExampleRun = run.parameters
    figure, axes = plt.subplots(4, 1, sharex=True, figsize=(7.0, 7.6))
    moments = key_moments(loop.time, loop.wave_torque)
    for one in axes:
        for start, end in moments:
            one.axvspan(start, end, color="#e4e4e4", linewidth=0, zorder=0)
    _elevation(axes[0], sea_of(case), loop)
    _tips(axes[1], loop, np.asarray(case.parameters.arm.base_position))
    _by_segment(axes[2], loop, loop.torque, r"\tau")
    _by_segment(axes[3], loop, loop.wave_torque, r"F")
    axes[1].set_ylabel("tip of segment, m")
    axes[2].set_ylabel("actuation torque, N m")
    axes[3].set_ylabel("wave torque, N m")
    axes[3].set_xlabel("time, s")
    axes[3].set_xlim(0, loop.time[-1])
    failed = mark_failures(axes[3], loop)
    figure.align_ylabels(axes)
    height = case.parameters.sea.significant_height
    target = "({:.1f}, {:.1f}) m".format(*case.target)
    return Drawing(
        figure,
        caption=(
            f"The example case under NMPC in the {SEA_NAMES[name]}, significant height "
            f"{height:.1f} m, tip held at {target}: (a) elevation above the base, (b) tips of "
            "the three segments relative to the base, (c) actuation torques, (d) wave torques. "
            "Shaded: the norm of the wave torques is above its 90 % quantile over the window."
            + failed
        ),
        alt=(
            "Four stacked time series over 60 s. The elevation swings over metres; the tip of "
            "the third segment stays level after the start while the first two move; actuation "
            "torques mirror the wave torques, most clearly in the shaded bands."
        ),
    )


def mark_failures(axes: Axes, loop: ClosedLoop) -> str:
    """Put a tick on the time axis for every solve that failed; say so for the caption.

    Failed are those that did not converge, and those whose input a fallback replaced.
    """
    failed = (loop.status > Status.CONVERGED) | (loop.source != Source.CONTROLLER)
    if not np.any(failed):
        return ""
    base = np.zeros(np.count_nonzero(failed))
    axes.plot(
        loop.time[:-1][failed],
        base,
        linestyle="none",
        marker="|",
        color=ORANGE,
        markersize=9,
        clip_on=False,
        transform=axes.get_xaxis_transform(),
    )
    return f" Ticks on the time axis: {len(base)} of {len(failed)} solves failed."


def _elevation(axes: Axes, sea: Sea, loop: ClosedLoop) -> None:
    times = np.linspace(loop.time[0], loop.time[-1], 1201)
    axes.plot(times, sea.elevation(0.0, times), color=BLUE, linestyle="-")
    axes.set_ylabel("elevation, m")
    axes.set_title("(a) wave train")


def _tips(axes: Axes, loop: ClosedLoop, base: np.ndarray) -> None:
    relative = loop.tips - base
    for segment in range(relative.shape[1]):
        colour = SERIES[segment % 3]
        for axis, letter, dash in ((0, "x", "-"), (1, "z", DASHES[2])):
            series = relative[:, segment, axis]
            label = f"${letter}_{segment + 1}$"
            axes.plot(loop.time, series, linestyle=dash, color=colour, label=label)
    _legend_above(axes)
    axes.set_title("(b) tips")


def _legend_above(axes: Axes) -> None:
    """Put the legend on the line of the title, where it hides no data."""
    count = len(axes.get_lines())
    axes.legend(
        ncols=count, loc="lower right", bbox_to_anchor=(1.0, 0.97), borderpad=0, handlelength=2.4
    )


def _by_segment(axes: Axes, loop: ClosedLoop, series: np.ndarray, symbol: str) -> None:
    for segment in range(series.shape[1]):
        axes.plot(
            loop.time[:-1],
            series[:, segment],
            color=SERIES[segment % 3],
            linestyle=DASHES[segment % 3],
            label=f"${symbol}_{segment + 1}$",
        )
    _legend_above(axes)
    axes.set_title("(c) actuation" if symbol == r"\tau" else "(d) waves")


def _errors(loops: dict[str, ClosedLoop]) -> Drawing:
    medians = {
        name: 1000 * float(np.median(loop.error[loop.time >= TRANSIENT]))
        for name, loop in loops.items()
    }
    failed: list[str] = []
    figure, axes = plt.subplots(len(SEAS), 1, sharex=True, figsize=(7.0, 4.4))
    for one, sea in zip(axes, SEAS, strict=True):
        baseline, nmpc = loops[f"{sea}-baseline"], loops[f"{sea}-nmpc"]
        one.semilogy(baseline.time, baseline.error, color=ORANGE, linestyle=DASHES[1])
        one.semilogy(nmpc.time, nmpc.error, color=INK, linestyle="-")
        failed.append(mark_failures(one, nmpc))
        one.axvline(TRANSIENT, color=GREY, linewidth=0.8, linestyle="-")
        one.set_ylabel("tip error, m")
        one.set_title(SEA_NAMES[sea])
        one.set_ylim(1e-5, 1.5)
    axes[0].legend(["feed-forward + PD", "NMPC"], ncols=2, loc="upper right")
    axes[-1].set_xlabel("time, s")
    axes[-1].set_xlim(0, 60)
    return Drawing(
        figure,
        caption=(
            "Distance of the tip from its target under both controllers in both seas, on a "
            "logarithmic scale. Left of the vertical line is the start-up transient from the "
            "straight arm, which the paper's RMSE includes in our reading." + "".join(failed)
        ),
        alt=(
            "Two panels, one per sea. After the first seconds the NMPC's error stays far below "
            "that of feed-forward plus PD. Medians after the transient in the JONSWAP sea: "
            f"{medians['jonswap-nmpc']:.1f} mm against {medians['jonswap-baseline']:.0f} mm."
        ),
    )


def _headline(runs: dict[str, Run], loops: dict[str, ClosedLoop]) -> Drawing:
    case: ExampleRun = runs["jonswap-nmpc"].parameters
    arm = Arm(case.parameters.arm, case.parameters.fluid)
    sides = (
        Side("feed-forward + PD", ORANGE, loops["jonswap-baseline"]),
        Side("NMPC with preview of the waves", BLUE, loops["jonswap-nmpc"]),
    )
    return headline(arm, sea_of(case), sides)
