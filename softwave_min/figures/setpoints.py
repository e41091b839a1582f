"""The paper's Fig. various_setpoints, and the workspaces behind it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
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
Cells = NDArray[np.bool_]
Cases = dict[str, Case]
Maps = dict[str, Cells]

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
    postures = {name: arrays[f"rest-{name}"]["q"] for name in cases}
    bound = parameters.nmpc.angle_bound
    return {
        "setpoints": _postures(arm, cases, maps, postures, table, bound),
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
    arm: Arm, cases: Cases, maps: Maps, ends: dict[str, Floats], table: pd.DataFrame, bound: float
) -> Drawing:
    # The paper's panels: no failure, then each segment passive.
    shown = {name: case for name, case in cases.items() if case.manner == "passive"}
    figure, axes = plt.subplots(1, len(shown), figsize=(9.2, 3.9), sharex=True, sharey=True)
    titles, sentences = [], []
    for one, letter, (name, case) in zip(axes, "abc", shown.items(), strict=False):
        titles.append(f"({letter}) {case.words}")
        _shaded(one, arm, maps[name])
        left = table["distance_left"].xs(name)
        for index, (pose, target) in enumerate(poses().items()):
            _body(one, arm, ends[name][index], FACES[index % 3], case.segment)
            if left[pose] < REACHED:
                one.plot(*target, "x", color=INK, markersize=7, mew=1.8, zorder=7)
            else:
                one.plot(*target, "o", color="none", mec=BLUE, markersize=9, mew=1.8, zorder=7)
            one.annotate(pose, target, (7, 3), textcoords="offset points", fontsize=8, zorder=7)
        missed = left[left >= REACHED]
        words = [f"{pose} missed by {100 * offset:.1f} cm" for pose, offset in missed.items()]
        one.text(0.98, 0.02, "\n".join(words), transform=one.transAxes, ha="right", fontsize=8)
        one.plot(*arm.parameters.base_position, "s", color=INK, markersize=7, zorder=6)
        one.set(title=titles[-1], aspect="equal", xlabel="x, m")
        one.grid(visible=False)
        out = ", ".join(table.loc[name].query("not reachable").index)
        found = f"{out} are out of reach" if out else "all targets are reached"
        sentences.append(f"With {case.words}, {found}.")
    x, z = arm.parameters.base_position
    axes[0].set(ylabel="z, m", xlim=(x - 0.12, x + 0.9), ylim=(z - 0.82, z + 0.62))
    handles = [
        Line2D([], [], color=INK, marker="x", linestyle="", label="target within reach"),
        Line2D([], [], color="none", marker="o", markeredgecolor=BLUE, label="out of reach"),
        Patch(facecolor=SHADE, label="workspace of the tip"),
        Patch(facecolor="white", edgecolor=INK, hatch="/////", label="passive segment"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return Drawing(
        figure,
        caption=(
            "Postures in which the NMPC ends in still water, from the straight arm, for the six "
            f"poses: {', '.join(titles)}; what is passive is hatched. Grey: "
            "where the tip can be at rest with every actuated angle "
            f"within {bound:.2f} rad. A cross is a target within reach; a ring is one out of "
            "reach, with the distance that is left by the best posture. " + failure_sentence(table)
        ),
        alt=(
            f"{len(shown)} panels with six postures of a thick arm each, three bending up from "
            f"the base and three down. {' '.join(sentences)}"
        ),
    )


def _map(arm: Arm, cells: Cells) -> tuple[Floats, Floats, Floats]:
    """The cells' middles, x and z, and the map blurred by less than a cell: no stairs."""
    x, z = arm.parameters.base_position
    offsets: Floats = CELL * (np.arange(len(cells), dtype=float) + 0.5 - len(cells) / 2)
    return x + offsets, z + offsets, gaussian_filter(cells.T.astype(float), 0.8)


def _shaded(axes: Axes, arm: Arm, cells: Cells) -> None:
    axes.contourf(*_map(arm, cells), levels=[0.5, 2], colors=[SHADE], zorder=0)


def _body(axes: Axes, arm: Arm, q: Floats, face: str, failed: int) -> None:
    look: Any = {"facecolor": face, "edgecolor": INK, "linewidth": 0.7, "linestyle": "-"}
    for number, outline in enumerate(outlines(arm, q), start=1):
        hatch = "/////" if number == failed else None
        axes.fill(*outline.T, hatch=hatch, alpha=0.75, zorder=2, **look)


def _workspaces(arm: Arm, cases: Cases, maps: Maps, areas: pd.DataFrame, bound: float) -> Drawing:
    failed = sorted({case.segment for case in cases.values()} - {0})
    figure, axes = plt.subplots(
        1, len(failed), figsize=(7.6, 4.6), sharex=True, sharey=True, squeeze=False
    )
    panels = dict(zip("ab", failed, strict=False))
    for one, (letter, segment) in zip(axes[0], panels.items(), strict=True):
        _shaded(one, arm, maps[INTACT])
        shown = {name: case for name, case in cases.items() if case.segment in {0, segment}}
        handles = []
        for (name, case), (colour, dash) in zip(shown.items(), OUTLINES, strict=True):
            look: Any = {"colors": [colour], "linestyles": [dash], "linewidths": 1.4}
            one.contour(*_map(arm, maps[name]), levels=[0.5], **look)
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
    names = [f"({letter}) with the {ordinal(one)} segment failed" for letter, one in panels.items()]
    shares = (100 * areas["share"].drop(INTACT)).items()
    in_words = ", ".join(f"{cases[str(name)].words}: {share:.0f} %" for name, share in shares)
    return Drawing(
        figure,
        caption=(
            "Where the tip can be at rest in still water with every actuated angle within "
            f"{bound:.2f} rad: {', '.join(names)}, passive (it hangs by its weight and stiffness) "
            "or locked straight, against the intact arm (grey). Crosses: the six poses. Areas by "
            f"counting cells of {100 * CELL:.0f} cm; the uncertainty is half of the cells on the "
            "rim."
        ),
        alt=(
            "Maps of the plane about the base with outlines of workspaces. Shares of the intact "
            f"arm's area: {in_words}."
        ),
    )
