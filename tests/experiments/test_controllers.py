"""A third controller is one entry: tables have a column or rows of it, figures a line or panel."""

from itertools import product

import numpy as np
import pytest
from invented_loops import STEPS, computed, tabulated

from softwave_min.experiments import actuator_failure, error_ratio, example_case, random_seas
from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.closed_loop import LoopRun, closed_loops
from softwave_min.figures import actuator_failure as failure_figures
from softwave_min.figures import error_ratio as grid_figures
from softwave_min.figures import example_case as example_figures
from softwave_min.figures import random_seas as seas_figures
from softwave_min.figures.marks import look
from softwave_min.simulation import CONTROLLERS, BaselineController, Command

THIRD = "limp"


class Limp:
    """Half of what the planner commands."""

    def __init__(self, scenario):
        self._planner = BaselineController(scenario)

    def command(self, step, state):
        return Command(0.5 * self._planner.command(step, state).q_bar)


@pytest.fixture(autouse=True)
def third(monkeypatch):
    monkeypatch.setitem(CONTROLLERS, THIRD, Limp)


@pytest.fixture
def brief(nominal):
    return varied(nominal, (("simulation.duration", 0.1 * STEPS),))


def rows_of(table):
    return table[table["controller"] == THIRD]


def test_the_simulation_runs_it_by_its_name(brief):
    short = varied(brief, (("simulation.duration", 1.0),))
    found = closed_loops(LoopRun(short, ((0.7, -3.7),)))
    ends = {name: found[f"{name}_error"][-1] for name in CONTROLLERS}
    assert ends[THIRD] > ends["baseline"]


def test_the_grid_has_it(brief):
    tables, store = tabulated(error_ratio.EXPERIMENT, brief)
    grid = tables["error_ratio"]
    expected = ["e_baseline", "e_nmpc", f"e_{THIRD}", "ratio_nmpc", f"ratio_{THIRD}"]
    assert list(grid.columns[4:9]) == expected
    np.testing.assert_allclose(grid[f"ratio_{THIRD}"], 0.25)
    assert (grid["solves_failed"] == STEPS).all()
    for stem in ("extremes", "headline"):
        theirs = rows_of(tables[stem])
        assert len(theirs) == len(tables[stem]) / 2
        assert theirs["paper"].isna().all()  # the paper has no number of it
    assert f"correlation_{THIRD}_settled" in tables["trends"]
    assert f"spread_{THIRD}_largest" in tables["periods"]
    assert f"torque_reduction_{THIRD}" in tables["curvature"]
    assert f"ratio_difference_{THIRD}" in tables["pairs"]
    drawings = grid_figures.draw(store, brief)
    stems = product(("error_ratio", "settled"), ("", f"_{THIRD}"))
    assert set(drawings) == {"".join(stem) for stem in stems}
    bars = drawings[f"error_ratio_{THIRD}"].figure.axes[0].patches
    np.testing.assert_allclose([bar.get_height() for bar in bars], 0.25)


def test_failures_have_it(brief):
    tables, store = tabulated(actuator_failure.EXPERIMENT, brief)
    grid = tables["actuator_failure"]
    assert {f"e_{THIRD}", f"rise_percent_{THIRD}_settled", "e_baseline_intact"} <= set(grid)
    for stem in ("rises", "spread", "statements", "passive_motion", "excitation"):
        assert len(rows_of(tables[stem])) == len(tables[stem]) / 2
    drawings = failure_figures.draw(store, brief)
    assert {f"rises_{THIRD}", f"all_cases_{THIRD}", "rises", "all_cases"} <= set(drawings)
    assert THIRD in drawings[f"actuator_failure_{THIRD}"].caption


def test_many_seas_have_it(brief, monkeypatch):
    monkeypatch.setattr("softwave_min.experiments.random_seas.SEEDS", 2)
    tables, store = tabulated(random_seas.EXPERIMENT, brief)
    for stem in ("reductions", "reductions_settled", "rises", "rise_spread", "places"):
        assert len(rows_of(tables[stem])) == len(tables[stem]) / 2
    assert f"random_seas_{THIRD}" in seas_figures.draw(store, brief)


def test_the_example_has_it(brief):
    arrays = computed(example_case.EXPERIMENT, brief)
    tables = example_case.EXPERIMENT.tabulate(brief, arrays)
    errors = tables["example_case"].set_index(["sea", "controller"])["rmse"]
    assert errors["jonswap", THIRD] > errors["jonswap", "baseline"]
    assert THIRD in set(tables["joints"]["controller"])
    loops = {name: example_figures.ClosedLoop(**one) for name, one in arrays.items()}
    drawing = example_figures._errors(example_figures._sea_words(brief), loops)
    assert len(drawing.figure.axes[0].lines) == 3 + 1  # and where the start ends
    assert THIRD in drawing.alt


def test_each_controller_is_drawn_in_its_own_way(monkeypatch):
    monkeypatch.setitem(CONTROLLERS, "fourth", Limp)
    looks = [look(name) for name in CONTROLLERS]
    assert len({one.colour for one in looks}) == len({one.label for one in looks}) == 4
    assert len({one.face for one in looks}) == 4
    with pytest.raises(KeyError):
        look("nobody")
