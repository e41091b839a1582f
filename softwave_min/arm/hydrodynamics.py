r"""Morison loads on the arm and the flow at its points, as CasADi expressions.

The flow reaches the model as the coefficients :math:`c_{nm}` of its complex velocity,

.. math:: u - \mathrm i w = \sum_{n,m} c_{nm} (Z - Z_0)^n (t - t_0)^m, \qquad Z = x + \mathrm i z ,

with :math:`Z_0` the arm's base, so that the cost does not depend on the number
of wave components. All forces are per whole segment, to be integrated over
:math:`s \in [0, 1]` (the paper's eq. 4).
"""

from __future__ import annotations

import casadi as ca

from softwave_min.arm.kinematics import BodyPoint

__all__ = [
    "cross_flow_coriolis",
    "cross_flow_inertia",
    "drag_force",
    "drag_matrix",
    "flow_at",
    "local_frame",
]


def flow_at(coefficients: tuple[ca.SX, ca.SX], offset: ca.SX) -> ca.SX:
    """Evaluate sum_n c_n (Z - Z_0)^n at one time.

    Parameters
    ----------
    coefficients : pair of SX, (N + 1,)
        Real and imaginary parts of c_n.
    offset : SX, (2,)
        (x - x_0, z - z_0), in m.

    Returns
    -------
    SX, (2,)
        (u, w), or their rates if the coefficients are those of the rate.
    """
    real, imaginary = coefficients
    x, z = offset[0], offset[1]
    u, v = ca.SX(0), ca.SX(0)
    for n in reversed(range(real.numel())):
        u, v = real[n] + x * u - z * v, imaginary[n] + x * v + z * u
    return ca.vertcat(u, -v)


def local_frame(angle: ca.SX) -> ca.SX:
    """Rotation R(s, q) from (x, z) to (normal, tangential); the normal is 90 degrees
    counter-clockwise of the tangent.
    """
    cosine, sine = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(-sine, cosine), ca.horzcat(cosine, sine))


def drag_force(relative_velocity: ca.SX, normal: ca.SX, tangential: ca.SX) -> ca.SX:
    r"""Quadratic drag :math:`F_D = -\mathcal D v_r` in the local frame, in N.

    Parameters
    ----------
    relative_velocity : SX, (2,)
        Velocity of the body less that of the water, (normal, tangential), in m/s.
    normal, tangential : SX
        :math:`\tfrac12 \rho_f A C_d` and :math:`\tfrac12 \rho_f A C_f`, in kg/m.
    """
    factors = ca.vertcat(normal, tangential)
    return -factors * ca.fabs(relative_velocity) * relative_velocity


def drag_matrix(
    point: BodyPoint, relative_velocity: ca.SX, normal: ca.SX, tangential: ca.SX
) -> ca.SX:
    r"""Slope of the generalised drag, :math:`-\partial (J^T R^T F_D)/\partial\dot q`.

    Positive semidefinite, n x n, in N m s/rad.
    """
    jacobian = local_frame(point.angle) @ point.jacobian
    slope = 2 * ca.vertcat(normal, tangential) * ca.fabs(relative_velocity)
    return jacobian.T @ ca.diag(slope) @ jacobian


def cross_flow_inertia(point: BodyPoint) -> ca.SX:
    r"""Inertia of a unit mass that follows the normal motion alone, :math:`J^T n n^T J`."""
    across = local_frame(point.angle)[0, :] @ point.jacobian
    return across.T @ across


def cross_flow_coriolis(point: BodyPoint, qd: ca.SX) -> ca.SX:
    r"""Coriolis vector that belongs to ``cross_flow_inertia``.

    Lagrange's equation for :math:`\tfrac12 (n \cdot v)^2`: with :math:`\omega` the
    section's rate of turn and :math:`v_n, v_t` its velocity across and along,

    .. math:: (n \cdot \dot J \dot q - \omega v_t)\, J^T n - \omega v_n\, J^T t
              + v_n v_t\, \partial\theta/\partial q .

    The last term is Munk's moment; without them energy would not be conserved
    in still water.
    """
    frame = local_frame(point.angle)
    normal, tangent = frame[0, :] @ point.jacobian, frame[1, :] @ point.jacobian
    across, along = normal @ qd, tangent @ qd
    spin = point.angular_velocity
    convective = frame[0, :] @ point.convective_acceleration
    return (
        (convective - spin * along) * normal.T
        - spin * across * tangent.T
        + across * along * point.angle_jacobian
    )
