"""The effect of every other reading: all of them measured, by the same loops in the same seas."""

from __future__ import annotations

import zlib
from itertools import pairwise
from operator import attrgetter

import numpy as np
import pytest
from invented_loops import shelf
from segments import with_segments

from softwave_min.data import ParameterError
from softwave_min.experiments.ablation_loops import varied
from softwave_min.figures import open_points as figure
from softwave_min.figures import style
from softwave_min.paper.open_points import open_points as register
from softwave_min.paper.tolerance import tolerance
from softwave_min.parameters import parameter_set
from softwave_min.studies import headlines
from softwave_min.studies.cells import headline_cells, with_bounded_solves
from softwave_min.studies.headlines import attempted_numbers, headline_numbers
from softwave_min.studies.open_points import (
    BRIEF,
    GROUPS,
    MEASURED,
    OFFSETS,
    REALISATIONS,
    SCATTER_SEAS,
    alternatives,
    group_of,
    loops,
    offsets,
    runs,
    tabulate,
)

WAVES = ("W1", "W2", "W3")
NUMBERS = [
    *(f"{group}_{wave}" for group in GROUPS for wave in WAVES),
    "rise",
    "rise_spread",
    "cells_below_one",
]
POINTS = register()
CALIBRATED = parameter_set()


def invented(run, drag=100.0):
    """Numbers that scatter with the sea, and hang on the drag and on the bounds alone."""
    found = run.parameters
    sea = zlib.crc32(str((found.sea.seed, found.preview.seed)).encode()) / 2**32
    level = 10 * sea + drag * found.fluid.drag_coefficient + (found.nmpc.angle_bound > 6)
    return {name: np.array(level) for name in NUMBERS} | {"solves_failed": np.array(3)}


def invented_tables(parameters, numbers=invented):
    arrays = {run.name: numbers(run.parameters) for run in runs(parameters)}
    return tabulate(parameters, arrays)


@pytest.fixture(scope="module")
def tables():
    return invented_tables(CALIBRATED)


def test_every_point_with_a_switch_is_measured(tables):
    switched = {
        (one.id, switch.field, len(switch.values)) for one in POINTS for switch in one.switches
    }
    assert len(POINTS) == 51
    rows = tables["points"]
    assert set(zip(rows["point"], rows["field"], rows["values"], strict=True)) == switched
    assert (rows["status"] == MEASURED).all()
    effects = tables["effects"]
    assert len(effects) == len(NUMBERS) * sum(count for _, _, count in switched)
    assert np.isfinite(effects["difference"]).all()


def test_runs_are_named_once_and_computed_once():
    found = runs(CALIBRATED)
    assert len({run.name for run in found}) == len({run.parameters for run in found}) == len(found)
    others = {(one.field, one.written) for one in alternatives(CALIBRATED)}
    expected = sum(len(offsets(field)) for field, _ in others if field != REALISATIONS)
    assert len(found) == 1 + SCATTER_SEAS + expected


def test_readings_and_nominal_set_meet_the_same_seas():
    """Bar those readings that are about the sea's seed or its sampling."""
    nominal = varied(CALIBRATED, (("sea.realisations", 1),))
    for one in alternatives(CALIBRATED):
        section, _ = one.field.split(".")
        if section in {"sea", "preview"}:
            continue
        for offset in offsets(one.field):
            here = loops(one.parameters, one.field, offset)
            usual = loops(nominal, one.field, offset)
            assert here.cells == usual.cells
            for same in map(attrgetter, ("sea", "preview", "simulation.duration")):
                assert same(here.parameters) == same(usual.parameters)


def test_seas_are_seas_of_their_own():
    """Another seed of the register must not bring a sea that was met already."""
    (switch,) = (one for point in POINTS for one in point.switches if one.field == "sea.seed")
    seeds = [CALIBRATED.sea.seed, *switch.values]
    met = [seed + offset for seed in seeds for offset in OFFSETS]
    assert len(set(met)) == len(met)
    assert max(OFFSETS) < SCATTER_SEAS


def test_slow_readings_are_measured_briefly():
    brief = {run for run in runs(CALIBRATED) if run.parameters.cells != headline_cells()}
    assert brief
    assert {run.parameters.parameters.simulation.duration for run in brief} == {BRIEF}
    assert {len(run.parameters.cells.grid) for run in brief} == {1}
    for run in set(runs(CALIBRATED)) - brief:
        found = run.parameters.parameters
        assert found.simulation.integrator == CALIBRATED.simulation.integrator
        assert found.nmpc.solver == CALIBRATED.nmpc.solver


def test_solves_are_bounded_and_take_no_more_than_the_set_allows():
    bounded = {with_bounded_solves(run.parameters.parameters) for run in runs(CALIBRATED)}
    assert bounded == {run.parameters.parameters for run in runs(CALIBRATED)}
    assert with_bounded_solves(CALIBRATED) != CALIBRATED
    hasty = varied(CALIBRATED, (("nmpc.max_iterations", 1),))
    assert with_bounded_solves(hasty) == hasty


def test_the_effect_is_the_difference_in_the_same_sea_and_may_be_exactly_none(tables):
    effects = tables["effects"]
    own = effects[effects["field"] == "fluid.drag_coefficient"]
    expected = 100.0 * (own["value"].astype(float) - CALIBRATED.fluid.drag_coefficient)
    for name in ("difference", "low", "high"):  # the sea's own part cancels
        np.testing.assert_allclose(own[name], expected)
    np.testing.assert_allclose(own["alternative"] - own["nominal"], expected)
    rows = tables["points"].set_index("field")
    assert (rows.loc["baseline.task_gain", list(GROUPS)] == 0.0).all()
    assert rows.loc["baseline.task_gain", "matters"] == "no"


def test_a_reading_that_the_set_has_already_has_exactly_no_effect():
    textbook = varied(CALIBRATED, (("fluid.morison", "textbook"),))

    def sharp(run):
        """Numbers that tell any two runs apart."""
        level = zlib.crc32(repr(run).encode()) / 2**32
        return {name: np.array(level) for name in NUMBERS} | {"solves_failed": np.array(0)}

    effects = invented_tables(textbook, sharp)["effects"]
    same = effects["field"] == "fluid.morison"
    assert set(effects[same]["point"]) == {"A03", "A04", "A06"}
    assert (effects[same][["difference", "low", "high"]] == 0.0).all(axis=None)
    assert (effects[~same]["difference"] != 0.0).all()


def test_a_change_is_seen_beside_another_sea_and_the_claims_tolerance(tables):
    scatter = tables["scatter"].set_index("number")
    assert list(scatter.index) == NUMBERS
    assert scatter["scatter"].between(2.0, 5.0).all()  # half of 90 % of ten
    allowance = scatter["allowance"]
    assert allowance["largest_reduction_W1"] == tolerance(81.67, "%")
    assert allowance["star_W1"] == scatter["scatter"]["star_W1"]
    rows = tables["points"].set_index("field")
    assert list(rows[rows["matters"] == "yes"].index) == ["fluid.drag_coefficient"]
    bound = rows.loc["nmpc.angle_bound"]  # changes all by one, less than the scatter
    assert bound["star"] == pytest.approx(1.0)
    assert bound["star_times"] == pytest.approx(1 / scatter["scatter"]["star_W1"])
    assert bound["star_at"] == "6.283185307179586"
    assert bound["exceeds"] == bound["star_exceeds"] == "no"
    assert rows.loc["fluid.drag_coefficient", "rise_exceeds"] == "yes"


def test_a_change_may_exceed_the_scatter_and_not_matter():
    def between(run):
        """A change that another sea does not make, and that no verdict hangs on."""
        level = 0.1 * run.parameters.sea.seed + 2.9 * (run.parameters.nmpc.angle_bound > 6)
        return {name: np.array(level) for name in NUMBERS} | {"solves_failed": np.array(0)}

    rows = invented_tables(CALIBRATED, between)["points"].set_index("field")
    bound = rows.loc["nmpc.angle_bound"]
    assert bound["lowest_reduction_exceeds"] == "yes"
    assert bound["lowest_reduction_times"] <= 1


def test_many_seas_are_compared_with_one_by_their_median(tables):
    effects = tables["effects"]
    rows = effects[effects["field"] == REALISATIONS].set_index("number")
    median = tables["scatter"].set_index("number")["median"]
    np.testing.assert_allclose(rows["alternative"], median)
    assert (rows["low"] < rows["high"]).all()


def test_what_cannot_run_is_in_the_table(tables):
    def failing(run):
        if run.parameters.fluid.drag_coefficient == 1.5:
            return {"failure": np.array("the state is not finite at t = 3.2 s")}
        return invented(run)

    found = invented_tables(CALIBRATED, failing)
    rows = found["points"].set_index("field")
    assert rows.loc["fluid.drag_coefficient", "status"] == (
        "cannot run: the state is not finite at t = 3.2 s"
    )
    # the other value counts
    other = tables["effects"].query("field == 'fluid.drag_coefficient' and value == '0.7'")
    largest = rows.loc["fluid.drag_coefficient", "star"]
    assert largest == pytest.approx(other["difference"].iloc[0])
    assert (rows.drop("fluid.drag_coefficient")["status"] == MEASURED).all()


@pytest.mark.parametrize("segments", [2, 5])
def test_values_that_a_set_cannot_have_are_in_the_table(segments):
    rows = invented_tables(with_segments(CALIBRATED, segments))["points"].set_index("field")
    assert rows.loc["arm.density", "status"].startswith("cannot be set")
    assert rows.loc["arm.density", "matters"] == "no"
    assert np.isnan(rows.loc["arm.density", "star"])
    assert rows.loc["nmpc.horizon", "status"] == MEASURED


def test_more_seas_asked_for_change_nothing():
    many = varied(CALIBRATED, (("sea.realisations", 7),))
    assert [run.parameters for run in runs(many)] == [run.parameters for run in runs(CALIBRATED)]


@pytest.mark.parametrize(
    ("number", "group"),
    [("rise", "rise"), ("rise_W2", "rise"), ("rise_spread", ""), ("star_W1", "star")],
)
def test_numbers_belong_to_groups(number, group):
    assert group_of(number) == group


# --- the real thing, briefly ------------------------------------------------------------


@pytest.fixture(scope="module")
def brief():
    return varied(CALIBRATED, (("simulation.duration", 4.0),))


@pytest.fixture(scope="module")
def usual(brief):
    return headline_numbers(loops(brief, "", 0))


def changed(brief, usual, field, value):
    found = attempted_numbers(loops(varied(brief, ((field, value),)), "", 0))
    assert set(usual) == {*NUMBERS, "solves_failed"}
    return {name: float(found[name] - usual[name]) for name in usual}


@pytest.mark.parametrize("change", [("fluid.morison", "textbook"), ("fluid.drag_coefficient", 1.5)])
def test_the_load_matters(brief, usual, change):
    found = changed(brief, usual, *change)
    assert max(abs(found[f"largest_reduction_{wave}"]) for wave in WAVES) > 0.2
    assert max(abs(found[f"star_{wave}"]) for wave in WAVES) > 1e-4


def test_the_manner_of_the_failure_changes_the_rise_alone(brief, usual):
    found = changed(brief, usual, "failure.manner", "locked")
    for name in NUMBERS:
        assert (found[name] == 0.0) == (not name.startswith("rise")), name


def test_a_finer_integrator_changes_nothing_that_counts(brief, usual):
    found = changed(brief, usual, "simulation.extrapolated_steps", 4)
    assert max(abs(found[name]) for name in NUMBERS) < 0.01


def test_the_middle_segment_of_the_paper_may_be_the_last(brief):
    short = varied(with_segments(brief, 2), (("simulation.duration", 1.0),))
    found = headline_numbers(loops(short, "", 0))
    assert found.keys() >= set(NUMBERS)
    with pytest.raises(ParameterError, match="segment 2: the arm has 1"):
        runs(with_segments(brief, 1))


def test_a_set_that_cannot_run_says_why(brief):
    heavy = varied(brief, (("arm.density", (1e308,) * 3),))
    found = attempted_numbers(loops(heavy, "", 0))
    assert list(found) == ["failure"]
    assert "not finite" in str(found["failure"])


def test_a_mistake_in_the_program_is_no_property_of_the_set(brief, monkeypatch):
    def mistaken(_):
        raise KeyError("W4")

    monkeypatch.setattr(headlines, "headline_numbers", mistaken)
    with pytest.raises(KeyError):
        attempted_numbers(loops(brief, "", 0))


# --- the figure -------------------------------------------------------------------------


def test_the_figure_ranks_every_switch(tables):
    drawing = figure.draw(shelf(tables), CALIBRATED)["open_points"]
    labels = [label.get_text() for label in drawing.figure.axes[0].get_yticklabels()]
    assert labels[0] == "A11 drag coefficient"
    assert "A03, A04, A06 morison" in labels
    assert len(labels) == tables["points"]["field"].nunique()
    times = tables["points"].drop_duplicates("field").set_index("field")["times"]
    ranked = list(figure.ranking(tables["points"]))
    assert all(times[one] >= times[other] for one, other in pairwise(ranked))
    assert b"A11 drag coefficient" in style.svg(drawing)
