"""The stars beside the nominal one: which there are, and which come near the paper."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from invented_loops import computed, shelf
from segments import with_segments

from softwave_min.experiments import star
from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.star import choice
from softwave_min.experiments.star_loops import METRICS, STILL, follow, follow_swept, measures
from softwave_min.experiments.star_sweep import EXPERIMENT, sweep_points
from softwave_min.figures.star_sweep import draw
from softwave_min.figures.style import svg
from softwave_min.paper.tolerance import SHARE


@pytest.fixture(scope="module")
def short(nominal):
    """Twelve seconds, in the first sea only."""
    return varied(nominal, (("simulation.duration", 12.0), ("sea.realisations", 1)))


@pytest.fixture(scope="module")
def table(short):
    return EXPERIMENT.tabulate(short, computed(EXPERIMENT, short))["star_sweep"]


def test_sweep_holds_the_nominal_star_and_no_star_twice():
    nominal, found = choice().path, sweep_points()
    assert [one.star for one in found if one.previewed].count(nominal) == 1
    assert len({one.name for one in found}) == len(found)
    time = nominal.laps * nominal.lap_duration
    assert all(one.star.laps * one.star.lap_duration == pytest.approx(time) for one in found)


def test_nominal_star_of_the_sweep_is_the_nominal_run(short, table):
    found = {run.name: follow(run.parameters) for run in star.runs(short)}
    nominal = star.star_table(short, found)
    nominal = nominal[nominal.controller == "nmpc"].set_index("wave")
    own = choice().path
    for name in ("outer_radius", "drawing", "manner", "laps"):
        table = table[table[name] == getattr(own, name)]
    swept = table[table.previewed].set_index("measure")
    for wave in (STILL, "W3"):
        found = [swept[wave][metric] for metric in METRICS]
        assert found == pytest.approx([nominal[metric][wave] for metric in METRICS], rel=1e-9)


def test_arms_of_two_segments_follow_the_sweep(short):
    two = with_segments(short, 2)
    first, *others = EXPERIMENT.runs(two)
    found = first.compute(first.parameters)
    swept = EXPERIMENT.tabulate(two, {run.name: found for run in (first, *others)})["star_sweep"]
    assert len(swept) == len(METRICS) * len(sweep_points())
    assert np.isfinite(swept["deviation"]).all()


def test_candidates_are_near_the_paper_in_every_sea(table):
    sweep, paper = table, pd.Series(choice().rmse)
    apart = (sweep[paper.index].astype(float) - paper).abs() / paper
    np.testing.assert_allclose(sweep.deviation, apart.max(axis=1))
    complete = sweep[paper.index].notna().all(axis=1)
    assert (sweep.candidate == (complete & (apart <= SHARE).all(axis=1))).all()


def test_candidates_and_failed_solves_are_seen_in_the_figure(short, table):
    def drawn(rows):
        return draw(shelf({"star_sweep": rows}), short)["star_sweep"]

    none = drawn(table.assign(candidate=False))
    assert "(0 of all" in none.caption
    assert none.alt
    one = table.assign(candidate=table.index == 0)
    assert svg(drawn(one)) != svg(none)
    assert "(1 of all" in drawn(one).caption
    (axes,) = drawn(table.assign(solves_failed=7)).figure.axes
    assert all("[7]" in label.get_text() for label in axes.get_yticklabels())


def test_other_seas_are_run_only_for_what_may_agree(short):
    """A hopeless star is seen in still water and one sea, a hopeful one in all."""

    def swept(paper):
        seas = tuple(replace(sea, paper=paper) for sea in run.seas)
        return follow_swept(replace(run, seas=seas))

    nominal = next(one.name for one in sweep_points() if one.star == choice().path)
    run = next(one.parameters for one in EXPERIMENT.runs(short) if one.name == nominal)
    hopeless = swept(50.0)
    assert {name for name in hopeless if name.endswith("tip")} == {"still_tip", "W3_tip"}
    tips = hopeless["target"], hopeless["W3_tip"], hopeless["still_tip"]
    hopeful = swept(1.1 * measures(run.star, *tips, 0.1)["rmse"])
    assert {"W1_tip", "W2_tip"} < hopeful.keys()
    np.testing.assert_array_equal(hopeful["W3_tip"], hopeless["W3_tip"])
