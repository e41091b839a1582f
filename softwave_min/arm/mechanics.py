r"""Every term of the equation of motion, assembled from its definitions.

The expressions depend on the structure alone (number of segments, quadrature,
reading of the Morison load); every number is an input of the functions, so that
one set of functions serves all parameter sets.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm.dynamics import (
    coriolis_vector,
    gravity_vector,
    inertia_matrix,
    potential_energy,
    rotary_inertia_matrix,
    solve_symmetric,
)
from softwave_min.arm.hydrodynamics import (
    cross_flow_coriolis,
    cross_flow_inertia,
    drag_force,
    drag_matrix,
    flow_at,
    local_frame,
)
from softwave_min.arm.kinematics import BodyPoint, body_point, segment_bases
from softwave_min.parameters import ArmParameters, FluidParameters

__all__ = ["LOAD_TERMS", "Mechanics", "Structure", "Values", "mechanics"]

Floats = NDArray[np.float64]

LOAD_TERMS = ("drag_normal", "drag_tangential", "fluid_inertia")
"""Loads of the water that do not depend on the arm's acceleration."""


@dataclass(frozen=True)
class Structure:
    """What shapes the expressions; all else is a number."""

    segments: int
    quadrature_points: int
    rotary_inertia: bool
    morison: Literal["paper", "textbook"]
    space_order: int = 8
    """Order N of the flow's expansion in Z; its error is bounded in
    ``Sea.taylor_error_bound``."""
    time_order: int = 5
    """Order M of the flow's expansion in t, over half a control period."""

    @property
    def flow_size(self) -> int:
        """Entries of the vector that carries the flow's coefficients."""
        return 2 * (self.space_order + 1) * (self.time_order + 1)

    @cached_property
    def quadrature(self) -> tuple[list[float], list[float]]:
        """Places and weights of the Gauss-Legendre rule on [0, 1]."""
        places, weights = np.polynomial.legendre.leggauss(self.quadrature_points)
        return list((places + 1) / 2), list(weights / 2)


@dataclass(frozen=True)
class Values:
    """Symbols (or numbers) of the parameters, unpacked from one vector."""

    length: ca.SX
    diameter: ca.SX
    density: ca.SX
    stiffness: ca.SX
    damping: ca.SX
    base_position: ca.SX
    base_angle: ca.SX
    fluid_density: ca.SX
    gravity: ca.SX
    inertia_coefficient: ca.SX
    drag_coefficient: ca.SX
    friction_coefficient: ca.SX

    @staticmethod
    def size(segments: int) -> int:
        """Length of the packed vector."""
        return 5 * segments + 8

    @classmethod
    def unpacked(cls, vector: ca.SX, segments: int) -> Values:
        """Take the packed vector apart."""
        sizes = [segments] * 5 + [2] + [1] * 6
        return cls(*ca.vertsplit(vector, list(np.cumsum([0, *sizes]))))

    @staticmethod
    def packed(arm: ArmParameters, fluid: FluidParameters) -> Floats:
        """Vector of the numbers, in the order of the fields."""
        return np.concatenate(
            [
                arm.length,
                arm.diameter,
                arm.density,
                arm.stiffness,
                arm.damping,
                arm.base_position,
                [arm.base_angle, fluid.density, fluid.gravity],
                [fluid.inertia_coefficient, fluid.drag_coefficient, fluid.friction_coefficient],
            ]
        )


@dataclass(frozen=True)
class Mechanics:
    """Every term of the equation of motion at one state, fluid load aside."""

    points: list[list[BodyPoint]]
    """Quadrature points, by segment."""
    tips: list[ca.SX]
    """Position of each segment's tip, in m."""
    tip_jacobian: ca.SX
    """2 x n, of the arm's tip, in m/rad."""
    body_inertia: ca.SX
    """M(q) of the body alone, in kg m^2."""
    added_inertia: ca.SX
    """Generalised added mass, in kg m^2."""
    coriolis: ca.SX
    """C(q, q') q' of the body and the added mass, in N m."""
    gravity: ca.SX
    """G(q) with buoyancy, in N m."""
    gravity_potential: ca.SX
    """Energy whose derivative is G(q), in J."""
    structure: Structure
    values: Values
    qd: ca.SX

    @property
    def inertia(self) -> ca.SX:
        """Inertia of body and added mass together, in kg m^2."""
        return self.body_inertia + self.added_inertia

    def passive_force(self, q: ca.SX) -> ca.SX:
        """Sum of the left side without the inertia: C q' + D q' + K(q) + G(q), in N m."""
        elastic = self.values.damping * self.qd + self.values.stiffness * q
        return self.coriolis + elastic + self.gravity

    def acceleration(self, q: ca.SX, force: ca.SX) -> ca.SX:
        """Angular accelerations under torques and load of the water together, in rad/s^2."""
        return solve_symmetric(self.inertia, force - self.passive_force(q))

    def fluid_load(self, flow: ca.SX, time: ca.SX | float) -> ca.SX:
        """Generalised load of the water, F_E without the added mass: (n,) in N m."""
        terms = self.load_terms(flow, time).values()
        return ca.sum2(sum(terms, start=ca.SX(0)))

    def load_terms(self, flow: ca.SX, time: ca.SX | float) -> dict[str, ca.SX]:
        """The terms of the load by name, each n x n in N m; column i is from segment i.

        ``flow`` carries the coefficients of the flow, ``time`` is counted from the
        time of their expansion.
        """
        velocity, rate = _flow_coefficients(flow, time, self.structure)
        n = self.structure.segments
        loads = {term: ca.SX.zeros(n, n) for term in LOAD_TERMS}
        for segment, point, weight in self._weighted_points():
            frame = local_frame(point.angle)
            offset = point.position - self.values.base_position
            drag = drag_force(
                frame @ (point.jacobian @ self.qd - flow_at(velocity, offset)),
                *self._drag_factors(segment),
            )
            inertia = self._fluid_inertia(segment) * (frame @ flow_at(rate, offset))
            forces = (ca.vertcat(drag[0], 0), ca.vertcat(0, drag[1]), inertia)
            for load, force in zip(loads.values(), forces, strict=True):
                load[:, segment] += weight * (frame @ point.jacobian).T @ force
        return loads

    def drag_slope(self, flow: ca.SX, time: ca.SX | float) -> ca.SX:
        """Derivative of the generalised drag by the rates, sign changed: n x n, N m s/rad."""
        velocity, _ = _flow_coefficients(flow, time, self.structure)
        slope = ca.SX(0)
        for segment, point, weight in self._weighted_points():
            offset = point.position - self.values.base_position
            relative = local_frame(point.angle) @ (
                point.jacobian @ self.qd - flow_at(velocity, offset)
            )
            slope += weight * drag_matrix(point, relative, *self._drag_factors(segment))
        return slope

    def _weighted_points(self) -> list[tuple[int, BodyPoint, float]]:
        _, weights = self.structure.quadrature
        return [
            (segment, point, weight)
            for segment, on_segment in enumerate(self.points)
            for point, weight in zip(on_segment, weights, strict=True)
        ]

    def _drag_factors(self, segment: int) -> tuple[ca.SX, ca.SX]:
        """Half density times area times coefficient, normal and tangential, in kg/m."""
        v = self.values
        frontal = v.diameter[segment] * v.length[segment]
        rubbed = ca.pi * frontal if self.structure.morison == "textbook" else frontal
        pressure = v.fluid_density / 2
        return (
            pressure * frontal * v.drag_coefficient,
            pressure * rubbed * v.friction_coefficient,
        )

    def _fluid_inertia(self, segment: int) -> ca.SX:
        """Mass on the fluid's acceleration, normal and tangential, in kg.

        C_m across the axis; along it the pressure gradient alone, as in buoyancy.
        """
        if self.structure.morison == "paper":
            return ca.SX.zeros(2)
        displaced = displaced_mass(self.values)[segment]
        return displaced * ca.vertcat(self.values.inertia_coefficient, 1)


def displaced_mass(values: Values) -> ca.SX:
    """Mass of the water that each segment displaces, in kg."""
    return values.fluid_density * ca.pi / 4 * values.diameter**2 * values.length


def mechanics(structure: Structure, q: ca.SX, qd: ca.SX, values: Values) -> Mechanics:
    """Build every term of the equation of motion at (q, qd)."""
    bases = segment_bases(q, qd, values.length, values.base_position, values.base_angle)
    places, weights = structure.quadrature
    points = [
        [body_point(bases[i], i, q, values.length[i], s) for s in places]
        for i in range(structure.segments)
    ]
    displaced = displaced_mass(values)
    mass = values.density * ca.pi / 4 * values.diameter**2 * values.length

    def spread(per_segment: ca.SX) -> list[tuple[BodyPoint, ca.SX]]:
        return [
            (point, weight * per_segment[i])
            for i, on_segment in enumerate(points)
            for point, weight in zip(on_segment, weights, strict=True)
        ]

    body = spread(mass)
    body_inertia = inertia_matrix(body)
    if structure.rotary_inertia:
        # rho I L with I = pi d^4 / 64 is the mass times d^2 / 16.
        body_inertia += rotary_inertia_matrix(spread(mass * values.diameter**2 / 16))
    added_inertia, added_coriolis = _added_mass(structure, spread(displaced), qd, values)
    submerged = spread(mass - displaced)
    return Mechanics(
        points=points,
        tips=[base.position for base in bases[1:]],
        tip_jacobian=bases[-1].jacobian,
        body_inertia=body_inertia,
        added_inertia=added_inertia,
        coriolis=coriolis_vector(body) + added_coriolis,
        gravity=gravity_vector(submerged, values.gravity),
        gravity_potential=potential_energy(submerged, values.gravity),
        structure=structure,
        values=values,
        qd=qd,
    )


def _added_mass(
    structure: Structure, displaced: list[tuple[BodyPoint, ca.SX]], qd: ca.SX, values: Values
) -> tuple[ca.SX, ca.SX]:
    """Generalised added mass and the Coriolis vector that belongs to it.

    As printed: C_m = 1 + C_a on the body's acceleration, in all directions alike.
    Textbook: C_a, across the axis alone.
    """
    if structure.morison == "paper":
        added = [(point, values.inertia_coefficient * mass) for point, mass in displaced]
        return inertia_matrix(added), coriolis_vector(added)
    inertia, coriolis = ca.SX(0), ca.SX(0)
    for point, mass in displaced:
        added_mass = (values.inertia_coefficient - 1) * mass
        inertia += added_mass * cross_flow_inertia(point)
        coriolis += added_mass * cross_flow_coriolis(point, qd)
    return inertia, coriolis


def _flow_coefficients(
    flow: ca.SX, time: ca.SX | float, structure: Structure
) -> tuple[tuple[ca.SX, ca.SX], tuple[ca.SX, ca.SX]]:
    """Coefficients in Z of the velocity and of its rate, at ``time`` from the
    expansion's own time.
    """
    rows, columns = structure.space_order + 1, structure.time_order + 1
    parts = [
        ca.reshape(half, columns, rows).T for half in ca.vertsplit(flow, rows * columns)
    ]  # row-major, as NumPy packs them
    velocity, rate = [], []
    for part in parts:
        value, slope = part[:, -1], ca.SX.zeros(rows)
        for m in reversed(range(columns - 1)):
            slope = value + time * slope
            value = part[:, m] + time * value
        velocity.append(value)
        rate.append(slope)
    return (velocity[0], velocity[1]), (rate[0], rate[1])
