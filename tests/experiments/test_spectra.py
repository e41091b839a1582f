"""The experiment `spectra`: what it recovers, what it depends on, what it draws."""

import math

import numpy as np
import pytest
from invented_loops import computed, shelf

from softwave_min.experiments.ablation_loops import varied
from softwave_min.figures.spectra import draw
from softwave_min.figures.style import svg
from softwave_min.paper.cases import wave_cases
from softwave_min.parameters import parameter_set
from softwave_min.runs.source import source_files
from softwave_min.studies.catalogue import experiment
from softwave_min.waves import Sea, periodogram

SPECTRA = experiment("spectra")


@pytest.fixture(scope="module")
def parameters():
    return parameter_set()


@pytest.fixture(scope="module")
def arrays(parameters):
    return computed(SPECTRA, parameters)


@pytest.fixture(scope="module")
def tables(parameters, arrays):
    return SPECTRA.tabulate(parameters, arrays)


def test_the_papers_table(tables):
    table = tables["wave_cases"]
    assert list(table["case"]) == ["W1", "W2", "W3"]
    assert list(table["peak_period"]) == [6.1, 8.0, 10.0]
    assert set(table["significant_heights"]) == {"0.5 1 1.5 2 2.5 3"}


def test_curves_and_records_have_the_papers_height_and_period(tables):
    table = tables["spectra"]
    assert len(table) == 6
    np.testing.assert_allclose(table["curve"], table["paper"], rtol=3e-4)
    assert table["within"].all()
    assert (table["record"] - table["paper"]).abs().le(2 * table["sampling_error"]).all()


def test_a_record_outside_the_range_is_marked(parameters, arrays):
    wrong = {name: dict(found) for name, found in arrays.items()}
    wrong["W2"]["record_significant_height"] = np.array([5.0])
    table = SPECTRA.tabulate(parameters, wrong)["spectra"]
    assert list(table["within"]) == [True, True, False, True, True, True]


def test_sampling_error_is_the_theoretical_one(parameters, arrays):
    """For random phases the variance of a record's m_0 is, over pairs of components,
    sum a_i^2 a_j^2 / 2 [sinc^2((f_i - f_j) T) + sinc^2((f_i + f_j) T)], besides the single
    components' sum a_i^4 / 8 sinc^2(2 f_i T).
    """
    for run in SPECTRA.runs(parameters):
        sea = Sea.random(run.parameters.sea, run.parameters.gravity)
        f, power = sea.angular_frequency / (2 * np.pi), sea.amplitude**2
        window = run.parameters.window
        i, j = np.triu_indices(len(f), 1)
        pairs = np.sinc((f[i] - f[j]) * window) ** 2 + np.sinc((f[i] + f[j]) * window) ** 2
        variance = np.sum(power[i] * power[j] / 2 * pairs)
        variance += np.sum(power**2 / 8 * np.sinc(2 * f * window) ** 2)
        found = arrays[run.name]["sample_significant_height"] ** 2 / 16
        assert found.std() == pytest.approx(math.sqrt(variance), rel=0.08)
        assert found.mean() == pytest.approx(9 / 16, rel=0.05)


def test_periodogram_holds_the_variance_and_finds_a_line():
    """In steps of 1/(8 T), T the length of the record, up to half the sampling rate."""
    time = np.arange(0, 60, 0.1)
    elevation = 0.3 + 1.5 * np.cos(2 * np.pi * time / 7.5 + 0.4)
    spectrum = periodogram(elevation, 0.1)
    assert spectrum.moment(0) == pytest.approx(np.var(elevation), rel=1e-4)
    assert spectrum.peak_period == pytest.approx(7.5, rel=0.01)
    np.testing.assert_allclose(np.diff(spectrum.frequency_hz), 1 / (8 * 60.0), rtol=1e-9)
    assert spectrum.frequency_hz[-1] == pytest.approx(5.0)


def test_the_elevation_is_that_of_the_nominal_seed(parameters, arrays):
    run = SPECTRA.runs(parameters)[2]
    sea = Sea.random(run.parameters.sea, run.parameters.gravity)
    found = arrays["W3"]
    np.testing.assert_array_equal(found["elevation"], sea.elevation(0.0, found["time"]))
    assert run.parameters.sea.seed == parameters.sea.seed
    assert found["time"][0] == 0
    assert found["time"][-1] == 60


@pytest.mark.parametrize(
    ("field", "value", "decisive"),
    [
        ("fluid.drag_coefficient", 0.7, False),
        ("arm.stiffness", (2.0, 2.0, 2.0), False),
        ("sea.significant_height", 1.0, False),
        ("sea.peak_period", 7.0, False),
        ("simulation.duration", 30.0, False),
        ("fluid.gravity", 9.8, True),
        ("sea.seed", 5, True),
        ("sea.depth", 30.0, True),
        ("sea.peak_enhancement", 1.0, True),
    ],
)
def test_only_the_sea_and_gravity_make_it_stale(parameters, field, value, decisive):
    other = varied(parameters, ((field, value),))
    for run, usual in zip(SPECTRA.runs(other), SPECTRA.runs(parameters), strict=True):
        assert (run.identity != usual.identity) == decisive


def test_source_of_arm_and_controllers_is_not_part_of_it():
    rooms = {path.parent.name for path in source_files(["softwave_min.experiments.spectra"])}
    assert "waves" in rooms
    assert not rooms & {"arm", "control", "figures"}


def test_figure_shows_the_curves_and_the_records(parameters, arrays):
    drawing = draw(shelf({}, arrays), parameters)["spectra"]
    panels = drawing.figure.axes
    assert [len(axes.lines) for axes in panels] == [3, 1, 1, 1]
    for name, axes in zip(wave_cases(), panels[1:], strict=True):
        np.testing.assert_array_equal(axes.lines[0].get_ydata(), arrays[name]["elevation"])
        assert name in axes.get_title(loc="left")
    assert svg(drawing) == svg(draw(shelf({}, arrays), parameters)["spectra"])
    assert "6.1 s (W1), 8 s (W2), 10 s (W3)" in drawing.alt
