"""The search for a parameter set: its ranges, its objective, its steps, and its record."""

import tomllib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from softwave_min.data import ParameterError, data_folder
from softwave_min.native import compiler
from softwave_min.parameters import ParameterSet, parameter_set, validate
from softwave_min.runs.executor import Processes
from softwave_min.runs.store import Store, read_table, results_folder
from softwave_min.studies import calibration
from softwave_min.studies.calibration import (
    best_of,
    calibrate,
    flatness,
    objective,
    search_settings,
    set_text,
)
from softwave_min.studies.cells import headline_cells
from softwave_min.studies.headlines import HeadlineRun, headline_numbers
from softwave_min.studies.ranges import (
    GRADATION,
    open_fields,
    plausible_ranges,
    value_in,
    with_values,
)

RANGES, SEARCH = plausible_ranges(), search_settings()
RECORD = results_folder() / "calibration" / "evaluations.csv"


@pytest.mark.parametrize("name", ["physical", "calibrated"])
def test_the_sets_that_ship_lie_within_the_plausible_ranges(name):
    for value in RANGES:
        assert value.low <= value_in(parameter_set(name), value.field) <= value.high, value.field


def test_a_share_of_a_range_and_its_value_belong_together():
    for value in RANGES:
        assert value.at(0) == pytest.approx(value.low)
        assert value.at(1) == pytest.approx(value.high)
        middle = value.at(0.5)
        assert value.share(middle) == pytest.approx(0.5)
        mean = np.sqrt(value.low * value.high) if value.scale == "log" else None
        assert middle == pytest.approx(mean or (value.low + value.high) / 2)


def test_open_parameters_are_set_one_by_one(nominal):
    for value in RANGES:
        changed = with_values(nominal, {value.field: value.high})
        assert value_in(changed, value.field) == pytest.approx(value.high, rel=1e-3)
        for other in RANGES:
            if other.field not in {value.field, GRADATION, "baseline.proportional_gain"}:
                found = value_in(changed, other.field)
                assert found == value_in(nominal, other.field), (value.field, other.field)


def test_gains_fall_from_the_base_to_the_tip_about_their_mean(nominal):
    gains = with_values(nominal, {"baseline.proportional_gain": 6.0, GRADATION: 2.0}).baseline
    assert gains.proportional_gain == pytest.approx((12.0, 6.0, 3.0))


def test_the_text_of_a_set_is_the_set_and_keeps_its_comments(nominal):
    text = (data_folder() / "parameters" / "physical.toml").read_text()
    fields = open_fields()
    other = with_values(nominal, {value.field: value.at(0.3) for value in RANGES})
    written = set_text(text, other, fields)
    assert validate(ParameterSet, tomllib.loads(written), source="text") == other
    assert written.count("#") == text.count("#")
    with pytest.raises(ParameterError, match="not in the set"):
        set_text("[arm]\n", other, fields)


def test_the_objective_counts_deviations_in_units_of_their_scale():
    exact = {one.name: one.paper for one in SEARCH.number}
    assert objective(exact, SEARCH) == 0.0
    for one in SEARCH.number:
        above, below, far = (
            objective({**exact, one.name: one.paper + steps * one.scale}, SEARCH)
            for steps in (1, -1, 100)
        )
        assert above == pytest.approx(2 * (np.sqrt(2) - 1))
        assert below == (0.0 if one.at_most else pytest.approx(above))
        assert far == pytest.approx(2 * 100 - 2, rel=1e-3)


def bowl(run):
    """Numbers that agree with the paper's at one place of the ranges only."""
    shares = [value.share(value_in(run.parameters, value.field)) for value in RANGES]
    offset = np.max(np.abs(np.array(shares) - 0.4))
    found = {one.name: np.array(one.paper + offset * 10) for one in SEARCH.number}
    return {**found, "solves_failed": np.array(0)}


def test_the_search_goes_on_where_it_was_interrupted(tmp_path, monkeypatch):
    evaluated = []

    def counted(run):
        if len(evaluated) == 10:
            evaluated.append(None)
            raise KeyboardInterrupt
        evaluated.append(run)
        return bowl(run)

    # Both evaluations have one identity, that of a function of this module.
    counted.__module__, counted.__qualname__ = bowl.__module__, bowl.__qualname__
    search = replace(SEARCH, population=6, generations=4)
    with Processes(1) as workers:
        monkeypatch.setattr(calibration, "headline_numbers", bowl)
        straight = calibrate(Store("straight", tmp_path / "straight"), workers, search)
        monkeypatch.setattr(calibration, "headline_numbers", counted)
        store = Store("resumed", tmp_path / "resumed")
        with pytest.raises(KeyboardInterrupt):
            calibrate(store, workers, search)
        resumed = calibrate(store, workers, search)
    assert len(evaluated) - 1 == len(straight) == 1 + 4 * 6
    pd.testing.assert_frame_equal(resumed, straight)
    assert straight["objective"].min() < straight["objective"].iloc[0]


def test_flatness_is_the_interval_of_sets_about_as_good_as_the_best():
    values = RANGES[:2]
    shares = np.array([[0.1, 0.5], [0.4, 0.5], [0.9, 0.6]])
    table = pd.DataFrame(
        {
            value.field: [value.at(share) for share in column]
            for value, column in zip(values, shares.T, strict=True)
        }
    ).assign(objective=[5.0, 5.9, 7.0])
    found = flatness(table, values)
    assert found["near"].tolist() == [2, 2]
    assert found["share"].tolist() == pytest.approx([0.3, 0.0])
    assert found["best"].tolist() == pytest.approx(
        [value.at(s) for value, s in zip(values, shares[0], strict=True)]
    )


def test_the_calibrated_set_is_the_best_of_the_record():
    record = read_table(RECORD)
    best = best_of(record)
    fields = open_fields()
    start = parameter_set(calibration.START)
    assert with_values(start, best[fields].to_dict()) == parameter_set("calibrated")
    assert len(record) == 1 + SEARCH.generations * SEARCH.population
    recomputed = [objective(row, SEARCH) for row in record.to_dict("records")]
    np.testing.assert_allclose(recomputed, record["objective"], rtol=1e-8)


@pytest.mark.skipif(compiler() is None, reason="takes minutes without a compiler")
def test_the_numbers_of_the_best_set_are_found_again():
    record = read_table(RECORD)
    best = best_of(record)
    found = headline_numbers(HeadlineRun(parameter_set("calibrated"), headline_cells()))
    for one in SEARCH.number:
        assert found[one.name] == pytest.approx(best[one.name], abs=0.1 * one.scale), one.name
