"""The experiment `error_ratio`: its grid, its tables, its figures, and one cell for real."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from invented_loops import shelf

from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.closed_loop import closed_loops
from softwave_min.experiments.error_ratio import (
    EXPERIMENT,
    curvature_correlations,
    depth_pairs,
    extremes,
    headline,
    period_spread,
    run_at,
    torque_table,
    trends,
)
from softwave_min.experiments.error_ratio import grid_table as table_of
from softwave_min.experiments.places import places
from softwave_min.figures.error_ratio import draw
from softwave_min.figures.style import svg
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import parameter_set
from softwave_min.simulation import BaselineController, NmpcController, Scenario, simulate
from softwave_min.waves import Sea

STEPS = 120
START = 100
"""Steps of the start-up, 10 s of 0.1 s."""


@pytest.fixture(scope="module")
def parameters():
    return varied(parameter_set(), (("simulation.duration", 0.1 * STEPS),))


def seas(parameters, count):
    return varied(parameters, (("sea.realisations", count),))


def loop_arrays():
    """A run of both controllers, less off after the start; the NMPC by half the baseline's."""
    error = np.where(np.arange(STEPS + 1) < START, 0.4, 0.1)
    found = {}
    for controller, factor in (("nmpc", 0.5), ("baseline", 1.0)):
        found |= {
            f"{controller}_error": factor * error,
            f"{controller}_q": np.full((STEPS + 1, 3), 0.3),
            f"{controller}_wave_torque": np.ones((STEPS, 3)),
            f"{controller}_status": np.full(STEPS, 0 if controller == "nmpc" else -1),
            f"{controller}_source": np.zeros(STEPS, int),
        }
    return found


def all_arrays(parameters):
    return {run.name: loop_arrays() for run in EXPERIMENT.runs(parameters)}


# --- the grid ---------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2])
def test_the_table_has_every_cell_of_the_paper_once(parameters, count):
    asked = seas(parameters, count)
    table = EXPERIMENT.tabulate(asked, all_arrays(asked))["error_ratio"]
    found = table[["wave", "pose", "Hs", "seed"]]
    assert len(found) == len(found.drop_duplicates()) == 108 * count
    heights = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    grid = product(("W1", "W2", "W3"), (f"P{i}" for i in range(1, 7)), heights)
    assert set(map(tuple, found[["wave", "pose", "Hs"]].to_numpy())) == set(grid)


def test_names_are_unique_and_a_place_is_in_its_sea_and_at_its_pose(parameters):
    names = [run.name for run in EXPERIMENT.runs(seas(parameters, 2))]
    assert len(set(names)) == len(names)
    for place in places(parameters):
        run = run_at(place).parameters
        assert run.parameters.sea.peak_period == wave_cases()[place.wave].peak_period
        assert run.path == (poses()[place.pose],)
        assert run.controllers == ("baseline", "nmpc")


def test_seas_differ_in_their_phases_and_in_the_controllers_noise(parameters):
    first, second = list(places(seas(parameters, 2)))[:2]
    assert (first.wave, first.pose, first.height) == (second.wave, second.pose, second.height)
    assert first.seed != second.seed
    assert first.parameters.preview.seed != second.parameters.preview.seed


# --- the tables -------------------------------------------------------------------------


def test_errors_are_whole_and_settled(parameters):
    row = table_of(parameters, all_arrays(parameters)).iloc[0]
    whole = np.sqrt((START * 0.4**2 + (STEPS + 1 - START) * 0.1**2) / (STEPS + 1))
    assert row.e_baseline == pytest.approx(whole)
    assert row.e_nmpc == pytest.approx(whole / 2)
    assert row.ratio_nmpc == row.ratio_nmpc_settled == pytest.approx(0.5)
    assert row.e_baseline_settled == pytest.approx(0.1)
    assert row.solves_failed == row.fallbacks == 0


def test_failed_solves_and_fallbacks_are_counted(parameters):
    arrays = all_arrays(parameters)
    arrays["W2-P4-150cm-1"]["nmpc_status"][[3, 7, 50]] = [1, 3, 2]
    arrays["W2-P4-150cm-1"]["nmpc_source"][7] = 1
    table = table_of(parameters, arrays)
    failed = table[table.solves_failed > 0]
    assert failed[["wave", "pose", "Hs"]].to_numpy().tolist() == [["W2", "P4", 1.5]]
    assert failed.solves_failed.item() == 3
    assert table.fallbacks.sum() == failed.fallbacks.item() == 1


def grid_table(ratio, count=1):
    """A table of the whole grid; ``ratio`` is a function of wave, pose, height and seed."""
    heights = wave_cases()["W1"].significant_height
    cells = list(product(wave_cases(), poses(), heights, range(1, count + 1)))
    ratios = np.array([ratio(*cell) for cell in cells])
    return pd.DataFrame(cells, columns=["wave", "pose", "Hs", "seed"]).assign(
        e_nmpc=0.1 * ratios, e_baseline=0.1, ratio_nmpc=ratios, ratio_nmpc_settled=0.5 * ratios,
        solves_failed=0, fallbacks=0,
    )  # fmt: skip


def falling(wave, pose, height, seed):
    """Smaller in higher waves and far from the base; 0.01 more for every seed."""
    lever = {"1": 0.0, "2": 0.1, "3": 0.15, "4": -0.05, "5": 0.05, "6": 0.1}[pose[1]]
    return 0.9 - lever * height - 0.02 * int(wave[1]) + 0.01 * (seed - 1)


def test_extremes_name_the_cell_its_failed_solves_and_the_papers_value():
    table = grid_table(falling)
    table.loc[(table.wave == "W1") & (table.pose == "P3") & (table.Hs == 3.0), "solves_failed"] = 2
    found = extremes(table).set_index(["wave", "extreme"])
    assert dict(found.failed[found.failed > 0]) == {("W1", "largest"): 2}
    best, worst = found.loc[("W2", "largest")], found.loc[("W2", "smallest")]
    assert (best.pose, best.Hs) == ("P3", 3.0)
    assert best.reduction == pytest.approx(100 * (1 - (0.9 - 0.45 - 0.04)))
    assert (worst.pose, worst.Hs) == ("P4", 3.0)
    assert worst.reduction == pytest.approx(100 * (1 - (0.9 + 0.15 - 0.04)))
    assert best.paper == 81.60
    assert worst.paper == 2.82
    assert best.difference == pytest.approx(best.reduction - 81.60)


def test_the_headline_is_the_interval_over_the_seas():
    count = 21
    found = headline(grid_table(falling, count)).set_index(["wave", "quantity"])
    best = found.loc[("W3", "largest")]
    assert best.seeds == count
    assert best["median"] == pytest.approx(100 * (1 - (0.9 - 0.45 - 0.06)) - 10)
    assert best.high - best.low == pytest.approx(18)  # 90 % of 20 steps of one per cent
    everything = found.loc["all"]
    assert everything["median"]["largest"] == pytest.approx(best["median"])
    assert everything.paper["largest"] == 83.78
    assert everything.paper["smallest"] == 2.82
    assert everything.paper["below_one"] == 100


def test_the_headline_counts_cells_below_one_and_has_the_settled_ratios():
    found = headline(grid_table(lambda _, pose, *__: 1.0 if pose == "P4" else 0.5))
    share = found.set_index(["wave", "quantity"])["median"]
    assert share["all", "below_one"] == pytest.approx(100 * 5 / 6)
    assert share["W1", "smallest"] == 0
    settled = headline(grid_table(falling), "settled").set_index(["wave", "quantity"])["median"]
    assert settled["W1", "largest"] == pytest.approx(100 * (1 - 0.5 * (0.9 - 0.45 - 0.02)))


def test_trends_tell_falling_from_rising():
    found = trends(grid_table(falling)).set_index(["wave", "pose"])
    assert found.correlation_nmpc["W1", "P3"] == pytest.approx(-1)
    assert found.correlation_nmpc["W3", "P4"] == pytest.approx(1)
    assert len(found) == 18


def test_the_spread_over_the_periods_is_that_of_the_waves():
    table = grid_table(lambda wave, pose, height, _: 0.5 + 0.1 * height * (wave + pose == "W3P1"))
    found = period_spread(table, (0.0, -4.0)).set_index("pose")
    assert found.spread_nmpc["P1"] == pytest.approx(0.1 * np.mean([0.5, 1, 1.5, 2, 2.5, 3]))
    assert found.spread_nmpc_largest["P1"] == pytest.approx(0.3)
    assert found.spread_nmpc_settled["P1"] == pytest.approx(found.spread_nmpc["P1"] / 2)
    assert found.spread_nmpc.drop("P1").abs().max() == pytest.approx(0)
    assert set(found.distance.nsmallest(2).index) == {"P1", "P4"}


def test_torques_are_of_the_settled_arm(parameters):
    arrays = all_arrays(parameters)
    one = arrays["W1-P1-050cm-1"]
    one["nmpc_q"][START:] = [-0.9, 0.6, 0.3]
    one["nmpc_q"][:START] = 7.0
    one["nmpc_wave_torque"][START:] = [3.0, -2.0, 6.0]
    one["nmpc_wave_torque"][:START] = 99.0
    found = torque_table(parameters, arrays).set_index(["wave", "pose", "Hs", "controller"])
    row = found.loc[("W1", "P1", 0.5, "nmpc")]
    assert row.curvature == pytest.approx(1.8 / sum(parameters.arm.length))
    assert row.torque == pytest.approx(7.0)
    assert row[["torque_1", "torque_2", "torque_3"]].tolist() == pytest.approx([3, 2, 6])
    assert found.loc[("W1", "P1", 0.5, "baseline")].torque == pytest.approx(np.sqrt(3))


def torques_of(table, torque, curvature):
    place = table[["wave", "pose", "Hs", "seed"]]
    one = place.assign(curvature=place.pose.map(curvature), torque=place.pose.map(torque))
    return pd.concat(one.assign(controller=name) for name in ("baseline", "nmpc"))


def test_curvature_torque_and_reduction_are_ranked_over_the_poses():
    number = {pose: float(pose[1]) for pose in poses()}
    table = grid_table(lambda _, pose, *__: 1 - 0.1 * number[pose])
    torques = torques_of(table, torque=number.get, curvature=lambda pose: 7 - number[pose])
    found = curvature_correlations(torques, table)
    assert len(found) == 3 * 6 * 2
    np.testing.assert_allclose(found.curvature_torque, -1)
    np.testing.assert_allclose(found.torque_reduction_nmpc, 1)


def test_pairs_are_one_above_the_other():
    table = grid_table(lambda _, pose, *__: 0.5 if pose in {"P1", "P2", "P3"} else 0.7)
    torques = torques_of(table, lambda pose: 3.0 if pose < "P4" else 2.0, lambda _: 1.0)
    found = depth_pairs(torques, table)
    pairs = {("P1", "P4"), ("P2", "P5"), ("P3", "P6")}
    assert set(zip(found.upper, found.lower, strict=True)) == pairs
    assert len(found) == 3 * 18
    np.testing.assert_allclose(found.ratio_difference_nmpc, 0.2)
    np.testing.assert_allclose(found.torque_quotient, 1.5)


# --- one place for real -----------------------------------------------------------------


def loops_at(parameters, name):
    """The loops of one place for real, as if they were those of every place."""
    place = next(one for one in places(parameters) if one.run_name() == name)
    found = closed_loops(run_at(place).parameters)
    return place, dict.fromkeys((one.run_name() for one in places(parameters)), found)


def test_a_place_is_what_the_simulation_gives(parameters):
    place, arrays = loops_at(parameters, "W1-P2-200cm-1")
    row = table_of(parameters, arrays).iloc[0]
    own = place.parameters
    scenario = Scenario.build(own, Sea.random(own.sea, own.fluid.gravity), poses()["P2"])
    nmpc = simulate(scenario, NmpcController(scenario)).error
    baseline = simulate(scenario, BaselineController(scenario)).error
    for ratio, start in ((row.ratio_nmpc, 0), (row.ratio_nmpc_settled, START)):
        expected = np.sqrt(np.mean(nmpc[start:] ** 2) / np.mean(baseline[start:] ** 2))
        assert ratio == pytest.approx(expected, rel=1e-9)


def test_solves_that_run_out_of_iterations_are_failed_ones(parameters):
    hasty = varied(parameters, (("nmpc.max_iterations", 1), ("nmpc.tolerance", 1e-12)))
    _, arrays = loops_at(hasty, "W3-P3-300cm-1")
    row = table_of(hasty, arrays).iloc[0]
    assert row.solves_failed > STEPS / 2
    assert np.isfinite(row.ratio_nmpc)


# --- the figures ------------------------------------------------------------------------


@pytest.fixture
def drawn(parameters):
    """Draw a table of cells."""
    return lambda table: draw(shelf({"error_ratio": table}), parameters)


def crosses(drawing):
    lines = (line for axes in drawing.figure.axes for line in axes.lines)
    return sum(len(line.get_xdata()) for line in lines if line.get_marker() == "x")


def heights_of(axes):
    return [bar.get_height() for bar in sorted(axes.patches, key=lambda bar: bar.get_x())]


def test_the_bars_are_the_ratios(drawn):
    drawings = drawn(grid_table(falling))
    panels = drawings["error_ratio"].figure.axes
    for wave, axes in zip(wave_cases(), panels, strict=True):
        heights = wave_cases()[wave].significant_height
        expected = [falling(wave, pose, height, 1) for pose, height in product(poses(), heights)]
        np.testing.assert_allclose(heights_of(axes), expected)
        assert wave in axes.get_title(loc="left")
        assert not axes.containers[0].errorbar
    assert crosses(drawings["error_ratio"]) == 0
    assert "Every solve converged" in drawings["error_ratio"].caption


def test_bars_stand_at_their_pose_whatever_its_name(drawn, monkeypatch):
    """`P10` comes before `P2` in the alphabet, and last in the file."""
    renamed = dict(zip(["P1", "P2", "P3", "P4", "P5", "P10"], poses().values(), strict=True))
    table = grid_table(falling).replace({"pose": {"P6": "P10"}})
    before = [heights_of(axes) for axes in drawn(grid_table(falling))["error_ratio"].figure.axes]
    monkeypatch.setattr("softwave_min.figures.error_ratio.poses", lambda: renamed)
    panels = drawn(table)["error_ratio"].figure.axes
    assert [text.get_text() for text in panels[-1].get_xticklabels()] == list(renamed)
    for axes, expected in zip(panels, before, strict=True):
        np.testing.assert_allclose(heights_of(axes), expected)


def test_bars_are_lighter_in_lower_waves_and_the_papers_values_stand_at_their_poses(drawn):
    first, _, last = drawn(grid_table(falling))["error_ratio"].figure.axes
    bars = sorted(first.patches, key=lambda bar: bar.get_x())
    lightness = [np.dot(bar.get_facecolor()[:3], (0.3, 0.6, 0.1)) for bar in bars[:6]]
    assert np.all(np.diff(lightness) < -0.05)
    drawn_lines = [line.get_data() for line in last.lines if len(line.get_xdata()) == 2]
    levels = {round(float(heights[0]), 4): np.mean(places) for places, heights in drawn_lines}
    assert levels[0.1622] == pytest.approx(list(poses()).index("P3"))
    assert levels[0.9488] == pytest.approx(list(poses()).index("P4"))


def test_a_failed_cell_is_marked_in_every_figure_of_it(drawn):
    table = grid_table(falling)
    table.loc[[4, 70], "solves_failed"] = [3, 2]
    table.loc[20, "fallbacks"] = 1
    drawings = drawn(table)
    for name in ("error_ratio", "settled"):
        assert crosses(drawings[name]) == 3
        assert "converge: 5; commands from a fallback: 1;" in drawings[name].caption
        assert "3 of 108" in drawings[name].caption


def test_several_seas_get_whiskers(drawn):
    drawing = drawn(grid_table(falling, 3))["error_ratio"]
    whiskers = [one for axes in drawing.figure.axes for one in axes.containers if one is not None]
    assert any(type(one).__name__ == "ErrorbarContainer" for one in whiskers)
    assert "Medians over 3 random seas" in drawing.caption


def test_figures_are_the_same_bytes_again(drawn):
    table = grid_table(falling)
    first, second = drawn(table), drawn(table)
    assert set(first) == {"error_ratio", "settled"}
    for name, drawing in first.items():
        assert svg(drawing) == svg(second[name])
        assert drawing.alt
