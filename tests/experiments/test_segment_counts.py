"""Arms of two, four and five segments: every experiment runs, or says why it does not apply."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from invented_loops import shelf, tabulated
from segments import with_segments

from softwave_min.arm import Arm
from softwave_min.data import ParameterError
from softwave_min.experiments import actuator_failure, error_ratio, random_seas, setpoints
from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.closed_loop import closed_loops
from softwave_min.experiments.failures import failure_cases, ordinal
from softwave_min.experiments.resting_arm import RestingArm, area, reach, workspace
from softwave_min.figures import actuator_failure as failure_figures
from softwave_min.figures import setpoints as setpoint_figures


def of_segments(parameters, count):
    """A brief run of an arm of the same length."""
    return varied(with_segments(parameters, count), (("simulation.duration", 12.0),))


def test_cases_of_failure_are_those_that_the_arm_has(nominal):
    two, three, five = (failure_cases(with_segments(nominal, count)) for count in (2, 3, 5))
    segments = {name: case.segment for name, case in two.items()}
    assert segments == {"intact": 0, "mid_passive": 2, "mid_locked": 2}
    assert three["mid_locked"].segment == five["mid_passive"].segment == 2
    assert (three["tip_locked"].segment, five["tip_passive"].segment) == (3, 5)
    assert [ordinal(1), ordinal(5), ordinal(12)] == ["first", "fifth", "12th"]


@pytest.mark.parametrize("experiment", [setpoints, actuator_failure, random_seas])
def test_one_segment_is_refused_in_a_line(nominal, experiment):
    with pytest.raises(ParameterError, match=r"^arm.length: .*at least two segments$"):
        experiment.EXPERIMENT.runs(of_segments(nominal, 1))


@pytest.mark.parametrize("count", [2, 4, 5])
def test_the_grid_and_the_failures_run(nominal, count):
    parameters = of_segments(nominal, count)
    run = actuator_failure.EXPERIMENT.runs(parameters)[1].parameters
    short = varied(run.parameters, (("simulation.duration", 0.5),))
    found = closed_loops(replace(run, parameters=short))
    assert found["nmpc_q"].shape == (6, count)
    grid, _ = tabulated(error_ratio.EXPERIMENT, parameters, count)
    assert f"torque_{count}" in grid["torques"]
    tables, store = tabulated(actuator_failure.EXPERIMENT, parameters, count)
    assert set(tables["actuator_failure"]["case"]) == set(failure_cases(parameters))
    assert "passive_motion" in failure_figures.draw(store, parameters)


@pytest.mark.parametrize("count", [2, 4, 5])
def test_setpoints_run(nominal, count, monkeypatch):
    """Kinematics for real, on a coarse map; postures of the controller invented."""
    coarse = partial(workspace, cell=0.1)
    monkeypatch.setattr("softwave_min.experiments.resting_arm.workspace", coarse)
    monkeypatch.setattr("softwave_min.experiments.resting_arm.LEADING", 4)
    parameters = of_segments(nominal, count)
    arrays = {}
    for run in setpoints.EXPERIMENT.runs(parameters):
        if run.compute is reach:
            arrays[run.name] = reach(run.parameters)
            assert arrays[run.name]["posture"].shape == (6, count)
    rest = {"q": np.full((6, count), 0.2), "error": np.full(6, 0.1)}
    rest |= dict.fromkeys(("status", "source"), np.zeros((6, 3), int))
    arrays |= {f"rest-{name}": rest for name in failure_cases(parameters)}
    tables = setpoints.EXPERIMENT.tabulate(parameters, arrays)
    assert f"q{count}" in tables["setpoints"]
    assert (tables["workspace"]["share"] < 1.05).all()
    drawings = setpoint_figures.draw(shelf(tables, arrays), parameters)
    assert set(drawings) == {"setpoints", "workspace"}


def test_the_map_of_four_angles_is_the_disc_that_the_arm_can_turn_in(nominal):
    """With the whole turn at every joint the tip reaches all of the disc but its rim."""
    parameters = of_segments(nominal, 4)
    arm = Arm(parameters.arm, parameters.fluid)
    cell = 0.05
    whole = RestingArm(arm, parameters.failure)
    cells = workspace(whole, np.pi, cell)
    size, error = area(cells, cell)
    angles = np.random.default_rng(2).uniform(-np.pi, np.pi, (3000, 4))
    base, half = np.array(parameters.arm.base_position), len(cells) // 2
    column, row = np.floor((whole.tips(angles) - base) / cell).astype(int).T + half
    assert cells[column, row].mean() > 0.999
    assert size - error < np.pi * sum(parameters.arm.length) ** 2


def test_one_free_angle_reaches_a_line(nominal):
    parameters = of_segments(nominal, 2)
    locked = failure_cases(parameters)["mid_locked"].of(parameters)
    size, error = area(workspace(RestingArm(Arm(locked.arm, locked.fluid), locked.failure), np.pi))
    assert size == error > 0
