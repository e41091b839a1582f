"""Failed segments, bounds on torque, previews that err, and what happens when a solve fails."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from softwave_min.control.compiled.engine import Engine
from softwave_min.control.nmpc import GaussNewton
from softwave_min.control.preview import Forecast, Preview
from softwave_min.control.problem import Problem, Solution, Status
from softwave_min.figures.example_case import mark_failures
from softwave_min.native import compiler
from softwave_min.paper.cases import poses
from softwave_min.parameters import FailureParameters
from softwave_min.simulation import (
    BaselineController,
    NmpcController,
    Scenario,
    Source,
    root_mean_square_error,
    simulate,
)
from softwave_min.waves import Sea

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")


def scenario_of(nominal, duration=4.0, pose="P3", **changes):
    parts = {name: replace(getattr(nominal, name), **values) for name, values in changes.items()}
    parameters = replace(
        nominal, **parts, simulation=replace(nominal.simulation, duration=duration)
    )
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    return Scenario.build(parameters, sea, poses()[pose])


def settled(loop):
    return root_mean_square_error(loop.error[len(loop.error) // 2 :])


@pytest.mark.parametrize("segment", [1, 2, 3])
@pytest.mark.parametrize("integrator", ["extrapolation", "cvodes"])
def test_a_passive_segment_has_no_torque_and_a_locked_one_does_not_move(
    nominal, segment, integrator
):
    nominal = replace(nominal, simulation=replace(nominal.simulation, integrator=integrator))
    loops = {}
    for manner in ("passive", "locked"):
        scenario = scenario_of(nominal, 2.0, failure={"segment": segment, "manner": manner})
        loops[manner] = simulate(scenario, BaselineController(scenario))
    failed, moved = segment - 1, np.ptp(loops["locked"].q, axis=0)
    assert np.all(loops["passive"].torque[:, failed] == 0)
    assert np.ptp(loops["passive"].q[:, failed]) > 1e-3
    np.testing.assert_allclose(loops["locked"].q[:, failed], 0, atol=1e-12)
    assert np.all(np.delete(moved, failed) > 1e-3)


def test_to_know_of_a_failure_helps(nominal):
    errors = {}
    for known in (True, False):
        scenario = scenario_of(nominal, 12.0, failure={"segment": 2, "known": known})
        errors[known] = settled(simulate(scenario, NmpcController(scenario)))
    assert errors[True] < errors[False]


def test_two_of_three_segments_reach_the_pose_in_still_water(nominal):
    scenario = scenario_of(nominal, 25.0, sea={"significant_height": 0.0}, failure={"segment": 3})
    assert simulate(scenario, NmpcController(scenario)).error[-1] < 1e-3


def problems(scenario, count, seed):
    rng = np.random.default_rng(seed)
    n, horizon = scenario.arm.segments, scenario.parameters.nmpc.horizon
    for _ in range(count):
        forecast = Forecast(scenario.flow[:horizon], 0.1 * rng.standard_normal((horizon, n)))
        state = rng.normal(size=2 * n) * ([0.5] * n + [0.2] * n)
        reference = np.tile(poses()["P3"], (horizon, 1))
        yield Problem(state, rng.uniform(-1, 1, n), reference, forecast)


def both_solvers(scenario):
    p = scenario.parameters
    return (
        GaussNewton(scenario.arm, scenario.believed_gains, p.nmpc),
        Engine(scenario.arm, scenario.believed_gains, scenario.gains, p.nmpc, p.simulation),
    )


@needs_compiler
@pytest.mark.parametrize(
    "changes",
    [
        {"nmpc": {"torque_bound": 1.0, "torque_weight": 50.0}},
        {"nmpc": {"terminal_weight": 5.0, "horizon": 7}},
        {"failure": {"segment": 2}},
        {"failure": {"segment": 1, "manner": "locked"}},
        {"fluid": {"morison": "textbook"}, "arm": {"rotary_inertia": True}},
    ],
    ids=["torque", "terminal", "passive", "locked", "textbook"],
)
def test_both_solvers_agree_under_every_option(nominal, changes):
    scenario = scenario_of(nominal, **changes)
    numpy_solver, engine = both_solvers(scenario)
    for problem in problems(scenario, 4, 11):
        guess = np.tile(problem.previous, (scenario.parameters.nmpc.horizon, 1))
        ours, theirs = engine.solve(problem, guess), numpy_solver.solve(problem, guess)
        assert ours.status == theirs.status
        np.testing.assert_allclose(ours.inputs, theirs.inputs, rtol=0, atol=1e-8)


def test_the_soft_bound_on_torque_is_in_the_derivatives_and_lowers_the_torque(nominal):
    bounded = scenario_of(nominal, nmpc={"torque_bound": 1.0, "torque_weight": 50.0})
    solver = GaussNewton(bounded.arm, bounded.believed_gains, bounded.parameters.nmpc)
    problem = next(problems(bounded, 1, 5))
    inputs = np.random.default_rng(6).uniform(-1, 1, (15, 3))
    _, jacobian = solver.residual(problem, inputs)
    direction = np.random.default_rng(7).standard_normal(inputs.shape)
    up, _ = solver.residual(problem, inputs + 1e-6 * direction)
    down, _ = solver.residual(problem, inputs - 1e-6 * direction)
    np.testing.assert_allclose((up - down) / 2e-6, jacobian @ direction.ravel(), atol=1e-4)
    free = scenario_of(nominal)
    largest = [np.max(np.abs(simulate(one, NmpcController(one)).torque)) for one in (bounded, free)]
    assert largest[0] < largest[1]


def test_previews_err_as_they_are_told_to(nominal):
    flow = np.arange(40.0)[:, None] * np.ones(3)
    preview = replace(nominal.preview, noise="none")

    def rows(**changes):
        return Preview(flow, np.zeros(3), 5, replace(preview, **changes)).at(10).flow[:, 0]

    np.testing.assert_array_equal(rows(), np.arange(10.0, 15.0))
    np.testing.assert_array_equal(rows(delay_periods=3), np.arange(7.0, 12.0))
    np.testing.assert_allclose(rows(bias=0.5), 1.5 * np.arange(10.0, 15.0))
    np.testing.assert_array_equal(rows(waves=False), np.zeros(5))


def test_the_better_the_preview_the_smaller_the_error(nominal):
    previews = ({"noise": "none"}, {"noise": "none", "delay_periods": 5}, {"waves": False})
    errors = []
    for preview in previews:
        scenario = scenario_of(nominal, 15.0, preview=preview)
        errors.append(settled(simulate(scenario, NmpcController(scenario))))
    assert errors == sorted(errors)


def test_a_plan_that_fails_is_replaced_and_the_replacement_is_on_record(nominal):
    scenario = scenario_of(nominal, 3.0)
    solver = GaussNewton(scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)

    class FailsForAWhile:
        calls = 0

        def solve(self, problem, guess):
            self.calls += 1
            if 3 < self.calls <= 20:
                return Solution(guess * np.nan, np.nan, Status.NOT_FINITE, 0, np.inf)
            return solver.solve(problem, guess)

    controller = NmpcController(scenario, FailsForAWhile())
    loop = simulate(scenario, controller)
    assert np.all(np.isfinite(loop.q))
    assert [int(np.sum(loop.source == source)) for source in Source] == [13, 14, 3]
    assert np.sum(loop.status == Status.NOT_FINITE) == 17
    # The former plan goes on, input by input; then the planner takes over.
    np.testing.assert_array_equal(loop.q_bar[17], scenario.planned_angles[17])
    assert loop.source[20] == Source.CONTROLLER


def test_failed_solves_are_marked_in_the_figure(nominal):
    scenario = scenario_of(nominal, 1.0)
    loop = simulate(scenario, "nmpc")
    status, source = loop.status.copy(), loop.source.copy()
    status[3], source[7] = Status.ITERATION_LIMIT, Source.FORMER_PLAN
    figure, (clean, touched) = plt.subplots(2)
    assert mark_failures(clean, loop) == ""
    assert not clean.lines
    said = mark_failures(touched, replace(loop, status=status, source=source))
    np.testing.assert_allclose(touched.lines[0].get_xdata(), [0.3, 0.7])
    assert "2 of 10" in said
    plt.close(figure)


@needs_compiler
def test_the_loop_in_c_is_the_loop_in_python(nominal):
    scenario = scenario_of(nominal, 3.0, preview={"redrawn": True})
    for build, whole in ((NmpcController, "nmpc"), (BaselineController, "baseline")):
        stepped, compiled = simulate(scenario, build(scenario)), simulate(scenario, whole)
        for name, series in vars(stepped).items():
            np.testing.assert_array_equal(series, getattr(compiled, name), err_msg=name)


def test_a_failed_segment_beyond_the_arm_is_refused(nominal):
    with pytest.raises(ValueError, match=r"failure\.segment at most 3"):
        replace(nominal, failure=FailureParameters(4, "passive", True))
