"""Where the arm is and how its points move: definitions, derivatives, zero curvature."""

import casadi as ca
import numpy as np
import pytest
from arm_by_hand import motion
from arm_cases import UNEQUAL, WATER, cases, derivative, gradient, uniform
from hypothesis import given
from hypothesis import strategies as st

from softwave_min.arm import Arm
from softwave_min.arm.kinematics import curvature_moments

BENDS = [0.0, 1e-12, -1e-6, 0.03, 0.49, -0.499, 0.5, -0.5, 0.7, -0.99, 1.4, 2.5, -np.pi, 2 * np.pi]
PLACES, WEIGHTS = np.polynomial.legendre.leggauss(60)


@pytest.fixture(scope="module")
def unequal():
    return Arm(UNEQUAL, WATER)


@pytest.fixture(scope="module")
def moments():
    """phi_0 ... phi_3, then their first and second derivatives, (12,) complex."""
    a = ca.SX.sym("a")
    values = ca.vertcat(*(ca.horzcat(*pair) for pair in curvature_moments(a)))
    slope = ca.jacobian(ca.vec(values), a)
    parts = [values, *(ca.reshape(d, 4, 2) for d in (slope, ca.jacobian(slope, a)))]
    table = ca.Function("moments", [a], [ca.vertcat(*parts)])
    return lambda angle: table(angle).full() @ [1, 1j]


def moment_by_quadrature(m, angle):
    sigma = (PLACES + 1) / 2
    return np.sum(WEIGHTS / 2 * sigma**m * np.exp(1j * angle * sigma))


@pytest.mark.parametrize("angle", BENDS)
def test_moments_and_their_derivatives_are_the_integrals(moments, angle):
    """The k-th derivative of phi_m is i^k phi_(m+k)."""
    expected = [1j**k * moment_by_quadrature(m + k, angle) for k in range(3) for m in range(4)]
    # The highest moment is divided by the angle four times, and so is each derivative.
    digits = np.repeat([2e-14, 2e-13, 2e-12], 4)
    assert np.all(np.abs(moments(angle) - expected) < digits)


@pytest.mark.parametrize("edge", [0.0, 0.5, -0.5])
def test_moments_have_no_jump(moments, edge):
    """At zero curvature, and where the series hands over to the recurrence."""
    sides = moments(np.nextafter(edge, -2)), moments(edge), moments(np.nextafter(edge, 2))
    np.testing.assert_allclose(sides[0], sides[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(sides[2], sides[1], rtol=0, atol=1e-12)


@given(case=cases(), s=st.sampled_from([0.0, 0.3, 1.0]), data=st.data())
def test_points_move_as_the_integral_of_the_tangent(case, s, data):
    """J q' is the integral's own derivative, and (J q')' its convective acceleration."""
    arm, q, qd = case.arm, case.q, case.qd
    segment = data.draw(st.integers(0, arm.segments - 1))
    expected = motion(arm.parameters, q, qd, segment, s)
    position = arm.forward_kinematics(q, segment, s)
    velocity = arm.jacobian(q, segment, s) @ qd
    acceleration = arm.jacobian_rate(q, qd, segment, s) @ qd
    np.testing.assert_allclose(position @ [1, 1j], expected.position, rtol=0, atol=1e-13)
    np.testing.assert_allclose(velocity @ [1, 1j], expected.velocity, rtol=0, atol=1e-12)
    np.testing.assert_allclose(acceleration @ [1, 1j], expected.acceleration, rtol=0, atol=1e-11)


@given(case=cases(), s=st.sampled_from([0.0, 0.3, 1.0]), data=st.data())
def test_jacobian_against_finite_differences(case, s, data):
    arm, q, qd = case.arm, case.q, case.qd
    segment = data.draw(st.integers(0, arm.segments - 1))
    by_angles = gradient(lambda series: arm.forward_kinematics(series, segment, s), q).T
    np.testing.assert_allclose(arm.jacobian(q, segment, s), by_angles, rtol=0, atol=1e-9)
    along = derivative(lambda series: arm.jacobian(series, segment, s), q, qd, step=0.004)
    np.testing.assert_allclose(arm.jacobian_rate(q, qd, segment, s), along, rtol=0, atol=1e-8)


@given(case=cases())
def test_tips_and_axis_are_points_of_the_segments(case):
    arm, q = case.arm, case.q
    ends = [arm.forward_kinematics(q, i, 1.0) for i in range(arm.segments)]
    np.testing.assert_allclose(arm.segment_tips(q), ends, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(arm.tip(q), arm.segment_tips(q)[-1])
    last = arm.jacobian(q, arm.segments - 1, 1.0)
    np.testing.assert_allclose(arm.tip_jacobian(q), last, rtol=0, atol=1e-13)


def test_axis_runs_from_the_base_to_the_tip(unequal):
    q = np.array([0.9, -1.7, 0.4])
    axis = unequal.axis(q, points_per_segment=4)
    assert axis.shape == (13, 2)
    np.testing.assert_allclose(axis[0], UNEQUAL.base_position)
    np.testing.assert_allclose(axis[[4, 8, 12]], unequal.segment_tips(q), rtol=0, atol=1e-15)
    np.testing.assert_allclose(axis[5], unequal.forward_kinematics(q, 1, 0.25), rtol=0, atol=1e-15)
    assert unequal.axis(q).shape == (49, 2)


def test_a_positive_angle_bends_counter_clockwise():
    """A quarter turn of radius 2 L / pi, from +x to +z."""
    arm = Arm(uniform(1), WATER)
    radius = 0.6 / np.pi
    np.testing.assert_allclose(arm.tip([np.pi / 2]), [radius, -4 + radius], rtol=1e-15)


def test_a_series_of_states_gives_a_series_of_answers(unequal):
    rng = np.random.default_rng(5)
    q, qd = rng.uniform(-2, 2, (2, 7, 3))
    calls = {"tip": (), "axis": (), "tip_jacobian": (), "jacobian": (1, 0.3)}
    for name, rest in calls.items():
        answer = getattr(unequal, name)
        np.testing.assert_array_equal(answer(q, *rest), [answer(row, *rest) for row in q])
    rates = [unequal.jacobian_rate(*row, 1, 0.3) for row in zip(q, qd, strict=True)]
    np.testing.assert_array_equal(unequal.jacobian_rate(q, qd, 1, 0.3), rates)
