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

HIGHEST_MOMENT = 3
SERIES_LIMIT = 0.5
SERIES_TERMS = 8
"""Terms in each part of the series; at the limit they leave less than 1e-17."""


@dataclass(frozen=True)
class BodyPoint:
    r"""Motion of one point of the arm's axis.

    Every bend turns all that lies beyond its segment as a rigid body. So a partial
    derivative of the position by any bending angles depends, up to quarter turns, on
    the angle of largest index alone: with l that index, m its multiplicity and r the
    order,

    .. math:: \partial^r p = \mathrm i^{\,r-m} D_m(l), \qquad
              D_m(l) = \partial^m p/\partial q_l^m .
    """

    position: ca.SX
    """(x, z), in m."""
    angle: ca.SX
    """Direction of the tangent, in rad."""
    derivatives: list[tuple[ca.SX, ca.SX]]
    """D_1, D_2 by each bending angle up to the point's own, in m/rad^m."""
    third: ca.SX
    """D_3 by the point's own bending angle, in m/rad^3."""
    angle_jacobian: ca.SX | ca.DM
    """(n,), derivative of the tangent's direction by q, dimensionless."""
    qd: ca.SX
    """(n,), rates of the bending angles, in rad/s."""
    base: BodyPoint | None
    """Base of the point's segment; none for that of the arm itself."""
    lever: ca.SX
    """(x, z) from the segment's base, in m."""

    @property
    def jacobian(self) -> ca.SX:
        """J(s, q), 2 x n, in m/rad."""
        columns = [first for first, _ in self.derivatives]
        beyond = self.qd.numel() - len(columns)
        return ca.horzcat(*columns, ca.SX.zeros(2, beyond))

    @property
    def velocity(self) -> ca.SX:
        """J q', in m/s."""
        return self.product(self.qd)

    @property
    def angular_velocity(self) -> ca.SX:
        """Rate of the tangent's direction, in rad/s."""
        return ca.dot(self.angle_jacobian, self.qd)

    def product(self, rates: ca.SX) -> ca.SX:
        """J ``rates``, 2."""
        if self.base is None:
            return ca.SX.zeros(2)
        return self.base.product(rates) + self._lever_product(rates)

    def gradient_of_product(self, rates: ca.SX) -> ca.SX:
        """Derivative of J ``rates`` by q, 2 x n; for rates = q' it is J'."""
        if self.base is None:
            return ca.SX.zeros(2, self.qd.numel())
        turning, own = self._turning(rates)
        first, second = self.derivatives[-1]
        return self._grown(
            self.base.gradient_of_product(rates),
            self._lever_product(rates),
            turning * quarter_turn(first) + own * second,
        )

    @property
    def convective_acceleration(self) -> ca.SX:
        """J'(s, q, q') q', in m/s^2."""
        if self.base is None:
            return ca.SX.zeros(2)
        return self.base.convective_acceleration + self._lever_convection

    def gradient_of_convective_acceleration(self) -> ca.SX:
        """Derivative of J' q' by q, 2 x n."""
        if self.base is None:
            return ca.SX.zeros(2, self.qd.numel())
        turning, own = self._turning(self.qd)
        return self._grown(
            self.base.gradient_of_convective_acceleration(),
            self._lever_convection,
            _turned_convection(turning, own, (*self.derivatives[-1], self.third)),
        )

    def hessian_along(self, force: ca.SX) -> ca.SX:
        """Derivative of J^T ``force`` by q at a fixed force, n x n, symmetric."""
        n, own = self.qd.numel(), len(self.derivatives)
        matrix = ca.SX.zeros(n, n)
        for k in range(own):
            first, second = self.derivatives[k]
            matrix[k, k] = ca.dot(second, force)
            for j in range(k):
                matrix[j, k] = matrix[k, j] = ca.dot(quarter_turn(first), force)
        return matrix

    def _turning(self, rates: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Sum of the rates of all segments before the point's own, and its own."""
        own = len(self.derivatives) - 1
        return sum(ca.vertsplit(rates)[:own], start=ca.SX(0)), rates[own]

    def _lever_product(self, rates: ca.SX) -> ca.SX:
        """The part of J ``rates`` by which the point moves against its segment's base."""
        turning, own = self._turning(rates)
        return turning * quarter_turn(self.lever) + own * self.derivatives[-1][0]

    @property
    def _lever_convection(self) -> ca.SX:
        first, second = self.derivatives[-1]
        return _turned_convection(*self._turning(self.qd), (self.lever, first, second))

    def _grown(self, base: ca.SX, lever: ca.SX, own: ca.SX) -> ca.SX:
        """Derivative by q of a vector at the base plus one of the lever: whatever bends
        before the segment turns the latter as a whole; ``own`` is by the segment's angle.
        """
        before = len(self.derivatives) - 1
        columns = [base[:, k] + quarter_turn(lever) for k in range(before)]
        return ca.horzcat(*columns, own, ca.SX.zeros(2, self.qd.numel() - before - 1))


def _turned_convection(
    turning: ca.SX, own: ca.SX, derivatives: tuple[ca.SX, ca.SX, ca.SX]
) -> ca.SX:
    """Second time derivative of a vector that turns and changes with its segment's angle,
    at constant rates of both.
    """
    zeroth, first, second = derivatives
    return own**2 * second + 2 * turning * own * quarter_turn(first) - turning**2 * zeroth


def curvature_moments(angle: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    r"""Real and imaginary parts of :math:`\varphi_0, \dots, \varphi_3` at ``angle``.

    Partial integration, :math:`\mathrm i a \varphi_m = e^{\mathrm i a} - m \varphi_{m-1}`,
    gives each moment from its neighbour. Upwards it divides by a, and loses all digits
    as a goes to 0; there the power series gives the highest moment. Downwards it
    divides by m, and is harmless.
    """
    cosine, sine = ca.cos(angle), ca.sin(angle)
    small = ca.fabs(angle) < SERIES_LIMIT
    # Both branches are always evaluated, and differentiated: the recurrence must not
    # divide by zero.
    near = _highest_by_series(angle)
    far = _highest_by_recurrence(ca.if_else(small, SERIES_LIMIT, angle), cosine, sine)
    real, imaginary = (ca.if_else(small, *parts) for parts in zip(near, far, strict=True))
    moments = [(real, imaginary)]
    for m in range(HIGHEST_MOMENT, 0, -1):
        real, imaginary = (cosine + angle * imaginary) / m, (sine - angle * real) / m
        moments.insert(0, (real, imaginary))
    return moments


def _highest_by_series(a: ca.SX) -> tuple[ca.SX, ca.SX]:
    square = a * a
    real, imaginary = ca.SX(0), ca.SX(0)
    for j in reversed(range(SERIES_TERMS)):
        sign, power = (-1) ** j, 2 * j + HIGHEST_MOMENT + 1
        real = sign / (math.factorial(2 * j) * power) + square * real
        imaginary = sign / (math.factorial(2 * j + 1) * (power + 1)) + square * imaginary
    return real, a * imaginary


def _highest_by_recurrence(a: ca.SX, cosine: ca.SX, sine: ca.SX) -> tuple[ca.SX, ca.SX]:
    real, imaginary = sine / a, (1 - cosine) / a
    for m in range(1, HIGHEST_MOMENT + 1):
        real, imaginary = (sine - m * imaginary) / a, (m * real - cosine) / a
    return real, imaginary


def body_point(
    base: BodyPoint, segment: int, q: ca.SX, length: ca.SX, s: ca.SX | float
) -> BodyPoint:
    """Motion of the point at ``s`` on a segment.

    Parameters
    ----------
    base : BodyPoint
        The segment's base, which is the tip of the one before.
    segment : int
        Index of the segment, from 0.
    q : SX, (n,)
        Bending angles, in rad.
    length : SX
        Length of the segment, in m.
    s : SX or float
        Place on the segment, 0 at its base and 1 at its tip.
    """
    zeroth, first, second, third = curvature_moments(s * q[segment])
    lever = length * s * _rotated(base.angle, *zeroth)
    turned = quarter_turn(lever)
    own = (
        length * s**2 * quarter_turn(_rotated(base.angle, *first)),
        -length * s**3 * _rotated(base.angle, *second),
    )
    upstream = [(by_one + turned, by_two - lever) for by_one, by_two in base.derivatives]
    return BodyPoint(
        position=base.position + lever,
        angle=base.angle + s * q[segment],
        derivatives=[*upstream, own],
        third=-length * s**4 * quarter_turn(_rotated(base.angle, *third)),
        angle_jacobian=ca.vertcat(*[1.0] * segment, s, *[0.0] * (q.numel() - segment - 1)),
        qd=base.qd,
        base=base,
        lever=lever,
    )


def segment_bases(
    q: ca.SX, qd: ca.SX, length: ca.SX, base_position: ca.SX, base_angle: ca.SX
) -> list[BodyPoint]:
    """Motion of the base of every segment and, last, of the arm's tip."""
    n = q.numel()
    at_rest = ca.SX.zeros(2)
    bases = [
        BodyPoint(
            base_position,
            base_angle,
            derivatives=[],
            third=at_rest,
            angle_jacobian=ca.DM.zeros(n),
            qd=qd,
            base=None,
            lever=at_rest,
        )
    ]
    for segment in range(n):
        bases.append(body_point(bases[-1], segment, q, length[segment], 1.0))
    return bases


def quarter_turn(vector: ca.SX) -> ca.SX:
    """Turn a vector by 90 degrees counter-clockwise: multiply x + iz by i."""
    return ca.vertcat(-vector[1], vector[0])


def _rotated(angle: ca.SX, real: ca.SX, imaginary: ca.SX) -> ca.SX:
    cosine, sine = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(cosine * real - sine * imaginary, sine * real + cosine * imaginary)
