"""The paper's Fig. block_diagram: the control loop, drawn from a list of the code's signals."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.patches import FancyBboxPatch, Rectangle

from softwave_min.arm import Arm
from softwave_min.control.baseline import InnerLoop
from softwave_min.control.preview import Preview
from softwave_min.control.problem import Problem
from softwave_min.figures.style import GREY, INK, Drawing
from softwave_min.simulation import ClosedLoop, Command, NmpcController
from softwave_min.simulation.plant import Plant
from softwave_min.waves import Sea

Point = tuple[float, float]

WIDTH, HEIGHT = 2.2, 0.9
FACE, ROUND = "#f4f4f4", "round,pad=0,rounding_size=0.08"


@dataclass(frozen=True)
class Box:
    """A block: a class of the package and what it is called there."""

    kind: type
    words: str
    """Stands in the docstring of ``kind``, or is its name."""
    middle: Point


@dataclass(frozen=True)
class Signal:
    """An arrow: what the code hands from one block to another."""

    symbol: str
    carrier: Callable[..., Any]
    """Dataclass with the signal as a field, or function with it as an argument."""
    name: str
    """The signal's name in ``carrier``."""
    path: tuple[Point, ...]
    label: Point

    def exists(self) -> bool:
        """Whether the code has the signal."""
        if is_dataclass(self.carrier):
            return self.name in {field.name for field in fields(self.carrier)}
        return self.name in inspect.signature(self.carrier).parameters


CENTRED: Any = {"ha": "center", "va": "center"}
TO_ARM = (1.3, 4.45), (1.3, 4.85), (11.0, 4.85), (11.0, 2.65)
TO_ITSELF = (5.8, 2.2), (5.8, 1.25), (4.8, 1.25), (4.8, 1.75)
TO_NMPC = (11.0, 1.75), (11.0, 0.5), (3.8, 0.5), (3.8, 1.75)

BOXES = (
    Box(Sea, "Sea", (1.3, 4.0)),
    Box(Preview, "Preview", (4.3, 4.0)),
    Box(NmpcController, "NMPC", (4.3, 2.2)),
    Box(InnerLoop, "feed-forward + PD", (7.8, 2.2)),
    Box(Arm, "Arm", (11.0, 2.2)),
)

SIGNALS = (
    Signal(r"$v_f$", Preview, "flow", ((2.4, 4.0), (3.2, 4.0)), (2.8, 4.22)),
    Signal(r"$v_f$", Plant.advance, "flow", TO_ARM, (11.3, 3.7)),
    Signal("noise", Preview, "deviation", ((6.4, 4.0), (5.4, 4.0)), (6.85, 4.0)),
    Signal("forecast", Problem, "forecast", ((4.3, 3.55), (4.3, 2.65)), (4.95, 3.1)),
    Signal(r"$\bar{\mathbf{x}}$", Problem, "reference", ((2.2, 2.4), (3.2, 2.4)), (2.0, 2.4)),
    Signal(r"$\bar q$", Command, "q_bar", ((5.4, 2.2), (6.7, 2.2)), (6.2, 2.47)),
    Signal(r"$\bar q_{k-1}$", Problem, "previous", TO_ITSELF, (5.3, 1.02)),
    Signal(r"$\tau$", ClosedLoop, "torque", ((8.9, 2.2), (9.9, 2.2)), (9.4, 2.47)),
    Signal(r"$q,\ \dot q$", InnerLoop.torque, "x", ((7.8, 0.5), (7.8, 1.75)), (8.3, 1.1)),
    Signal(r"$q,\ \dot q$", Problem, "state", TO_NMPC, (11.55, 1.1)),
)


def block_diagram() -> Drawing:
    """Blocks and signals of the closed loop under the NMPC."""
    figure, axes = plt.subplots(figsize=(7.0, 3.1))
    axes.set(xlim=(0.0, 12.3), ylim=(0.0, 5.2))
    axes.set_axis_off()
    frame = Rectangle((6.45, 0.75), 5.8, 2.45, fill=False, edgecolor=GREY, linestyle=(0, (4, 2)))
    axes.add_patch(frame)
    axes.text(9.0, 2.97, "continuous time", color="#555555", fontsize=8, **CENTRED)
    for box in BOXES:
        x, z = box.middle
        corner = x - WIDTH / 2, z - HEIGHT / 2
        axes.add_patch(FancyBboxPatch(corner, WIDTH, HEIGHT, boxstyle=ROUND, fc=FACE, ec=INK))
        axes.text(x, z + 0.17, box.words, fontweight="bold", fontsize=8, **CENTRED)
        axes.text(x, z - 0.2, box.kind.__name__, family="monospace", fontsize=7.5, **CENTRED)
    arrow = {"arrowstyle": "-|>", "color": INK, "shrinkA": 0, "shrinkB": 0, "linewidth": 1.0}
    for signal in SIGNALS:
        *_, before, end = signal.path
        if len(signal.path) > 2:
            corners = zip(*signal.path[:-1], strict=True)
            axes.plot(*corners, color=INK, linestyle="-", linewidth=1.0)
        axes.annotate("", xy=end, xytext=before, arrowprops=arrow)
        axes.text(*signal.label, signal.symbol, **CENTRED)
    return Drawing(
        figure,
        "The control loop as the code has it (the paper's block diagram). Each block names the "
        "class that it is. Once per control period the NMPC reads the state, the desired tip, its "
        "own last command and a forecast, which is the flow that the arm will meet, with a noise "
        "on the load. Its command is held; the torque law acts in continuous time.",
        "Block diagram. The sea feeds the arm and, through the preview with its noise, the NMPC. "
        "The NMPC's commanded angles go to feed-forward and PD, whose torque goes to the arm. "
        "The arm's state returns to both, and the NMPC's last command to itself.",
    )
