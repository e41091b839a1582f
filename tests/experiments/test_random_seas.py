"""Many seas: each closed loop once, every table over all seas."""

import numpy as np
import pytest

from softwave_min.experiments import error_ratio
from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.closed_loop import (
    SUMMARY_FIELDS,
    LoopRun,
    closed_loops,
    errors_alone,
)
from softwave_min.experiments.failures import INTACT, PAPERS_CASE
from softwave_min.experiments.random_seas import SEEDS, runs, tabulate

SEAS = 3
STEPS = 200


@pytest.fixture(scope="module")
def parameters(nominal):
    return varied(nominal, (("sea.realisations", SEAS),))


def series(run):
    """Made-up arrays of a run, of the size of a multiple of its significant height."""
    sea = run.parameters.parameters.sea
    level = 0.01 * (1 + sea.significant_height) * (1 + 0.1 * sea.seed)
    failed = run.parameters.parameters.failure.segment > 0
    found = {}
    for controller, factor in (("baseline", 4.0), ("nmpc", 1.5 if failed else 1.0)):
        error = np.full(STEPS + 1, factor * level)
        tip = np.stack([error, np.zeros_like(error)], axis=1)
        found |= {
            f"{controller}_error": error,
            f"{controller}_tip": tip,
            f"{controller}_target": np.zeros_like(tip),
            f"{controller}_status": np.zeros(STEPS, int),
            f"{controller}_source": np.zeros(STEPS, int),
        }
    return found


def test_twenty_seas_unless_asked_otherwise(nominal):
    assert len({run.parameters.parameters.sea.seed for run in runs(nominal)}) == SEEDS >= 20


def test_every_closed_loop_is_run_once(parameters):
    found = runs(parameters)
    assert len({run.name for run in found}) == len(found)
    assert len({run.parameters for run in found}) == len(found)
    # The grid has the intact arm already; failure adds the failed one at two poses, the star
    # its three waves, and still water once.
    failed = 3 * 2 * 4
    assert len(found) == SEAS * (3 * 6 * 6 + failed + 3) + 1
    seeds = {run.parameters.parameters.sea.seed for run in found}
    noises = {run.parameters.parameters.preview.seed for run in found}
    assert len(seeds) == len(noises) == SEAS


def test_what_is_kept_of_a_loop_is_what_the_sweep_has(nominal):
    run = LoopRun(varied(nominal, (("simulation.duration", 0.5),)), ((0.7, -3.7),))
    whole, kept = closed_loops(run), errors_alone(run)
    assert {name.partition("_")[2] for name in kept} == set(SUMMARY_FIELDS)
    for name, array in kept.items():
        np.testing.assert_array_equal(array, whole[name])


def test_tables_cover_all_seas_and_agree_with_the_experiments(parameters):
    arrays = {run.name: series(run) for run in runs(parameters)}
    tables = tabulate(parameters, arrays)
    grid = tables["error_ratio"]
    assert len(grid) == 108 * SEAS
    np.testing.assert_allclose(grid["ratio_nmpc"], 0.25)
    own = {run.name: series(run) for run in error_ratio.runs(parameters)}
    assert grid.equals(error_ratio.grid_table(parameters, own))
    failure = tables["actuator_failure"]
    assert set(failure["case"]) == {INTACT, PAPERS_CASE}
    failed = failure[failure["case"] == PAPERS_CASE]
    np.testing.assert_allclose(failed["rise_percent_nmpc"], 50.0)
    assert tables["star"]["seed"].nunique() == SEAS
    reductions = tables["reductions"]
    np.testing.assert_allclose(reductions[reductions["quantity"] == "largest"]["median"], 75.0)
    assert (tables["places"].groupby(["wave", "extreme"])["seas"].sum() == SEAS).all()
