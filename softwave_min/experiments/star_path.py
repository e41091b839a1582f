"""A star as the path of the tip: its vertices, and where the target is at a time."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict, Field, Strict, model_validator
from pydantic.dataclasses import dataclass

from softwave_min.parameters import Angle, Count, Positive, Real, Seed

Floats = NDArray[np.float64]
Drawing = Literal["outline", "one_stroke"]
Manner = Literal["edges", "vertices"]

ROUNDING = 1e-9
"""Part of an edge by which an instant may miss a vertex through rounding."""


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class StarParameters:
    """A star and how it is followed."""

    points: Annotated[int, Strict(), Field(ge=3)]
    """Number of outer vertices, p."""
    centre: tuple[Real, Real]
    """(x, z), in m."""
    outer_radius: Positive
    """Distance of the outer vertices from the centre, in m."""
    inner_ratio: Annotated[float, Strict(), Field(gt=0, lt=1)]
    """Distance of the inner vertices of an outline, as a part of the outer one."""
    orientation: Angle
    """Direction from the centre to outer vertex 0, counter-clockwise from +x, in rad."""
    start_vertex: Seed
    """Vertex at which a lap starts, counted along the path."""
    drawing: Drawing
    """'outline': outer and inner vertices in turn. 'one_stroke': straight from each outer
    vertex to one on the far side, as a pentagram is drawn."""
    manner: Manner
    """'edges': with constant speed along the edges. 'vertices': from vertex to vertex at
    once, and an equal time at each."""
    laps: Count
    """Times round; then the path stays where it began."""
    lap_duration: Positive
    """Time of one lap, in s."""

    @model_validator(mode="after")
    def _is_a_star(self) -> Self:
        if self.drawing == "one_stroke" and (self.points % 2 == 0 or self.points < 5):
            raise ValueError("an odd number of points, 5 or more, to be drawn in one stroke")
        if self.start_vertex >= self.vertices:
            raise ValueError(f"start_vertex below the number of vertices, {self.vertices}")
        return self

    @property
    def vertices(self) -> int:
        """Number of vertices of a lap, V."""
        return self.points if self.drawing == "one_stroke" else 2 * self.points

    @property
    def edge(self) -> float:
        """Length of every edge, in m."""
        first, second = star_vertices(self)[:2]
        return float(np.hypot(*(second - first)))

    @property
    def speed(self) -> float:
        """Speed along the edges, in m/s."""
        return self.vertices * self.edge / self.lap_duration


def star_vertices(star: StarParameters) -> Floats:
    """Vertices of one lap in their order, from the start vertex, (V, 2) in m."""
    index = np.arange(star.vertices) + star.start_vertex
    if star.drawing == "one_stroke":
        # each stroke passes over all points but the farthest
        step, radius = 2 * math.pi * (star.points // 2) / star.points, np.ones(star.vertices)
    else:
        step, radius = math.pi / star.points, np.where(index % 2, star.inner_ratio, 1.0)
    angle = star.orientation + step * index
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices: Floats = np.array(star.centre) + star.outer_radius * radius[:, None] * direction
    return vertices


def star_path(star: StarParameters, times: ArrayLike) -> Floats:
    r"""Desired tip at ``times``, in m.

    With V vertices :math:`v_j`, all edges of one length, and the lap time T,

    .. math:: u = V \min(t / T, \text{laps}), \quad j = \lfloor u \rfloor, \quad
       x_r = v_j + (u - j)(v_{j+1} - v_j),

    so that the speed is constant; by jumps, :math:`x_r = v_j`.

    Parameters
    ----------
    star : StarParameters
    times : array_like, (T,)
        In s, from the start of the first lap.

    Returns
    -------
    ndarray, (T, 2)
    """
    corners = star_vertices(star)
    progress = np.clip(np.asarray(times, float) / star.lap_duration, 0.0, star.laps)
    passed = star.vertices * progress
    index = np.floor(passed + ROUNDING).astype(int)
    here, there = corners[index % star.vertices], corners[(index + 1) % star.vertices]
    gone = passed - index if star.manner == "edges" else np.zeros_like(passed)
    path: Floats = here + gone[:, None] * (there - here)
    return path


def distance_to_star(star: StarParameters, points: Floats) -> Floats:
    """Distance of each point to the nearest place on the star's edges, (T,) in m."""
    start = star_vertices(star)
    edge = np.roll(start, -1, axis=0) - start
    offset = points[:, None, :] - start
    along = np.clip((offset * edge).sum(axis=2) / (edge**2).sum(axis=1), 0.0, 1.0)
    nearest = offset - along[:, :, None] * edge
    distance: Floats = np.hypot(nearest[..., 0], nearest[..., 1]).min(axis=1)
    return distance
