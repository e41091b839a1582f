"""The paper's Fig. example_case, in two seas, and all controllers side by side."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from softwave_min.arm import Arm
from softwave_min.control.problem import Status
from softwave_min.experiments.closed_loop import TRANSIENT, LoopRun, controllers, others, sea_of
from softwave_min.experiments.example_case import EXPERIMENT, SEAS, key_moments
from softwave_min.figures.headline import headline
from softwave_min.figures.marks import legend_above, look, stem_for
from softwave_min.figures.style import BLUE, DASHES, GREY, ORANGE, SERIES, Drawing
from softwave_min.paper.cases import wave_cases
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store
from softwave_min.simulation import ClosedLoop, Source


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """The paper's four panels for each sea and controller, and the errors of all controllers."""
    runs = {run.name: run for run in EXPERIMENT.runs(parameters)}
    loops = {name: ClosedLoop(**store.load_run(run)) for name, run in runs.items()}
    words = _sea_words(parameters)
    drawings = {
        stem_for(f"example_case_{sea}", name): _panels(
            words[sea], name, runs[f"{sea}-{name}"].parameters, loops[f"{sea}-{name}"]
        )
        for name in others()
        for sea in SEAS
    }
    sides = {name: loops[f"{SEAS[0]}-{name}"] for name in controllers()}
    case = next(iter(runs.values())).parameters
    arm = Arm(parameters.arm, parameters.fluid)
    return {
        **drawings,
        "errors": _errors(words, loops),
        "headline": headline(arm, sea_of(case), sides),
    }


def _sea_words(parameters: ParameterSet) -> dict[str, str]:
    """What the seas are called; the JONSWAP sea by its wave case, if it is one of the paper's."""
    period = parameters.sea.peak_period
    known = [name for name, case in wave_cases().items() if case.peak_period == period]
    return {
        "jonswap": f"JONSWAP sea {(known or [f'of {period:g} s'])[0]}",
        "measured": "measured sea, NDBC 41010",
    }


def _panels(sea: str, controller: str, case: LoopRun, loop: ClosedLoop) -> Drawing:
    figure, axes = plt.subplots(4, 1, sharex=True, figsize=(7.0, 7.6))
    for one in axes:
        for start, end in key_moments(loop.time, loop.wave_torque):
            one.axvspan(start, end, color="#e4e4e4", linewidth=0, zorder=0)
    times = np.linspace(loop.time[0], loop.time[-1], 1201)
    axes[0].plot(times, sea_of(case).elevation(0.0, times), color=BLUE, linestyle="-")
    axes[0].set(ylabel="elevation, m", title="(a) wave train")
    _tips(axes[1], loop.time, loop.tips - np.asarray(case.parameters.arm.base_position))
    axes[1].set(ylabel="tip of segment, m", title="(b) tips")
    _by_segment(axes[2], loop.time, loop.torque, r"\tau")
    axes[2].set(ylabel="actuation torque, N m", title="(c) actuation")
    _by_segment(axes[3], loop.time, loop.wave_torque, "F")
    axes[3].set(ylabel="wave torque, N m", title="(d) waves", xlabel="time, s")
    axes[3].set_xlim(0, loop.time[-1])
    failed = mark_failures(axes[3], loop)
    figure.align_ylabels(axes)
    target = "({:.1f}, {:.1f}) m".format(*case.path[-1])
    return Drawing(
        figure,
        caption=(
            f"The example case under {look(controller).label} in the {sea}, significant height "
            f"{case.parameters.sea.significant_height:.1f} m, tip held at {target}: (a) elevation "
            "above the base, (b) tips of the segments relative to the base, (c) actuation torques, "
            "(d) wave torques. Shaded: the norm of the wave torques is above its 90 % quantile "
            f"over the window.{failed}"
        ),
        alt=(
            f"Four stacked time series over {loop.time[-1]:.0f} s. The elevation swings over "
            "metres; the tip of the last segment stays level after the start while the others "
            "move; actuation torques mirror the wave torques, most clearly in the shaded bands."
        ),
    )


def mark_failures(axes: Axes, loop: ClosedLoop) -> str:
    """Put a tick on the time axis for every solve that failed; say so for the caption.

    Failed are those that did not converge, and those whose input a fallback replaced.
    """
    failed = (loop.status > Status.CONVERGED) | (loop.source != Source.CONTROLLER)
    if not np.any(failed):
        return ""
    at, foot = loop.time[:-1][failed], axes.get_xaxis_transform()
    axes.plot(at, 0 * at, "|", color=ORANGE, markersize=9, clip_on=False, transform=foot)
    return f" Ticks on the time axis: {len(at)} of {len(failed)} solves failed."


def _tips(axes: Axes, time: np.ndarray, relative: np.ndarray) -> None:
    for number, tip in enumerate(relative.swapaxes(0, 1)):
        for series, letter, dash in zip(tip.T, "xz", ("-", DASHES[2]), strict=True):
            label, colour = f"${letter}_{number + 1}$", SERIES[number % 3]
            axes.plot(time, series, linestyle=dash, color=colour, label=label)
    legend_above(axes, handlelength=2.4)


def _by_segment(axes: Axes, time: np.ndarray, series: np.ndarray, symbol: str) -> None:
    for number, values in enumerate(series.T):
        label, colour, dash = f"${symbol}_{number + 1}$", SERIES[number % 3], DASHES[number % 3]
        axes.plot(time[:-1], values, linestyle=dash, color=colour, label=label)
    legend_above(axes, handlelength=2.4)


def _errors(words: dict[str, str], loops: dict[str, ClosedLoop]) -> Drawing:
    names, failed = controllers(), list[str]()
    figure, axes = plt.subplots(len(SEAS), 1, sharex=True, figsize=(7.0, 4.4))
    for one, sea in zip(axes, SEAS, strict=True):
        for name in names:
            loop, shown = loops[f"{sea}-{name}"], look(name)
            one.semilogy(
                loop.time, loop.error, color=shown.colour, linestyle=shown.dash, label=shown.label
            )
            failed.append(mark_failures(one, loop))
        one.axvline(TRANSIENT, color=GREY, linewidth=0.8, linestyle="-")
        one.set(ylabel="tip error, m", title=words[sea], ylim=(1e-5, 1.5))
    axes[0].legend(ncols=len(names), loc="upper right")
    axes[-1].set_xlabel("time, s")
    axes[-1].set_xlim(0, loop.time[-1])
    settled = {name: loops[f"{SEAS[0]}-{name}"].error[loop.time >= TRANSIENT] for name in names}
    medians = ", ".join(
        f"{look(name).label} {1000 * np.median(error):.3g} mm" for name, error in settled.items()
    )
    return Drawing(
        figure,
        caption=(
            "Distance of the tip from its target under all controllers in both seas, on a "
            "logarithmic scale. Left of the vertical line is the start-up transient from the "
            "straight arm, which the paper's RMSE includes in our reading." + "".join(failed)
        ),
        alt=(
            "Two panels, one per sea, with a line for each controller. Medians of the error after "
            f"the transient in the JONSWAP sea: {medians}."
        ),
    )
