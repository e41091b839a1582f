"""The paper's three seas: their JONSWAP curves and one 60 s record of each.

A record of six to ten waves tells height and period of its sea with an error that is
not small. That error is measured: the same estimates are made from many records that
differ in their random phases alone, and their spread stands beside every estimate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from softwave_min.experiments.places import in_sea
from softwave_min.paper.cases import WaveCase, wave_cases
from softwave_min.paper.numbers import spectra
from softwave_min.parameters import ParameterSet, SeaParameters
from softwave_min.runs.experiment import Arrays, Experiment, Run, RunArrays, Tables
from softwave_min.waves.field import Sea
from softwave_min.waves.spectrum import Spectrum, jonswap_density, periodogram

INTERVAL = 0.1
"""Time between two elevations, in s."""
RECORDS = 1000
"""Random records that the sampling error is taken from."""
CURVE_END_HZ = 5.0
CURVE_STEP_HZ = 0.0002
RANGE = (2.5, 97.5)
"""Percentiles of the estimates that bound their 95 % range."""

QUANTITIES = {"significant_height": "m", "peak_period": "s"}


@dataclass(frozen=True)
class SeaRecord:
    """A sea of the paper and how long it is looked at."""

    case: WaveCase
    """The row of the paper's table, which the tables repeat."""
    sea: SeaParameters
    """That sea at the height shown."""
    gravity: float
    """g, in m/s^2."""
    window: float
    """Length of the record, in s."""


def runs(parameters: ParameterSet) -> list[Run]:
    """One run per wave case."""
    chosen, gravity = spectra(), parameters.fluid.gravity
    seas = {name: in_sea(parameters, name, chosen.significant_height).sea for name in wave_cases()}
    return [
        Run(name, compute, SeaRecord(case, seas[name], gravity, chosen.window))
        for name, case in wave_cases().items()
    ]


def compute(record: SeaRecord) -> dict[str, NDArray[Any]]:
    """Curve, elevation at x = 0, and what is recovered from both.

    Returns
    -------
    dict of ndarray
        ``frequency_hz``, ``density``: the JONSWAP curve; ``time``, ``elevation``: the
        record, both ends included; and for q = ``significant_height``, ``peak_period``:
        ``curve_q``, ``record_q`` and ``sample_q``, the estimates from `RECORDS` records
        of seeds 0, 1, ...
    """
    sea = record.sea
    frequency_hz = np.arange(0.0, CURVE_END_HZ + CURVE_STEP_HZ / 2, CURVE_STEP_HZ)
    density = jonswap_density(
        frequency_hz, sea.significant_height, sea.peak_period, sea.peak_enhancement
    )
    time = np.linspace(0.0, record.window, round(record.window / INTERVAL) + 1)

    def elevation(seed: int) -> NDArray[np.float64]:
        return Sea.random(replace(sea, seed=seed), record.gravity).elevation(0.0, time)

    def spectrum(seed: int) -> Spectrum:
        # N steps make a record of N samples: the last belongs to the next one
        return periodogram(elevation(seed)[:-1], time[1] - time[0])

    found = {
        "curve": [Spectrum(frequency_hz, density)],
        "record": [spectrum(sea.seed)],
        "sample": [spectrum(seed) for seed in range(RECORDS)],
    }
    estimates = {
        f"{source}_{quantity}": np.array([getattr(one, quantity) for one in estimated])
        for source, estimated in found.items()
        for quantity in QUANTITIES
    }
    return {
        "frequency_hz": frequency_hz,
        "density": density,
        "time": time,
        "elevation": elevation(sea.seed),
        **estimates,
    }


def tabulate(_: ParameterSet, arrays: RunArrays) -> Tables:
    """Tables ``wave_cases`` (the paper's) and ``spectra`` (paper, curve and record)."""
    cases, height = wave_cases().values(), spectra().significant_height
    table = pd.DataFrame(
        {
            "case": case.name,
            "peak_period": case.peak_period,
            "significant_heights": " ".join(f"{height:g}" for height in case.significant_height),
        }
        for case in cases
    )
    rows = [row for case in cases for row in _recovered(case, height, arrays[case.name])]
    return {"wave_cases": table, "spectra": pd.DataFrame(rows)}


def _recovered(case: WaveCase, height: float, found: Arrays) -> Iterator[dict[str, Any]]:
    """One row per quantity, with the sampling error of the record's estimate."""
    papers = {"significant_height": height, "peak_period": case.peak_period}
    for quantity, unit in QUANTITIES.items():
        sample, paper = found[f"sample_{quantity}"], papers[quantity]
        low, high = np.percentile(sample, RANGE)
        estimate = float(found[f"record_{quantity}"][0])
        yield {
            "case": case.name,
            "quantity": quantity,
            "unit": unit,
            "paper": paper,
            "curve": float(found[f"curve_{quantity}"][0]),
            "record": estimate,
            "sampling_error": float(sample.std(ddof=1)),
            "range_low": low,
            "range_high": high,
            "within": bool(low <= estimate <= high and low <= paper <= high),
        }


EXPERIMENT = Experiment(
    name="spectra",
    title="The three JONSWAP seas and a 60 s record of each at Hs = 3 m",
    claims=("C08", "C09", "C10", "C11", "C12", "C13", "C14"),
    runs=runs,
    tabulate=tabulate,
)
