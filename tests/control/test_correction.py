"""What fairer opponents add to the planner's command."""

from dataclasses import replace

import numpy as np

from softwave_min.control.baseline import Correction
from softwave_min.paper.cases import poses
from softwave_min.simulation import Scenario, preview_of
from softwave_min.waves import Sea


def test_the_load_that_is_fed_forward_is_that_of_the_forecast_with_its_noise(nominal):
    gains = replace(nominal.baseline, load_feedforward=True)
    simulation = replace(nominal.simulation, duration=0.5)
    parameters = replace(nominal, baseline=gains, simulation=simulation)
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    scenario = Scenario.build(parameters, sea, poses()["P3"])
    arm, preview = scenario.arm, preview_of(scenario)  # forecasts as the correction gets them
    q, planned = np.array([0.3, -0.2, 0.1]), np.array([0.4, 0.1, -0.3])
    state = np.concatenate([q, [0.5, -0.4, 0.2]])
    correction = Correction(arm, gains, scenario.period, preview_of(scenario))
    shifts = []
    for step in range(3):
        present = preview.at(step)
        middle = -scenario.period / 2
        load = arm.fluid_load(q, np.zeros(3), present.flow[0], time=middle)
        noise = present.disturbance[0]
        assert np.all(np.abs(noise) > 0)
        # The spring that the torque law is about its command turns a load into a shift.
        command = correction.command(step, state, planned)
        shifts.append(_spring(scenario, planned) @ (planned - command))
        np.testing.assert_allclose(shifts[-1], load + noise, rtol=0, atol=1e-9)
    assert np.ptp(shifts, axis=0).max() > 0


def _spring(scenario, planned):
    """S = diag(k + alpha) + dG/dq at the plan, by central differences of the torques."""
    arm, gains = scenario.arm, scenario.parameters.baseline
    columns = []
    for direction in np.eye(3):
        up, down = (arm.gravity_vector(planned + sign * 1e-5 * direction) for sign in (1, -1))
        columns.append((up - down) / 2e-5)
    return np.array(columns).T + np.diag(
        np.array(arm.parameters.stiffness) + np.array(gains.proportional_gain)
    )
