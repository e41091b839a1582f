"""The fast solver and the planner against programs that state the same problems anew."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from softwave_min.control.baseline import KinematicPlanner
from softwave_min.control.compiled.engine import Engine
from softwave_min.control.nmpc import GaussNewton
from softwave_min.control.predictor import PeriodSteps, stage_function
from softwave_min.control.problem import Status
from softwave_min.control.reference import convex, interior_point
from softwave_min.control.reference.convex import (
    ConvexGaussNewton,
    ConvexPlanner,
    UnsolvedError,
    sqp_step,
)
from softwave_min.control.reference.interior_point import InteriorPoint, transition_function
from softwave_min.experiments.places import in_sea
from softwave_min.native import compiler
from softwave_min.paper.cases import poses
from softwave_min.simulation import NmpcController, Scenario, simulate, solver_of
from softwave_min.simulation.plant import CvodesPlant, ExtrapolatedPlant
from softwave_min.waves import Sea


def scenario_of(nominal, pose="P3", duration=4.0, failure=None, **nmpc):
    parameters = replace(
        nominal,
        simulation=replace(nominal.simulation, duration=duration),
        nmpc=replace(nominal.nmpc, **{"tolerance": 1e-8, "max_iterations": 100, **nmpc}),
        failure=replace(nominal.failure, **(failure or {})),
    )
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    return Scenario.build(parameters, sea, poses()[pose])


class Recorder:
    """A solver that keeps what it is asked."""

    def __init__(self, solver):
        self.solver, self.asked = solver, []

    def solve(self, problem, guess):
        self.asked.append((problem, guess))
        return self.solver.solve(problem, guess)


def recorded(scenario):
    """Problems and guesses of a closed loop."""
    recorder = Recorder(solver_of(scenario))
    simulate(scenario, NmpcController(scenario, recorder))
    return recorder.asked


def numpy_solver(scenario):
    return GaussNewton(scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)


def fast_solvers(scenario):
    yield numpy_solver(scenario)
    if compiler() is not None:
        p = scenario.parameters
        gains = (scenario.believed_gains, scenario.gains)
        yield Engine(scenario.arm, *gains, p.nmpc, p.simulation)


def reference(scenario, **settings):
    return InteriorPoint(
        scenario.arm, scenario.believed_gains, scenario.parameters.nmpc, **settings
    )


@pytest.mark.parametrize(
    ("pose", "settings"),
    [
        ("P1", {}),
        ("P3", {}),
        ("P1", {"angle_bound": 0.5}),
        ("P3", {"torque_bound": 0.6, "torque_weight": 30.0}),
        ("P3", {"failure": {"segment": 2}}),
        ("P6", {"failure": {"segment": 1, "manner": "locked"}, "terminal_weight": 3.0}),
    ],
)
def test_the_fast_solvers_end_where_the_interior_point_method_does(nominal, pose, settings):
    scenario = scenario_of(nominal, pose, **settings)
    ipopt = reference(scenario)
    for problem, guess in recorded(scenario)[2::13]:
        expected = ipopt.solve(problem, guess)
        assert expected.status is Status.CONVERGED
        for solver in fast_solvers(scenario):
            found = solver.solve(problem, guess)
            assert found.status is Status.CONVERGED
            assert np.max(np.abs(found.inputs[0] - expected.inputs[0])) < 1e-5
            assert found.cost == pytest.approx(expected.cost, rel=1e-8)


def test_the_cases_of_the_comparison_are_not_all_alike(nominal):
    """Bounds on angle and torque are active in the recorded problems."""
    bounded = scenario_of(nominal, "P1", angle_bound=0.5)
    problem, guess = recorded(bounded)[2]
    assert np.any(np.abs(numpy_solver(bounded).solve(problem, guess).inputs) == 0.5)
    soft = scenario_of(nominal, torque_bound=0.6, torque_weight=30.0)
    problem, guess = recorded(soft)[2]
    solver = numpy_solver(soft)
    plan = solver.solve(problem, guess).inputs
    assert np.any(np.abs(solver.predict(problem.state, plan, problem.forecast).torques) > 0.6)


def test_unrolled_or_called_the_program_is_the_same(nominal):
    scenario = scenario_of(nominal, horizon=4, duration=0.5)
    problem, guess = recorded(scenario)[3]
    called, unrolled = (
        reference(scenario, expand=expand).solve(problem, guess) for expand in (False, True)
    )
    np.testing.assert_allclose(called.inputs, unrolled.inputs, rtol=0, atol=1e-9)


def test_the_interior_point_method_reports_how_it_ended_and_recovers(nominal, monkeypatch):
    scenario = scenario_of(nominal, duration=0.5)
    problem, guess = recorded(scenario)[1]
    ipopt = reference(scenario)
    good = ipopt.solve(problem, guess)
    bad = ipopt.solve(replace(problem, state=np.full(6, np.nan)), guess)
    assert bad.status is Status.NOT_FINITE
    assert np.isnan(bad.cost)
    np.testing.assert_array_equal(ipopt.solve(problem, guess).inputs, good.inputs)
    monkeypatch.setattr(interior_point, "MAX_ITERATIONS", 1)
    cut_short = reference(scenario, tolerance=2e-10).solve(problem, guess)
    assert (cut_short.status, cut_short.iterations) == (Status.ITERATION_LIMIT, 1)


@pytest.mark.parametrize("morison", ["paper", "textbook"])
def test_the_derivatives_in_closed_form_are_those_of_automatic_differentiation(nominal, morison):
    scenario = scenario_of(replace(nominal, fluid=replace(nominal.fluid, morison=morison)))
    model = (scenario.arm.structure, PeriodSteps(0.1, 2, 3))
    stage, transition = stage_function(*model), transition_function(*model)
    by_definition = transition.factory(
        "by_definition",
        transition.name_in(),
        [f"jac:{one}:{other}" for one in ("next", "torque") for other in ("x", "q_bar")],
    )
    rng = np.random.default_rng(1)
    for flow in scenario.flow[:40:10]:
        state, q_bar, load = rng.normal(size=6), rng.normal(size=3), rng.normal(size=3)
        inputs = (state, q_bar, flow, load, scenario.gains, scenario.arm.values)
        after = dict(zip(stage.name_out(), stage(*inputs), strict=True))
        ours = [after[name] for name in ("A", "B", "torque_by_state", "torque_by_command")]
        for one, other in zip(ours, by_definition(*inputs), strict=True):
            np.testing.assert_allclose(one.full(), other.full(), rtol=0, atol=1e-10)


def cost_function(scenario):
    """Value and gradient of the cost as the paper prints it, differentiated automatically."""
    weights, n = scenario.parameters.nmpc, scenario.arm.segments
    transition = transition_function(scenario.arm.structure, PeriodSteps.of(weights))
    inputs = ca.MX.sym("inputs", n, weights.horizon)

    def evaluate(problem, plan):
        x, before, cost = ca.DM(problem.state), ca.DM(problem.previous), ca.MX(0)
        for k in range(weights.horizon):
            told = (problem.forecast.flow[k], problem.forecast.disturbance[k])
            fixed = (scenario.believed_gains, scenario.arm.values)
            x, tip, _ = transition(x, inputs[:, k], *told, *fixed)
            if k + 1 < weights.horizon:
                cost += weights.tip_weight * ca.sumsqr(tip - problem.reference[k])
            cost += weights.step_weight * ca.sumsqr(inputs[:, k] - before)
            before = inputs[:, k]
        both = ca.Function("both", [inputs], [cost, ca.gradient(cost, inputs)])
        value, gradient = both(plan.T)
        return float(value), gradient.full().T

    return evaluate


@pytest.mark.parametrize("bound", [np.pi, 0.5])
def test_the_projected_gradient_vanishes_at_a_converged_plan(nominal, bound):
    scenario = scenario_of(nominal, "P1", angle_bound=bound)
    evaluate = cost_function(scenario)
    for problem, guess in recorded(scenario)[1::13]:
        for solver in fast_solvers(scenario):
            found = solver.solve(problem, guess)
            cost, gradient = evaluate(problem, found.inputs)
            assert found.cost == pytest.approx(cost, rel=1e-10)
            moved = np.clip(found.inputs - gradient, -bound, bound)
            assert np.max(np.abs(moved - found.inputs)) < 1e-6


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"angle_bound": 0.4},
        {"terminal_weight": 2.0},
        {"torque_bound": 0.6, "torque_weight": 30.0},
    ],
)
def test_the_step_posed_in_cvxpy_is_the_one_that_the_solver_takes(nominal, settings):
    scenario = scenario_of(nominal, duration=1.0, **settings)
    solver, bound = numpy_solver(scenario), scenario.parameters.nmpc.angle_bound
    rng, touched = np.random.default_rng(6), 0
    for problem, guess in recorded(scenario):
        inputs = np.clip(guess + 0.2 * rng.standard_normal(guess.shape), -bound, bound)
        ours = solver.step(inputs, *solver.residual(problem, inputs))
        posed = sqp_step(problem, inputs, solver)
        np.testing.assert_allclose(posed, ours, rtol=0, atol=1e-7)
        assert np.max(np.abs(ours)) > 1e-2
        touched += np.any(np.abs(inputs + ours) > bound - 1e-9)
    assert (touched > 5) == ("angle_bound" in settings)


def planners(nominal, bound):
    scenario = scenario_of(nominal, duration=0.1)
    plain = KinematicPlanner(scenario.arm, nominal.baseline, 0.1)
    return scenario.arm, plain, ConvexPlanner(scenario.arm, nominal.baseline, 0.1, bound)


@pytest.mark.parametrize("pose", ["P1", "P3", "P6"])
def test_the_convex_planner_is_the_plain_one_where_no_bound_is_active(nominal, pose):
    _, plain, convex = planners(nominal, np.pi)
    targets = np.tile(poses()[pose], (100, 1))
    expected = plain.path(np.zeros(3), targets)
    assert np.ptp(expected) > 0.5
    np.testing.assert_allclose(convex.path(np.zeros(3), targets), expected, rtol=0, atol=1e-6)


def test_bounds_of_the_convex_planner_hold_and_cost_no_reachable_target(nominal):
    target = np.array(poses()["P1"])
    targets = np.tile(target, (150, 1))
    arm, plain, _ = planners(nominal, np.pi)
    bound = 0.95 * np.max(np.abs(plain.path(np.zeros(3), targets)))
    path = planners(nominal, bound)[2].path(np.zeros(3), targets)
    assert np.max(np.abs(path)) == pytest.approx(bound)
    assert np.max(np.abs(path)) <= bound
    assert np.linalg.norm(arm.tip(path[-1]) - target) < 1e-6


def test_bounds_in_the_program_lead_closer_than_clipping_its_answer(nominal):
    # Out of reach under this bound: the other angles must make up for the clipped one.
    target, bound = np.array(poses()["P1"]), 1.2
    targets = np.tile(target, (150, 1))
    arm, plain, convex = planners(nominal, bound)
    bounded = convex.path(np.zeros(3), targets)[-1]
    clipped = plain.first_posture(np.zeros(3), target)
    for _ in targets:
        clipped = np.clip(plain.step(clipped, target), -bound, bound)
    least, miss = (np.linalg.norm(arm.tip(q) - target) for q in (bounded, clipped))
    assert least < miss / 2


def test_a_convex_program_that_is_not_solved_gives_no_step(nominal, monkeypatch):
    scenario = scenario_of(nominal, duration=0.3, angle_bound=0.2)
    problem, guess = recorded(scenario)[1]
    solver = ConvexGaussNewton(scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)
    planner = planners(nominal, np.pi)[2]
    monkeypatch.setitem(convex.SETTINGS, "max_iter", 1)
    with pytest.raises(UnsolvedError, match=r"user_limit|inaccurate"):
        solver.solve(problem, guess)
    with pytest.raises(UnsolvedError, match=r"user_limit|inaccurate"):
        planner.step(np.zeros(3), np.array(poses()["P1"]))


def test_the_convex_planner_needs_damping(nominal):
    with pytest.raises(ValueError, match="damping"):
        planners(replace(nominal, baseline=replace(nominal.baseline, damping=0.0)), np.pi)


@pytest.fixture(scope="module")
def predicted(nominal):
    """Plans of closed loops in 3 m waves, and where they lead the tip at 1e-11."""
    cases = []
    for wave, pose in (("W1", "P4"), ("W2", "P1"), ("W3", "P3")):
        quiet = replace(nominal, preview=replace(nominal.preview, noise="none"))
        scenario = scenario_of(in_sea(quiet, wave, 3.0), pose, duration=8.0, tolerance=1e-6)
        tight = {"relative_tolerance": 1e-11, "absolute_tolerance": 1e-12, "largest_step": 0.1}
        plant = CvodesPlant(
            scenario.arm, scenario.gains, replace(nominal.simulation, **tight), scenario.period
        )
        solver = solver_of(scenario)
        for problem, guess in recorded(scenario)[::10]:
            plan, state, tips = solver.solve(problem, guess).inputs, problem.state, []
            for q_bar, flow in zip(plan, problem.forecast.flow, strict=True):
                state = plant.advance(state, q_bar, flow)
                tips.append(scenario.arm.tip(state[:3]))
            cases.append((problem, plan, np.array(tips)))
    return cases


def prediction_errors(nominal, predicted, columns):
    """Distance of the predicted tips from the tight ones, (plans, K) in m."""
    scenario = scenario_of(nominal, duration=0.1)
    horizon = scenario.parameters.nmpc.horizon
    steps = PeriodSteps(scenario.period, 1, columns)
    predict = transition_function(scenario.arm.structure, steps)
    fixed = [
        np.tile(one[:, None], horizon) for one in (scenario.believed_gains, scenario.arm.values)
    ]
    rollout = predict.mapaccum(horizon)
    return np.array(
        [
            np.linalg.norm(
                rollout(p.state, plan.T, p.forecast.flow.T, p.forecast.disturbance.T, *fixed)[1]
                .full()
                .T
                - tips,
                axis=1,
            )
            for p, plan, tips in predicted
        ]
    )


def test_the_predictor_is_off_by_less_than_a_millimetre(nominal, predicted):
    settings = nominal.nmpc
    assert settings.substeps == 1
    errors = prediction_errors(nominal, predicted, settings.extrapolation_columns)
    assert np.max(errors) < 1e-3


@pytest.mark.parametrize("columns", [1, 2])
def test_each_column_of_the_extrapolation_makes_the_predictor_better(nominal, predicted, columns):
    coarse, fine = (
        np.sqrt(np.mean(prediction_errors(nominal, predicted, count) ** 2))
        for count in (columns, columns + 1)
    )
    assert coarse > 4 * fine


@pytest.mark.parametrize(("substeps", "columns"), [(1, 1), (1, 3), (2, 2)])
def test_the_predictor_goes_a_period_as_the_plant_does(nominal, predicted, substeps, columns):
    scenario = scenario_of(nominal, duration=0.1)
    problem, plan, _ = predicted[1]
    flow, state, q_bar = problem.forecast.flow[0], problem.state, plan[0]
    numerics = {"extrapolated_steps": substeps, "extrapolation_columns": columns}
    simulation = replace(nominal.simulation, **numerics)
    plant = ExtrapolatedPlant(scenario.arm, scenario.gains, simulation, scenario.period)
    stage = stage_function(scenario.arm.structure, PeriodSteps(scenario.period, substeps, columns))
    after = stage(state, q_bar, flow, np.zeros(3), scenario.believed_gains, scenario.arm.values)[0]
    expected = plant.advance(state, q_bar, flow)
    np.testing.assert_allclose(after.full().ravel(), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("columns", [1, 2, 3])  # beyond, the corner of |v| v shows
def test_the_order_of_an_extrapolation_is_the_number_of_its_columns(nominal, predicted, columns):
    scenario = scenario_of(nominal, duration=0.1)
    problem, plan, _ = predicted[1]

    def after(steps, columns):
        numerics = {"extrapolated_steps": steps, "extrapolation_columns": columns}
        simulation = replace(nominal.simulation, **numerics)
        plant = ExtrapolatedPlant(scenario.arm, scenario.gains, simulation, scenario.period)
        return plant.advance(problem.state, plan[0], problem.forecast.flow[0])

    exact = after(200, 5)
    errors = [np.linalg.norm(after(steps, columns) - exact) for steps in (8, 16)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(columns, abs=0.4)


@pytest.mark.parametrize("name", ["interior_point", "convex"])
def test_the_solver_is_a_setting(nominal, name):
    fast, asked = (
        scenario_of(nominal, "P1", duration=0.3, horizon=5, solver=solver)
        for solver in ("gauss_newton", name)
    )
    ours, theirs = simulate(fast, "nmpc"), simulate(asked, "nmpc")
    assert (theirs.status == Status.CONVERGED).all()
    np.testing.assert_allclose(theirs.q_bar, ours.q_bar, rtol=0, atol=1e-6)
