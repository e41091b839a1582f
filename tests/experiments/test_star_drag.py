"""The star without drag: nothing is changed but the cause that the paper names."""

from __future__ import annotations

import numpy as np
import pytest
from invented_loops import computed
from segments import with_segments

from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.star_drag import EXPERIMENT, LOADS, loaded
from softwave_min.experiments.star_loops import scenario_on_star
from softwave_min.paper.cases import wave_cases
from softwave_min.parameters import parameter_set
from softwave_min.simulation import root_mean_square_error, simulate


def test_the_loads_differ_by_drag_and_friction_alone():
    nominal = parameter_set()
    whole, bare = (loaded(nominal, load) for load in LOADS)
    assert whole.fluid.morison == bare.fluid.morison == "textbook"
    assert whole.fluid.drag_coefficient == nominal.fluid.drag_coefficient
    none = (("fluid.drag_coefficient", 0.0), ("fluid.friction_coefficient", 0.0))
    assert varied(whole, none) == bare


def test_each_load_is_tried_in_each_sea_on_one_path():
    runs = EXPERIMENT.runs(parameter_set())
    assert len(runs) == len(LOADS) * len(wave_cases())
    assert len({run.parameters.star for run in runs}) == 1
    assert len({run.name for run in runs}) == len(runs)


def test_errors_are_those_with_the_start_and_without():
    nominal = parameter_set()
    steps = 200
    run = {
        "nmpc_error": np.where(np.arange(steps + 1) < 100, 1.0, 0.5),
        "nmpc_status": np.array([0] * (steps - 2) + [1, 1]),
        "nmpc_source": np.zeros(steps, dtype=int),
    }
    arrays = {one.name: run for one in EXPERIMENT.runs(nominal)}
    table = EXPERIMENT.tabulate(nominal, arrays)["star_drag"]
    assert table["rmse"].to_numpy() == pytest.approx(np.sqrt((100 + 101 * 0.25) / 201))
    assert table["rmse_settled"].to_numpy() == pytest.approx(0.5)
    assert set(table["solves_failed"]) == {2}


@pytest.mark.parametrize("segments", [3, 2])
def test_the_table_has_the_error_of_each_loop(segments):
    short = varied(with_segments(parameter_set(), segments), (("simulation.duration", 11.0),))
    table = EXPERIMENT.tabulate(short, computed(EXPERIMENT, short))["star_drag"]
    for run, rmse in zip(EXPERIMENT.runs(short), table["rmse"], strict=True):
        loop = simulate(scenario_on_star(run.parameters.parameters, run.parameters.star), "nmpc")
        far = np.linalg.norm(loop.tips[:, -1] - loop.target, axis=1)
        assert rmse == pytest.approx(root_mean_square_error(far))
