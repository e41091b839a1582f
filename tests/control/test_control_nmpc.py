"""The optimal control problem and its solvers."""

from collections import Counter
from copy import deepcopy
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from arm_cases import uniform
from scipy.optimize import lsq_linear

from softwave_min.arm import Arm
from softwave_min.control.baseline import InnerLoop
from softwave_min.control.compiled import engine as compiled
from softwave_min.control.compiled.engine import Engine
from softwave_min.control.nmpc import GaussNewton
from softwave_min.control.preview import Forecast
from softwave_min.control.problem import Problem, Status
from softwave_min.native import build, compiler
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import FailureParameters, parameter_set
from softwave_min.simulation import NmpcController, Scenario, plant_of, preview_of
from softwave_min.simulation.plant import ExtrapolatedPlant
from softwave_min.waves import Sea

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")


def scenario_at(nominal, pose="P3", duration=3.0, **nmpc):
    parameters = replace(
        nominal,
        simulation=replace(nominal.simulation, duration=duration),
        nmpc=replace(nominal.nmpc, **nmpc),
    )
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    return Scenario.build(parameters, sea, poses()[pose])


def solvers(scenario):
    p = scenario.parameters
    return (
        GaussNewton(scenario.arm, scenario.believed_gains, p.nmpc),
        Engine(scenario.arm, scenario.believed_gains, scenario.gains, p.nmpc, p.simulation),
    )


def recorded_problems(scenario, count):
    """Problems and guesses that a closed loop under the NumPy solver meets."""
    p = scenario.parameters
    solver = GaussNewton(scenario.arm, scenario.believed_gains, p.nmpc)
    preview = preview_of(scenario)
    plant = plant_of(scenario)
    n, horizon = scenario.arm.segments, p.nmpc.horizon
    state, previous = np.zeros(2 * n), np.zeros(n)
    guess = np.zeros((horizon, n))
    for step in range(count):
        reference = scenario.targets[step + 1 : step + 1 + horizon]
        problem = Problem(state, previous, reference, preview.at(step))
        yield problem, guess
        solution = solver.solve(problem, guess)
        previous = solution.inputs[0]
        guess = np.vstack([solution.inputs[1:], solution.inputs[-1:]])
        state = plant.advance(state, previous, scenario.flow[step])


def random_problem(scenario, rng):
    n, horizon = scenario.arm.segments, scenario.parameters.nmpc.horizon
    flow = scenario.flow[:horizon]
    return Problem(
        rng.normal(size=2 * n),
        rng.uniform(-1, 1, n),
        np.tile(rng.uniform([-1, -5], [1, -3]), (horizon, 1)),
        Forecast(flow, 0.1 * rng.standard_normal((horizon, n))),
    ), rng.uniform(-2, 2, (horizon, n))


def test_the_jacobian_of_the_residuals_is_their_derivative(nominal):
    scenario = scenario_at(nominal, terminal_weight=2.0)
    solver, _ = solvers(scenario) if compiler() else (first_solver(scenario), None)
    problem, inputs = random_problem(scenario, np.random.default_rng(3))
    _, jacobian = solver.residual(problem, inputs)
    width = 1e-6
    for column in np.random.default_rng(4).choice(inputs.size, 12, replace=False):
        move = np.zeros(inputs.size)
        move[column] = width
        move = move.reshape(inputs.shape)
        up, _ = solver.residual(problem, inputs + move)
        down, _ = solver.residual(problem, inputs - move)
        np.testing.assert_allclose((up - down) / (2 * width), jacobian[:, column], atol=2e-6)


def first_solver(scenario):
    p = scenario.parameters
    return GaussNewton(scenario.arm, scenario.believed_gains, p.nmpc)


def test_the_cost_is_the_one_that_the_paper_prints(nominal):
    scenario = scenario_at(nominal)
    solver = first_solver(scenario)
    weights = scenario.parameters.nmpc
    problem, inputs = random_problem(scenario, np.random.default_rng(5))
    residual, _ = solver.residual(problem, inputs)
    tips = solver.predict(problem.state, inputs, problem.forecast).tips
    # x_0 is a constant, x_K is not in the sum
    errors = np.sum((tips - problem.reference)[:-1] ** 2)
    changes = np.sum(np.diff(np.vstack([problem.previous, inputs]), axis=0) ** 2)
    expected = weights.tip_weight * errors + weights.step_weight * changes
    assert residual @ residual == pytest.approx(expected, rel=1e-12)


@needs_compiler
def test_the_engine_takes_the_steps_of_the_numpy_solver(nominal):
    scenario = scenario_at(nominal)
    numpy_solver, engine = solvers(scenario)
    for problem, guess in recorded_problems(scenario, 25):
        ours, theirs = engine.solve(problem, guess), numpy_solver.solve(problem, guess)
        np.testing.assert_allclose(ours.inputs, theirs.inputs, rtol=0, atol=1e-9)
        assert ours.cost == pytest.approx(theirs.cost, rel=1e-9)
        assert (ours.status, ours.iterations) == (theirs.status, theirs.iterations)


@needs_compiler
@pytest.mark.parametrize(
    ("horizon", "substeps", "columns"), [(1, 1, 3), (8, 1, 2), (9, 2, 1), (2, 1, 5), (3, 2, 2)]
)
def test_the_engine_takes_any_number_of_periods_steps_and_columns(
    nominal, horizon, substeps, columns
):
    numerics = {"substeps": substeps, "extrapolation_columns": columns}
    scenario = scenario_at(nominal, horizon=horizon, terminal_weight=1.0, **numerics)
    numpy_solver, engine = solvers(scenario)
    rng = np.random.default_rng(horizon)
    for _ in range(3):
        problem, guess = random_problem(scenario, rng)
        ours, theirs = engine.solve(problem, guess), numpy_solver.solve(problem, guess)
        np.testing.assert_allclose(ours.inputs, theirs.inputs, rtol=0, atol=1e-8)
        assert ours.cost == pytest.approx(theirs.cost, rel=1e-9)
        assert (ours.status, ours.iterations) == (theirs.status, theirs.iterations)


@needs_compiler
@pytest.mark.parametrize(("steps", "columns"), [(1, 1), (3, 2), (1, 5), (2, 8)])
def test_the_engine_moves_the_plant_as_its_readable_twin(nominal, steps, columns):
    numerics = {"extrapolated_steps": steps, "extrapolation_columns": columns}
    simulation = replace(nominal.simulation, **numerics)
    scenario = scenario_at(replace(nominal, simulation=simulation))
    readable = ExtrapolatedPlant(scenario.arm, scenario.gains, simulation, 0.1)
    _, engine = solvers(scenario)
    rng = np.random.default_rng(columns)
    for flow in scenario.flow[:30:10]:
        state, q_bar = rng.normal(size=6), rng.normal(size=3)
        expected = readable.advance(state, q_bar, flow)
        np.testing.assert_allclose(engine.advance(state, q_bar, flow), expected, atol=1e-8)


@needs_compiler
@pytest.mark.parametrize(("segments", "points", "failed"), [(1, 3, 0), (2, 5, 2)])
def test_the_engine_serves_any_number_of_segments_and_places(nominal, segments, points, failed):
    arm = Arm(uniform(segments, quadrature_points=points), nominal.fluid)
    cut = ("proportional_gain", "derivative_gain")
    some = {name: getattr(nominal.baseline, name)[:segments] for name in cut}
    gains = replace(nominal.baseline, **some)
    believed = InnerLoop.packed(gains, FailureParameters(failed, "locked", known=True))
    settings = replace(
        nominal.nmpc, horizon=9, substeps=2, torque_bound=0.5, torque_weight=30.0, max_iterations=4
    )
    engine = Engine(arm, believed, believed, settings, nominal.simulation)
    twin = GaussNewton(arm, believed, settings)
    plant = ExtrapolatedPlant(arm, believed, nominal.simulation, settings.control_period)
    rng = np.random.default_rng(segments)
    for _ in range(3):
        flow = 0.05 * rng.normal(size=(9, arm.structure.flow_size))
        problem = Problem(
            state=0.5 * rng.normal(size=2 * segments),
            previous=rng.uniform(-0.3, 0.3, segments),
            reference=np.tile(rng.uniform([-0.5, -4.5], [0.5, -3.5]), (9, 1)),
            forecast=Forecast(flow, 0.1 * rng.normal(size=(9, segments))),
        )
        guess = rng.uniform(-0.5, 0.5, (9, segments))
        ours, readable = engine.solve(problem, guess), twin.solve(problem, guess)
        assert (ours.status, ours.iterations) == (readable.status, readable.iterations)
        np.testing.assert_allclose(ours.inputs, readable.inputs, rtol=0, atol=1e-9)
        there = [one.advance(problem.state, guess[0], flow[0]) for one in (engine, plant)]
        np.testing.assert_allclose(*there, rtol=0, atol=1e-9)


def test_a_rollout_is_its_own_and_of_the_whole_horizon(nominal):
    scenario = scenario_at(nominal, duration=0.5)
    solver = first_solver(scenario)
    problem, guess = next(recorded_problems(scenario, 1))
    given = (problem.state, guess, problem.forecast)
    first = solver.predict(*given)
    kept = deepcopy(first)
    solver.predict(problem.state + 0.3, guess - 0.2, problem.forecast)
    for name, array in vars(kept).items():
        np.testing.assert_array_equal(getattr(first, name), array)
    with pytest.raises(ValueError, match="reshape"):
        solver.predict(problem.state, guess[:1], problem.forecast)


@needs_compiler
def test_the_engine_treats_active_bounds_as_the_library_does(nominal):
    # A bound this tight is active in every problem.
    scenario = scenario_at(nominal, angle_bound=0.4, max_iterations=1, real_time=True)
    numpy_solver, engine = solvers(scenario)
    rng = np.random.default_rng(7)
    active = 0
    for _ in range(20):
        problem, guess = random_problem(scenario, rng)
        inputs = np.clip(guess, -0.4, 0.4)
        residual, jacobian = numpy_solver.residual(problem, inputs)
        limits = (-0.4 - inputs.ravel(), 0.4 - inputs.ravel())
        library = lsq_linear(jacobian, -residual, limits, method="bvls", tol=1e-14).x
        found = engine.solve(problem, guess).inputs - inputs
        np.testing.assert_allclose(found.ravel(), library, rtol=0, atol=1e-8)
        active += np.any(np.abs(inputs + found) > 0.4 - 1e-12)
    assert active > 10


@pytest.mark.parametrize("bound", [np.pi, 0.5])
def test_a_converged_plan_satisfies_the_first_order_conditions(nominal, bound):
    scenario = scenario_at(nominal, angle_bound=bound, tolerance=1e-9, max_iterations=200)
    solver = first_solver(scenario)
    for problem, guess in recorded_problems(scenario, 8):
        solution = solver.solve(problem, guess)
        assert solution.status is Status.CONVERGED
        residual, jacobian = solver.residual(problem, solution.inputs)
        gradient = 2 * jacobian.T @ residual
        moved = np.clip(solution.inputs.ravel() - gradient, -bound, bound)
        assert np.max(np.abs(moved - solution.inputs.ravel())) < 1e-6


@pytest.mark.parametrize("in_c", [False, pytest.param(True, marks=needs_compiler)])
def test_real_time_iteration_takes_full_steps_and_no_more(nominal, in_c):
    scenario = scenario_at(nominal, real_time=True, max_iterations=3)
    readable = first_solver(scenario)
    solver = solvers(scenario)[1] if in_c else readable
    rng, risen = np.random.default_rng(12), 0
    for _ in range(6):
        problem, guess = hard_problem(scenario.flow, scenario.parameters.nmpc, 3, rng)
        inputs, costs = np.clip(guess, -np.pi, np.pi), []
        for _ in range(3):
            residual, jacobian = readable.residual(problem, inputs)
            inputs = inputs + readable.step(inputs, residual, jacobian)
            costs.append(residual @ residual)
        found = solver.solve(problem, guess)
        np.testing.assert_allclose(found.inputs, inputs, rtol=0, atol=1e-7)
        assert found.iterations == 3
        risen += costs != sorted(costs, reverse=True)
    assert risen  # where a line search would have shortened the step


@needs_compiler
def test_real_time_iteration_goes_on_where_nothing_is_left_to_do(nominal):
    scenario = scenario_at(nominal, real_time=True, max_iterations=20)
    problem, guess = next(recorded_problems(scenario, 1))
    for solver in solvers(scenario):
        found = solver.solve(problem, guess)
        assert (found.status, found.iterations) == (Status.CONVERGED, 20)


STUB = """
typedef const double *const *given;
typedef double *const *result;
void command_torque(given arg, result res) {}
void implicit_slopes(given arg, result res) {}
void implicit_step(given arg, result res) {
    for (int i = 0; i < COUNT * ABREAST; i++) res[0][i] = 0;
}
void period_cost(given arg, result res) { /* each command should be its former one plus 1 */
    for (int i = 0; i < COUNT * WIDE; i++) {
        res[0][i] = arg[4][i] - arg[5][i] - 1;
        for (int l = 0; l < 2; l++) res[1][(2 * (i / WIDE) + l) * WIDE + i % WIDE] = l ? -1 : 1;
    }
}
"""


@needs_compiler
def test_the_loop_in_c_hands_on_the_command_of_any_number_of_segments(monkeypatch):
    """Under a model of arms that do not move."""
    count, steps = 300, 4
    own = Path(compiled.__file__).with_name("engine.c").read_text(encoding="utf-8")
    columns = [f"{3 * count + i}, {4 * count + i}" for i in range(count)]
    macros = {
        "ABREAST": 2,
        "WIDE": 2,
        "COUNT": count,
        "RESIDUALS": count,
        "SLOPE_STARTS": ", ".join(str(2 * i) for i in range(count + 1)),
        "SLOPE_OF": ", ".join(columns),
    }
    defined = "".join(f"#define {name} {value}\n" for name, value in macros.items())
    library = build("stub", {"engine.c": defined + own, "stub.c": defined + STUB})
    loaded = compiled.loaded(library)
    monkeypatch.setattr(compiled, "_library", lambda _: loaded)
    structure = SimpleNamespace(flow_size=2)
    arm = SimpleNamespace(segments=count, structure=structure, values=np.zeros(1))
    parameters = parameter_set("physical")
    nmpc = replace(parameters.nmpc, horizon=1, angle_bound=6.0, max_iterations=3)
    engine = Engine(arm, np.zeros(1), np.zeros(1), nmpc, parameters.simulation)
    begin = np.linspace(-1, 1, count)
    _, q_bar, status, _ = engine.run(
        np.concatenate([begin, np.zeros(count)]),
        np.zeros((steps + 1, 2)),
        np.zeros((steps, 2)),
        np.zeros((steps, 2)),
        np.zeros((steps, 1, count)),
    )
    assert (status == Status.CONVERGED).all()
    np.testing.assert_allclose(q_bar, begin + 1 + np.arange(steps)[:, None], atol=1e-9)


def test_bounds_hold_always(nominal):
    scenario = scenario_at(nominal, angle_bound=0.3, max_iterations=3)
    solver = first_solver(scenario)
    rng = np.random.default_rng(8)
    for _ in range(10):
        problem, guess = random_problem(scenario, rng)
        assert np.max(np.abs(solver.solve(problem, guess).inputs)) <= 0.3 + 1e-12


FAILURES = [
    FailureParameters(segment, manner, known)
    for segment, manner in ((1, "passive"), (2, "locked"))
    for known in (True, False)
]


def hard_cases(nominal, horizons):
    """Solvers of all horizons, failures and torque bounds, each in a sea of 6 m."""
    for horizon, failure, bound in product(
        horizons, [nominal.failure, *FAILURES], [(0.0, 0.0), (0.6, 30.0)]
    ):
        yield replace(
            nominal,
            failure=failure,
            nmpc=replace(
                nominal.nmpc,
                horizon=horizon,
                max_iterations=6,
                torque_bound=bound[0],
                torque_weight=bound[1],
            ),
        )


def test_random_starts_end_with_a_status_and_finite_bounded_inputs(nominal):
    compiled = compiler() is not None
    cases = list(hard_cases(nominal, (1, 2, 5, 15, 40) if compiled else (1, 15)))
    starts = 40 if compiled else 3
    rng = np.random.default_rng(9)
    seas = {case.name: longest_flow(nominal, case) for case in wave_cases().values()}
    ended = Counter()
    for parameters in cases:
        arm, nmpc = Arm(parameters.arm, parameters.fluid), parameters.nmpc
        gains = InnerLoop.packed(parameters.baseline, parameters.failure)
        told = parameters.failure if parameters.failure.known else None
        believed = InnerLoop.packed(parameters.baseline, told)
        tight = replace(nmpc, tolerance=1e-11, max_iterations=300)
        solver, exact = (
            Engine(arm, believed, gains, settings, parameters.simulation)
            if compiled
            else GaussNewton(arm, believed, settings)
            for settings in (nmpc, tight)
        )
        for _ in range(starts):
            problem, guess = hard_problem(seas[rng.choice(list(seas))], nmpc, arm.segments, rng)
            solution = solver.solve(problem, guess)
            assert np.all(np.abs(solution.inputs) <= nmpc.angle_bound + 1e-12)  # NaN is not
            assert 0 <= solution.iterations <= nmpc.max_iterations
            assert np.isfinite(solution.cost) == (solution.status is not Status.NOT_FINITE)
            if solution.status is Status.CONVERGED:
                settled = exact.solve(problem, solution.inputs).inputs
                assert np.max(np.abs(solution.inputs - settled)) < 3e-5
            if solution.status is Status.ITERATION_LIMIT:
                assert solution.iterations == nmpc.max_iterations
            ended[solution.status] += 1
    assert ended.total() == (2000 if compiled else 60)
    # Arms folded over, targets far away, six steps: many need more, and say so.
    assert ended[Status.CONVERGED] > 0.15 * ended.total()
    assert ended[Status.ITERATION_LIMIT] > 0.15 * ended.total()


def longest_flow(nominal, case):
    sea = replace(nominal.sea, peak_period=case.peak_period, significant_height=6.0)
    parameters = replace(
        nominal,
        sea=sea,
        nmpc=replace(nominal.nmpc, horizon=40),
        simulation=replace(nominal.simulation, duration=60.0),
    )
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    return Scenario.build(parameters, sea, poses()["P3"]).flow


def hard_problem(flow, nmpc, segments, rng):
    horizon, start = nmpc.horizon, rng.integers(0, len(flow) - nmpc.horizon)
    fast = rng.choice([0.1, 1.0, 10.0])
    return Problem(
        np.concatenate([rng.uniform(-3, 3, segments), fast * rng.normal(size=segments)]),
        rng.uniform(-3, 3, segments),
        np.tile(rng.uniform([-3, -7], [3, -1]), (horizon, 1)),
        Forecast(flow[start : start + horizon], rng.standard_normal((horizon, segments))),
    ), rng.uniform(-4, 4, (horizon, segments))


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_compiler)])
def test_a_state_that_is_not_finite_is_reported_and_the_solver_recovers(nominal, compiled):
    scenario = scenario_at(nominal)
    solver = solvers(scenario)[1] if compiled else first_solver(scenario)
    problem, guess = next(recorded_problems(scenario, 1))
    good = solver.solve(problem, guess)
    assert (
        solver.solve(replace(problem, state=np.full(6, np.nan)), guess).status is Status.NOT_FINITE
    )
    np.testing.assert_array_equal(solver.solve(problem, guess).inputs, good.inputs)


def test_a_horizon_of_one_period_moves_nothing(nominal):
    # The printed sum ends before the only state that the input reaches.
    scenario = scenario_at(nominal, horizon=1)
    problem, guess = random_problem(scenario, np.random.default_rng(2))
    solution = first_solver(scenario).solve(problem, guess)
    np.testing.assert_allclose(solution.inputs[0], problem.previous, atol=1e-12)


def test_the_controller_passes_the_reference_of_the_coming_periods(nominal):
    scenario = scenario_at(nominal)
    moving = scenario.targets + np.arange(len(scenario.targets))[:, None] * [1e-3, 0]
    seen = []

    class Recorder:
        def solve(self, problem, guess):
            seen.append(problem.reference)
            return first_solver(scenario).solve(problem, guess)

    controller = NmpcController(replace(scenario, targets=moving), Recorder())
    controller.command(4, np.zeros(6))
    # The tip that the first input moves is that of the next instant.
    np.testing.assert_array_equal(seen[0][0], moving[5])
