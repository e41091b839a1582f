"""One statement of the cost: what is written in problem.py reaches every solver."""

import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from softwave_min.control import problem as statement
from softwave_min.control.compiled.engine import Engine
from softwave_min.control.nmpc import GaussNewton
from softwave_min.control.predictor import PeriodSteps
from softwave_min.control.preview import Forecast
from softwave_min.control.problem import Problem, Status
from softwave_min.control.reference.convex import ConvexGaussNewton
from softwave_min.control.reference.interior_point import InteriorPoint, transition_function
from softwave_min.data import ROOT
from softwave_min.native import compiler
from softwave_min.paper.cases import poses
from softwave_min.simulation import Scenario
from softwave_min.waves import Sea

EFFORT = 0.5
"""Weight of the squared torques that the test adds to the cost."""


def fatrop(arm, gains, parameters):
    sys.path.insert(0, str(ROOT / "bench"))
    try:
        from fatrop import Fatrop
    finally:
        sys.path.pop(0)
    return Fatrop(arm, gains, parameters, gauss_newton=True)


def engine(scenario):
    gains = (scenario.believed_gains, scenario.gains)
    return Engine(scenario.arm, *gains, scenario.parameters.nmpc, scenario.parameters.simulation)


SOLVERS = {
    "NumPy": GaussNewton,
    "IPOPT": InteriorPoint,
    "cvxpy": ConvexGaussNewton,
    "fatrop": fatrop,
}


NAMES = [*SOLVERS, *["C"] * (compiler() is not None)]


def solver_named(name, scenario):
    if name == "C":
        return engine(scenario)
    return SOLVERS[name](scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)


@pytest.fixture(scope="module")
def scenario(nominal):
    """A short horizon with every option of the cost."""
    options = {"terminal_weight": 2.0, "torque_bound": 0.3, "torque_weight": 30.0}
    nmpc = replace(nominal.nmpc, horizon=4, tolerance=1e-9, max_iterations=200, **options)
    parameters = replace(nominal, nmpc=nmpc, simulation=replace(nominal.simulation, duration=1.0))
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    return Scenario.build(parameters, sea, poses()["P3"])


def task_of(scenario):
    rng = np.random.default_rng(1)
    target = scenario.arm.tip(np.array([0.3, 0.2, -0.1]))
    forecast = Forecast(scenario.flow[:4], 0.05 * rng.standard_normal((4, 3)))
    state = np.concatenate([[0.2, 0.1, 0.0], np.zeros(3)])
    return Problem(state, np.full(3, 0.1), np.tile(target, (4, 1)), forecast)


def sum_of_squares(scenario, task, inputs, effort):
    """The cost term by term, in plain numbers."""
    weights, fixed = scenario.parameters.nmpc, (scenario.believed_gains, scenario.arm.values)
    step = transition_function(scenario.arm.structure, PeriodSteps.of(weights))
    state, tips, torques = task.state, [], []
    for q_bar, flow, load in zip(
        inputs, task.forecast.flow, task.forecast.disturbance, strict=True
    ):
        state, tip, torque = (one.full().ravel() for one in step(state, q_bar, flow, load, *fixed))
        tips.append(tip)
        torques.append(torque)
    torques = np.array(torques)
    errors = np.sum((np.array(tips) - task.reference) ** 2, axis=1)
    changes = np.diff(np.vstack([task.previous, inputs]), axis=0)
    beyond = np.maximum(np.abs(torques) - weights.torque_bound, 0)
    assert np.any(beyond > 0)
    return (
        weights.tip_weight * (np.sum(errors[:-1]) + weights.terminal_weight * errors[-1])
        + weights.step_weight * np.sum(changes**2)
        + weights.torque_weight * np.sum(beyond**2)
        + effort * np.sum(torques**2)
    )


def gradient(scenario, task, inputs, effort):
    """Of ``sum_of_squares``, by central differences."""
    slopes, width = np.zeros(inputs.size), 1e-5
    for index in range(inputs.size):
        move = np.zeros(inputs.size)
        move[index] = width
        up, down = (
            sum_of_squares(scenario, task, inputs + sign * move.reshape(inputs.shape), effort)
            for sign in (1, -1)
        )
        slopes[index] = (up - down) / (2 * width)
    return slopes


def forget_what_was_built():
    """Empty the caches of everything that is built from the statement."""
    for name, module in list(sys.modules.items()):
        if name.startswith("softwave_min.control"):
            for value in vars(module).values():
                if hasattr(value, "cache_clear"):
                    value.cache_clear()


@pytest.fixture
def with_effort(monkeypatch):
    """The statement with one more term: the squared torques."""
    stated = statement.residuals

    def residuals(period, weights):
        return {**stated(period, weights), "effort": ca.sqrt(EFFORT) * period.torque}

    monkeypatch.setattr(statement, "residuals", residuals)
    forget_what_was_built()
    yield
    monkeypatch.undo()
    forget_what_was_built()


def complaint(name, scenario, effort):
    """What is wrong with a solver's answer; None where it minimises the sum of squares."""
    task, guess = task_of(scenario), np.full((4, 3), 0.1)
    found = solver_named(name, scenario).solve(task, guess)
    if found.status is not Status.CONVERGED:
        return f"{name}: {found.status.name}"
    expected = sum_of_squares(scenario, task, found.inputs, effort)
    if found.cost != pytest.approx(expected, rel=1e-7):
        return f"{name} minimises another cost: {found.cost:.6g}, not {expected:.6g}"
    rise = np.max(np.abs(gradient(scenario, task, guess, effort)))
    left = np.max(np.abs(gradient(scenario, task, found.inputs, effort)))
    return None if left < 1e-5 * rise else f"{name} does not end at the minimum"


def test_every_solver_minimises_the_cost_that_is_stated(scenario):
    assert [one for name in NAMES if (one := complaint(name, scenario, effort=0.0))] == []


@pytest.mark.usefixtures("with_effort")
def test_a_term_that_is_added_to_the_statement_reaches_every_solver(scenario):
    assert [one for name in NAMES if (one := complaint(name, scenario, effort=EFFORT))] == []
