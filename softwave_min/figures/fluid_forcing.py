"""The paper's schematic Fig. fluid_forcing, drawn from the model: the load along a real posture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch
from numpy.typing import ArrayLike, NDArray

from softwave_min.arm import Arm, Section, Values
from softwave_min.arm.hydrodynamics import local_frame
from softwave_min.figures.style import BLUE, GREY, INK, ORANGE, SKY, Drawing
from softwave_min.waves import Sea

Floats = NDArray[np.float64]

BODY = ("#d9d9d9", "#bdbdbd", "#d9d9d9")
FRICTION_SCALE = 10
"""Tangential drag is so small that its arrows are enlarged by this factor."""
LONGEST_FORCE = 0.2
"""Length on paper of the largest normal force, in m."""
LONGEST_VELOCITY = 0.1
"""Length on paper of the largest velocity in the close-up, in m."""
FINE = 25


@dataclass(frozen=True)
class PointLoad:
    """Motion of the arm and of the water at one point of the axis, and the drag there."""

    position: Floats
    """(x, z), in m."""
    frame: Floats
    """R(s, q); its rows are the normal and the tangent."""
    velocity: Floats
    """v of the body, (x, z) in m/s."""
    flow: Floats
    """v_f of the water, (x, z) in m/s."""
    normal: Floats
    """Drag across the axis per length, (x, z) in N/m."""
    tangential: Floats
    """Drag along the axis per length, (x, z) in N/m."""

    @property
    def relative(self) -> Floats:
        """Velocity of the body less that of the water, (x, z) in m/s."""
        return self.velocity - self.flow


def point_load(
    arm: Arm, sea: Sea, state: tuple[ArrayLike, ArrayLike], time: float, place: tuple[int, float]
) -> PointLoad:
    """Evaluate the model at one point.

    Parameters
    ----------
    state : pair of array_like, (n,)
        q and qd, in rad and rad/s.
    time : float
        In s.
    place : tuple of int and float
        Segment, from 0, and s in [0, 1].
    """
    q, qd = (np.asarray(part, dtype=float) for part in state)
    segment, s = place
    angle = arm.parameters.base_angle + float(np.sum(q[:segment])) + s * q[segment]
    position = arm.forward_kinematics(q, segment, s)
    velocity = arm.jacobian(q, segment, s) @ qd
    flow = np.array(sea.velocity(position[0], position[1], time))
    values = Values.unpacked(ca.SX(arm.values), arm.segments)
    section = Section.of(arm.structure, values, segment)
    drag = section.loads(ca.SX(angle), ca.SX(velocity), ca.SX(flow), ca.SX.zeros(2))[:2]
    length = arm.parameters.length[segment]
    return PointLoad(
        position,
        np.array(ca.evalf(local_frame(ca.SX(angle)))),
        velocity,
        flow,
        *(np.array(ca.evalf(one)).ravel() / length for one in drag),
    )


def fluid_forcing(
    arm: Arm,
    sea: Sea,
    state: tuple[ArrayLike, ArrayLike],
    time: float,
    close_up: tuple[int, int] = (1, 2),
) -> Drawing:
    """Draw the arm at one instant, in s, with the drag on it.

    Parameters
    ----------
    state : pair of array_like, (n,)
        q and qd, in rad and rad/s.
    close_up : tuple of int
        Segment and quadrature point, each from 0, that the second panel shows.
    """

    def loads(places: Iterable[float]) -> list[list[PointLoad]]:
        return [
            [point_load(arm, sea, state, time, (segment, s)) for s in places]
            for segment in range(arm.segments)
        ]

    points, fine = loads([s for s, _ in arm.structure.rule]), loads(np.linspace(0, 1, FINE))
    largest = max(float(np.linalg.norm(one.normal)) for on in fine for one in on)
    figure, (whole, near) = plt.subplots(1, 2, figsize=(8.4, 4.3), width_ratios=(1.1, 1))
    _water(whole, sea, time, fine)
    _body(whole, arm, fine)
    _drag(whole, points, fine, LONGEST_FORCE / largest)
    x, z = arm.parameters.base_position
    whole.plot(x, z, marker="s", color=INK, markersize=9, zorder=6)
    whole.set(title="(a) drag on every segment", aspect="equal", xlabel="x (m)", ylabel="z (m)")
    chosen = points[close_up[0]][close_up[1]]
    whole.plot(*chosen.position, "o", color="none", markeredgecolor=INK, markersize=17, zorder=7)
    _body(near, arm, fine)
    _velocities(near, chosen)
    return Drawing(
        figure,
        caption=(
            "The load of the moving water on the moving arm, at one instant. (a) Body, flow "
            "(grey arrows), and drag across the axis per length (orange; the largest is "
            f"{largest:.0f} N/m), as it runs along each segment and at the {len(points[0])} "
            "quadrature points of each; drag along the axis (blue) is drawn "
            f"{FRICTION_SCALE} times larger. (b) The circled point: the velocity $v$ of the "
            "body, that of the water $v_f$, the relative velocity $v_r = v - v_f$ and its "
            "parts in the local frame $(n, t)$. Drag is opposed to each part."
        ),
        alt=(
            "Left: a bent arm of three segments in a flow. Orange arrows stand at right angles "
            "to it and form a curved profile that grows towards the tip; small blue arrows lie "
            "along it. Right: a close-up of one point, with a triangle of the velocities of "
            "body, water and their difference, the local normal and tangent, and the difference "
            "taken apart along these two."
        ),
    )


def _water(axes: Axes, sea: Sea, time: float, fine: Sequence[Sequence[PointLoad]]) -> None:
    corners = np.array([one.position for on in fine for one in on])
    low, high = corners.min(axis=0) - 0.22, corners.max(axis=0) + 0.22
    x, z = np.meshgrid(np.arange(low[0], high[0], 0.13), np.arange(low[1], high[1], 0.13))
    look: Any = {"color": GREY, "alpha": 0.55, "width": 0.004, "zorder": 0}
    flow = sea.velocity(x, z, time)
    axes.quiver(x, z, *flow, angles="xy", scale_units="xy", scale=12, **look)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.grid(visible=False)


def _body(axes: Axes, arm: Arm, fine: Sequence[Sequence[PointLoad]]) -> None:
    for segment, on in enumerate(fine):
        half = arm.parameters.diameter[segment] / 2
        side = np.array([half * one.frame[0] for one in on])
        middle = np.array([one.position for one in on])
        outline = np.concatenate([middle + side, (middle - side)[::-1]])
        face = BODY[segment % len(BODY)]
        axes.fill(*outline.T, fc=face, edgecolor=INK, linewidth=0.7, linestyle="-", zorder=1)
        axes.plot(*middle.T, color=INK, linestyle="-.", linewidth=0.6, zorder=2)


def _drag(
    axes: Axes,
    points: Sequence[Sequence[PointLoad]],
    fine: Sequence[Sequence[PointLoad]],
    scale: float,
) -> None:
    """Profiles of the drag along each segment, and arrows at its quadrature points."""
    for on_points, on_fine in zip(points, fine, strict=True):
        middle = np.array([one.position for one in on_fine])
        ends = middle + scale * np.array([one.normal for one in on_fine])
        profile = np.concatenate([middle, ends[::-1]])
        axes.fill(*profile.T, color=ORANGE, alpha=0.18, linewidth=0, zorder=2)
        axes.plot(*ends.T, color=ORANGE, linestyle="-", linewidth=0.9, zorder=3)
        for one in on_points:
            _arrow(axes, one.position, scale * one.normal, ORANGE)
            _arrow(axes, one.position, FRICTION_SCALE * scale * one.tangential, BLUE)
            axes.plot(*one.position, "o", color=INK, markersize=3.2, zorder=6)


def _velocities(axes: Axes, point: PointLoad) -> None:
    """The velocities at a point, and the local frame's parts of the relative one."""
    normal, tangent = point.frame
    origin = point.position
    speeds = [np.linalg.norm(one) for one in (point.velocity, point.flow, point.relative)]
    scale = LONGEST_VELOCITY / float(max(speeds))
    body, flow, relative = (scale * one for one in (point.velocity, point.flow, point.relative))
    across, along = normal * (normal @ relative), tangent * (tangent @ relative)
    for direction, name in ((normal, "$n$"), (tangent, "$t$")):
        _arrow(axes, origin, 0.115 * direction, INK, linewidth=0.9)
        _label(axes, origin + 0.125 * direction, name, INK)
    dashed: dict[str, Any] = {"linewidth": 1.0, "linestyle": "--"}
    for start, vector, share, side, name, colour, look in (
        (origin, body, 0.6, -1, "$v$", SKY, {}),
        (origin, flow, 0.6, -1, "$v_f$", GREY, {}),
        (origin + flow, relative, 0.3, -1, "$v_r$", INK, dashed),
        (origin, -across, 0.6, -1, "$-v_n$", ORANGE, {}),
        (origin, -along, 0.8, 1, "$-v_t$", BLUE, {}),
    ):
        _arrow(axes, start, vector, colour, **look)
        aside = np.array([-vector[1], vector[0]]) / float(np.linalg.norm(vector))
        _label(axes, start + share * vector + 0.014 * side * aside, name, colour)
    for part, colour in ((across, ORANGE), (along, BLUE)):
        corner = np.array([origin - part, origin - relative])
        axes.plot(*corner.T, color=colour, linestyle=":", linewidth=1.0)
    axes.plot(*origin, "o", color=INK, markersize=5, zorder=6)
    x, z, reach = *origin, 0.15
    axes.set(xlim=(x - reach, x + reach), ylim=(z - reach, z + reach), xlabel="x (m)")
    axes.set(title="(b) one quadrature point", aspect="equal")
    axes.grid(visible=False)


def _arrow(axes: Axes, start: Floats, vector: Floats, colour: str, **look: Any) -> None:
    look = {"linewidth": 1.6, "mutation_scale": 9, "shrinkA": 0, "shrinkB": 0, "zorder": 5, **look}
    ends = tuple(start), tuple(start + vector)
    axes.add_patch(FancyArrowPatch(*ends, arrowstyle="-|>", color=colour, **look))


def _label(axes: Axes, place: Floats, text: str, colour: str) -> None:
    axes.text(place[0], place[1], text, color=colour, ha="center", va="center", zorder=8)
