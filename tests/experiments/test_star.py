"""The star: its geometry, the measures of the error, and a short real run."""

import math
from dataclasses import asdict, replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
from invented_loops import computed, shelf
from segments import with_segments

from softwave_min.control.problem import Status
from softwave_min.data import ParameterError
from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.closed_loop import TRANSIENT
from softwave_min.experiments.star import EXPERIMENT, choice, headline, period_spread
from softwave_min.experiments.star_loops import (
    METRICS,
    STILL,
    StarRun,
    closing_time,
    follow,
    in_still_water,
    inner_loop_time,
    measures,
    scenario_on_star,
)
from softwave_min.experiments.star_path import (
    StarParameters,
    distance_to_star,
    star_path,
    star_vertices,
)
from softwave_min.figures.star import draw
from softwave_min.figures.style import svg
from softwave_min.parameters import validate
from softwave_min.simulation import CONTROLLERS, BaselineController

PENTAGRAM = math.cos(2 * math.pi / 5) / math.cos(math.pi / 5)
STAR = StarParameters(
    points=5,
    centre=(0.5, -4.0),
    outer_radius=0.25,
    inner_ratio=PENTAGRAM,
    orientation=math.pi / 2,
    start_vertex=0,
    drawing="outline",
    manner="edges",
    laps=1,
    lap_duration=60.0,
)
ONE_STROKE = replace(STAR, drawing="one_stroke")
STARS = pytest.mark.parametrize(
    "star",
    [
        STAR,
        ONE_STROKE,
        replace(STAR, points=7, inner_ratio=0.6, start_vertex=3),
        replace(ONE_STROKE, points=9, orientation=0.3),
        replace(STAR, points=4, laps=3, lap_duration=8.0),
    ],
    ids=["outline", "one stroke", "seven points", "nonagram", "four points, three laps"],
)


# --- geometry -----------------------------------------------------------------------------


def test_vertices_alternate_between_the_radii_at_equal_angles():
    spokes = star_vertices(STAR) - STAR.centre
    radius = np.hypot(*spokes.T)
    np.testing.assert_allclose(radius[::2], 0.25)
    np.testing.assert_allclose(radius[1::2], 0.25 * PENTAGRAM)
    angle = np.unwrap(np.arctan2(spokes[:, 1], spokes[:, 0]))
    np.testing.assert_allclose(np.diff(angle), math.pi / 5)
    np.testing.assert_allclose(star_vertices(STAR)[0], [0.5, -3.75])


def test_one_stroke_passes_through_the_inner_vertices_of_the_outline():
    """The nominal ratio is the pentagram's: both stars are the same set of five lines."""
    inner = star_vertices(STAR)[1::2]
    np.testing.assert_allclose(distance_to_star(ONE_STROKE, inner), 0.0, atol=1e-12)
    wider = star_vertices(replace(STAR, inner_ratio=0.5))[1::2]
    assert distance_to_star(ONE_STROKE, wider).min() > 1e-3


def test_known_perimeters():
    """Of the unit pentagram's strokes 2 sin(2 pi / 5); an outline leaves out the inner fifth."""
    chord = 2 * math.sin(2 * math.pi / 5)
    assert ONE_STROKE.edge == pytest.approx(0.25 * chord)
    assert STAR.edge == pytest.approx(0.25 * chord * PENTAGRAM)


@STARS
def test_laps_pass_all_vertices_at_constant_speed_and_end_where_they_began(star):
    period = star.lap_duration / star.vertices / 40
    times = period * np.arange(star.laps * star.vertices * 40 + 1)
    path, corners = star_path(star, times), star_vertices(star)
    np.testing.assert_allclose(np.hypot(*np.diff(path, axis=0).T) / period, star.speed, rtol=1e-6)
    laps = np.vstack([*[corners] * star.laps, corners[:1]])
    np.testing.assert_allclose(path[::40], laps, atol=1e-9)
    assert star.speed * star.lap_duration == pytest.approx(star.edge * star.vertices)
    assert len({tuple(np.round(corner, 9)) for corner in corners}) == star.vertices
    end = star.laps * star.lap_duration
    after = star_path(star, [end, end + 0.1, 2 * end])
    np.testing.assert_allclose(after, np.tile(corners[0], (3, 1)), atol=1e-12)


def test_jumps_hold_each_vertex_for_an_equal_time():
    star = replace(ONE_STROKE, manner="vertices", lap_duration=10.0)
    times = 0.1 * np.arange(100)
    path = star_path(star, times)
    np.testing.assert_array_equal(path, np.repeat(star_vertices(star), 20, axis=0))


def test_start_vertex_only_turns_the_order():
    turned = star_vertices(replace(STAR, start_vertex=4))
    np.testing.assert_allclose(turned, np.roll(star_vertices(STAR), -4, axis=0), atol=1e-12)


def test_distance_to_the_star_of_points_off_an_edge():
    corners = star_vertices(STAR)
    middle, edge = corners[:2].mean(axis=0), corners[1] - corners[0]
    outward = np.array([-edge[1], edge[0]]) / np.hypot(*edge)
    # the tip's nearest place is the vertex itself
    beyond = corners[0] + [0.0, 0.03]
    points = np.array([middle, middle + 1e-3 * outward, beyond])
    np.testing.assert_allclose(distance_to_star(STAR, points), [0, 1e-3, 0.03], atol=1e-12)


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("points", 2, "points"),
        ("inner_ratio", 1.0, "inner_ratio"),
        ("outer_radius", 0.0, "outer_radius"),
        ("laps", 0, "laps"),
        ("start_vertex", 10, "below the number of vertices, 10"),
        ("drawing", "spiral", "'outline' or 'one_stroke'"),
    ],
)
def test_impossible_stars_are_refused(field, value, complaint):
    with pytest.raises(ParameterError, match=complaint):
        validate(StarParameters, {**asdict(STAR), field: value}, source="star")


@pytest.mark.parametrize("points", [3, 6])
def test_a_star_that_one_stroke_cannot_draw_is_refused(points):
    with pytest.raises(ValueError, match="one stroke"):
        replace(ONE_STROKE, points=points)


# --- measures -----------------------------------------------------------------------------


PERIOD = 0.1
TARGET = star_path(STAR, PERIOD * np.arange(601))


def test_measures_of_a_constant_offset():
    tip, still = (TARGET + np.array(offset) for offset in ((0.03, -0.04), (0.03, 0.0)))
    found = measures(STAR, TARGET, tip, still, PERIOD)
    del found["cross_track"]
    assert found == pytest.approx(
        dict.fromkeys(("rmse", "rmse_settled", "largest", "largest_settled"), 0.05)
        | {"rmse_x": 0.03, "rmse_z": 0.04, "waves_alone": 0.04}
        | {"root_sum_square": 0.05 * math.sqrt(601)}
        | {"root_integral_square": 0.05 * math.sqrt(60.1)}
    )


def test_start_counts_in_the_whole_run_alone():
    tip = TARGET.copy()
    tip[0] += [3.0, 4.0]
    found = measures(STAR, TARGET, tip, TARGET, PERIOD)
    assert found["rmse"] == pytest.approx(5 / math.sqrt(601))
    assert found["largest"] == pytest.approx(5.0)
    assert found["rmse_settled"] == found["largest_settled"] == 0.0
    tip[round(TRANSIENT / PERIOD)] += [0.0, 1.0]
    assert measures(STAR, TARGET, tip, TARGET, PERIOD)["largest_settled"] == pytest.approx(1.0)


def test_being_late_costs_distance_but_no_cross_track():
    found = measures(STAR, TARGET, np.roll(TARGET, 10, axis=0), TARGET, PERIOD)
    assert found["cross_track"] == pytest.approx(0.0, abs=1e-9)
    # one second late, and at most that far in a straight line: less around the corners
    assert 0.9 * STAR.speed < found["rmse"] <= STAR.speed


def test_closing_is_the_first_time_below_a_part_of_the_start():
    fading = np.exp(-PERIOD * np.arange(40) / 1.5)
    offset = fading[:, None] * [0.3, 0.4]
    assert closing_time(offset, PERIOD) == pytest.approx(1.6)
    assert math.isnan(closing_time(offset[:15], PERIOD))


# --- tables -------------------------------------------------------------------------------


def star_table():
    rows = [
        {"wave": wave, "seed": seed, "controller": "nmpc", "paper": paper}
        | dict.fromkeys(METRICS, scale * (1 + seed / 100))
        for seed in range(101)
        for wave, scale, paper in (("W1", 0.2, 0.25), ("W2", 0.3, 0.30), ("W3", 0.4, 0.35))
    ]
    calm = {"wave": STILL, "seed": pd.NA, "controller": "nmpc"} | dict.fromkeys(METRICS, 9.0)
    return pd.DataFrame([calm, *rows])


def test_headline_is_the_median_and_the_quantiles_over_the_seas():
    table = headline(star_table())
    row = table[(table.wave == "W2") & (table.measure == "rmse")].iloc[0]
    assert [row.low, row["median"], row.high] == pytest.approx([0.315, 0.45, 0.585])
    assert row.seas == 101
    assert row.paper == 0.30
    assert set(table.wave) == {"W1", "W2", "W3"}
    assert table[table.measure == "rmse_settled"].paper.isna().all()


def test_spread_over_periods_is_relative_to_the_mean():
    row = period_spread(star_table()).set_index("measure").loc["rmse"]
    assert [row.low, row["median"], row.high] == pytest.approx([0.2 / 0.3] * 3)
    assert row.paper == pytest.approx(0.1 / 0.3)


# --- closed loops -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def short(nominal):
    """Twelve seconds, in the first sea only."""
    return varied(nominal, (("simulation.duration", 12.0), ("sea.realisations", 1)))


def test_the_run_starts_fully_extended_and_follows(short):
    quick = replace(STAR, lap_duration=50.0)
    found = follow(StarRun(in_still_water(short), quick))
    assert found["nmpc_tip"][0] == pytest.approx([0.9, -4.0])
    offset = np.hypot(*(found["nmpc_tip"] - found["nmpc_target"]).T)
    assert offset[-1] < 0.02 < offset[0]
    assert not found["nmpc_status"].any()
    np.testing.assert_allclose(found["nmpc_target"], star_path(quick, found["time"]))


def test_path_goes_on_through_the_last_horizon(short):
    """Else the end of a run would look to the NMPC as if the target stopped."""
    star = replace(STAR, lap_duration=60.0)
    scenario = scenario_on_star(short, star)
    times = 0.1 * np.arange(121 + short.nmpc.horizon)
    np.testing.assert_allclose(scenario.targets, star_path(star, times))


def test_drag_of_still_water_opposes_the_motion(short):
    """Its power is negative, and no fluid accelerates."""
    found = follow(StarRun(in_still_water(short), STAR))
    rate = np.gradient(found["nmpc_q"], 0.1, axis=0)[1:-1]
    power = np.sum(found["nmpc_drag"][1:] * rate, axis=1)
    assert power.sum() < 0
    assert power.max() < 1e-3 * -power.min()
    assert not found["nmpc_fluid_inertia"].any()


@pytest.fixture(scope="module")
def arrays(short):
    return computed(EXPERIMENT, short)


@pytest.fixture(scope="module")
def tables(short, arrays):
    return EXPERIMENT.tabulate(short, arrays)


def test_table_has_every_sea_and_controller_and_still_water_once(tables):
    table = tables["star"]
    rows = zip(table.wave, table.controller, strict=True)
    assert sorted(rows) == sorted(product((STILL, "W1", "W2", "W3"), CONTROLLERS))
    paper = table.set_index(["controller", "wave"]).paper
    assert dict(paper["nmpc"].dropna()) == choice().rmse
    assert paper["baseline"].isna().all()


def test_waves_move_the_tip_and_still_water_is_its_own_reference(tables):
    table = tables["star"].set_index(["wave", "controller"])
    assert table.waves_alone[STILL].eq(0).all()
    for wave in ("W1", "W2", "W3"):
        assert table.waves_alone[wave]["baseline"] > 2 * table.waves_alone[wave]["nmpc"] > 1e-4


def test_drag_grows_with_the_speed_of_the_water(tables):
    """At one height the shortest period has the fastest water."""
    scales = tables["time_scales"].set_index("wave")
    assert scales.drag["W1"] > scales.drag["W3"]
    assert scales.drag_over_fluid_inertia["W1"] < scales.drag_over_fluid_inertia["W3"]


def test_failed_solves_are_seen_in_the_figure(short, arrays, tables):
    well = draw(shelf(tables, arrays), short)
    assert set(well) == {"star_trajectory", "errors"}
    assert all(drawing.caption and drawing.alt for drawing in well.values())
    run = f"W3-{short.sea.seed}"
    status = arrays[run]["nmpc_status"].copy()
    status[[20, 50]] = Status.ITERATION_LIMIT
    failed = {**arrays, run: {**arrays[run], "nmpc_status": status}}
    marked = draw(shelf(tables, failed), short)["star_trajectory"]
    assert "crosses at the 2 solves" in marked.caption
    assert svg(marked) != svg(well["star_trajectory"])


@pytest.mark.parametrize("segments", [2, 4, 5])
def test_arms_of_any_number_of_segments_follow_the_star(short, segments):
    """That of two has no closing time: its NMPC stays beside the star."""
    other = with_segments(short, segments)
    found = computed(EXPERIMENT, other)
    tables = EXPERIMENT.tabulate(other, found)
    assert np.isfinite(tables["star"][list(METRICS)]).all(axis=None)
    assert all(svg(drawing) for drawing in draw(shelf(tables, found), other).values())


def test_an_error_that_never_falls_is_a_gap_in_the_table(short, arrays):
    """An arm that stays where it starts has no closing time, and all else in its row."""
    calm = dict(arrays[STILL])
    calm["nmpc_tip"] = np.tile(calm["nmpc_tip"][0], (len(calm["nmpc_tip"]), 1))
    calm["nmpc_target"] = calm["nmpc_tip"] + [0.1, 0.0]
    scales = EXPERIMENT.tabulate(short, {**arrays, STILL: calm})["time_scales"]
    gaps = scales.columns[scales.isna().any()]
    assert set(gaps) == {"closing", "peak_period_over_closing"}


def test_a_third_controller_is_in_every_table_and_in_the_figure(short, arrays, monkeypatch):
    monkeypatch.setitem(CONTROLLERS, "third", BaselineController)
    run = EXPERIMENT.runs(short)[0]
    calm = run.compute(run.parameters)
    np.testing.assert_array_equal(calm["third_tip"], calm["baseline_tip"])
    several = {
        name: found | {key.replace("baseline", "third"): found[key] for key in found}
        for name, found in arrays.items()
    }
    tables = EXPERIMENT.tabulate(short, several)
    assert all("third" in set(table["controller"]) for table in tables.values())
    drawn = draw(shelf(tables, several), short)["errors"]
    _, labels = drawn.figure.axes[0].get_legend_handles_labels()
    assert "third" in labels


def test_inner_loop_time_of_an_overdamped_joint(nominal):
    """A single light segment with much damping: (damping) / (stiffness)."""
    arm = {"length": 0.05, "diameter": 0.01, "density": nominal.fluid.density}
    arm |= {"stiffness": 1.0, "damping": 0.3}
    gains = {"proportional_gain": 3.0, "derivative_gain": 0.7}
    parameters = replace(
        nominal,
        arm=replace(nominal.arm, **{name: (value,) for name, value in arm.items()}),
        baseline=replace(nominal.baseline, **{name: (value,) for name, value in gains.items()}),
    )
    assert inner_loop_time(parameters, np.array([0.4])) == pytest.approx(1.0 / 4.0, rel=1e-3)
