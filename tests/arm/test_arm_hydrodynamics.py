"""Morison loads: closed forms on the straight arm, virtual work, each term by itself."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from arm_by_hand import generalised_loads, power
from arm_cases import MODES, UNEQUAL, cases, numbers, uniform, water
from hypothesis import given
from hypothesis import strategies as st

from softwave_min.arm import LOAD_TERMS, Arm, Structure, Values, mechanics, pack_flow
from softwave_min.waves import Sea


def uniform_flow(structure: Structure, u: float, w: float, *, rate: int = 0) -> np.ndarray:
    """A steady current, or with ``rate`` = 1 one that grows from rest by (u, w) a second."""
    coefficients = np.zeros((structure.space_order + 1, structure.time_order + 1), dtype=complex)
    coefficients[0, rate] = u - 1j * w
    return pack_flow(coefficients)


def wave_flow(arm: Arm, sea: Sea, time: float) -> np.ndarray:
    """The sea's flow about the arm's base."""
    orders = arm.structure.space_order, arm.structure.time_order
    return pack_flow(sea.taylor_velocity(arm.parameters.base_position, [time], *orders)[0])


def straight(**changes):
    """An arm of unequal segments, with the nominal number of quadrature points."""
    return uniform(3, length=(0.4, 0.25, 0.15), quadrature_points=4, **changes)


def segment_loads(length, force):
    """Loads (n, n) of a force per length across a straight arm: [bend, segment].

    ``force(m, a, b)`` is the integral of x^m times the force per length from a to b, exactly.
    """
    n, ends = len(length), np.cumsum([0, *length])
    loads = np.zeros((n, n))
    for i in range(n):
        a, b = ends[i], ends[i + 1]
        for j in range(i):
            middle = (ends[j] + ends[j + 1]) / 2
            loads[j, i] = force(1, a, b) - middle * force(0, a, b)
        square = force(2, a, b) - 2 * a * force(1, a, b) + a**2 * force(0, a, b)
        loads[i, i] = square / (2 * length[i])
    return loads


def exponential_moment(m, rate, a, b):
    """Integral of x^m exp(rate x) from a to b, by parts."""
    if m == 0:
        return (np.exp(rate * b) - np.exp(rate * a)) / rate
    ends = b**m * np.exp(rate * b) - a**m * np.exp(rate * a)
    return (ends - m * exponential_moment(m - 1, rate, a, b)) / rate


def power_moment(m, a, b):
    return (b ** (m + 1) - a ** (m + 1)) / (m + 1)


def exact(loads, expected):
    np.testing.assert_allclose(loads, expected, rtol=0, atol=1e-8 * np.max(np.abs(expected)))


def drag_per_length(fluid, diameter):
    return fluid.density / 2 * diameter * fluid.drag_coefficient


def inertia_per_length(fluid, diameter):
    """Of the water's acceleration alone: in the paper's reading there is none."""
    displaced = fluid.density * np.pi * diameter**2 / 4
    return fluid.inertia_coefficient * displaced if fluid.morison == "textbook" else 0.0


@pytest.mark.parametrize("morison", MODES)
@pytest.mark.parametrize("angle", [0.0, 0.4, -np.pi / 2, 2.5])
def test_straight_arm_in_a_steady_current(morison, angle):
    fluid = water(morison)
    arm = Arm(straight(base_angle=angle), fluid)
    u, w = 1.3, -0.8
    across = -u * np.sin(angle) + w * np.cos(angle)
    strength = drag_per_length(fluid, 0.05) * abs(across) * across
    flow = uniform_flow(arm.structure, u, w)
    loads = arm.load_terms(np.zeros(3), np.zeros(3), flow)
    length = arm.parameters.length
    expected = segment_loads(length, lambda m, a, b: strength * power_moment(m, a, b))
    exact(loads["drag_normal"], expected)
    np.testing.assert_allclose(loads["drag_tangential"], 0, atol=1e-14)
    np.testing.assert_allclose(loads["fluid_inertia"], 0, atol=1e-14)
    exact(arm.fluid_load(np.zeros(3), np.zeros(3), flow), expected.sum(axis=1))


@pytest.mark.parametrize("morison", MODES)
def test_level_straight_arm_in_a_regular_wave(morison):
    """w = W sin(k x - w t) > 0 all along it: drag with sin^2, inertia with -w W cos."""
    fluid, time = water(morison), -1.1
    arm = Arm(straight(base_position=(0.7, -4.0)), fluid)
    sea = Sea.regular(2.0, 6.1, 20.0, fluid.gravity, phase=0.3)
    loads = arm.load_terms(np.zeros(3), np.zeros(3), wave_flow(arm, sea, time))
    k, frequency = sea.wave_number[0], sea.angular_frequency[0]
    speed = np.pi * 2.0 / 6.1 * np.sinh(k * 16) / np.sinh(k * 20)
    phase = k * 0.7 - frequency * time + 0.3
    assert 0 < phase < phase + 0.8 * k < np.pi

    def drag(m, a, b):
        """Integral of x^m W^2 sin^2."""
        twice = (exponential_moment(m, 2j * k, a, b) * np.exp(2j * phase)).real
        return speed**2 / 2 * (power_moment(m, a, b) - twice)

    def rise(m, a, b):
        """Integral of x^m dw/dt."""
        return -speed * frequency * (exponential_moment(m, 1j * k, a, b) * np.exp(1j * phase)).real

    length = arm.parameters.length
    strength = drag_per_length(fluid, 0.05)
    exact(loads["drag_normal"], strength * segment_loads(length, drag))
    inertia = inertia_per_length(fluid, 0.05)
    np.testing.assert_allclose(
        loads["fluid_inertia"], inertia * segment_loads(length, rise), rtol=1e-8, atol=1e-12
    )
    np.testing.assert_allclose(loads["drag_tangential"], 0, atol=1e-14)


@pytest.mark.parametrize("morison", MODES)
def test_pile_in_a_regular_wave(morison):
    """The arm upright from z = -4 m: u = U cosh(k (z + d)) cos, as on Morison's pile.

    Across an arm that points up is -x: crests push its bends clockwise.
    """
    fluid, time = water(morison), 0.9
    arm = Arm(straight(base_angle=np.pi / 2), fluid)
    sea = Sea.regular(2.0, 6.1, 20.0, fluid.gravity)
    loads = arm.load_terms(np.zeros(3), np.zeros(3), wave_flow(arm, sea, time))
    k, frequency = sea.wave_number[0], sea.angular_frequency[0]
    amplitude = np.pi * 2.0 / 6.1 / np.sinh(k * 20)
    u, du = amplitude * np.cos(frequency * time), -amplitude * frequency * np.sin(frequency * time)
    assert u > 0

    def cosh(m, a, b, k):
        """Integral of x^m cosh(k (16 m + x))."""
        up, down = exponential_moment(m, k, a, b), exponential_moment(m, -k, a, b)
        return (np.exp(16 * k) * up + np.exp(-16 * k) * down) / 2

    length = arm.parameters.length
    squared = segment_loads(
        length, lambda m, a, b: (cosh(m, a, b, 2 * k) + power_moment(m, a, b)) / 2
    )
    exact(loads["drag_normal"], -drag_per_length(fluid, 0.05) * u**2 * squared)
    inertia = inertia_per_length(fluid, 0.05)
    plain = segment_loads(length, lambda m, a, b: cosh(m, a, b, k))
    np.testing.assert_allclose(loads["fluid_inertia"], -inertia * du * plain, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(("morison", "rubbed"), [("paper", 1.0), ("textbook", np.pi)])
def test_friction_along_a_segment(morison, rubbed):
    """A quarter bend, then a straight segment that points up in an upward current.

    The first bend raises the second segment by L Re phi_1(pi/2), and turns it across.
    """
    fluid = water(morison)
    arm = Arm(uniform(2, length=(0.3, 0.5)), fluid)
    q, w = np.array([np.pi / 2, 0.0]), 1.4
    friction = fluid.density / 2 * 0.05 * 0.5 * rubbed * fluid.friction_coefficient * w**2
    rise = 0.3 * (1 - 2 / np.pi) / (np.pi / 2)
    loads = arm.load_terms(q, np.zeros(2), uniform_flow(arm.structure, 0.0, w))
    assert loads["drag_tangential"][0, 1] == pytest.approx(friction * rise, rel=1e-12)
    assert loads["drag_tangential"][1, 1] == pytest.approx(0, abs=1e-14)
    np.testing.assert_allclose(loads["drag_normal"][:, 1], 0, atol=1e-14)


def polynomial_flow(structure: Structure, rng: np.random.Generator):
    """Any flow that the model can be told: its coefficients, and the flow at (Z - Z_0, t)."""
    orders = structure.space_order + 1, structure.time_order + 1
    coefficients = rng.normal(size=(*orders, 2)) @ [1, 1j]
    coefficients *= 0.4 ** np.arange(orders[0])[:, None]
    rates = coefficients[:, 1:] * np.arange(1, orders[1])

    def at(offset, time):
        velocity = np.polynomial.polynomial.polyval2d(offset, time, coefficients)
        acceleration = np.polynomial.polynomial.polyval2d(offset, time, rates)
        return velocity.conjugate(), acceleration.conjugate()

    return pack_flow(coefficients), at


def test_orders_of_the_flow_are_the_least_that_will_do(nominal):
    """Error bound over the arm's reach and a control period, relative to the rms of the flow
    at its lowest point: below 1e-6 for velocity and acceleration in the steepest of the
    paper's seas, W1, and not with an order less in space or in time.
    """
    sea = Sea.random(replace(nominal.sea, peak_period=6.1), nominal.fluid.gravity)
    (x, z), reach = nominal.arm.base_position, sum(nominal.arm.length)
    times = np.arange(0, nominal.simulation.duration, 0.5)

    def bound(space_order, time_order):
        worst = 0.0
        for in_time, field in enumerate((sea.velocity, sea.acceleration)):
            level = np.sqrt(np.mean(np.sum(np.square(field(x, z - reach, times)), axis=0)))
            orders = {"space_order": space_order, "time_order": time_order}
            half = nominal.nmpc.control_period / 2
            error = sea.taylor_error_bound((x, z), reach, half, **orders, time_derivative=in_time)
            worst = max(worst, error / level)
        return worst

    space, time = Structure.space_order, Structure.time_order
    assert bound(space, time) < 1e-6
    assert bound(space - 1, time) > 1e-6
    assert bound(space, time - 1) > 1e-6


@pytest.mark.parametrize("morison", MODES)
def test_plant_and_figures_have_the_same_load(morison):
    """The sum that enters the equation of motion, and that of the terms by segment."""
    arm = Arm(UNEQUAL, water(morison))
    structure = arm.structure
    symbols = [ca.SX.sym(*one) for one in (("q", 3), ("qd", 3), ("flow", structure.flow_size))]
    values = Values.unpacked(ca.SX(arm.values), 3)
    terms = mechanics(structure, *symbols[:2], values)
    load = ca.Function("load", symbols, [terms.fluid_load(symbols[2], 0.03)])
    flow, _ = polynomial_flow(structure, np.random.default_rng(12))
    state = np.array([[0.9, -1.7, 0.4], [-0.8, 2.5, 4.0]])
    expected = arm.fluid_load(*state, flow, 0.03)
    assert np.all(np.abs(expected) > 0.05)
    np.testing.assert_allclose(load(*state, flow).full()[:, 0], expected, rtol=1e-12)


@given(case=cases(), seed=st.integers(0, 1000), time=numbers(-0.05, 0.05))
def test_loads_are_the_virtual_work_of_morisons_forces(case, seed, time):
    """Every term, from every segment, on every bend; and all of them as power."""
    arm, q, qd = case.arm, case.q, case.qd
    flow, at = polynomial_flow(arm.structure, np.random.default_rng(seed))
    base = complex(*arm.parameters.base_position)
    expected = generalised_loads(
        arm.parameters, arm.fluid, q, qd, lambda position: at(position - base, time)
    )
    loads = arm.load_terms(q, qd, flow, time)
    assert tuple(loads) == LOAD_TERMS
    scale = max(np.max(np.abs(load)) for load in expected.values())
    for name, load in loads.items():
        np.testing.assert_allclose(load, expected[name], rtol=1e-9, atol=1e-11 * (1 + scale))
    total = sum(expected.values()).sum(axis=1)
    np.testing.assert_allclose(
        arm.fluid_load(q, qd, flow, time), total, rtol=1e-9, atol=1e-10 * (1 + scale)
    )


@pytest.mark.parametrize("morison", MODES)
def test_power_of_the_load_in_a_random_sea(nominal, morison):
    """Generalised load times rates is the integral of force times velocity along the arm,
    the forces from the plain sum of waves. Kinks of the drag limit the quadrature.
    """
    fluid, time, delay = water(morison), 7.0, 0.04
    fine = replace(UNEQUAL, quadrature_points=16)
    arm = Arm(fine, fluid)
    sea = Sea.random(nominal.sea, fluid.gravity)
    flow = wave_flow(arm, sea, time)

    def at(position):
        where = position.real, position.imag, time + delay
        return complex(*sea.velocity(*where)), complex(*sea.acceleration(*where))

    for q, qd in np.random.default_rng(11).uniform(-2, 2, (4, 2, 3)):
        expected = generalised_loads(fine, fluid, q, qd, at)
        loads = arm.load_terms(q, qd, flow, delay)
        for name, load in loads.items():
            np.testing.assert_allclose(load, expected[name], rtol=0, atol=1e-7)
        found = qd @ arm.fluid_load(q, qd, flow, delay)
        assert found == pytest.approx(power(fine, fluid, q, qd, at), rel=3e-3)


@given(case=cases())
def test_drag_takes_energy_from_a_moving_arm_in_still_water(case):
    arm, q, qd = case.arm, case.q, case.qd
    loads = arm.load_terms(q, qd, np.zeros(arm.structure.flow_size))
    assert qd @ loads["drag_normal"].sum(axis=1) <= 1e-15
    assert qd @ loads["drag_tangential"].sum(axis=1) <= 1e-15
    assert not np.any(loads["fluid_inertia"])


@pytest.mark.parametrize("morison", MODES)
def test_loads_do_not_jump_where_a_segment_is_straight(morison):
    arm = Arm(UNEQUAL, water(morison))
    flow, _ = polynomial_flow(arm.structure, np.random.default_rng(4))
    qd = np.array([-0.8, 2.5, 4.0])
    for segment in range(3):
        q = np.array([0.9, -1.7, 0.4])
        q[segment] = 0.0
        aside = 1e-13 * np.eye(3)[segment]
        at = [arm.fluid_load(angles, qd, flow) for angles in (q - aside, q, q + aside)]
        np.testing.assert_allclose(at[0], at[1], rtol=0, atol=1e-10)
        np.testing.assert_allclose(at[2], at[1], rtol=0, atol=1e-10)


def test_a_series_of_flows_is_packed_row_by_row():
    rng = np.random.default_rng(6)
    flows = rng.normal(size=(5, 9, 6, 2)) @ [1, 1j]
    packed = pack_flow(flows)
    assert packed.shape == (5, Structure(3, 4, False, "paper").flow_size)
    for row, flow in zip(packed, flows, strict=True):
        np.testing.assert_array_equal(row, pack_flow(flow))
        real, imaginary = row.reshape(2, 9, 6)
        np.testing.assert_array_equal(real + 1j * imaginary, flow)


def test_a_series_of_states_gives_a_series_of_loads():
    arm = Arm(UNEQUAL, water("textbook"))
    rng = np.random.default_rng(5)
    q, qd = rng.uniform(-2, 2, (2, 7, 3))
    flow = np.array([polynomial_flow(arm.structure, rng)[0] for _ in q])
    together = arm.load_terms(q, qd, flow, 0.02)
    for row in range(7):
        for name, load in arm.load_terms(q[row], qd[row], flow[row], 0.02).items():
            np.testing.assert_array_equal(together[name][row], load)
    loads = arm.fluid_load(q, qd, flow, 0.02)
    assert loads.shape == (7, 3)
    np.testing.assert_allclose(loads[2], arm.fluid_load(q[2], qd[2], flow[2], 0.02), rtol=1e-12)
