"""The block diagram shows the wiring that the code has (claim C04)."""

from dataclasses import replace

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pytest

from softwave_min.arm import Values
from softwave_min.control.baseline import InnerLoop
from softwave_min.control.nmpc import GaussNewton
from softwave_min.figures.block_diagram import BOXES, SIGNALS, Signal, block_diagram
from softwave_min.paper.cases import poses
from softwave_min.simulation import (
    BaselineController,
    Command,
    NmpcController,
    Scenario,
    plant_of,
    simulate,
)
from softwave_min.waves import Sea


@pytest.fixture
def scenario(nominal):
    parameters = replace(nominal, simulation=replace(nominal.simulation, duration=0.5))
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    return Scenario.build(parameters, sea, poses()["P3"], np.array([0.2, -0.1, 0.3]))


class Asked:
    """A solver that keeps what it is asked."""

    def __init__(self, scenario):
        self._solver = GaussNewton(scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)
        self.problems = []

    def solve(self, problem, guess):
        self.problems.append(problem)
        return self._solver.solve(problem, guess)


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda signal: signal.name)
def test_the_code_has_every_signal(signal):
    assert signal.exists()


def test_a_signal_that_the_code_has_not_is_noticed():
    assert not Signal("", Command, "voltage", (), (0, 0)).exists()
    assert not Signal("", InnerLoop.torque, "flow", (), (0, 0)).exists()


@pytest.mark.parametrize("box", BOXES, ids=lambda box: box.kind.__name__)
def test_blocks_are_called_as_their_classes_are(box):
    assert box.words in (box.kind.__doc__ or "") or box.words == box.kind.__name__


def test_every_block_and_signal_is_drawn():
    drawing = block_diagram()
    texts = [text.get_text() for text in drawing.figure.axes[0].texts]
    plt.close(drawing.figure)
    for name in [box.kind.__name__ for box in BOXES] + [signal.symbol for signal in SIGNALS]:
        assert name in texts


def test_the_problem_holds_the_state_the_last_command_and_the_forecast_of_the_sea(scenario):
    exact = replace(
        scenario,
        parameters=replace(
            scenario.parameters, preview=replace(scenario.parameters.preview, noise="none")
        ),
    )
    asked = Asked(exact)
    loop = simulate(exact, NmpcController(exact, asked))
    commands = np.vstack([exact.initial_angles, loop.q_bar])
    horizon = exact.parameters.nmpc.horizon
    for step, problem in enumerate(asked.problems):
        np.testing.assert_array_equal(problem.state, [*loop.q[step], *loop.qd[step]])
        np.testing.assert_array_equal(problem.previous, commands[step])
        np.testing.assert_array_equal(problem.forecast.flow, exact.flow[step : step + horizon])
        np.testing.assert_array_equal(problem.forecast.disturbance, 0)


def test_the_noise_enters_through_the_forecast_alone(scenario):
    asked = Asked(scenario)
    NmpcController(scenario, asked).command(0, np.zeros(2 * scenario.arm.segments))
    forecast = asked.problems[0].forecast
    assert np.std(forecast.disturbance) > 0
    np.testing.assert_array_equal(forecast.flow, scenario.flow[: len(forecast.flow)])


def test_the_torque_is_a_function_of_command_and_state(scenario):
    loop = simulate(scenario, BaselineController(scenario))
    arm = scenario.arm
    gains = InnerLoop.unpacked(ca.DM(scenario.gains), arm.segments)
    values = Values.unpacked(ca.DM(arm.values), arm.segments)
    for step, torque in enumerate(loop.torque):
        state = ca.DM(np.concatenate([loop.q[step], loop.qd[step]]))
        law = gains.torque(arm.structure, values, ca.DM(loop.q_bar[step]), state)
        np.testing.assert_allclose(ca.evalf(law).full().ravel(), torque, atol=1e-12)


def test_command_and_sea_both_move_the_arm(scenario):
    plant = plant_of(scenario)
    state = np.concatenate([scenario.initial_angles, np.zeros(scenario.arm.segments)])
    held, flow = scenario.initial_angles, scenario.flow[0]
    reference = plant.advance(state, held, flow)
    assert np.max(np.abs(plant.advance(state, held + 0.1, flow) - reference)) > 1e-4
    assert np.max(np.abs(plant.advance(state, held, 0 * flow) - reference)) > 1e-4
