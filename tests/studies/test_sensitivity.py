"""The sensitivity study: its emulator against known indices, its steps, and its record."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from SALib.analyze import morris
from SALib.test_functions import Ishigami
from scipy.stats import qmc

from softwave_min.native import compiler
from softwave_min.parameters import parameter_set
from softwave_min.runs.executor import Processes
from softwave_min.runs.store import Store
from softwave_min.studies.cells import with_bounded_solves
from softwave_min.studies.headlines import headline_numbers
from softwave_min.studies.ranges import open_fields, plausible_ranges, value_in
from softwave_min.studies.sensitivity import (
    NAME,
    SEA,
    important,
    investigate,
    number_names,
    samples,
    study_settings,
    tables,
)
from softwave_min.studies.sensitivity.emulator import fitted, indices, indices_sample, resampled

FIELDS = open_fields()
RANGES = {value.field: value for value in plausible_ranges()}
TABLES = ("screening", "indices", "prediction")


# --- the emulator -----------------------------------------------------------------------


def design(variables, size, seed=3):
    return qmc.Sobol(variables, rng=seed).random(size)


def product(shares):
    """Six factors 1 + c (x - 1/2) with known indices: variance c^2 / 12 each."""
    return np.prod(1 + STRENGTHS * (shares - 0.5), axis=1)


STRENGTHS = np.array([1.6, 1.2, 0.8, 0.4, 0.1, 0.0])
PARTS = STRENGTHS**2 / 12
VARIANCE = np.prod(1 + PARTS) - 1
FIRST = PARTS / VARIANCE
TOTAL = PARTS / (1 + PARTS) * np.prod(1 + PARTS) / VARIANCE


def test_a_polynomial_is_found_again():
    def polynomial(shares):
        return 1 + shares[:, 0] - 3 * shares[:, 1] * shares[:, 2]

    shares, elsewhere = design(3, 64), design(3, 16, seed=4)
    emulator = fitted(shares, polynomial(shares), [1, 2, 3])
    assert emulator.degree == 2
    np.testing.assert_allclose(emulator(elsewhere), polynomial(elsewhere), atol=1e-10)
    np.testing.assert_allclose(emulator.left_out, 0, atol=1e-10)


def test_points_left_out_are_predicted_from_all_others():
    shares, noise = design(2, 32), np.random.default_rng(5).normal(size=32)
    values = shares[:, 0] ** 2 + noise
    emulator = fitted(shares, values, [2])
    for one in (0, 7):
        others = np.arange(32) != one
        without = fitted(shares[others], values[others], [2])
        expected = values[one] - without(shares[[one]])[0]
        assert emulator.left_out[one] == pytest.approx(expected, rel=1e-8)


def test_too_many_terms_are_not_tried():
    shares = design(6, 32)
    assert fitted(shares, product(shares), [1, 2, 3]).degree == 1


def test_indices_of_a_product_are_the_known_ones_and_lie_in_their_intervals():
    shares = design(6, 256)
    generator = np.random.default_rng(6)
    noise = 0.1 * np.sqrt(VARIANCE) * generator.normal(size=256)
    values = product(shares) + noise
    emulator = fitted(shares, values, [1, 2, 3])
    points = indices_sample(6, 1024, seed=7)
    first, total = indices(emulator(points)[:, None], 6)
    np.testing.assert_allclose(first[:, 0], FIRST, atol=0.03)
    np.testing.assert_allclose(total[:, 0], TOTAL, atol=0.03)
    many = resampled(emulator, shares, values, 100, generator)
    low, high = np.quantile(indices(many(points), 6)[1], [0.05, 0.95], axis=1)
    assert np.all(low <= high)
    assert np.sum((low - 0.01 <= TOTAL) & (high + 0.01 >= TOTAL)) >= 5
    assert np.all(high - low < 0.2)


def test_indices_of_ishigamis_function():
    shares = design(3, 256)
    emulator = fitted(shares, Ishigami.evaluate(2 * np.pi * shares - np.pi), range(1, 9))
    points = indices_sample(3, 4096, seed=7)
    first, total = indices(emulator(points)[:, None], 3)
    np.testing.assert_allclose(first[:, 0], [0.3139, 0.4424, 0.0], atol=0.03)
    np.testing.assert_allclose(total[:, 0], [0.5576, 0.4424, 0.2437], atol=0.03)


# --- the study, with numbers of which one knows what decides them -----------------------


def known(run):
    """Numbers that three values decide, the sea a little, and all others not."""
    values = [value_in(run.parameters, field) for field in DECISIVE]
    first, second, third = (RANGES[one].share(x) for one, x in zip(DECISIVE, values, strict=True))
    sea = 0.02 * (run.parameters.sea.seed % 3 - 1)
    found = {
        "largest_reduction_W1": 100 * (1 - np.exp(-2 + first + second * first + sea)),
        "rise": 100 * (np.exp(0.2 + 3 * third + second**2) - 1),
        "rise_spread": 1.0,
        "star_W1": 0.03 * np.exp(first),
        "cells_below_one": 100.0 if first < 0.6 else 50.0,
        "solves_failed": 0,
    }
    return {name: np.array(value, float) for name, value in found.items()}


DECISIVE = ("nmpc.step_weight", "baseline.proportional_gain", "arm.stiffness")


def small():
    """The study with few sets."""
    settings = study_settings()
    return replace(
        settings,
        screening=replace(settings.screening, trajectories=4, candidates=8, resamples=20),
        important=3,
        design=replace(settings.design, sets=32, resamples=20, indices_sample=256),
        draws=5,
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Where the small study of the known numbers left its tables."""
    with pytest.MonkeyPatch.context() as patch, Processes(1) as workers:
        patch.setattr(samples, "attempted_numbers", known)
        store = Store("known", tmp_path_factory.mktemp("study"))
        assert set(investigate(store, workers, small())) == set(DECISIVE)
    return store


def test_the_solves_of_every_set_are_bounded():
    for sample in samples.screening(small()):
        judged = sample.run(small()).parameters.parameters
        assert with_bounded_solves(judged) == judged


def test_the_screening_finds_what_decides(finished):
    table = finished.read_table("screening")
    count = len(FIELDS) + 1
    assert len(table) == len(number_names(finished.read_table("draw_evaluations"))) * count
    of = table.set_index(["number", "field"])["mu_star_normalised"]
    assert of["star_W1", "nmpc.step_weight"] == pytest.approx(1)
    assert of["rise", "nmpc.step_weight"] == pytest.approx(0, abs=1e-2)
    # Within the number, one sea more or less makes less than the values that decide it.
    assert 0 < of["largest_reduction_W1", SEA] < 0.2
    assert (of["rise_spread"] == 0).all()
    ranks = table.set_index(["number", "field"])["rank"]
    assert (ranks["rise_spread"] == 1).all()
    assert ranks["star_W1", "nmpc.step_weight"] == 1
    assert ranks["star_W1"].max() <= count


def test_the_indices_are_those_of_the_numbers(finished):
    of = finished.read_table("indices").set_index(["number", "field"])
    assert of.loc[("star_W1", "nmpc.step_weight"), "total"] == pytest.approx(1, abs=0.02)
    assert of.loc[("star_W1", "arm.stiffness"), "total_high"] < 0.05
    # Variances of 3 u and of u^2 with u uniform in [0, 1].
    parts = np.array([9 / 12, 1 / 5 - 1 / 9])
    found = of.loc["rise"].loc[["arm.stiffness", "baseline.proportional_gain"], "total"]
    np.testing.assert_allclose(found, parts / parts.sum(), atol=0.03)


def test_draws_tell_the_emulators_error_from_what_was_left_out(finished):
    of = finished.read_table("prediction").set_index(["number", "drawn"])
    for drawn in ("important", "all"):
        assert of.loc[("star_W1", drawn), "explained"] > 0.99
        assert of.loc[("star_W1", drawn), "left"] == pytest.approx(0, abs=1e-4)
    seas = of.loc[("largest_reduction_W1", "all_other_sea")]
    assert seas["left"] > 5 * of.loc[("largest_reduction_W1", "all"), "left"]
    assert seas["rmse"] == pytest.approx(seas["left"], rel=0.2)
    # The interval for draws of all values has room for what seas do in the screening.
    assert of.loc[("largest_reduction_W1", "all"), "coverage"] == 1


def test_seas_are_numbered_apart_and_noise_goes_with_them():
    settings = small()
    screened, tested = samples.screening(settings), samples.draws(settings, DECISIVE)
    base = parameter_set(settings.base)
    assert {one.sea for one in screened} == {*range(settings.screening.levels)}
    unseen = [one.sea for one in tested if one.drawn == samples.OTHER_SEA]
    assert len(set(unseen)) == settings.draws
    assert not set(unseen) & {one.sea for one in screened}
    for one in tested[:3]:
        found = one.run(settings).parameters.parameters
        assert found.sea.seed - base.sea.seed == found.preview.seed - base.preview.seed == one.sea


def test_draws_of_the_important_values_leave_the_others_at_the_base():
    settings = study_settings()
    base = parameter_set(settings.base)
    alone, every, _ = samples.draws(settings, DECISIVE)[:3]
    for field in FIELDS:
        if field in DECISIVE:
            assert alone.values[field] == every.values[field] != value_in(base, field)
        else:
            assert alone.values[field] == value_in(base, field) != every.values[field]


def test_elementary_effects_are_those_of_salib(finished):
    evaluations, table = map(finished.read_table, ("screening_evaluations", "screening"))
    levels = small().screening.levels
    factors = [*FIELDS, SEA]
    grid = np.array([[RANGES[one].share(x) for x in evaluations[one]] for one in FIELDS])
    grid = np.column_stack([np.round(grid.T * levels - 0.5), evaluations[SEA]]) / (levels - 1)
    problem = {"num_vars": len(factors), "names": factors, "bounds": [[0, 1]] * len(factors)}
    for number, rows in table.groupby("number"):
        expected = morris.analyze(problem, grid, tables.on_scale(evaluations, number))
        # A step between levels is a share of the range that is smaller by one part.
        ratio = levels / (levels - 1)
        for name in ("mu_star", "sigma"):
            found = rows[name] / ratio
            np.testing.assert_allclose(found, np.array(expected[name], float), atol=1e-8)


def test_an_effect_is_left_out_if_one_of_its_sets_cannot_run(finished):
    evaluations = finished.read_table("screening_evaluations")
    evaluations.loc[3, number_names(evaluations)] = np.nan
    before = tables.effects(finished.read_table("screening_evaluations"), "star_W1", small())
    after = tables.effects(evaluations, "star_W1", small())
    assert np.isnan(after).sum() == 2
    kept = np.isfinite(after)
    np.testing.assert_array_equal(after[kept], before[kept])
    table = tables.screening_table(evaluations, small())
    assert table["mu_star"].notna().all()
    assert table.groupby("number")["effects"].sum().eq(before.size - 2).all()


def test_draws_and_what_belongs_to_them_are_left_out_together(finished):
    drawn = finished.read_table("draw_evaluations")
    drawn.loc[4, number_names(drawn)] = np.nan
    kept = tables.complete(drawn, len(samples.DRAWN))
    assert kept.index.tolist() == [0, 1, 2, *range(6, len(drawn))]


def test_numbers_are_taken_as_logarithms_of_errors_and_their_ratios():
    numbers = {
        "largest_reduction_W1": (75.0, np.log(0.25)),
        "lowest_reduction_W1": (-100.0, np.log(2)),
        "rise_W1": (100.0, np.log(2)),
        "rise": (0.0, 0.0),
        "star_W1": (0.5, np.log(0.5)),
        "cells_below_one": (50.0, 50.0),
    }
    for name, (value, expected) in numbers.items():
        (found,) = tables.on_scale(pd.DataFrame({name: [value]}), name)
        assert found == pytest.approx(expected), name
    assert np.isfinite(tables.on_scale(pd.DataFrame({"rise_spread": [0.0]}), "rise_spread"))


def test_the_study_goes_on_where_it_was_interrupted(finished, tmp_path, monkeypatch):
    evaluated = []

    def counted(run):
        if len(evaluated) == 70:
            evaluated.append(None)
            raise KeyboardInterrupt
        evaluated.append(run)
        return known(run)

    # Both have one identity, that of a function of this module.
    counted.__module__, counted.__qualname__ = known.__module__, known.__qualname__
    monkeypatch.setattr(samples, "attempted_numbers", counted)
    store = Store("resumed", tmp_path)
    with Processes(1) as workers:
        with pytest.raises(KeyboardInterrupt):
            investigate(store, workers, small())
        investigate(store, workers, small())
    for stem in TABLES:
        pd.testing.assert_frame_equal(store.read_table(stem), finished.read_table(stem))
    sets = (store.read_table(f"{one}_evaluations") for one in ("screening", "design", "draw"))
    assert len(evaluated) - 1 == sum(map(len, sets))


# --- the record -------------------------------------------------------------------------

RECORD = Store(NAME)


def test_the_record_is_of_the_settings():
    settings = study_settings()
    chosen = important(RECORD.read_table("screening"), settings)
    for step, expected in (
        ("screening", samples.screening(settings)),
        ("design", samples.design(settings, chosen)),
        ("draw", samples.draws(settings, chosen)),
    ):
        table = RECORD.read_table(f"{step}_evaluations")
        assert table["sample"].tolist() == [one.name for one in expected]
        assert table[SEA].tolist() == [one.sea for one in expected]
        values = [[one.values[field] for field in FIELDS] for one in expected]
        np.testing.assert_allclose(table[FIELDS], values, rtol=1e-8)


def test_the_tables_of_the_record_follow_from_its_evaluations():
    settings = study_settings()
    screened, designed, drawn = (
        RECORD.read_table(f"{one}_evaluations") for one in ("screening", "design", "draw")
    )
    for stem, found in (
        ("screening", tables.screening_table(screened, settings)),
        ("indices", tables.index_table(designed, settings)),
        ("prediction", tables.prediction_table(drawn, designed, screened, settings)),
    ):
        pd.testing.assert_frame_equal(found, RECORD.read_table(stem), rtol=1e-5, atol=1e-6)


@pytest.mark.skipif(compiler() is None, reason="takes minutes without a compiler")
def test_an_evaluation_of_the_record_is_found_again():
    settings = study_settings()
    chosen = important(RECORD.read_table("screening"), settings)
    row = tables.complete(RECORD.read_table("draw_evaluations")).iloc[0]
    (one,) = (one for one in samples.draws(settings, chosen) if one.name == row["sample"])
    found = headline_numbers(one.run(settings).parameters)
    for number in number_names(row.to_frame().T):
        # Of the cells one more or less may be below one, where it is close to it.
        least = 0.0 if number.startswith("star") else 9.0 if number.startswith("cells") else 0.5
        assert found[number] == pytest.approx(row[number], rel=0.05, abs=least), number
