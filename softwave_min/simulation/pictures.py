"""What a comparison of controllers looks like, in whatever style matplotlib is set to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.artist import Artist
from matplotlib.axes import Axes

if TYPE_CHECKING:
    from softwave_min.simulation.comparison import Comparison

LONGEST = 150
"""Most frames of a film: of a longer run, every second, third, ... instant."""
MARGIN = 0.15
"""Empty space around the arms, in m."""


def plot(comparison: Comparison) -> tuple[Axes, Axes]:
    """The elevation above the base and, below it, the tip's error under each controller."""
    _, (above, below) = plt.subplots(2, sharex=True, layout="constrained", height_ratios=(1, 2))
    scenario = comparison.scenario
    x, _ = scenario.parameters.arm.base_position
    above.plot(scenario.times, comparison.sea.elevation(x, scenario.times))
    above.set(ylabel="elevation, m")
    for name, run in comparison.runs.items():
        below.plot(run.time, run.error, label=name)
    below.set(xlabel="time, s", ylabel="error of the tip, m", ylim=(0, None))
    below.legend()
    return above, below


def animate(comparison: Comparison) -> FuncAnimation:
    """The arm under each controller, side by side, with its target."""
    runs, scenario = comparison.runs, comparison.scenario
    bodies = [scenario.arm.axis(run.q) for run in runs.values()]
    corners = np.concatenate([*(body.reshape(-1, 2) for body in bodies), scenario.targets])
    low, high = corners.min(axis=0) - MARGIN, corners.max(axis=0) + MARGIN
    width = 3.2 * len(runs)
    figure, row = plt.subplots(
        1, len(runs), squeeze=False, sharex=True, sharey=True, layout="constrained",
        figsize=(width, 4.0),
    )  # fmt: skip
    moving = []
    for axes, name in zip(row[0], runs, strict=True):
        axes.set(title=name, xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set(xlabel="x, m", ylabel="z, m")
        (target,) = axes.plot([], [], "x", color="black", markersize=9, zorder=3)
        (arm,) = axes.plot([], [], linestyle="-", linewidth=5, solid_capstyle="round")
        moving.append((target, arm))
    clock = figure.suptitle("t = 0.0 s")
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # which would lay out every frame anew

    def show(frame: int) -> list[Artist]:
        clock.set_text(f"t = {scenario.times[frame]:.1f} s")
        for (target, arm), body in zip(moving, bodies, strict=True):
            target.set_data(*scenario.targets[frame][:, None])
            arm.set_data(*body[frame].T)
        return [clock, *(artist for pair in moving for artist in pair)]

    stride = -(-len(scenario.times) // LONGEST)
    frames = range(0, len(scenario.times), stride)
    film = FuncAnimation(figure, show, frames, interval=1000 * stride * scenario.period)
    plt.close(figure)  # or a notebook shows the first frame below the film
    return film
