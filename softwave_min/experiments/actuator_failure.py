"""The paper's Fig. actuation_failure_rmse: poses held with a failed segment (C48-C60).

The paper's case is the second segment, passive. Beside it stand the last segment, and
both of them locked. The intact arm runs under all controllers, the others without the reference.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from softwave_min.experiments import places as grid
from softwave_min.experiments.closed_loop import (
    TRANSIENT,
    WINDOWS,
    LoopRun,
    closed_loops,
    controllers,
    errors,
    failed_solves,
    fallbacks,
    others,
)
from softwave_min.experiments.failures import INTACT, PAPERS_CASE, failure_cases
from softwave_min.experiments.fixed_arm import peak_wave_number
from softwave_min.experiments.places import Place
from softwave_min.paper.cases import wave_cases
from softwave_min.paper.numbers import CONTROLLER, actuator_failure
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables, Tolerance
from softwave_min.runs.statistics import over_seas
from softwave_min.simulation import REFERENCE

Floats = NDArray[np.float64]
Row = dict[str, Any]

ALL = "all"
"""Stands for all spectra together."""
READINGS = ("mean", "maximum")
"""What a rise 'across all spectra' can mean."""


def places(parameters: ParameterSet) -> Iterator[Place]:
    """Spectra, poses, heights and random seas of the figure."""
    chosen = actuator_failure()
    return grid.places(parameters, chosen.pose, lambda height: height >= chosen.lowest_height)


def run_at(place: Place, case: str) -> Run:
    """The closed loops at a place with a state of the actuation."""
    state = failure_cases(place.parameters)[case]
    names = controllers() if case == INTACT else others()
    run = LoopRun(state.of(place.parameters), place.path, names)
    return Run(place.run_name(case), closed_loops, run)


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """Every case at every place."""
    cases = failure_cases(parameters)
    return [run_at(place, case) for place in places(parameters) for case in cases]


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Errors and rises at every place, and what the paper says of them."""
    table = grid_table(parameters, arrays, tuple(failure_cases(parameters)))
    joints = _joint_table(parameters, arrays)
    return {
        "actuator_failure": table,
        "rises": headline(table),
        "spread": spread(table),
        "statements": statements(table),
        "passive_motion": joints,
        "excitation": excitation(table, joints),
        "wave_size": pd.DataFrame(_size_rows(parameters)),
    }


def grid_table(parameters: ParameterSet, arrays: RunArrays, cases: Sequence[str]) -> pd.DataFrame:
    """Table 'actuator_failure': errors and rises at every place, in each of the cases."""
    every = places(parameters)
    return pd.DataFrame([row for place in every for row in _rows(place, arrays, cases)])


def _rows(place: Place, arrays: RunArrays, cases: Sequence[str]) -> Iterator[Row]:
    period = place.parameters.nmpc.control_period
    before = errors(arrays[place.run_name(INTACT)], controllers(), period)
    for case in cases:
        data = arrays[place.run_name(case)]
        after = errors(data, others(), period)
        row: Row = {**place.labels, "case": case}
        for ending in WINDOWS.values():
            keys = [f"{name}{ending}" for name in others()]
            row |= {f"e_{key}": after[key] for key in keys}
            row[f"e_{REFERENCE}_intact{ending}"] = before[f"{REFERENCE}{ending}"]
            row |= {f"rise_percent_{key}": 100 * (after[key] / before[key] - 1) for key in keys}
        names = controllers() if case == INTACT else others()
        row["solves_failed"] = failed_solves(data, *names)
        row["fallbacks"] = fallbacks(data, *names)
        yield row


def motion(angle: Floats, period: float, frequency_hz: float) -> tuple[float, float]:
    """Rms of a joint's motion about its mean, below and above a frequency, in rad.

    By Parseval's theorem; the squares of the two add up to the variance.
    """
    amplitude = np.fft.rfft(angle - angle.mean()) / len(angle)
    power = 2 * np.abs(amplitude) ** 2
    if len(angle) % 2 == 0:
        power[-1] /= 2  # the highest frequency has no mirror image
    above = np.fft.rfftfreq(len(angle), period) > frequency_hz
    return math.sqrt(power[~above].sum()), math.sqrt(power[above].sum())


def _joint_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """Motion of each passive joint after the start, and of the same joint actuated."""
    period = parameters.nmpc.control_period
    start = round(TRANSIENT / period)
    rows: list[Row] = []
    for name, place, (case, state) in product(
        others(), places(parameters), failure_cases(parameters).items()
    ):
        if case == INTACT or state.manner == "locked":
            continue
        frequency = 1 / place.parameters.sea.peak_period
        for arm in (INTACT, case):
            angle = arrays[place.run_name(arm)][f"{name}_q"][start:, state.segment - 1]
            below, above = motion(angle, period, frequency)
            rows.append(
                {
                    "controller": name,
                    **place.labels,
                    "case": arm,
                    "segment": state.segment,
                    "peak_frequency_hz": frequency,
                    "rms_below": below,
                    "rms_above": above,
                    "share_above": above**2 / (below**2 + above**2),
                }
            )
    return pd.DataFrame(rows)


def headline(table: pd.DataFrame) -> pd.DataFrame:
    """Rises of the RMSE per spectrum and over all, with their spread over seas.

    A row for each controller, failure, window, spectrum (and all) and reading of 'the rise':
    the mean or the maximum over poses and heights. ``rise``, ``low`` and ``high`` are median,
    5 % and 95 % over seas, in per cent; ``paper`` is empty where the paper has no number.
    ``table`` is 'actuator_failure', or a part of its cases.
    """
    paper = actuator_failure()
    quoted = {ALL: paper.rise, paper.lowest_rise_case: paper.lowest_rise}
    return pd.DataFrame(
        [
            {
                **labels,
                "wave": wave,
                "reading": reading,
                **_middle_first("rise", of_sea[wave, reading]),
                "paper": quoted.get(wave, math.nan) if _is_papers(labels) else math.nan,
            }
            for labels, of_sea in _rises(table)
            for wave, reading in product([*_waves(table), ALL], READINGS)
        ]
    )


def spread(table: pd.DataFrame) -> pd.DataFrame:
    """How far the spectra's rises lie apart, and which is the lowest (C55, C56).

    ``points`` is the largest less the smallest rise, in percentage points; ``relative``
    is the same as a share of the smallest, in per cent.
    """
    paper = actuator_failure()
    rows: list[Row] = []
    for (labels, of_sea), reading in product(_rises(table), READINGS):
        by_wave = np.array([of_sea[wave, reading] for wave in _waves(table)])
        smallest = by_wave.min(axis=0)
        points = by_wave.max(axis=0) - smallest
        rows.append(
            {
                **labels,
                "reading": reading,
                "lowest": _waves(table)[int(np.argmin(np.median(by_wave, axis=1)))],
                **_middle_first("points", points),
                **_middle_first("relative", 100 * points / np.abs(smallest), "relative_"),
                "paper": paper.largest_spread if _is_papers(labels) else math.nan,
                "paper_lowest": paper.lowest_rise_case if _is_papers(labels) else "",
            }
        )
    return pd.DataFrame(rows)


def _middle_first(name: str, values: ArrayLike, prefix: str = "") -> dict[str, float]:
    low, median, high = over_seas(values)
    return {name: median, f"{prefix}low": low, f"{prefix}high": high}


def _is_papers(labels: Row) -> bool:
    """Whether the paper has numbers of a controller with a failure."""
    return bool(labels["controller"] == CONTROLLER and labels["case"] == PAPERS_CASE)


def _failures(table: pd.DataFrame) -> list[str]:
    return [case for case in table["case"].unique() if case != INTACT]


def _waves(table: pd.DataFrame) -> list[str]:
    return list(table["wave"].unique())


def _rises(table: pd.DataFrame) -> Iterator[tuple[Row, pd.DataFrame]]:
    """Controller, case and window; and the rises: a row per sea, columns (spectrum, reading)."""
    for name, case, (window, ending) in product(others(), _failures(table), WINDOWS.items()):
        of_case = table[table["case"] == case]
        columns = {}
        for wave in [*_waves(table), ALL]:
            of_wave = of_case if wave == ALL else of_case[of_case["wave"] == wave]
            by_sea = of_wave.groupby("seed")[f"rise_percent_{name}{ending}"]
            columns[wave, "mean"], columns[wave, "maximum"] = by_sea.mean(), by_sea.max()
        yield {"controller": name, "case": case, "window": window}, pd.DataFrame(columns)


def statements(table: pd.DataFrame) -> pd.DataFrame:
    """What the paper says of single cells, counted (C57, C59, C70).

    ``better`` cells are those in which the failed arm has the smaller error, of which
    ``better_at_largest`` at the largest height; in ``below_baseline`` of them the failed
    arm beats the intact one under the baseline.
    """
    rows: list[Row] = []
    for name, case, (window, ending) in product(others(), _failures(table), WINDOWS.items()):
        cells = table[table["case"] == case]
        error = cells[f"e_{name}{ending}"]
        better = cells[f"rise_percent_{name}{ending}"] < 0
        ratio = error / cells[f"e_{REFERENCE}_intact{ending}"]
        rows.append(
            {
                "controller": name,
                "case": case,
                "window": window,
                "cells": len(cells),
                "better": better.sum(),
                "better_at_largest": (better & (cells["Hs"] == cells["Hs"].max())).sum(),
                "below_baseline": (ratio < 1).sum(),
                "largest_ratio": ratio.max(),
                "largest_error": error.max(),
                "solves_failed": cells["solves_failed"].sum(),
                "fallbacks": cells["fallbacks"].sum(),
            }
        )
    return pd.DataFrame(rows)


def excitation(table: pd.DataFrame, joints: pd.DataFrame) -> pd.DataFrame:
    """Motion of the passive joint per spectrum beside the rise of the error (C60).

    Means over poses, heights and seas: rms of the angle below and above the peak
    frequency, in rad; the part above as a multiple of that of the actuated joint; the
    rise in per cent. Were the faster waves to excite the joint, and the joint to cause
    the error, both would fall from W1 to W3.
    """
    rows: list[Row] = []
    for name, case, wave in product(others(), _failures(joints), _waves(joints)):
        here = joints[(joints["controller"] == name) & (joints["wave"] == wave)]
        passive = here[here["case"] == case]
        actuated = here[(here["case"] == INTACT) & here["segment"].isin(passive["segment"])]
        cells = table[(table["case"] == case) & (table["wave"] == wave)]
        above = passive["rms_above"].mean()
        rows.append(
            {
                "controller": name,
                "case": case,
                "wave": wave,
                "rms_below": passive["rms_below"].mean(),
                "rms_above": above,
                "above_to_actuated": above / actuated["rms_above"].mean(),
                "rise_percent": cells[f"rise_percent_{name}"].mean(),
            }
        )
    return pd.DataFrame(rows)


def _size_rows(parameters: ParameterSet) -> Iterator[Row]:
    """Largest height and length of each wave in lengths of the arm (C58)."""
    body = sum(parameters.arm.length)
    for wave, case in wave_cases().items():
        height = max(case.significant_height)
        length = 2 * math.pi / peak_wave_number(grid.in_sea(parameters, wave, height))
        yield {
            "wave": wave,
            "body_length": body,
            "largest_height": height,
            "height_over_body": height / body,
            "wavelength": length,
            "wavelength_over_body": length / body,
            "paper": actuator_failure().height_over_body,
        }


EXPERIMENT = Experiment(
    name="actuator_failure",
    title="Poses held under waves with a failed segment, passive or locked",
    claims=(*(f"C{number}" for number in range(48, 61)), "C70"),
    runs=runs,
    tabulate=tabulate,
    tolerances={
        # Per cent of an error that is itself reproduced to 1e-4, hence points.
        column: Tolerance(absolute=0.05)
        for column in (
            *("rise_percent", "rise", "low", "high", "points"),
            *(f"rise_percent_{name}{end}" for name in others() for end in WINDOWS.values()),
        )
    },
)
