"""Inertia, Coriolis and gravity terms against other codes, Lagrange and their own invariants."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from arm_by_hand import body_mass, displaced_mass, kinetic_energy, weight_less_buoyancy
from arm_cases import (
    MODES,
    UNEQUAL,
    WATER,
    acceleration_function,
    cases,
    derivative,
    gradient,
    uniform,
    water,
)
from hypothesis import given
from hypothesis import strategies as st

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.arm.dynamics import solve_symmetric

REFERENCE_Q = np.array([0.3, -0.5, 0.8])
REFERENCE_QD = np.array([0.1, 0.2, -0.3])


def in_air(**changes):
    """The nominal arm without any water."""
    return Arm(uniform(3, **changes), replace(WATER, density=0.0))


def test_other_codes_give_the_same_arm():
    """soromox 0.5.0, the symbolic expressions of jsrm 0.0.18 and 24-point Gauss quadrature.

    They agree to about 2e-7; three segments of 0.3 m, 0.05 m and 1080 kg/m^3, g = 9.81.
    """
    arm = in_air(rotary_inertia=True)
    q, qd = REFERENCE_Q, REFERENCE_QD
    inertia = [
        [0.2926083936, 0.1278201280, 0.0208287761],
        [0.1278201280, 0.0633565392, 0.0114925531],
        [0.0208287761, 0.0114925531, 0.0028241029],
    ]
    coriolis = [9.499465e-4, 1.399562e-4, 1.487795e-4]
    np.testing.assert_allclose(arm.body_inertia(q), inertia, rtol=1e-6)
    np.testing.assert_allclose(arm.coriolis_vector(q, qd), coriolis, rtol=1e-6)
    np.testing.assert_allclose(arm.gravity_vector(q), [5.8276577, 2.1564326, 0.3009573], rtol=1e-6)
    tip = arm.tip(q) - arm.parameters.base_position
    np.testing.assert_allclose(tip, [0.8782758557, 0.1175256752], rtol=1e-6)
    np.testing.assert_allclose(
        np.diag(in_air().body_inertia(q)), [0.2923765, 0.0632240, 0.0027910], rtol=1e-6, atol=5e-8
    )
    downwards = in_air(base_angle=-np.pi / 2)
    np.testing.assert_allclose(
        downwards.gravity_vector(q), [0.6946256, 0.0450492, 0.0610071], rtol=1e-6
    )


@pytest.mark.parametrize("morison", MODES)
@pytest.mark.parametrize("rotary", [False, True])
def test_energies_are_the_integrals(morison, rotary):
    parameters, fluid = replace(UNEQUAL, rotary_inertia=rotary), water(morison)
    arm = Arm(parameters, fluid)
    q, qd = np.array([0.9, -1.7, 0.4]), np.array([-0.8, 2.5, 4.0])
    body, added = kinetic_energy(parameters, fluid, q, qd)
    assert qd @ arm.body_inertia(q) @ qd / 2 == pytest.approx(body, rel=1e-12)
    assert qd @ arm.added_inertia(q) @ qd / 2 == pytest.approx(added, rel=1e-12)
    assert arm.kinetic_energy(q, qd) == pytest.approx(body + added, rel=1e-12)
    bending = np.sum(parameters.stiffness * q**2) / 2
    weight = weight_less_buoyancy(parameters, fluid, q)
    assert arm.potential_energy(q) == pytest.approx(weight + bending, rel=1e-12)
    np.testing.assert_allclose(arm.stiffness_vector(q), parameters.stiffness * q)


@given(case=cases())
def test_inertia_is_symmetric_and_positive_definite(case):
    body, added = case.arm.body_inertia(case.q), case.arm.added_inertia(case.q)
    scale = np.max(np.abs(body + added))
    for matrix in (body, added):
        np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-14 * scale)
    assert np.min(np.linalg.eigvalsh(body)) > 0
    assert np.min(np.linalg.eigvalsh(body + added)) > 0
    # Nothing is added along the axis, or where C_a = 0.
    assert np.min(np.linalg.eigvalsh(added)) > -1e-14 * scale


@given(case=cases())
def test_coriolis_vector_is_lagranges(case):
    """c = M' q' - d/dq (q' M q') / 2, by finite differences of M: it does no other work."""
    arm, q, qd = case.arm, case.q, case.qd

    def inertia(series):
        return arm.body_inertia(series) + arm.added_inertia(series)

    rate = derivative(inertia, q, qd, step=0.004)
    slope = gradient(lambda series: inertia(series) @ qd @ qd, q)
    scale = np.max(np.abs(inertia(q))) * (1 + qd @ qd)
    expected = rate @ qd - slope / 2
    np.testing.assert_allclose(arm.coriolis_vector(q, qd), expected, rtol=0, atol=1e-9 * scale)


@given(case=cases())
def test_gravity_is_the_gradient_of_its_potential(case):
    arm, q = case.arm, case.q
    force = gradient(arm.potential_energy, q) - arm.stiffness_vector(q)
    np.testing.assert_allclose(arm.gravity_vector(q), force, rtol=0, atol=1e-7)


@given(case=cases())
def test_a_level_straight_arm_weighs_on_its_base(case):
    """A first bend spread evenly lifts its own segment by L/3 of its tip's rise L/2."""
    parameters, fluid = replace(case.arm.parameters, base_angle=0.0), case.arm.fluid
    net = 9.81 * (body_mass(parameters) - displaced_mass(parameters, fluid))
    length = np.array(parameters.length)
    levers = [
        [0.0] * i
        + [length[i] / 6]
        + [length[i] / 2 + sum(length[i + 1 : k]) + length[k] / 2 for k in range(i + 1, len(net))]
        for i in range(len(net))
    ]
    found = Arm(parameters, fluid).gravity_vector(np.zeros(len(net)))
    np.testing.assert_allclose(found, np.array(levers) @ net, rtol=1e-10, atol=1e-12)


def test_rotary_inertia_is_that_of_the_turning_sections():
    """rho I L over all sections, each turning with what precedes it, in any posture."""
    plain, turning = (Arm(replace(UNEQUAL, rotary_inertia=r), WATER) for r in (False, True))
    second_moment = np.pi * np.array(UNEQUAL.diameter) ** 4 / 64
    a, b, c = np.array(UNEQUAL.density) * second_moment * UNEQUAL.length
    expected = [
        [a / 3 + b + c, b / 2 + c, c / 2],
        [b / 2 + c, b / 3 + c, c / 2],
        [c / 2, c / 2, c / 3],
    ]
    for q in (np.zeros(3), np.array([1.0, -2.0, 0.5])):
        difference = turning.body_inertia(q) - plain.body_inertia(q)
        np.testing.assert_allclose(difference, expected, rtol=1e-9)


@given(case=cases())
def test_mirror_symmetry(case):
    """Up and down exchanged, q to -q: the same inertia, the opposite forces."""
    arm, q, qd = case.arm, case.q, case.qd
    mirrored = Arm(replace(arm.parameters, base_angle=-arm.parameters.base_angle), arm.fluid)
    assert np.array_equal(mirrored.body_inertia(-q), arm.body_inertia(q))
    np.testing.assert_allclose(mirrored.added_inertia(-q), arm.added_inertia(q), rtol=0, atol=1e-14)
    c, mirrored_c = arm.coriolis_vector(q, qd), mirrored.coriolis_vector(-q, -qd)
    np.testing.assert_allclose(mirrored_c, -c, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(mirrored.gravity_vector(-q), arm.gravity_vector(q), rtol=1e-12)


@given(case=cases())
def test_place_and_direction_of_the_base_do_not_matter_to_inertia(case):
    arm, q, qd = case.arm, case.q, case.qd
    moved = Arm(replace(arm.parameters, base_position=(3.0, -9.0), base_angle=-1.1), arm.fluid)
    scale = np.max(np.abs(arm.body_inertia(q) + arm.added_inertia(q)))
    close = {"rtol": 0, "atol": 1e-13 * scale}
    np.testing.assert_allclose(moved.body_inertia(q), arm.body_inertia(q), **close)
    np.testing.assert_allclose(moved.added_inertia(q), arm.added_inertia(q), **close)
    close["atol"] *= 1 + qd @ qd
    np.testing.assert_allclose(moved.coriolis_vector(q, qd), arm.coriolis_vector(q, qd), **close)


@pytest.mark.parametrize("morison", MODES)
def test_nothing_jumps_where_a_segment_is_straight(morison):
    arm = Arm(UNEQUAL, water(morison))
    qd = np.array([-0.8, 2.5, 4.0])
    for segment in range(3):
        q = np.array([0.9, -1.7, 0.4])
        q[segment] = 0.0
        aside = 1e-12 * np.eye(3)[segment]
        for at in (arm.body_inertia, arm.added_inertia, arm.gravity_vector, arm.tip):
            np.testing.assert_allclose(at(q - aside), at(q + aside), rtol=0, atol=1e-10)
            np.testing.assert_allclose(at(q), at(q + aside), rtol=0, atol=1e-10)
        left, right = arm.coriolis_vector(q - aside, qd), arm.coriolis_vector(q + aside, qd)
        np.testing.assert_allclose(left, right, rtol=0, atol=1e-10)


@pytest.mark.parametrize("morison", MODES)
def test_second_derivatives_are_finite_and_continuous_on_the_straight_arm(morison):
    """The Hessians of energy, of potential and of the tip, by automatic differentiation."""
    structure = Structure(2, 4, False, morison)
    q, qd = ca.SX.sym("q", 2), ca.DM([1.0, -2.0])
    values = Values.packed(uniform(2, base_angle=0.4), water(morison))
    terms = mechanics(structure, q, ca.SX(qd), Values.unpacked(ca.SX(values), 2))
    along = ca.cos(0.4) * terms.tips[-1][0] + ca.sin(0.4) * terms.tips[-1][1]
    scalars = [along, qd.T @ terms.inertia @ qd, terms.gravity_potential]
    hessian = ca.Function("hessian", [q], [ca.horzcat(*(ca.hessian(f, q)[0] for f in scalars))])
    straight = hessian([0.0, 0.0]).full()
    np.testing.assert_allclose(straight[:, :2], -0.3 * np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]]))
    assert np.all(np.isfinite(straight))
    assert np.all(np.abs(np.diag(straight[:, 2:4])) > 1e-3)
    np.testing.assert_allclose(hessian([1e-12, -1e-12]).full(), straight, rtol=0, atol=1e-10)


@given(case=cases(), data=st.data())
def test_the_acceleration_satisfies_the_equation_of_motion(case, data):
    """M q'' + C q' + D q' + K q + G = force, term by term with its sign, for every angle but
    a locked one: that stays, and the others feel it as a constraint.
    """
    arm, q, qd = case.arm, case.q, case.qd
    locked = np.eye(arm.segments + 1, arm.segments)[data.draw(st.integers(0, arm.segments))]
    force = np.linspace(-3, 5, arm.segments)
    found = acceleration_function(arm.structure)(q, qd, force, arm.values, locked).full().ravel()
    assert found @ locked == 0
    inertia = arm.body_inertia(q) + arm.added_inertia(q)
    terms = [
        inertia @ found,
        arm.coriolis_vector(q, qd),
        np.array(arm.parameters.damping) * qd,
        np.array(arm.parameters.stiffness) * q,
        arm.gravity_vector(q),
        -force,
    ]
    assert np.max(np.abs(sum(terms) * (1 - locked))) < 1e-9 * np.max(np.abs(terms))


@pytest.mark.parametrize("morison", MODES)
def test_an_arm_without_locks_is_one_with_none_locked(morison):
    """They are written separately: the plain equation of motion, and the one with constraints."""
    arm = Arm(UNEQUAL, water(morison))
    q, qd, force = (ca.SX.sym(name, 3) for name in ("q", "qd", "force"))
    terms = mechanics(arm.structure, q, qd, Values.unpacked(ca.SX(arm.values), 3))
    free = ca.Function("free", [q, qd, force], [terms.acceleration(force)])
    state = [0.9, -1.7, 0.4], [-0.8, 2.5, 4.0], [1.0, -2.0, 0.5]
    expected = acceleration_function(arm.structure)(*state, arm.values, 0).full()
    assert np.all(np.abs(expected) > 1)
    np.testing.assert_allclose(free(*state).full(), expected, rtol=1e-12)


def test_solve_symmetric():
    matrix = ca.SX.sym("matrix", 4, 4)
    right = ca.SX.sym("right", 4, 2)
    solve = ca.Function("solve", [matrix, right], [solve_symmetric(matrix, right)])
    rng = np.random.default_rng(3)
    root, wanted = rng.normal(size=(4, 4)), rng.normal(size=(4, 2))
    given_matrix = root @ root.T + np.eye(4)
    found = solve(given_matrix, given_matrix @ wanted).full()
    np.testing.assert_allclose(found, wanted, rtol=1e-11)
