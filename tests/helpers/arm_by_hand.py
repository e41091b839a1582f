r"""The arm a second time, in NumPy and from its definitions alone.

The tangent's angle is the integral of the curvature, a point of the axis the integral of
the tangent; velocity and acceleration are the same integrals differentiated in time. A
generalised load is the work of the forces along the axis on a virtual motion. Points,
velocities and forces of the plane are complex, x + i z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from softwave_min.parameters import ArmParameters, FluidParameters

_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
PLACES, WEIGHTS = (_PLACES + 1) / 2, _WEIGHTS / 2

Flow = Callable[[complex], tuple[complex, complex]]
"""Velocity and local acceleration of the water at a point."""


@dataclass(frozen=True)
class Motion:
    """What one point of the axis does."""

    position: complex
    by_angle: np.ndarray
    """Velocity for a unit rate of each bending angle, (n,)."""
    velocity: complex
    acceleration: complex
    """At constant rates."""
    angle: float
    spin: float


def motion(arm: ArmParameters, q: np.ndarray, qd: np.ndarray, segment: int, s: float) -> Motion:
    """Motion of the point at ``s`` on a segment."""
    position, acceleration = complex(*arm.base_position), 0j
    by_angle = np.zeros(arm.segments, dtype=complex)
    for i in range(segment + 1):
        end = s if i == segment else 1.0
        share = end * PLACES
        angle = arm.base_angle + np.sum(q[:i]) + share * q[i]
        spin = np.sum(qd[:i]) + share * qd[i]
        piece = arm.length[i] * end * WEIGHTS * np.exp(1j * angle)
        position += np.sum(piece)
        by_angle[:i] += 1j * np.sum(piece)
        by_angle[i] += 1j * share @ piece
        acceleration += -(spin**2) @ piece
    angle = arm.base_angle + np.sum(q[:segment]) + s * q[segment]
    spin = np.sum(qd[:segment]) + s * qd[segment]
    return Motion(position, by_angle, by_angle @ qd, acceleration, angle, spin)


def dot(a: complex, b: complex) -> float:
    """Scalar product of two vectors of the plane."""
    return (a.conjugate() * b).real


def along_the_axis(arm: ArmParameters, integrand: Callable[[int, float], float]) -> float:
    """Sum over segments of the integral over s in [0, 1]."""
    return sum(
        weight * integrand(i, s)
        for i in range(arm.segments)
        for s, weight in zip(PLACES, WEIGHTS, strict=True)
    )


def body_mass(arm: ArmParameters) -> np.ndarray:
    """Mass of each segment, in kg."""
    return np.array(arm.density) * np.pi * np.array(arm.diameter) ** 2 / 4 * arm.length


def displaced_mass(arm: ArmParameters, fluid: FluidParameters) -> np.ndarray:
    """Mass of the water that each segment displaces, in kg."""
    return fluid.density * np.pi * np.array(arm.diameter) ** 2 / 4 * arm.length


def kinetic_energy(
    arm: ArmParameters, fluid: FluidParameters, q: np.ndarray, qd: np.ndarray
) -> tuple[float, float]:
    """Energy of the body and of its added mass, in J."""
    mass, displaced = body_mass(arm), displaced_mass(arm, fluid)

    def body(i: int, s: float) -> float:
        here = motion(arm, q, qd, i, s)
        energy = mass[i] * abs(here.velocity) ** 2 / 2
        if arm.rotary_inertia:
            second_moment = np.pi * arm.diameter[i] ** 4 / 64
            energy += arm.density[i] * second_moment * arm.length[i] * here.spin**2 / 2
        return energy

    def added(i: int, s: float) -> float:
        here = motion(arm, q, qd, i, s)
        if fluid.morison == "paper":
            return fluid.inertia_coefficient * displaced[i] * abs(here.velocity) ** 2 / 2
        across = dot(1j * np.exp(1j * here.angle), here.velocity)
        return (fluid.inertia_coefficient - 1) * displaced[i] * across**2 / 2

    return along_the_axis(arm, body), along_the_axis(arm, added)


def weight_less_buoyancy(arm: ArmParameters, fluid: FluidParameters, q: np.ndarray) -> float:
    """Potential energy, zero on the mean surface, in J."""
    net = (body_mass(arm) - displaced_mass(arm, fluid)) * fluid.gravity
    rest = np.zeros_like(q)
    return along_the_axis(arm, lambda i, s: net[i] * motion(arm, q, rest, i, s).position.imag)


def morison_forces(
    arm: ArmParameters, fluid: FluidParameters, here: Motion, segment: int, flow: Flow
) -> dict[str, complex]:
    """Forces on a point of a segment by name, in N per whole segment.

    Drag: the paper's eqs. for F_D and D. Fluid inertia: Morison's C_m rho V du/dt across
    the axis, the undisturbed pressure gradient rho V du/dt along it.
    """
    tangent = np.exp(1j * here.angle)
    normal = 1j * tangent
    velocity, acceleration = flow(here.position)
    relative = here.velocity - velocity
    across, along = dot(normal, relative), dot(tangent, relative)
    diameter, length = arm.diameter[segment], arm.length[segment]
    frontal = diameter * length
    rubbed = frontal if fluid.morison == "paper" else np.pi * frontal
    inertia = 0j
    if fluid.morison == "textbook":
        displaced = displaced_mass(arm, fluid)[segment]
        inertia += fluid.inertia_coefficient * displaced * dot(normal, acceleration) * normal
        inertia += displaced * dot(tangent, acceleration) * tangent
    drag = frontal * fluid.drag_coefficient * abs(across) * across
    friction = rubbed * fluid.friction_coefficient * abs(along) * along
    return {
        "drag_normal": -fluid.density / 2 * drag * normal,
        "drag_tangential": -fluid.density / 2 * friction * tangent,
        "fluid_inertia": inertia,
    }


def generalised_loads(
    arm: ArmParameters, fluid: FluidParameters, q: np.ndarray, qd: np.ndarray, flow: Flow
) -> dict[str, np.ndarray]:
    """Work of each load per unit of each bending angle, (n, n) in N m: [angle, segment].

    With the arm's own quadrature: across the points where the flow along or across the
    arm changes sign the integrand has a kink, and no two rules agree closely.
    """
    places, weights = np.polynomial.legendre.leggauss(arm.quadrature_points)
    n = arm.segments
    loads = {name: np.zeros((n, n)) for name in ("drag_normal", "drag_tangential", "fluid_inertia")}
    for i in range(n):
        for s, weight in zip((places + 1) / 2, weights / 2, strict=True):
            here = motion(arm, q, qd, i, s)
            for name, force in morison_forces(arm, fluid, here, i, flow).items():
                loads[name][:, i] += weight * (np.conj(force) * here.by_angle).real
    return loads


def power(
    arm: ArmParameters, fluid: FluidParameters, q: np.ndarray, qd: np.ndarray, flow: Flow
) -> float:
    """Integral along the arm of the force times the velocity, in W."""

    def density(i: int, s: float) -> float:
        here = motion(arm, q, qd, i, s)
        return dot(sum(morison_forces(arm, fluid, here, i, flow).values()), here.velocity)

    return along_the_axis(arm, density)
