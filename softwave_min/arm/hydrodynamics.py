r"""Morison loads on the arm and the flow at its points, as CasADi expressions.

The flow reaches the model as the coefficients :math:`c_{nm}` of its complex velocity,

.. math:: u - \mathrm i w = \sum_{n,m} c_{nm} (Z - Z_0)^n (t - t_0)^m, \qquad Z = x + \mathrm i z ,

with :math:`Z_0` the arm's base, so that the cost does not depend on the number
of wave components. All forces are per whole segment, to be integrated over
:math:`s \in [0, 1]` (the paper's eq. 4).
"""

from __future__ import annotations

import casadi as ca

SLOPE_ROUNDING = 0.05
"""Relative velocity below which the drag's slope is rounded off, in m/s."""


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


def flow_gradient(coefficients: tuple[ca.SX, ca.SX], offset: ca.SX) -> ca.SX:
    """Derivative of ``flow_at`` by (x, z), 2 x 2: symmetric and without trace, because
    the complex velocity is analytic.
    """
    real, imaginary = coefficients
    orders = ca.DM(range(1, real.numel()))
    along = flow_at((orders * real[1:], orders * imaginary[1:]), offset)
    return ca.vertcat(ca.horzcat(along[0], along[1]), ca.horzcat(along[1], -along[0]))


def local_frame(angle: ca.SX) -> ca.SX:
    """Rotation R(s, q) from (x, z) to (normal, tangential); the normal is 90 degrees
    counter-clockwise of the tangent.
    """
    cosine, sine = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(-sine, cosine), ca.horzcat(cosine, sine))


def drag_force(relative_velocity: ca.SX, normal: ca.SX, tangential: ca.SX) -> ca.SX:
    r"""Quadratic drag :math:`F_D = -\mathcal D v_r` in the local frame, in N.

    The implicit step differentiates this law twice. Whoever changes it must change its first
    derivative ``drag_slopes`` and its second ``drag_bends`` with it.

    Parameters
    ----------
    relative_velocity : SX, (2,)
        Velocity of the body less that of the water, (normal, tangential), in m/s.
    normal, tangential : SX
        :math:`\tfrac12 \rho_f A C_d` and :math:`\tfrac12 \rho_f A C_f`, in kg/m.
    """
    factors = ca.vertcat(normal, tangential)
    return -factors * ca.fabs(relative_velocity) * relative_velocity


def drag_slopes(relative_velocity: ca.SX, normal: ca.SX, tangential: ca.SX) -> ca.SX:
    r"""Diagonal of :math:`-\partial F_D/\partial v_r` in the local frame, in N s/m.

    It is 2 |v| times the factor. The corner at v = 0 is rounded off: an implicit step
    may take any slope, and one with a corner would make the step's own derivative jump.
    """
    speed = ca.sqrt(relative_velocity**2 + SLOPE_ROUNDING**2)
    return 2 * ca.vertcat(normal, tangential) * speed


def drag_bends(relative_velocity: ca.SX, change: ca.SX, normal: ca.SX, tangential: ca.SX) -> ca.SX:
    """Diagonal of the derivative of ``drag_slopes`` x ``change`` - ``drag_force`` by the
    relative velocity, in N s/m.
    """
    speed = ca.sqrt(relative_velocity**2 + SLOPE_ROUNDING**2)
    bend = ca.fabs(relative_velocity) + relative_velocity / speed * change
    return 2 * ca.vertcat(normal, tangential) * bend


def in_plane(angle: ca.SX, diagonal: ca.SX) -> ca.SX:
    """The symmetric matrix R^T diag(normal, tangential) R in (x, z), 2 x 2."""
    cosine, sine = ca.cos(angle), ca.sin(angle)
    normal, tangential = diagonal[0], diagonal[1]
    mixed = (tangential - normal) * (sine * cosine)
    return ca.blockcat(
        [
            [normal * sine**2 + tangential * cosine**2, mixed],
            [mixed, normal * cosine**2 + tangential * sine**2],
        ]
    )


def cross_flow_force(angle: ca.SX, acceleration: ca.SX) -> ca.SX:
    """Inertial force of a unit mass that follows the normal motion alone, n (n . a)."""
    normal = local_frame(angle)[0, :].T
    return normal * ca.dot(normal, acceleration)


def cross_flow_convection(angle: ca.SX, spin: ca.SX, velocity: ca.SX) -> tuple[ca.SX, ca.SX]:
    r"""What Lagrange's equation for :math:`\tfrac12 (n \cdot v)^2` has beside n (n . a).

    With :math:`\omega` the section's rate of turn and :math:`v_n, v_t` its velocity
    across and along: the force :math:`-\omega (v_t\, n + v_n\, t)`, to be met with
    :math:`J^T`, and Munk's moment :math:`v_n v_t`, to be met with
    :math:`\partial\theta/\partial q`. Without them still water would not conserve energy.
    The velocity is the body's, as in still water: the corresponding terms of the moving
    water belong to the convective acceleration that Morison's equation leaves out.
    """
    frame = local_frame(angle)
    across, along = ca.vertsplit(frame @ velocity)
    return -spin * (along * frame[0, :].T + across * frame[1, :].T), across * along
