"""The derivatives written by hand, against automatic differentiation of what they derive."""

import casadi as ca
import numpy as np
import pytest
from arm_cases import MODES, UNEQUAL, water

from softwave_min.arm import Structure, Values, mechanics
from softwave_min.arm.hydrodynamics import drag_slopes, flow_at, flow_gradient

STATES = [
    (np.zeros(3), np.array([1.0, -2.0, 0.5])),
    (np.array([0.9, -1.7, 0.4]), np.array([-0.8, 2.5, 4.0])),
    (np.array([-4.0, 0.0, 6.0]), np.array([3.0, 0.0, -1.0])),
]


class Symbolic:
    """The arm at symbols q and qd, its parameters as numbers."""

    def __init__(self, morison):
        self.q, self.qd, self.other = (ca.SX.sym(name, 3) for name in ("q", "qd", "other"))
        values = Values.unpacked(ca.SX(Values.packed(UNEQUAL, water(morison))), 3)
        self.terms = mechanics(Structure(3, 2, True, morison), self.q, self.qd, values)

    def agree(self, by_hand, automatic):
        both = ca.Function("both", [self.q, self.qd, self.other], [by_hand, automatic])
        for q, qd in STATES:
            found, expected = both(q, qd, [0.7, -1.1, 0.3])
            assert np.max(np.abs(expected.full())) > 0
            np.testing.assert_allclose(found.full(), expected.full(), rtol=1e-9, atol=1e-12)


@pytest.fixture(scope="module", params=MODES)
def arm(request):
    return Symbolic(request.param)


@pytest.fixture(scope="module")
def points(arm):
    """A point within each segment."""
    return [point for _, point, _, _ in arm.terms.points[::2]]


def test_velocity_and_convective_acceleration(arm, points):
    for point in points:
        rate = ca.jtimes(point.position, arm.q, arm.qd)
        arm.agree(point.velocity, rate)
        arm.agree(point.convective_acceleration, ca.jtimes(rate, arm.q, arm.qd))
        arm.agree(point.angular_velocity, ca.jtimes(point.angle, arm.q, arm.qd))


def test_gradient_of_product(arm, points):
    for point in points:
        product = point.jacobian @ arm.other
        arm.agree(point.gradient_of_product(arm.other), ca.jacobian(product, arm.q))


def test_gradient_of_convective_acceleration(arm, points):
    for point in points:
        expected = ca.jacobian(point.convective_acceleration, arm.q)
        arm.agree(point.gradient_of_convective_acceleration(), expected)


def test_hessian_along_a_force(arm, points):
    force = arm.other[:2]
    for point in points:
        expected = ca.jacobian(point.jacobian.T @ force, arm.q)
        arm.agree(point.hessian_along(force), expected)


def test_gravity_gradient(arm):
    arm.agree(arm.terms.gravity_gradient, ca.jacobian(arm.terms.gravity, arm.q))


def test_drag_slope(arm):
    """At a speed beside which the rounding of its corner is nothing."""
    velocity, flow = 2000 + arm.qd[:2], arm.q[:2] + 0.2
    for section, *_ in arm.terms.points[::2]:
        drag = sum(section.loads(arm.other[2], velocity, flow, ca.SX.zeros(2))[:2])
        expected = -ca.jtimes(drag, arm.qd, arm.other)
        slope = section.drag_slope(arm.other[2], velocity - flow)
        arm.agree(slope @ arm.other[:2], expected)


def test_implicit_drag(arm):
    angle, relative, change = arm.other[2], arm.qd[:2], arm.other[:2]
    still = ca.SX.zeros(2)
    for section, *_ in arm.terms.points[::2]:
        force, by_angle, by_relative = section.implicit_drag(angle, relative, change)
        drag = sum(section.loads(angle, relative, still, still)[:2])
        arm.agree(force, section.drag_slope(angle, relative) @ change - drag)
        arm.agree(by_angle, ca.jacobian(force, arm.other)[:, 2])
        arm.agree(by_relative, ca.jacobian(force, arm.qd)[:, :2])


def test_drag_slope_is_rounded_off_where_the_flow_turns():
    """2 sqrt(v^2 + (0.05 m/s)^2): positive and smooth at rest."""
    np.testing.assert_allclose(drag_slopes(ca.DM([0.0, 0.12]), 3.0, 5.0).full()[:, 0], [0.3, 1.3])


def test_flow_gradient():
    offset, real, imaginary = ca.SX.sym("offset", 2), ca.SX.sym("real", 5), ca.SX.sym("imag", 5)
    coefficients = (real, imaginary)
    expected = ca.jacobian(flow_at(coefficients, offset), offset)
    both = ca.Function(
        "both", [offset, real, imaginary], [flow_gradient(coefficients, offset), expected]
    )
    rng = np.random.default_rng(2)
    found, automatic = both(rng.normal(size=2), rng.normal(size=5), rng.normal(size=5))
    np.testing.assert_allclose(found.full(), automatic.full(), rtol=1e-12)
