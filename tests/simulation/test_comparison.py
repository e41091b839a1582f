"""Controllers of one's own, by name or not, and controllers side by side."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import softwave_min as sw
from softwave_min.simulation import ClosedLoop

P3 = (0.7, -3.7)


class Posture:
    """Holds one posture, whatever the sea does."""

    made_of = None

    def __init__(self, scenario):
        type(self).made_of = scenario
        self.q_bar = np.full(scenario.arm.segments, 0.2)

    def command(self, step, state):  # noqa: ARG002
        return sw.Command(self.q_bar)


@pytest.fixture(scope="module")
def parameters(nominal):
    return replace(nominal, simulation=replace(nominal.simulation, duration=12.0))


@pytest.fixture(scope="module")
def sea(parameters):
    return sw.Sea.random(parameters.sea, parameters.fluid.gravity)


@pytest.fixture(scope="module")
def found(parameters, sea):
    """The baseline beside an arm that holds its posture."""
    return sw.compare(parameters, sea, P3, ["baseline", Posture])


@pytest.fixture
def posture(monkeypatch):
    """The controllers with one more; its class is made of the scenario."""
    monkeypatch.setitem(sw.CONTROLLERS, "posture", Posture)


@pytest.mark.usefixtures("posture")
def test_a_controller_that_is_entered_by_name_is_one_of_them(parameters, sea):
    scenario = sw.Scenario.build(parameters, sea, P3)
    named = sw.simulate(scenario, "posture")
    assert Posture.made_of is scenario
    np.testing.assert_array_equal(named.q_bar, np.full((120, 3), 0.2))
    found = sw.compare(parameters, sea, P3)
    assert list(found.runs) == ["baseline", "nmpc", "posture"]
    np.testing.assert_array_equal(found.runs["posture"].tips, named.tips)


def test_a_controller_is_given_by_its_name_its_class_or_itself(parameters, sea):
    """What is made for the run may be run by the engine, with the same numbers."""
    scenario = sw.Scenario.build(parameters, sea, P3)
    for name, kind in (("baseline", sw.BaselineController), ("nmpc", sw.NmpcController)):
        runs = [sw.simulate(scenario, given) for given in (name, kind, kind(scenario))]
        np.testing.assert_array_equal(runs[0].q, runs[1].q)
        np.testing.assert_allclose(runs[0].q, runs[2].q, rtol=0, atol=1e-9)


def test_a_name_that_is_not_there_is_refused_with_those_that_are(parameters, sea):
    with pytest.raises(ValueError, match=r"^no controller 'pid'; there are: baseline, nmpc$"):
        sw.compare(parameters, sea, P3, ["pid"])


def test_errors_are_those_of_the_runs_whole_and_settled(found):
    errors = found.errors()
    for name, run in found.runs.items():
        distance = np.linalg.norm(run.tips[:, -1] - P3, axis=1)
        assert errors[name].whole == pytest.approx(np.sqrt(np.mean(distance**2)))
        late = distance[round(ClosedLoop.TRANSIENT / 0.1) :]
        assert errors[name].settled == pytest.approx(np.sqrt(np.mean(late**2)))
    printed = repr(errors).splitlines()
    assert [line.split()[0] for line in printed[1:]] == list(errors) == ["baseline", "Posture"]
    assert len({len(line) for line in printed}) == 1
    for row, line in zip(errors.values(), printed[1:], strict=True):
        assert [float(word) for word in line.split()[1:]] == pytest.approx(row, abs=5e-5)
    assert errors._repr_html_().count("<tr>") == 3


def test_a_run_that_ends_before_it_settles_has_no_settled_error(parameters, sea):
    brief = replace(parameters, simulation=replace(parameters.simulation, duration=1.0))
    error = sw.compare(brief, sea, P3, ["baseline"]).errors()["baseline"]
    assert error.whole > 0
    assert np.isnan(error.settled)


def test_two_controllers_of_one_name_need_another(parameters, sea):
    scenario = sw.Scenario.build(parameters, sea, P3)
    one, other = Posture(scenario), Posture(scenario)
    with pytest.raises(ValueError, match="two controllers called 'Posture'"):
        sw.compare(parameters, sea, P3, [one, other])
    other.name = "other"
    assert list(sw.compare(parameters, sea, P3, [one, other]).runs) == ["Posture", "other"]


def test_a_plot_shows_every_error_over_time_below_the_elevation(found, sea):
    above, below = found.plot()
    (line,) = above.lines
    np.testing.assert_allclose(line.get_ydata(), sea.elevation(0.0, line.get_xdata()))
    for drawn, (name, run) in zip(below.lines, found.runs.items(), strict=True):
        assert drawn.get_label() == name
        np.testing.assert_array_equal(drawn.get_ydata(), run.error)
    plt.close(above.figure)


def test_a_film_moves_every_arm_to_its_tip_of_that_time(found):
    film = found.animate()
    film._draw_was_started = True  # as far as its warning is concerned
    *_, last = film.new_saved_frame_seq()
    film._draw_frame(last)
    clock, *moving = film._drawn_artists
    assert clock.get_text() == "t = 12.0 s"
    for (target, arm), run in zip(np.reshape(moving, (2, 2)), found.runs.values(), strict=True):
        np.testing.assert_allclose(np.ravel(target.get_data()), P3)
        np.testing.assert_allclose([one[-1] for one in arm.get_data()], run.tips[-1, -1])


def test_the_planner_follows_the_target_at_the_end_of_each_period(parameters, sea):
    """A jump of the path at an instant moves the command of the period that ends there."""
    path = np.tile(P3, (60, 1))
    jumping = path.copy()
    jumping[40:] = (0.3, -3.7)
    still, moved = (
        sw.Scenario.build(parameters, sea, one).planned_angles for one in (path, jumping)
    )
    np.testing.assert_array_equal(moved[:39], still[:39])
    assert np.all(np.any(moved[39:] != still[39:], axis=1))
