r"""Every term of the equation of motion, assembled from its definitions.

The expressions depend on the structure alone (number of segments, quadrature,
reading of the Morison load); every number is an input of the functions, so that
one set of functions serves all parameter sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm.dynamics import (
    coriolis_vector,
    inertia_matrix,
    rotary_inertia_matrix,
    solve_symmetric,
)
from softwave_min.arm.hydrodynamics import (
    cross_flow_convection,
    cross_flow_force,
    drag_bends,
    drag_force,
    drag_slopes,
    flow_at,
    in_plane,
    local_frame,
)
from softwave_min.arm.kinematics import BodyPoint, body_point, quarter_turn, segment_bases
from softwave_min.parameters import ArmParameters, FluidParameters

Floats = NDArray[np.float64]
Rule = Sequence[tuple[ca.SX | float, ca.SX | float]]
"""Places and weights of a quadrature on [0, 1]."""

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
    def rule(self) -> list[tuple[float, float]]:
        """Places and weights of the Gauss-Legendre rule on [0, 1]."""
        pairs = zip(*np.polynomial.legendre.leggauss(self.quadrature_points), strict=True)
        return [(float(s + 1) / 2, float(weight) / 2) for s, weight in pairs]


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
class Section:
    """Forces on the cross-sections of one segment, all per whole segment, in N.

    This is where the readings of the Morison load differ, and nowhere else.
    """

    morison: Literal["paper", "textbook"]
    mass: ca.SX
    """Mass of the segment, in kg."""
    displaced: ca.SX
    """Mass of the water that it displaces, in kg."""
    drag_factors: tuple[ca.SX, ca.SX]
    """Half density times area times coefficient, normal and tangential, in kg/m."""
    inertia_coefficient: ca.SX
    """C_m = 1 + C_a."""
    gravity: ca.SX

    @classmethod
    def of(cls, structure: Structure, values: Values, segment: int) -> Section:
        """Section of one segment."""
        diameter, length = values.diameter[segment], values.length[segment]
        volume = ca.pi / 4 * diameter**2 * length
        frontal = diameter * length
        rubbed = ca.pi * frontal if structure.morison == "textbook" else frontal
        pressure = values.fluid_density / 2
        return cls(
            structure.morison,
            mass=values.density[segment] * volume,
            displaced=values.fluid_density * volume,
            drag_factors=(
                pressure * frontal * values.drag_coefficient,
                pressure * rubbed * values.friction_coefficient,
            ),
            inertia_coefficient=values.inertia_coefficient,
            gravity=values.gravity,
        )

    @property
    def weight(self) -> ca.SX:
        """Weight less buoyancy, upwards positive."""
        return ca.vertcat(0, -(self.mass - self.displaced) * self.gravity)

    def added_force(self, angle: ca.SX, acceleration: ca.SX) -> ca.SX:
        """Force on the water that moves along.

        As printed: C_m = 1 + C_a on the body's acceleration, in all directions alike.
        Textbook: C_a, across the axis alone.
        """
        if self.morison == "paper":
            return self.inertia_coefficient * self.displaced * acceleration
        return self._added_mass * cross_flow_force(angle, acceleration)

    def added_convection(self, angle: ca.SX, spin: ca.SX, velocity: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Force and moment of that water beside its acceleration."""
        if self.morison == "paper":
            return ca.SX.zeros(2), ca.SX(0)
        force, moment = cross_flow_convection(angle, spin, velocity)
        return self._added_mass * force, self._added_mass * moment

    def loads(
        self, angle: ca.SX, velocity: ca.SX, flow: ca.SX, flow_rate: ca.SX
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Loads of the moving water, in the order of ``LOAD_TERMS``."""
        frame = local_frame(angle)
        drag = drag_force(frame @ (velocity - flow), *self.drag_factors)
        return (
            frame.T @ ca.vertcat(drag[0], 0),
            frame.T @ ca.vertcat(0, drag[1]),
            self.inertia_load(angle, flow_rate),
        )

    def inertia_load(self, angle: ca.SX, flow_rate: ca.SX) -> ca.SX:
        """Load of the accelerated water."""
        frame = local_frame(angle)
        return frame.T @ (self._fluid_inertia * (frame @ flow_rate))

    def drag_slope(self, angle: ca.SX, relative: ca.SX) -> ca.SX:
        """Fall of the drag with the velocity, linearised, 2 x 2."""
        slopes = drag_slopes(local_frame(angle) @ relative, *self.drag_factors)
        return in_plane(angle, slopes)

    def implicit_drag(
        self, angle: ca.SX, relative: ca.SX, change: ca.SX
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The force ``drag_slope`` @ ``change`` less the drag, and its derivatives by the angle
        and by the relative velocity: 2, 2 and 2 x 2.
        """
        frame = local_frame(angle)
        velocity, step = frame @ relative, frame @ change
        slopes = drag_slopes(velocity, *self.drag_factors)
        bends = drag_bends(velocity, step, *self.drag_factors)
        force = slopes * step - drag_force(velocity, *self.drag_factors)
        # The frame's derivative by its angle is a quarter turn of its components.
        by_angle = bends * quarter_turn(velocity) + slopes * quarter_turn(step)
        by_angle -= quarter_turn(force)
        return frame.T @ force, frame.T @ by_angle, in_plane(angle, bends)

    @property
    def _added_mass(self) -> ca.SX:
        return (self.inertia_coefficient - 1) * self.displaced

    @property
    def _fluid_inertia(self) -> ca.SX:
        """Mass on the fluid's acceleration, normal and tangential, in kg.

        C_m across the axis; along it the pressure gradient alone, as in buoyancy.
        """
        if self.morison == "paper":
            return ca.SX.zeros(2)
        return self.displaced * ca.vertcat(self.inertia_coefficient, 1)


@dataclass(frozen=True)
class Mechanics:
    """The arm at one state (q, qd): its points, and every term of the equation of motion."""

    structure: Structure
    values: Values
    q: ca.SX
    qd: ca.SX
    bases: list[BodyPoint]
    """Base of every segment and, last, the arm's tip."""
    points: list[tuple[Section, BodyPoint, ca.SX | float, int]]
    """Quadrature points: section, motion, weight, and index of the segment."""

    @property
    def tips(self) -> list[ca.SX]:
        """Position of each segment's tip, in m."""
        return [base.position for base in self.bases[1:]]

    @property
    def tip_jacobian(self) -> ca.SX:
        """2 x n, of the arm's tip, in m/rad."""
        return self.bases[-1].jacobian

    @property
    def body_inertia(self) -> ca.SX:
        """M(q) of the body alone, in kg m^2."""
        inertia = inertia_matrix(self._masses())
        return inertia + self.rotary_inertia if self.structure.rotary_inertia else inertia

    @property
    def rotary_inertia(self) -> ca.SX:
        """Share of M(q) of the cross-sections' own rotation, in kg m^2.

        A section has rho I L with I = pi d^4 / 64, its mass times d^2 / 16.
        """
        return rotary_inertia_matrix(
            (point, weight * section.mass * self.values.diameter[segment] ** 2 / 16)
            for section, point, weight, segment in self.points
        )

    @property
    def added_inertia(self) -> ca.SX:
        """Generalised added mass, in kg m^2."""
        return self._sum(
            lambda section, point: (
                point.jacobian.T
                @ ca.horzcat(
                    *(
                        section.added_force(point.angle, column)
                        for column in ca.horzsplit(point.jacobian)
                    )
                )
            )
        )

    @property
    def inertia(self) -> ca.SX:
        """Inertia of body and added mass together, in kg m^2."""
        return self.body_inertia + self.added_inertia

    @property
    def coriolis(self) -> ca.SX:
        """C(q, q') q' of the body and the added mass, in N m."""

        def added(section: Section, point: BodyPoint) -> ca.SX:
            convected = section.added_force(point.angle, point.convective_acceleration)
            force, moment = section.added_convection(
                point.angle, point.angular_velocity, point.velocity
            )
            return point.jacobian.T @ (convected + force) + point.angle_jacobian * moment

        return coriolis_vector(self._masses()) + self._sum(added)

    @property
    def gravity(self) -> ca.SX:
        """G(q) with buoyancy, in N m; it stands on the left of the equation."""
        return -self._sum(lambda section, point: point.jacobian.T @ section.weight)

    @property
    def gravity_gradient(self) -> ca.SX:
        """Derivative of G(q) by q, n x n, in N m/rad."""
        return -self._sum(lambda section, point: point.hessian_along(section.weight))

    @property
    def gravity_potential(self) -> ca.SX:
        """Energy whose derivative is G(q), in J."""
        return -self._sum(lambda section, point: ca.dot(section.weight, point.position))

    def passive_force(self) -> ca.SX:
        """Sum of the left side without the inertia: C q' + D q' + K(q) + G(q), in N m."""
        elastic = self.values.damping * self.qd + self.values.stiffness * self.q
        return self.coriolis + elastic + self.gravity

    def acceleration(self, force: ca.SX, locked: ca.SX | None = None) -> ca.SX:
        """Angular accelerations under torques and load of the water together, in rad/s^2.

        ``locked`` is 1 for each angle that cannot change, else 0; all are free if None.
        """
        if locked is None:
            return solve_symmetric(self.inertia, force - self.passive_force())
        free = ca.diag(1 - locked)
        inertia = free @ self.inertia @ free + ca.diag(locked)
        return solve_symmetric(inertia, free @ (force - self.passive_force()))

    def offset(self, point: BodyPoint) -> ca.SX:
        """Position from the base, about which the flow is expanded, in m."""
        return point.position - self.values.base_position

    def fluid_load(self, flow: ca.SX, time: ca.SX | float) -> ca.SX:
        """Generalised load of the water, F_E without the added mass: (n,) in N m."""
        terms = self.load_terms(flow, time).values()
        return ca.sum2(sum(terms, start=ca.SX(0)))

    def load_terms(self, flow: ca.SX, time: ca.SX | float) -> dict[str, ca.SX]:
        """The terms of the load by name, each n x n in N m; column i is from segment i.

        ``flow`` carries the coefficients of the flow, ``time`` is counted from the
        time of their expansion.
        """
        velocity, rate = flow_coefficients(flow, time, self.structure)
        n = self.structure.segments
        terms = {term: ca.SX.zeros(n, n) for term in LOAD_TERMS}
        for section, point, weight, segment in self.points:
            offset = self.offset(point)
            loads = section.loads(
                point.angle, point.velocity, flow_at(velocity, offset), flow_at(rate, offset)
            )
            for term, load in zip(terms.values(), loads, strict=True):
                term[:, segment] += weight * point.jacobian.T @ load
        return terms

    def _masses(self) -> list[tuple[BodyPoint, ca.SX]]:
        return [(point, weight * section.mass) for section, point, weight, _ in self.points]

    def _sum(self, term: Callable[[Section, BodyPoint], ca.SX]) -> ca.SX:
        terms = [weight * term(section, point) for section, point, weight, _ in self.points]
        return sum(terms, start=ca.SX(0))


def mechanics(
    structure: Structure, q: ca.SX, qd: ca.SX, values: Values, rule: Rule | None = None
) -> Mechanics:
    """The arm at (q, qd), its integrals by a rule other than the structure's if one is given."""
    bases = segment_bases(q, qd, values.length, values.base_position, values.base_angle)
    sections = [Section.of(structure, values, segment) for segment in range(structure.segments)]
    points = [
        (sections[i], body_point(bases[i], i, q, values.length[i], s), weight, i)
        for i in range(structure.segments)
        for s, weight in (structure.rule if rule is None else rule)
    ]
    return Mechanics(structure, values, q, qd, bases, points)


def flow_coefficients(
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
