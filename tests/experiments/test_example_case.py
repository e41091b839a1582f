"""The experiment `example_case`: which sea it is in, and what its runs depend on."""

import numpy as np
import pytest
from invented_loops import computed

from softwave_min.data import data_folder
from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.closed_loop import sea_of, whole_record
from softwave_min.experiments.example_case import EXPERIMENT, key_moments, lag_and_correlation
from softwave_min.parameters import parameter_set
from softwave_min.runs.source import source_files
from softwave_min.simulation import ClosedLoop
from softwave_min.waves.records import measured_sea, named_records


@pytest.mark.parametrize("name", ["calibrated", "physical"])
def test_the_shipped_sets_have_the_papers_sea(name):
    for run in EXPERIMENT.runs(parameter_set(name)):
        sea = run.parameters.parameters.sea
        assert (sea.significant_height, sea.peak_period) == (3.0, 10.0)


def test_the_sea_of_a_parameter_set_acts(nominal):
    """`[sea]` with another height and period is another sea, and named so in the table."""
    sea = ("sea.significant_height", 2.0), ("sea.peak_period", 7.0)
    brief = varied(nominal, (*sea, ("simulation.duration", 12.0)))
    found = EXPERIMENT.runs(brief)
    for run in found:
        amplitude = sea_of(run.parameters).amplitude
        assert 4 * np.sqrt(np.sum(amplitude**2) / 2) == pytest.approx(2.0)
    jonswap = sea_of(found[0].parameters)
    peak = jonswap.angular_frequency[np.argmax(jonswap.amplitude)]
    assert 2 * np.pi / peak == pytest.approx(7.0, rel=0.05)
    tables = EXPERIMENT.tabulate(brief, computed(EXPERIMENT, brief))
    assert set(tables["example_case"]["peak_period"]) == {7.0}


def test_the_second_sea_is_the_measured_one(nominal):
    run = next(one for one in EXPERIMENT.runs(nominal) if one.name == "measured-nmpc")
    record = named_records(data_folder() / "buoys" / "records.toml")["W3"]
    expected = measured_sea(record, nominal.sea, nominal.fluid.gravity)
    np.testing.assert_array_equal(sea_of(run.parameters).amplitude, expected.amplitude)
    np.testing.assert_array_equal(sea_of(run.parameters).phase, expected.phase)


def test_a_reader_of_buoys_makes_no_closed_loop_stale(nominal):
    computed_in = {run.compute.__module__ for run in EXPERIMENT.runs(nominal)}
    rooms = {path.parent.name for path in source_files(computed_in)}
    assert "control" in rooms
    assert not rooms & {"records", "paper", "runs"}


def test_moments_that_are_close_are_one():
    time = 0.1 * np.arange(101)
    load = np.zeros((100, 3))
    load[[20, 21, 24, 60], 1] = 5.0
    assert key_moments(time, load) == [pytest.approx((2.0, 2.5)), pytest.approx((6.0, 6.1))]


def test_the_lag_is_found_with_its_sign():
    wave = np.random.default_rng(1).normal(size=300)
    lag, correlation = lag_and_correlation(wave[5:], -wave[:-5], 0.1)
    assert lag == pytest.approx(0.5)
    assert correlation == pytest.approx(-1, abs=0.1)


def test_a_run_has_every_signal(nominal):
    brief = varied(nominal, (("simulation.duration", 0.5),))
    loop = ClosedLoop(**whole_record(EXPERIMENT.runs(brief)[0].parameters))
    assert loop.error[0] > 0
    assert len(loop.torque) == 5
