"""What the study's evaluations say: elementary effects, indices, and how draws are predicted.

A headline number is the ratio of two errors, or an error, and a value matters by the factor by
which it changes that. So all of this is done on the logarithm (`on_scale`), but for the share
of cells, which stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from softwave_min.runs.statistics import rank_correlation
from softwave_min.simulation import root_mean_square_error
from softwave_min.studies.ranges import open_fields, plausible_ranges
from softwave_min.studies.sensitivity.emulator import (
    Emulator,
    fitted,
    indices,
    indices_sample,
    resampled,
)
from softwave_min.studies.sensitivity.samples import ALONE, DRAWN, SEA, Study

Floats = NDArray[np.float64]

PLACE = ("sample", "drawn", SEA)
"""Columns of a table of evaluations that are neither values nor numbers."""
LEAST = 1e-3
"""Per cent: the spread of the rises may be next to none."""


def number_names(evaluations: pd.DataFrame) -> list[str]:
    """The headline numbers, by their columns in a table of evaluations."""
    others = {*PLACE, "solves_failed", *open_fields()}
    return [name for name in evaluations.columns if name not in others]


def on_scale(evaluations: pd.DataFrame, number: str) -> Floats:
    """A headline number as the logarithm of what it stands for; the share of cells in per cent.

    A reduction is 1 - ratio of two errors and a rise their ratio - 1, both in per cent.
    """
    values: Floats = evaluations[number].to_numpy(float)
    if number.startswith(("largest_reduction", "lowest_reduction")):
        return np.asarray(np.log(1 - values / 100))
    if number == "rise_spread":
        return np.asarray(np.log(np.maximum(values, LEAST)))
    if number.startswith("rise"):
        return np.asarray(np.log(1 + values / 100))
    if number.startswith("star"):
        return np.asarray(np.log(values))
    return values


def complete(evaluations: pd.DataFrame, together: int = 1) -> pd.DataFrame:
    """The sets that have their numbers, and so all of the ``together`` that belong together."""
    numbers = evaluations[number_names(evaluations)].to_numpy(float)
    whole = np.isfinite(numbers).all(axis=1).reshape(-1, together).all(axis=1)
    return evaluations[np.repeat(whole, together)]


def effects(evaluations: pd.DataFrame, number: str, settings: Study) -> Floats:
    """Elementary effects per whole range, (trajectories, factors): the open parameters, the sea.

    NaN where one of the two sets cannot run.
    """
    fields, count = open_fields(), settings.screening.levels
    levels = np.round(_shares(evaluations, fields) * count - 0.5)
    levels = np.column_stack([levels, evaluations[SEA].to_numpy(float)])
    factors = levels.shape[1]
    steps = np.diff(levels.reshape(-1, factors + 1, factors), axis=1) / count
    changes = np.diff(on_scale(evaluations, number).reshape(-1, factors + 1), axis=1)
    # Each step changes one factor.
    found = changes / steps.sum(axis=2)
    return np.take_along_axis(found, np.abs(steps).argmax(axis=2).argsort(axis=1), axis=1)


def screening_table(evaluations: pd.DataFrame, settings: Study) -> pd.DataFrame:
    """Elementary effects: ``mu_star`` with half its interval, ``sigma``, and ranks.

    All are in units of `on_scale` per whole range. Seas have no order and no distance: theirs
    are scaled alike, so that a step between levels compares with a step between seas.
    ``effects`` is how many there are. ``mu_star_normalised`` is relative to the largest of
    the number's over the open parameters.
    """
    factors = [*open_fields(), SEA]
    generator = settings.generator(3)
    rows = []
    for number in number_names(evaluations):
        for factor, every in zip(factors, effects(evaluations, number, settings).T, strict=True):
            found = every[np.isfinite(every)]
            size = (settings.screening.resamples, len(found))
            means = np.abs(found)[generator.integers(len(found), size=size)].mean(axis=1)
            low, high = np.quantile(means, settings.quantiles)
            rows.append(
                {
                    "number": number,
                    "field": factor,
                    "mu_star": float(np.abs(found).mean()),
                    "mu_star_confidence": float(high - low) / 2,
                    "sigma": float(found.std(ddof=1)),
                    "effects": len(found),
                }
            )
    table = pd.DataFrame(rows)
    numbers = table["number"]
    largest = table["mu_star"].where(table["field"] != SEA).groupby(numbers).transform("max")
    table["mu_star_normalised"] = (table["mu_star"] / largest).where(largest > 0, 0.0)
    # Rounding must not decide between equals.
    ranks = table["mu_star"].round(9).groupby(numbers).rank(ascending=False, method="min")
    return table.assign(rank=ranks.astype(int))


def importance(table: pd.DataFrame) -> pd.Series[float]:
    """Mean normalised ``mu_star`` of each factor over the headline numbers, largest first."""
    means = table.groupby("field", sort=False)["mu_star_normalised"].mean()
    return means.sort_values(ascending=False, kind="stable")


def important(table: pd.DataFrame, settings: Study) -> list[str]:
    """The values that count as important, in the order of the open parameters."""
    first = importance(table).drop(SEA).index[: settings.important]
    return [field for field in open_fields() if field in first]


def emulators(evaluations: pd.DataFrame, settings: Study) -> dict[str, Emulator]:
    """For each headline number an emulator in the values that the design varies."""
    evaluations = complete(evaluations)
    shares = _shares(evaluations, varied(evaluations))
    return {
        number: fitted(shares, on_scale(evaluations, number), settings.design.degrees)
        for number in number_names(evaluations)
    }


def varied(evaluations: pd.DataFrame) -> list[str]:
    """Fields of the values that differ between the sets of a table."""
    return [one for one in open_fields() if np.ptp(evaluations[one]) > 0]


def index_table(evaluations: pd.DataFrame, settings: Study) -> pd.DataFrame:
    """First- and total-order indices of each number, with intervals over resamples.

    ``degree`` is the emulator's, ``explained`` the share of the variance in the design that it
    predicts where the point is left out; the indices are shares of what it predicts.
    """
    evaluations = complete(evaluations)
    fields = varied(evaluations)
    shares = _shares(evaluations, fields)
    points = indices_sample(len(fields), settings.design.indices_sample, settings.seed)
    parts = []
    for place, (number, emulator) in enumerate(emulators(evaluations, settings).items()):
        values = on_scale(evaluations, number)
        generator = settings.generator(100 + place)
        many = resampled(emulator, shares, values, settings.design.resamples, generator)
        found = {}
        for name, estimates, replicates in zip(
            ("first", "total"),
            indices(emulator(points)[:, None], len(fields)),
            indices(many(points), len(fields)),
            strict=True,
        ):
            low, high = np.quantile(replicates, settings.quantiles, axis=1)
            estimate = estimates[:, 0]
            # Where a fit to a resample is biased, as it is where the emulator explains little,
            # the interval still reaches the estimate.
            found[name] = estimate
            found[f"{name}_low"] = np.minimum(low, estimate)
            found[f"{name}_high"] = np.maximum(high, estimate)
        table = pd.DataFrame({"number": number, "field": fields, **found})
        explained = _explained(values, values - emulator.left_out)
        parts.append(table.assign(degree=emulator.degree, explained=explained))
    return pd.concat(parts, ignore_index=True)


def prediction_table(
    evaluations: pd.DataFrame, designed: pd.DataFrame, screened: pd.DataFrame, settings: Study
) -> pd.DataFrame:
    """How the emulators predict draws not seen before, by what was drawn; all on the scale.

    ``coverage`` is the share of the draws in an interval stated without them. Where the
    important values alone are drawn it is that of the errors in the design at the points left
    out; else that of the emulator's errors at the sets of the screening, in which all
    values and the sea change as well. ``left`` is the root mean square of what the other values
    (and the sea) change, found by judging the same draw with and without them.
    """
    fields = varied(designed)
    evaluations, screened = complete(evaluations, len(DRAWN)), complete(screened)
    alone = evaluations[evaluations["drawn"] == ALONE]
    rows = []
    for number, emulator in emulators(designed, settings).items():
        errors = on_scale(screened, number) - emulator(_shares(screened, fields))
        for drawn in DRAWN:
            table = evaluations[evaluations["drawn"] == drawn]
            values = on_scale(table, number)
            predicted = emulator(_shares(table, fields))
            stated = emulator.left_out if drawn == ALONE else errors
            low, high = np.quantile(stated, settings.quantiles)
            correlation = rank_correlation(pd.Series(values), pd.Series(predicted))
            inside = (low <= values - predicted) & (values - predicted <= high)
            rows.append(
                {
                    "number": number,
                    "drawn": drawn,
                    "draws": len(values),
                    "spread": float(np.std(values)),
                    "rmse": root_mean_square_error(values - predicted),
                    "explained": _explained(values, predicted),
                    "rank_correlation": float(np.nan_to_num(correlation)),
                    "coverage": float(np.mean(inside)),
                    "left": root_mean_square_error(values - on_scale(alone, number)),
                }
            )
    return pd.DataFrame(rows)


def _explained(values: Floats, predicted: Floats) -> float:
    """One less the ratio of the mean square error to the variance; 0 where there is none."""
    variance = float(np.var(values))
    return float(1 - np.mean((values - predicted) ** 2) / variance) if variance > 0 else 0.0


def _shares(evaluations: pd.DataFrame, fields: Sequence[str]) -> Floats:
    """Values of a table as shares of their ranges, (sets, fields)."""
    of = {value.field: value for value in plausible_ranges()}
    return np.array([[of[one].share(value) for value in evaluations[one]] for one in fields]).T
