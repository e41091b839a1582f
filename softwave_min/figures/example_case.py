"""The paper's Fig. example_case, in two seas, and all controllers side by side."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from softwave_min.arm import Arm
from softwave_min.control.problem import Status
from softwave_min.experiments.closed_loop import TRANSIENT, LoopRun, controllers, others, sea_of
from softwave_min.experiments.example_case import EXPERIMENT, SEAS, key_moments
from softwave_min.figures.headline import Side, headline
from softwave_min.figures.marks import legend_above, look, stem_for
from softwave_min.figures.style import BLUE, DASHES, GREY, ORANGE, SERIES, Drawing
from softwave_min.paper.cases import wave_cases
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Run
from softwave_min.runs.store import Store
from softwave_min.simulation import ClosedLoop, Source
from softwave_min.waves import Sea


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """The paper's four panels for each sea and controller, and the errors of all controllers."""
    runs = {run.name: run for run in EXPERIMENT.runs(parameters)}
    loops = {name: ClosedLoop(**store.load_run(run)) for name, run in runs.items()}
    drawings = {
        stem_for(f"example_case_{sea}", name): _panels(
            sea, name, runs[f"{sea}-{name}"], loops[f"{sea}-{name}"]
        )
        for name in others()
        for sea in SEAS
    }
    case: LoopRun = next(iter(runs.values())).parameters
    arm = Arm(case.parameters.arm, case.parameters.fluid)
    sides = tuple(Side(name, loops[f"{SEAS[0]}-{name}"]) for name in controllers())
    words = _sea_words(parameters)
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


def _panels(sea: str, controller: str, run: Run, loop: ClosedLoop) -> Drawing:
    case: LoopRun = run.parameters
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
    target = "({:.1f}, {:.1f}) m".format(*case.path[-1])
    return Drawing(
        figure,
        caption=(
            f"The example case under {look(controller).label} in the "
            f"{_sea_words(case.parameters)[sea]}, significant height "
            f"{height:.1f} m, tip held at {target}: (a) elevation above the base, (b) tips of "
            "the segments relative to the base, (c) actuation torques, (d) wave torques. "
            "Shaded: the norm of the wave torques is above its 90 % quantile over the window."
            + failed
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
    legend_above(axes, handlelength=2.4)
    axes.set_title("(b) tips")


def _by_segment(axes: Axes, loop: ClosedLoop, series: np.ndarray, symbol: str) -> None:
    for segment in range(series.shape[1]):
        axes.plot(
            loop.time[:-1],
            series[:, segment],
            color=SERIES[segment % 3],
            linestyle=DASHES[segment % 3],
            label=f"${symbol}_{segment + 1}$",
        )
    legend_above(axes, handlelength=2.4)
    axes.set_title("(c) actuation" if symbol == r"\tau" else "(d) waves")


def _errors(words: dict[str, str], loops: dict[str, ClosedLoop]) -> Drawing:
    failed: list[str] = []
    figure, axes = plt.subplots(len(SEAS), 1, sharex=True, figsize=(7.0, 4.4))
    for one, sea in zip(axes, SEAS, strict=True):
        for name in controllers():
            loop, shown = loops[f"{sea}-{name}"], look(name)
            one.semilogy(
                loop.time, loop.error, color=shown.colour, linestyle=shown.dash, label=shown.label
            )
            failed.append(mark_failures(one, loop))
        one.axvline(TRANSIENT, color=GREY, linewidth=0.8, linestyle="-")
        one.set(ylabel="tip error, m", title=words[sea], ylim=(1e-5, 1.5))
    axes[0].legend(ncols=len(controllers()), loc="upper right")
    axes[-1].set_xlabel("time, s")
    axes[-1].set_xlim(0, loop.time[-1])
    medians = ", ".join(
        f"{look(name).label} {1000 * _settled_median(loops[f'{SEAS[0]}-{name}']):.3g} mm"
        for name in controllers()
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


def _settled_median(loop: ClosedLoop) -> float:
    return float(np.median(loop.error[loop.time >= TRANSIENT]))
