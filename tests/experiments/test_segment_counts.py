"""Arms of two, four and five segments: every experiment runs, or says why it does not apply."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from invented_loops import STEPS, tabulated

from softwave_min.arm import Arm
from softwave_min.data import ParameterError
from softwave_min.experiments import actuator_failure, error_ratio, random_seas, setpoints
from softwave_min.experiments.closed_loop import closed_loops
from softwave_min.experiments.failures import failure_cases, ordinal
from softwave_min.experiments.resting_arm import (
    RestingArm,
    area,
    reach,
    workspace,
)
from softwave_min.figures import actuator_failure as failure_figures
from softwave_min.figures import setpoints as setpoint_figures
from softwave_min.figures.style import apply
from softwave_min.runs.store import Store


def of_segments(parameters, count):
    """The set with as many segments, all like the first, and a brief run."""

    def resized(part, names):
        return replace(part, **{name: (getattr(part, name)[0],) * count for name in names})

    arm = resized(parameters.arm, ("length", "diameter", "density", "stiffness", "damping"))
    gains = resized(parameters.baseline, ("proportional_gain", "derivative_gain"))
    simulation = replace(parameters.simulation, duration=0.1 * STEPS)
    return replace(parameters, arm=arm, baseline=gains, simulation=simulation)


def test_cases_of_failure_are_those_that_the_arm_has(nominal):
    segments = {
        count: {
            name: case.segment for name, case in failure_cases(of_segments(nominal, count)).items()
        }
        for count in (2, 3, 5)
    }
    assert segments[2] == {"intact": 0, "mid_passive": 2, "mid_locked": 2}
    assert segments[3]["mid_locked"] == segments[5]["mid_passive"] == 2
    assert (segments[3]["tip_locked"], segments[5]["tip_passive"]) == (3, 5)
    assert [ordinal(1), ordinal(5), ordinal(12)] == ["first", "fifth", "12th"]


@pytest.mark.parametrize("experiment", [setpoints, actuator_failure, random_seas])
def test_one_segment_is_refused_in_a_line(nominal, experiment):
    with pytest.raises(ParameterError, match=r"^arm.length: .*at least two segments$"):
        experiment.EXPERIMENT.runs(of_segments(nominal, 1))


@pytest.mark.parametrize("count", [2, 4, 5])
def test_the_grid_and_the_failures_run(nominal, count, tmp_path):
    parameters = of_segments(nominal, count)
    run = actuator_failure.EXPERIMENT.runs(parameters)[1].parameters
    simulation = replace(run.parameters.simulation, duration=0.5)
    found = closed_loops(replace(run, parameters=replace(run.parameters, simulation=simulation)))
    assert found["nmpc_q"].shape == (6, count)
    grid, _ = tabulated(error_ratio.EXPERIMENT, parameters, tmp_path, count)
    assert f"torque_{count}" in grid["torques"]
    tables, store = tabulated(actuator_failure.EXPERIMENT, parameters, tmp_path, count)
    assert set(tables["actuator_failure"]["case"]) == set(failure_cases(parameters))
    apply()
    assert "passive_motion" in failure_figures.draw(store, parameters)
    plt.close("all")


@pytest.mark.parametrize("count", [2, 4, 5])
def test_setpoints_run(nominal, count, tmp_path, monkeypatch):
    """Kinematics for real, on a coarse map; postures of the controller invented."""
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
    store = Store("setpoints", tmp_path)
    for run in setpoints.EXPERIMENT.runs(parameters):
        store.save_run(run, arrays[run.name], {})
    for stem, table in tables.items():
        store.write_table(stem, table)
    assert set(setpoint_figures.draw(store, parameters)) == {"setpoints", "workspace"}
    plt.close("all")


def coarse(resting, bound):
    return workspace(resting, bound, cell=0.1)


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
