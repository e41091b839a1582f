"""The plant, the closed loop and what the controllers are told of the sea."""

from dataclasses import replace

import numpy as np
import pytest
from arm_cases import acceleration_function
from scipy.integrate import solve_ivp

from softwave_min.arm import pack_flow
from softwave_min.control.preview import Preview, noise_deviation
from softwave_min.native import compiler
from softwave_min.simulation import (
    BaselineController,
    Command,
    NmpcController,
    Scenario,
    SimulationError,
    plant_of,
    root_mean_square_error,
    simulate,
)
from softwave_min.simulation.plant import (
    CvodesPlant,
    ExtrapolatedPlant,
    RungeKuttaPlant,
    rate_function,
)
from softwave_min.waves import Sea

P1, P3, P4 = (0.3, -3.7), (0.7, -3.7), (0.3, -4.3)
CONTROLLERS = [BaselineController, NmpcController]


def lasting(parameters, duration, **changes):
    """The parameter set with a run of another length, and other numerics of the plant."""
    simulation = replace(parameters.simulation, duration=duration, **changes)
    return replace(parameters, simulation=simulation)


@pytest.fixture(scope="module")
def sea(nominal):
    return Sea.random(nominal.sea, nominal.fluid.gravity)


@pytest.mark.parametrize("morison", ["paper", "textbook"])
def test_a_period_of_every_plant_is_the_equation_of_motion(nominal, sea, morison):
    """tau = K(q_bar) + G(q_bar) + alpha (q_bar - q) - beta q' in the sea of that time.

    The same period by an explicit Runge-Kutta method of order 8 at 1e-11, the loads from
    the functions of the arm; the start is as rough as it gets.
    """
    gains = replace(
        nominal.baseline, proportional_gain=(5.0, 3.0, 1.0), derivative_gain=(1.0, 0.5, 0.1)
    )
    fluid = replace(nominal.fluid, morison=morison)
    parameters = replace(nominal, fluid=fluid, baseline=gains)
    scenario = Scenario.build(lasting(parameters, 5.0), sea, P3)
    arm, flow = scenario.arm, scenario.flow[40]
    q_bar = np.array([0.8, -0.3, 0.6])
    start = np.array([0.4, -0.9, 0.5, 0.7, -1.0, 2.0])
    acceleration = acceleration_function(arm.structure)

    def rate(time, x):
        q, qd = np.split(x, 2)
        torque = arm.stiffness_vector(q_bar) + arm.gravity_vector(q_bar)
        torque += gains.proportional_gain * (q_bar - q) - np.array(gains.derivative_gain) * qd
        force = torque + arm.fluid_load(q, qd, flow, time - 0.05)
        return np.concatenate([qd, acceleration(q, qd, force, arm.values, 0).full().ravel()])

    expected = solve_ivp(rate, (0, 0.1), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    plants = [
        (CvodesPlant, 2, 1e-6),
        (RungeKuttaPlant, 2, 1e-7),
        (ExtrapolatedPlant, 2, 2e-3),
        (ExtrapolatedPlant, 20, 3e-6),
    ]
    for kind, steps, tolerance in plants:
        simulation = replace(parameters.simulation, extrapolated_steps=steps)
        end = kind(arm, scenario.gains, simulation, 0.1).advance(start, q_bar, flow)
        np.testing.assert_allclose(end, expected, rtol=0, atol=tolerance)


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_the_compiled_plant_is_the_interpreted_one(nominal, sea):
    scenario = Scenario.build(lasting(nominal, 5.0), sea, P3)
    compiled = plant_of(scenario)
    interpreted = ExtrapolatedPlant(
        scenario.arm, scenario.gains, scenario.parameters.simulation, scenario.period
    )
    assert type(compiled) is not type(interpreted)
    state = other = np.array([0.4, -0.9, 0.5, 0.7, -1.0, 2.0])
    for row in scenario.flow[:20]:
        state = interpreted.advance(state, np.array([0.8, -0.3, 0.6]), row)
        other = compiled.advance(other, np.array([0.8, -0.3, 0.6]), row)
    np.testing.assert_allclose(other, state, rtol=1e-9)


@pytest.mark.parametrize("pose", [P3, P4])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_without_waves_the_tip_reaches_its_pose(nominal, pose, controller):
    still = Sea.still(nominal.sea.depth, nominal.fluid.gravity)
    scenario = Scenario.build(lasting(nominal, 10.0), still, pose)
    error = simulate(scenario, controller(scenario)).error
    assert error[0] > 0.2
    assert np.max(error[70:]) < 1e-3
    assert error[-1] < 1e-4


@pytest.mark.parametrize(
    ("controller", "pose", "period", "duration"),
    [
        (BaselineController, P1, 6.1, 60.0),
        (BaselineController, P4, 10.0, 60.0),
        (NmpcController, P3, 6.1, 10.0),
        (NmpcController, P4, 10.0, 20.0),
    ],
)
def test_the_tips_path_does_not_depend_on_the_plants_steps(
    nominal, controller, pose, period, duration
):
    """Steps of half the size, and a tight CVODES: less than 0.1 mm.

    The hardest are the coiled poses under the controller that lets the arm swing.
    """
    parameters = replace(nominal, sea=replace(nominal.sea, peak_period=period))
    waves = Sea.random(parameters.sea, parameters.fluid.gravity)
    halved = {"extrapolated_steps": 2 * parameters.simulation.extrapolated_steps}
    tight = {"integrator": "cvodes", "relative_tolerance": 1e-8, "absolute_tolerance": 1e-10}
    paths = []
    for changes in ({}, halved, tight):
        scenario = Scenario.build(lasting(parameters, duration, **changes), waves, pose)
        paths.append(simulate(scenario, controller(scenario)).tips[:, -1])
    for other in paths[1:]:
        assert 0 < np.max(np.hypot(*(other - paths[0]).T)) < 1e-4


@pytest.fixture(scope="module")
def steepest(nominal):
    """Two seconds of the baseline's loop where the water is fastest: W1, 3 m, P3."""
    parameters = replace(nominal, sea=replace(nominal.sea, significant_height=3.0, peak_period=6.1))
    waves = Sea.random(parameters.sea, parameters.fluid.gravity)
    return Scenario.build(lasting(parameters, 2.0), waves, P3)


def tips_by(scenario, advance):
    """The tip at the control instants, under the planner's commands."""
    states = [np.zeros(6)]
    for q_bar, flow in zip(scenario.planned_angles, scenario.flow[: scenario.steps], strict=False):
        states.append(advance(states[-1], q_bar, flow))
    return scenario.arm.tip(np.array(states)[:, :3])


@pytest.fixture(scope="module")
def tight_tips(steepest):
    """By the explicit method of order 8 of Dormand and Prince, at a tolerance of 1e-11."""
    rate, half = rate_function(steepest.arm.structure), steepest.period / 2

    def advance(state, q_bar, flow):
        def derivative(time, x):
            return rate(x, time, q_bar, flow, steepest.gains, steepest.arm.values).full().ravel()

        options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}
        return solve_ivp(derivative, (-half, half), state, **options).y[:, -1]

    return tips_by(steepest, advance)


@pytest.mark.parametrize(
    ("integrator", "bound"), [("extrapolation", 2e-5), ("cvodes", 1e-8), ("runge_kutta", 1e-9)]
)
def test_error_of_each_integrator_in_the_steepest_sea(steepest, tight_tips, integrator, bound):
    """With the nominal steps and tolerances, in m at the tip over a closed loop."""
    simulation = replace(steepest.parameters.simulation, integrator=integrator)
    chosen = replace(steepest, parameters=replace(steepest.parameters, simulation=simulation))
    tips = tips_by(steepest, plant_of(chosen).advance)
    assert 0 < np.max(np.hypot(*(tips - tight_tips).T)) < bound


class Held:
    """A controller that never changes its command."""

    def __init__(self, q_bar):
        self.q_bar = np.array(q_bar)

    def command(self, step, state):  # noqa: ARG002
        return Command(self.q_bar)


def test_the_closed_loop_meets_the_sea_of_its_time(nominal, sea):
    """One second from t = 0, against an integration that asks the sea anew at every time."""
    parameters = lasting(nominal, 1.0, integrator="cvodes")
    scenario = Scenario.build(parameters, sea, P3, initial_angles=(0.3, 0.2, -0.4))
    q_bar = np.array([0.8, -0.3, 0.6])
    run = simulate(scenario, Held(q_bar))
    arm, gains = scenario.arm, nominal.baseline
    acceleration = acceleration_function(arm.structure)
    feedforward = arm.stiffness_vector(q_bar) + arm.gravity_vector(q_bar)

    def rate(time, x):
        q, qd = np.split(x, 2)
        flow = pack_flow(sea.taylor_velocity(nominal.arm.base_position, [time], 8, 5)[0])
        feedback = gains.proportional_gain * (q_bar - q) - np.array(gains.derivative_gain) * qd
        force = feedforward + feedback + arm.fluid_load(q, qd, flow)
        return np.concatenate([qd, acceleration(q, qd, force, arm.values, 0).full().ravel()])

    start = np.array([0.3, 0.2, -0.4, 0.0, 0.0, 0.0])
    path = solve_ivp(rate, (0, 1), start, method="BDF", rtol=1e-8, atol=1e-10, t_eval=run.time)
    np.testing.assert_allclose(np.hstack([run.q, run.qd]), path.y.T, rtol=0, atol=2e-6)


def test_record_of_a_run(nominal, sea):
    scenario = Scenario.build(lasting(nominal, 2.0), sea, P4)
    run = simulate(scenario, BaselineController(scenario))
    arm, gains = scenario.arm, nominal.baseline
    np.testing.assert_allclose(run.time, np.arange(21) * 0.1)
    np.testing.assert_array_equal(run.q[0], np.zeros(3))
    np.testing.assert_array_equal(run.target, np.tile(P4, (21, 1)))
    np.testing.assert_allclose(run.tips, arm.segment_tips(run.q))
    np.testing.assert_allclose(run.error, np.linalg.norm(arm.tip(run.q) - P4, axis=1))
    np.testing.assert_array_equal(run.q_bar, scenario.planned_angles[:20])
    torque = (
        arm.stiffness_vector(run.q_bar)
        + arm.gravity_vector(run.q_bar)
        + np.array(gains.proportional_gain) * (run.q_bar - run.q[:-1])
        - np.array(gains.derivative_gain) * run.qd[:-1]
    )
    np.testing.assert_allclose(run.torque, torque, rtol=1e-12)
    flow = pack_flow(sea.taylor_velocity(nominal.arm.base_position, run.time[:-1], 8, 5))
    load = arm.fluid_load(run.q[:-1], run.qd[:-1], flow)
    np.testing.assert_allclose(run.wave_torque, load, rtol=0, atol=1e-7)
    assert np.all(run.status == -1)
    assert np.all(run.iterations == 0)
    assert root_mean_square_error(np.array([3.0, 4.0])) == pytest.approx(np.sqrt(12.5))


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_sea_or_a_start_that_is_not_finite_stops_the_run(nominal, sea, controller):
    scenario = Scenario.build(lasting(nominal, 2.0), sea, P3)
    nowhere = replace(scenario, initial_angles=np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(SimulationError, match=r"^the state is not finite at t = 0\.0 s$"):
        simulate(nowhere, controller(scenario))
    scenario.flow[7, 3] = np.nan
    with pytest.raises(SimulationError, match=r"^the sea is not finite from t = 0\.7 s$"):
        simulate(scenario, controller(scenario))


@pytest.mark.parametrize("integrator", ["extrapolation", "cvodes", "runge_kutta"])
def test_a_state_that_is_not_finite_stops_the_run(nominal, sea, integrator):
    scenario = Scenario.build(lasting(nominal, 2.0, integrator=integrator), sea, P3)
    planned = scenario.planned_angles

    class Failing:
        def command(self, step, state):  # noqa: ARG002
            return Command(planned[step] if step < 5 else np.full(3, np.nan))

    with pytest.raises(SimulationError, match=r"^the state is not finite at t = 0\.6 s$"):
        simulate(scenario, Failing())


def test_preview_and_plant_meet_the_same_sea(nominal, sea):
    """Row j of the forecast at step i is the sea from t = (i + j) dt, at all points in reach."""
    scenario = Scenario.build(lasting(nominal, 5.0), sea, P3)
    horizon, dt = nominal.nmpc.horizon, scenario.period
    preview = Preview(scenario.flow, np.zeros(3), horizon, nominal.preview)
    orders = scenario.arm.structure.space_order + 1, scenario.arm.structure.time_order + 1
    reach = 0.9 * np.exp(1j * np.linspace(0, 2 * np.pi, 7))
    for step in (0, 13, 49):
        flow = preview.at(step).flow
        assert flow.shape == (horizon, scenario.arm.structure.flow_size)
        for j in range(horizon):
            np.testing.assert_array_equal(flow[j], scenario.flow[step + j])
            coefficients = (np.array([1, 1j]) @ flow[j].reshape(2, -1)).reshape(orders)
            for offset in (0.0, *reach):
                where = np.real(offset), np.imag(offset) + nominal.arm.base_position[1]
                for fraction in (0.0, 0.5, 1.0):
                    time = (step + j + fraction) * dt
                    found = np.polynomial.polynomial.polyval2d(
                        offset, (fraction - 0.5) * dt, coefficients
                    )
                    u, w = sea.velocity(*where, time)
                    assert abs(found - (u - 1j * w)) < 1e-6


@pytest.mark.parametrize(("noise", "ratio"), [("decibel", 100.0), ("ratio", 20.0)])
def test_signal_to_noise_ratio_as_measured(nominal, noise, ratio):
    """The ratio of the powers, for each load by itself, over 30000 draws."""
    parameters = replace(nominal.preview, noise=noise)
    assert parameters.signal_to_noise == 20
    signal = np.sin(np.arange(600))[:, None] * [8.0, 3.0, 0.5]
    deviation = noise_deviation(parameters, signal)
    preview = Preview(np.zeros((2015, 4)), deviation, 15, parameters)
    noise = np.concatenate([preview.at(step).disturbance for step in range(2000)])
    measured = np.mean(signal**2, axis=0) / np.mean(noise**2, axis=0)
    np.testing.assert_allclose(measured, ratio, rtol=0.03)
    assert np.all(np.abs(np.mean(noise, axis=0)) < 4 * deviation / np.sqrt(len(noise)))


def test_without_noise_there_is_none(nominal):
    parameters = replace(nominal.preview, noise="none")
    deviation = noise_deviation(parameters, np.ones((10, 3)))
    assert not np.any(Preview(np.zeros((20, 4)), deviation, 5, parameters).at(3).disturbance)


def disturbances(nominal, step, **changes):
    """The noise of a forecast of 15 periods, unit deviation."""
    parameters = replace(nominal.preview, **changes)
    return Preview(np.zeros((40, 4)), np.ones(3), 15, parameters).at(step).disturbance


def test_frozen_noise_belongs_to_the_time_it_speaks_of(nominal):
    for redrawn in (False, True):
        first, later = (disturbances(nominal, step, redrawn=redrawn) for step in (3, 4))
        assert np.all((first[1:] == later[:-1]) != redrawn)
        np.testing.assert_array_equal(disturbances(nominal, 3, redrawn=redrawn), first)


def test_one_seed_one_noise(nominal):
    one, same, other = (disturbances(nominal, 0, seed=seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one, same)
    assert not np.any(one == other)


def test_noise_refers_to_the_load_on_an_arm_held_at_the_plan(nominal, sea):
    scenario = Scenario.build(lasting(nominal, 3.0), sea, P3)
    planned, middles = scenario.planned_angles[:30], 0.1 * np.arange(30) + 0.05
    flow = pack_flow(sea.taylor_velocity(nominal.arm.base_position, middles, 8, 5))
    expected = scenario.arm.fluid_load(planned, np.zeros_like(planned), flow)
    np.testing.assert_allclose(scenario.held_loads, expected, rtol=1e-12)
