r"""Rigid-body side of the equation of motion, as CasADi expressions.

.. math:: M(q)\ddot q + C(q,\dot q)\dot q + D\dot q + K(q) + G(q) = \tau + F_E

(paper, eq. 3). Mass is spread along the axis; integrals over a segment are
Gauss-Legendre sums, so that the sums are themselves an exact Lagrangian system
of point masses and keep its invariants.
"""

from __future__ import annotations

from collections.abc import Iterable

import casadi as ca

from softwave_min.arm.kinematics import BodyPoint

MassPoint = tuple[BodyPoint, ca.SX]


def inertia_matrix(points: Iterable[MassPoint]) -> ca.SX:
    r"""Inertia matrix :math:`\sum_p m_p J_p^T J_p`, in kg m^2."""
    return _total(mass * point.jacobian.T @ point.jacobian for point, mass in points)


def coriolis_vector(points: Iterable[MassPoint]) -> ca.SX:
    r"""Coriolis and centrifugal vector, in N m: :math:`\sum_p m_p J_p^T \dot J_p \dot q`."""
    return _total(mass * point.jacobian.T @ point.convective_acceleration for point, mass in points)


def rotary_inertia_matrix(points: Iterable[MassPoint]) -> ca.SX:
    r"""Inertia of the cross-sections' own rotation, in kg m^2; constant in q.

    ``points`` carry the section's polar share :math:`\rho I L w`, in kg m^2, with
    :math:`I = \pi d^4/64`.
    """
    return _total(
        section * point.angle_jacobian @ point.angle_jacobian.T for point, section in points
    )


def solve_symmetric(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solve ``matrix x = right`` for a symmetric positive definite matrix, by L D L^T.

    Written out as expressions: n is small, and a call to a linear solver could
    not be differentiated and compiled with the rest.
    """
    n = matrix.shape[0]
    lower = ca.SX.eye(n)
    pivots: list[ca.SX] = []
    for j in range(n):
        pivots.append(matrix[j, j] - sum(lower[j, k] ** 2 * pivots[k] for k in range(j)))
        for i in range(j + 1, n):
            done = sum(lower[i, k] * lower[j, k] * pivots[k] for k in range(j))
            lower[i, j] = (matrix[i, j] - done) / pivots[j]
    x = ca.SX(right)
    for i in range(n):
        for k in range(i):
            x[i, :] -= lower[i, k] * x[k, :]
    for i in range(n):
        x[i, :] /= pivots[i]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            x[i, :] -= lower[k, i] * x[k, :]
    return x


def _total(terms: Iterable[ca.SX]) -> ca.SX:
    return sum(terms, start=ca.SX(0))
