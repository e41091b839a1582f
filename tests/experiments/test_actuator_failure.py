"""The experiment `actuator_failure`: its grid, its tables, one real place."""

import math
from itertools import product

import numpy as np
import pandas as pd
import pytest
from invented_loops import shelf

from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.actuator_failure import (
    ALL,
    EXPERIMENT,
    grid_table,
    headline,
    motion,
    places,
    run_at,
    spread,
    statements,
)
from softwave_min.experiments.closed_loop import closed_loops
from softwave_min.experiments.failures import PAPERS_CASE, failure_cases
from softwave_min.figures.actuator_failure import draw
from softwave_min.figures.style import svg
from softwave_min.paper.numbers import actuator_failure
from softwave_min.parameters import parameter_set

STEPS = 300
CASES = failure_cases(parameter_set())
RISES = {"mid_passive": 25.0, "tip_passive": 40.0, "mid_locked": 10.0, "tip_locked": -5.0}


def synthetic_run(place, case):
    """Constant errors: the intact arm's grow with the height, the failed arm's by its rise."""
    intact = 0.1 * place.height
    error = intact * (1 + RISES.get(case, 0.0) / 100)
    time = 0.1 * np.arange(STEPS + 1)
    q = np.zeros((STEPS + 1, 3))
    q[:, 1] = 0.3 * np.sin(2 * np.pi * 0.05 * time) + 0.04 * np.sin(2 * np.pi * time)
    q[:, 2] = q[:, 1] / 10
    data = {
        "nmpc_error": np.full(STEPS + 1, error),
        "nmpc_q": q,
        "nmpc_status": np.zeros(STEPS, dtype=int),
        "nmpc_source": np.zeros(STEPS, dtype=int),
    }
    if case == "intact":
        data["baseline_error"] = np.full(STEPS + 1, 3 * intact)
        data["baseline_status"] = data["baseline_source"] = np.zeros(STEPS, dtype=int)
    return data


def synthetic(parameters):
    return {
        run_at(place, case).name: synthetic_run(place, case)
        for place in places(parameters)
        for case in CASES
    }


@pytest.fixture(scope="module")
def tables(nominal):
    return EXPERIMENT.tabulate(nominal, synthetic(nominal))


@pytest.fixture
def grid(tables):
    return tables["actuator_failure"].copy()


def test_the_grid_is_the_papers_with_every_case(nominal, tables):
    cells = tables["actuator_failure"]
    expected = product(("W1", "W2", "W3"), ("P3", "P6"), (1.5, 2.0, 2.5, 3.0), CASES)
    found = cells[["wave", "pose", "Hs", "case"]].itertuples(index=False, name=None)
    assert sorted(found) == sorted(expected)
    assert len({run.name for run in EXPERIMENT.runs(nominal)}) == len(cells)


def test_each_run_has_its_sea_and_its_failure(nominal):
    two = varied(nominal, (("sea.realisations", 2),))
    for place in places(two):
        for case, state in CASES.items():
            run = run_at(place, case).parameters
            assert run.parameters.sea.significant_height == place.height
            assert run.parameters.sea.seed == place.seed
            assert run.parameters.failure.segment == state.segment
            assert run.parameters.failure.manner == state.manner
            assert run.parameters.preview == place.parameters.preview
            assert ("baseline" in run.controllers) == (case == "intact")
    assert {place.seed for place in places(two)} == {nominal.sea.seed, nominal.sea.seed + 1}


def test_a_part_of_the_cases_makes_a_part_of_the_tables(nominal, grid):
    two = ("intact", PAPERS_CASE)
    wanted = {run_at(*one).name for one in product(places(nominal), two)}
    arrays = {name: dict(one) for name, one in synthetic(nominal).items() if name in wanted}
    for one in arrays.values():
        del one["nmpc_q"]
    part = grid_table(nominal, arrays, two)
    whole = grid[grid["case"].isin(two)].reset_index(drop=True)
    pd.testing.assert_frame_equal(part, whole)
    for table in (headline, spread, statements):
        expected = table(grid).query("case == @PAPERS_CASE").reset_index(drop=True)
        pd.testing.assert_frame_equal(table(part), expected)


def test_rises_are_over_the_intact_arm_in_the_same_sea(grid):
    for case, rise in RISES.items():
        np.testing.assert_allclose(grid[grid["case"] == case]["rise_percent_nmpc"], rise)
    assert (grid[grid["case"] == "intact"]["rise_percent_nmpc"] == 0).all()
    np.testing.assert_allclose(grid["e_baseline_intact"], 0.3 * grid["Hs"])


def test_the_settled_window_leaves_the_start_out(nominal):
    arrays = synthetic(nominal)
    place = next(places(nominal))
    arrays[run_at(place, PAPERS_CASE).name]["nmpc_error"][:100] = 9.0
    table = EXPERIMENT.tabulate(nominal, arrays)["actuator_failure"]
    row = table[table["case"] == PAPERS_CASE].iloc[0]
    assert row["rise_percent_nmpc"] > 1000
    assert row["rise_percent_nmpc_settled"] == pytest.approx(25)


def test_mean_and_maximum_are_read_per_spectrum_and_over_all(grid):
    papers = grid["case"] == PAPERS_CASE
    grid.loc[papers & (grid["wave"] == "W1") & (grid["Hs"] == 2.0), "rise_percent_nmpc"] = 65.0
    rises = headline(grid).query("case == @PAPERS_CASE and window == 'whole'")
    rises = rises.set_index(["wave", "reading"])["rise"]
    mean, maximum = (rises.xs(one, level="reading") for one in ("mean", "maximum"))
    assert mean[["W1", ALL, "W3"]].tolist() == pytest.approx([35, 25 + 40 / 12, 25])
    assert maximum[["W1", ALL, "W3"]].tolist() == pytest.approx([65, 65, 25])


def test_the_papers_numbers_stand_where_they_belong(tables):
    rises = tables["rises"].dropna(subset="paper")
    assert set(rises["case"]) == {PAPERS_CASE}
    by_wave = rises.drop_duplicates("wave").set_index("wave")["paper"]
    assert dict(by_wave) == {"W3": 23.17, ALL: 25.61}


def test_the_interval_is_over_seas(grid):
    seas = [
        grid.assign(seed=seed, rise_percent_nmpc=grid["rise_percent_nmpc"] + seed)
        for seed in range(21)
    ]
    rises = headline(pd.concat(seas, ignore_index=True))
    row = rises.query("case == @PAPERS_CASE and window == 'whole' and wave == 'all'").iloc[0]
    assert row[["low", "rise", "high"]].tolist() == pytest.approx([26, 35, 44])


def test_the_spread_between_spectra_in_points_and_relative(grid):
    papers = grid["case"] == PAPERS_CASE
    for wave, rise in (("W1", 30.0), ("W2", 26.0), ("W3", 24.0)):
        grid.loc[papers & (grid["wave"] == wave), "rise_percent_nmpc"] = rise
    found = spread(grid).query("case == @PAPERS_CASE and window == 'whole'")
    assert set(found["reading"]) == {"mean", "maximum"}
    for row in found.itertuples():
        assert row.points == pytest.approx(6)
        assert row.relative == pytest.approx(25)
        assert row.lowest == "W3" == row.paper_lowest
        assert row.paper == actuator_failure().largest_spread


def test_single_cells_are_counted(grid):
    papers = grid["case"] == PAPERS_CASE
    grid.loc[papers & (grid["Hs"] == 3.0), "rise_percent_nmpc"] = -1.0
    grid.loc[papers & (grid["Hs"] == 1.5) & (grid["wave"] == "W2"), "rise_percent_nmpc"] = -1.0
    grid.loc[papers & (grid["Hs"] == 2.0), "e_nmpc"] = 1.0
    found = statements(grid).set_index(["case", "window"]).loc[(PAPERS_CASE, "whole")]
    assert (found["cells"], found["better"], found["better_at_largest"]) == (24, 8, 6)
    assert found["below_baseline"] == 24 - 6
    assert found["largest_ratio"] == pytest.approx(1 / 0.6)


def test_failed_solves_and_fallbacks_are_counted_where_they_occur(nominal):
    arrays = synthetic(nominal)
    place = list(places(nominal))[7]
    one = arrays[run_at(place, "tip_locked").name]
    one["nmpc_status"][3:6], one["nmpc_source"][3:5] = 2, 1
    found = EXPERIMENT.tabulate(nominal, arrays)
    table = found["actuator_failure"]
    touched = table[table["solves_failed"] > 0].iloc[0]
    assert (touched["case"], touched["Hs"]) == ("tip_locked", place.height)
    assert (touched["solves_failed"], touched["fallbacks"]) == (3, 2)
    assert table["solves_failed"].sum() == 3
    assert found["statements"]["fallbacks"].sum() == 2 * 2  # once for each window
    drawings = draw(shelf(found), nominal)
    assert "converge: 3; commands from a fallback: 2;" in drawings["all_cases"].caption
    assert "A star" in drawings["all_cases"].caption
    assert "Every solve converged" in drawings["actuator_failure"].caption
    lines = [line for axes in drawings["all_cases"].figure.axes for line in axes.lines]
    assert sum(len(line.get_xdata()) for line in lines if line.get_marker() == "*") == 1


def test_the_motion_is_split_at_the_frequency():
    period = 0.1
    time = period * np.arange(500)
    slow, fast = (a * np.cos(2 * np.pi * f * time + 0.3) for a, f in ((0.4, 0.08), (0.1, 0.5)))
    below, above = motion(1.7 + slow + fast, period, 0.1)
    assert below == pytest.approx(0.4 / math.sqrt(2), rel=1e-9)
    assert above == pytest.approx(0.1 / math.sqrt(2), rel=1e-9)


@pytest.mark.parametrize("count", [400, 401])
def test_the_parts_of_the_motion_make_its_variance(count):
    angle = np.random.default_rng(3).normal(size=count)
    below, above = motion(angle, 0.1, 1.3)
    assert below**2 + above**2 == pytest.approx(np.var(angle), rel=1e-12)


def test_the_motion_of_passive_and_actuated_joints_is_compared(tables):
    joints = tables["passive_motion"]
    assert set(joints["case"]) == {"intact", "mid_passive", "tip_passive"}
    mid = joints[joints["segment"] == 2]
    assert mid["rms_below"].iloc[0] > 5 * mid["rms_above"].iloc[0] > 0
    tip = joints[joints["segment"] == 3]
    np.testing.assert_allclose(10 * tip["rms_below"], mid["rms_below"])
    assert set(joints["peak_frequency_hz"].round(6)) == {round(1 / t, 6) for t in (6.1, 8, 10)}


def test_excitation_is_the_mean_motion_beside_the_mean_rise(tables):
    found = tables["excitation"].set_index(["case", "wave"])
    assert len(found) == 2 * 3
    np.testing.assert_allclose(found["above_to_actuated"], 1)  # the same motion in every run
    joints = tables["passive_motion"].set_index(["case", "wave"]).sort_index()
    for (case, wave), row in found.iterrows():
        assert row["rms_above"] == pytest.approx(joints.loc[(case, wave), "rms_above"].mean())
        assert row["rise_percent"] == pytest.approx(RISES[case])


def test_the_largest_wave_against_the_arm(nominal, tables):
    size = tables["wave_size"].set_index("wave")
    np.testing.assert_allclose(size["height_over_body"], 3.0 / 0.9)
    deep = nominal.fluid.gravity * 6.1**2 / (2 * math.pi)
    assert size.loc["W1", "wavelength"] == pytest.approx(deep, rel=0.05)
    assert size["wavelength"].is_monotonic_increasing


def test_figures_have_the_papers_panels(nominal, tables):
    drawings = draw(shelf(tables), nominal)
    panels = drawings["actuator_failure"].figure.axes
    titles = [axes.get_title(loc="left")[4:] for axes in panels]
    assert titles == [f"{wave}, {pose}" for wave in ("W1", "W2", "W3") for pose in ("P3", "P6")]
    cells = tables["actuator_failure"].set_index(["wave", "pose", "case", "Hs"])["e_nmpc"]
    heights = [bar.get_height() for bar in panels[2].patches]
    expected = cells.sort_index().loc["W2", "P3"]
    np.testing.assert_allclose(heights, [*expected["intact"], *expected[PAPERS_CASE]])
    assert svg(drawings["rises"]) == svg(draw(shelf(tables), nominal)["rises"])


def test_a_real_place(nominal):
    """Over the first seconds: a locked angle stays, a passive one moves, all is finite."""
    short = varied(nominal, (("simulation.duration", 3.0),))
    place = next(places(short))
    loops = {case: closed_loops(run_at(place, case).parameters) for case in CASES}
    assert "baseline_error" in loops["intact"]
    assert np.abs(loops["mid_locked"]["nmpc_q"][:, 1]).max() == 0
    assert np.abs(loops["tip_locked"]["nmpc_q"][:, 2]).max() == 0
    assert np.abs(loops["mid_passive"]["nmpc_q"][:, 1]).max() > 1e-2
    for loop in loops.values():
        assert np.isfinite(loop["nmpc_q"]).all()
        assert loop["nmpc_error"][-1] < 0.8 * loop["nmpc_error"][0]
