r"""Piecewise-constant-curvature kinematics, as CasADi expressions.

Segment :math:`i` of length :math:`L_i` bends by :math:`q_i` at constant curvature.
With its base at :math:`p_i` and its base tangent at the angle :math:`\theta_i`,
points of the plane written as complex numbers :math:`x + \mathrm i z`, the point at
:math:`s \in [0, 1]` is

.. math:: p_i + L_i s\, e^{\mathrm i \theta_i} \varphi_0(s q_i), \qquad
   \varphi_m(a) = \int_0^1 \sigma^m e^{\mathrm i a \sigma}\, \mathrm d\sigma ,

and :math:`\varphi_m' = \mathrm i \varphi_{m+1}`, so that the same functions give all
derivatives. They are smooth at zero curvature (Webster & Jones 2010 give the map
in its singular form).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

__all__ = ["BodyPoint", "SegmentBase", "body_point", "curvature_moments", "segment_bases"]

SERIES_TERMS = 9
SERIES_LIMIT = 1.0


@dataclass(frozen=True)
class SegmentBase:
    """Motion of a segment's base, caused by the segments before it."""

    position: ca.SX
    """(x, z), in m."""
    angle: ca.SX
    """Direction of the tangent, in rad."""
    jacobian: ca.SX
    """2 x n, derivative of the position by q, in m/rad."""
    angular_velocity: ca.SX
    """Rate of the tangent's direction, in rad/s."""
    convective_acceleration: ca.SX
    """Acceleration of the position at zero q'', that is J' q', in m/s^2."""


@dataclass(frozen=True)
class BodyPoint:
    """Motion of one point of the arm's axis."""

    position: ca.SX
    """(x, z), in m."""
    angle: ca.SX
    """Direction of the tangent, in rad."""
    jacobian: ca.SX
    """2 x n, J(s, q), in m/rad."""
    convective_acceleration: ca.SX
    """J'(s, q, q') q', in m/s^2."""
    angle_jacobian: ca.DM
    """(n,), derivative of the tangent's direction by q, dimensionless."""
    angular_velocity: ca.SX
    """Rate of the tangent's direction, in rad/s."""


def curvature_moments(angle: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    r"""Real and imaginary parts of :math:`\varphi_0, \varphi_1, \varphi_2` at ``angle``.

    Partial integration, :math:`\varphi_m = (e^{\mathrm i a} - m \varphi_{m-1}) / (\mathrm i a)`,
    loses all digits as a goes to 0; the power series takes over for \|a\| < 1, where
    its nine terms in each part leave less than 1e-17.
    """
    small = ca.fabs(angle) < SERIES_LIMIT
    # Both branches are always evaluated, and differentiated: each gets an
    # argument that it can bear.
    near = ca.if_else(small, angle, 0)
    far = ca.if_else(small, SERIES_LIMIT, angle)
    return [
        (ca.if_else(small, near_part[0], far_part[0]), ca.if_else(small, near_part[1], far_part[1]))
        for near_part, far_part in zip(_moments_near(near), _moments_far(far), strict=True)
    ]


def _moments_near(a: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    square = a * a
    moments = []
    for m in range(3):
        real, imaginary = ca.SX(0), ca.SX(0)
        for j in reversed(range(SERIES_TERMS)):
            sign = -1 if j % 2 else 1
            real = sign / (math.factorial(2 * j) * (2 * j + m + 1)) + square * real
            imaginary = sign / (math.factorial(2 * j + 1) * (2 * j + m + 2)) + square * imaginary
        moments.append((real, a * imaginary))
    return moments


def _moments_far(a: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    cosine, sine = ca.cos(a), ca.sin(a)
    moments = [(sine / a, (1 - cosine) / a)]
    for m in (1, 2):
        real, imaginary = moments[-1]
        moments.append(((sine - m * imaginary) / a, (m * real - cosine) / a))
    return moments


def body_point(
    base: SegmentBase, segment: int, q: ca.SX, qd: ca.SX, length: ca.SX, s: float
) -> BodyPoint:
    """Motion of the point at ``s`` on a segment.

    Parameters
    ----------
    base : SegmentBase
        Motion of the segment's base.
    segment : int
        Index of the segment, from 0.
    q, qd : SX, (n,)
        Bending angles and their rates, in rad and rad/s.
    length : SX
        Length of the segment, in m.
    s : float
        Place on the segment, 0 at its base and 1 at its tip.
    """
    bend, rate = q[segment], qd[segment]
    zeroth, first, second = curvature_moments(s * bend)
    arm = length * s * _rotated(base.angle, *zeroth)
    by_bend = length * s**2 * _quarter_turn(_rotated(base.angle, *first))
    by_bend_twice = -length * s**3 * _rotated(base.angle, *second)

    jacobian = ca.SX(base.jacobian)
    # Every bend before this segment turns it as a rigid body about its base.
    for upstream in range(segment):
        jacobian[:, upstream] += _quarter_turn(arm)
    jacobian[:, segment] = by_bend

    spin = base.angular_velocity
    acceleration = (
        base.convective_acceleration
        - spin**2 * arm
        + 2 * spin * rate * _quarter_turn(by_bend)
        + rate**2 * by_bend_twice
    )
    return BodyPoint(
        position=base.position + arm,
        angle=base.angle + s * bend,
        jacobian=jacobian,
        convective_acceleration=acceleration,
        angle_jacobian=ca.DM([1.0] * segment + [s] + [0.0] * (q.numel() - segment - 1)),
        angular_velocity=spin + s * rate,
    )


def segment_bases(
    q: ca.SX, qd: ca.SX, length: ca.SX, base_position: ca.SX, base_angle: ca.SX
) -> list[SegmentBase]:
    """Motion of the base of every segment and, last, of the arm's tip."""
    n = q.numel()
    base = SegmentBase(base_position, base_angle, ca.SX.zeros(2, n), ca.SX(0), ca.SX.zeros(2))
    bases = [base]
    for segment in range(n):
        tip = body_point(bases[-1], segment, q, qd, length[segment], 1.0)
        bases.append(
            SegmentBase(
                tip.position,
                tip.angle,
                tip.jacobian,
                tip.angular_velocity,
                tip.convective_acceleration,
            )
        )
    return bases


def _rotated(angle: ca.SX, real: ca.SX, imaginary: ca.SX) -> ca.SX:
    cosine, sine = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(cosine * real - sine * imaginary, sine * real + cosine * imaginary)


def _quarter_turn(vector: ca.SX) -> ca.SX:
    return ca.vertcat(-vector[1], vector[0])
