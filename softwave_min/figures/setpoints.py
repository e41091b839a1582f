"""The paper's Fig. various_setpoints, and the workspaces behind it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from softwave_min.arm import Arm
from softwave_min.experiments.failures import INTACT, Case, failure_cases, ordinal
from softwave_min.experiments.resting_arm import CELL, REACHED
from softwave_min.experiments.setpoints import EXPERIMENT
from softwave_min.figures.marks import failure_sentence
from softwave_min.figures.style import BLUE, GREY, INK, ORANGE, SKY, Drawing
from softwave_min.paper.cases import poses
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store

Floats = NDArray[np.float64]

FACES = (GREY, ORANGE, SKY)
"""Bodies at P1, P2, P3 and again at P4, P5, P6."""
SHADE = "#ececec"
OUTLINES: tuple[tuple[str, Literal["-", "--", ":"]], ...] = (
    (GREY, "-"),
    (ORANGE, "--"),
    (INK, ":"),
)
"""Of the intact arm's workspace, and of the passive and the locked arm's."""
PARTS = 14
"""Chords that stand for the arc of a segment: off by less than a hair's breadth in print."""


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """Postures in the paper's three panels, and outlines of the workspaces."""
    arrays = {run.name: store.load_run(run) for run in EXPERIMENT.runs(parameters)}
    table = store.read_table("setpoints").set_index(["case", "pose"])
    areas = store.read_table("workspace").set_index("case")
    arm = Arm(parameters.arm, parameters.fluid)
    cases = failure_cases(parameters)
    maps = {name: arrays[f"reach-{name}"]["workspace"] for name in cases}
    # The paper's panels: no failure, then each segment passive.
    panels = {name: case for name, case in cases.items() if case.manner == "passive"}
    postures = {name: arrays[f"rest-{name}"]["q"] for name in panels}
    bound = parameters.nmpc.angle_bound
    return {
        "setpoints": _postures(arm, panels, maps, postures, table, bound),
        "workspace": _workspaces(arm, cases, maps, areas, bound),
    }


def outlines(arm: Arm, q: Floats) -> Iterator[Floats]:
    """Outline of each segment's body in a posture, (2 P, 2) in m."""
    places = np.linspace(0, 1, PARTS + 1)
    whole = arm.axis(q, PARTS)
    base = arm.parameters.base_angle + np.concatenate([[0.0], np.cumsum(q)])
    for segment, diameter in enumerate(arm.parameters.diameter):
        axis = whole[PARTS * segment :][: PARTS + 1]
        angle = base[segment] + places * q[segment]
        side = diameter / 2 * np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        yield np.concatenate([axis + side, (axis - side)[::-1]])


def _postures(
    arm: Arm,
    panels: dict[str, Case],
    maps: dict[str, NDArray[np.bool_]],
    postures: dict[str, Floats],
    table: pd.DataFrame,
    bound: float,
) -> Drawing:
    figure, axes = plt.subplots(1, len(panels), figsize=(9.2, 3.9), sharex=True, sharey=True)
    titles = {
        name: f"({letter}) {case.words}"
        for letter, (name, case) in zip("abc", panels.items(), strict=False)
    }
    for one, (name, case) in zip(axes, panels.items(), strict=True):
        _shaded(one, arm, maps[name])
        left = table["distance_left"].xs(name)
        for index, (pose, target) in enumerate(poses().items()):
            _body(one, arm, postures[name][index], FACES[index % 3], case.segment)
            _mark(one, pose, target, float(left[pose]))
        missed = _shortfalls(left)
        one.text(0.98, 0.02, missed, transform=one.transAxes, ha="right", fontsize=8)
        one.plot(*arm.parameters.base_position, "s", color=INK, markersize=7, zorder=6)
        one.set(title=titles[name], aspect="equal", xlabel="x, m")
        one.grid(visible=False)
    x, z = arm.parameters.base_position
    axes[0].set(ylabel="z, m", xlim=(x - 0.12, x + 0.9), ylim=(z - 0.82, z + 0.62))
    _legend(figure)
    return Drawing(
        figure,
        caption=(
            "Postures in which the NMPC ends in still water, from the straight arm, for the six "
            f"poses: {', '.join(titles.values())}; what is passive is hatched. Grey: "
            "where the tip can be at rest with every actuated angle "
            f"within {bound:.2f} rad. A cross is a target within reach; a ring is one out of "
            "reach, with the distance that is left by the best posture. " + failure_sentence(table)
        ),
        alt=(
            f"{len(panels)} panels with six postures of a thick arm each, three bending up from "
            f"the base and three down. {_in_words(table, panels)}"
        ),
    )


def _in_words(table: pd.DataFrame, panels: dict[str, Case]) -> str:
    parts = []
    for name, case in panels.items():
        missed = [pose for pose in poses() if not table.loc[(name, pose), "reachable"]]
        parts.append(
            f"With {case.words}, "
            + (f"{', '.join(missed)} are out of reach." if missed else "all targets are reached.")
        )
    return " ".join(parts)


def _shortfalls(left: pd.Series[float]) -> str:
    missed = left[left >= REACHED]
    return "\n".join(f"{pose} missed by {100 * one:.1f} cm" for pose, one in missed.items())


def _shaded(axes: Axes, arm: Arm, cells: NDArray[np.bool_]) -> None:
    axes.contourf(*_middles(arm, cells), _smooth(cells), levels=[0.5, 2], colors=[SHADE], zorder=0)


def _smooth(cells: NDArray[np.bool_]) -> Floats:
    """The map with its first index upwards, blurred by less than a cell: no stairs."""
    blurred: Floats = gaussian_filter(cells.T.astype(float), 0.8)
    return blurred


def _middles(arm: Arm, cells: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    x, z = np.array(arm.parameters.base_position)
    offsets: Floats = CELL * (np.arange(len(cells), dtype=float) + 0.5 - len(cells) / 2)
    return x + offsets, z + offsets


def _body(axes: Axes, arm: Arm, q: Floats, face: str, failed: int) -> None:
    for number, outline in enumerate(outlines(arm, q), start=1):
        axes.fill(
            *outline.T,
            facecolor=face,
            edgecolor=INK,
            linewidth=0.7,
            linestyle="-",
            hatch="/////" if number == failed else None,
            alpha=0.75,
            zorder=2,
        )


def _mark(axes: Axes, pose: str, target: tuple[float, float], left: float) -> None:
    x, z = target
    if left < REACHED:
        axes.plot(x, z, "x", color=INK, markersize=7, markeredgewidth=1.8, zorder=7)
    else:
        axes.plot(x, z, "o", color="none", markeredgecolor=BLUE, markersize=9, mew=1.8, zorder=7)
    axes.annotate(pose, target, (7, 3), textcoords="offset points", fontsize=8, zorder=7)


def _legend(figure: Figure) -> None:
    handles = [
        Line2D([], [], color=INK, marker="x", linestyle="", label="target within reach"),
        Line2D([], [], color="none", marker="o", markeredgecolor=BLUE, label="out of reach"),
        Patch(facecolor=SHADE, label="workspace of the tip"),
        Patch(facecolor="white", edgecolor=INK, hatch="/////", label="passive segment"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)


def _workspaces(
    arm: Arm,
    cases: dict[str, Case],
    maps: dict[str, NDArray[np.bool_]],
    areas: pd.DataFrame,
    bound: float,
) -> Drawing:
    failed = sorted({case.segment for case in cases.values()} - {0})
    figure, axes = plt.subplots(
        1, len(failed), figsize=(7.6, 4.6), sharex=True, sharey=True, squeeze=False
    )
    for one, letter, segment in zip(axes[0], "ab", failed, strict=False):
        shown = {name: case for name, case in cases.items() if case.segment in {0, segment}}
        handles = []
        for (name, case), (colour, dash) in zip(shown.items(), OUTLINES, strict=True):
            drawn = maps[name]
            if name == INTACT:
                _shaded(one, arm, drawn)
            one.contour(
                *_middles(arm, drawn), _smooth(drawn), levels=[0.5], colors=[colour],
                linestyles=[dash], linewidths=1.4,
            )  # fmt: skip
            size, error = areas.loc[name, ["area", "resolution"]]
            label = f"{case.words}: {size:.2f} ± {error:.2f} m²"
            handles.append(Line2D([], [], color=colour, linestyle=dash, label=label))
        for pose, target in poses().items():
            one.plot(*target, "x", color=BLUE, markersize=6, markeredgewidth=1.6, zorder=5)
            one.annotate(pose, target, (3, 3), textcoords="offset points", fontsize=8)
        one.plot(*arm.parameters.base_position, "s", color=INK, markersize=7)
        one.set(title=f"({letter})", aspect="equal", xlabel="x, m")
        one.grid(visible=False)
        one.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.14), fontsize=8)
    axes[0, 0].set_ylabel("z, m")
    panels = ", ".join(
        f"({letter}) with the {ordinal(segment)} segment failed"
        for letter, segment in zip("ab", failed, strict=False)
    )
    shares = ", ".join(
        f"{case.words}: {100 * float(areas['share'][name]):.0f} %"
        for name, case in cases.items()
        if name != INTACT
    )
    return Drawing(
        figure,
        caption=(
            "Where the tip can be at rest in still water with every actuated angle within "
            f"{bound:.2f} rad: {panels}, passive (it hangs by its weight and stiffness) or locked "
            "straight, against the intact arm (grey). Crosses: the six poses. Areas by counting "
            f"cells of {100 * CELL:.0f} cm; the uncertainty is half of the cells on the rim."
        ),
        alt=(
            "Maps of the plane about the base with outlines of workspaces. Shares of the intact "
            f"arm's area: {shares}."
        ),
    )
