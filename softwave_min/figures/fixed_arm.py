"""Loads of the water on the fixed arm, over depth and over curvature."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from softwave_min.figures.style import DASHES, GREY, SERIES, Drawing
from softwave_min.paper.cases import poses
from softwave_min.paper.numbers import error_ratio
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """Torque over depth in one posture, and over curvature in all."""
    postures, depth = store.read_table("postures"), store.read_table("depth")
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 3.4), width_ratios=(1, 1.1))
    pose, base = error_ratio().reduction["W1"].largest_pose, parameters.arm.base_position[1]
    _decay(left, depth[(depth.pose == pose) & (depth.seed == depth.seed.min())], base)
    _by_curvature(right, postures[postures.seed == postures.seed.min()])
    ratio, depths = postures.torque_uniform / postures.torque, [z for _, z in poses().values()]
    drawing = Drawing(
        figure,
        caption=(
            "Rms torque of the water on the fixed arm, norm over the segments, at "
            f"significant height {depth.Hs.max():g} m. (a) In the posture of {pose}, base raised "
            "and lowered, relative to the operating depth: lines the torque, dots the square of "
            "the water's speed at the base, crosses exp(2kz) for the peak's wave number. Grey "
            "lines: the depths of the paper's targets. (b) In the postures of the six poses, over "
            f"their mean curvature: filled at z = {max(depths):g} m, open at {min(depths):g} m, "
            "crosses if the whole arm met the flow at its base; marks of the wave cases are "
            "shifted apart."
        ),
        alt=(
            "Left: relative torque against depth for three wave cases, falling with depth, "
            "fastest for the shortest waves, with dots and crosses beside the lines. Right: torque "
            f"against curvature, from {postures.torque.min():.1f} to {postures.torque.max():.1f} "
            f"N m; the crosses are at {ratio.min():.2f} to {ratio.max():.2f} of the marks."
        ),
    )
    return {"loads": drawing}


def _decay(axes: Axes, depth: pd.DataFrame, base: float) -> None:
    for (wave, rows), colour, dash in zip(depth.groupby("wave"), SERIES, DASHES, strict=False):
        here = rows[rows.z == base].iloc[0]
        axes.semilogx(rows.torque / here.torque, rows.z, color=colour, linestyle=dash, label=wave)
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
        colour, marker = SERIES[number], "os^"[number]
        places = rows.curvature + apart * (number - 1)
        above = rows.pose.map(lambda pose: poses()[pose][1] == upper)
        for shown, face, label in ((above, colour, wave), (~above, "white", None)):
            look: Any = {"color": colour, "mfc": face, "markersize": 5, "label": label}
            axes.plot(places[shown], rows.torque[shown], marker, **look)
        axes.plot(places, rows.torque_uniform, "x", color=colour, markersize=4)
    axes.set_ylim(bottom=0)
    axes.set(title="(b) the six poses", xlabel="mean curvature, 1/m", ylabel="rms torque, N m")
    axes.legend()
