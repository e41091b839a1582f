"""The paper's Fig. actuation_failure_rmse: poses held with a failed segment (C48-C60).

The paper's case is the second segment, passive. Beside it stand the third segment, and
both of them locked. The intact arm runs under both controllers, the others under the NMPC.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.experiments.closed_loop import (
    TRANSIENT,
    LoopRun,
    closed_loops,
    failed_solves,
    fallbacks,
    prepare,
    settled_error,
    whole_error,
)
from softwave_min.experiments.places import in_sea, realisations
from softwave_min.experiments.setpoints import CASES
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet, Positive, Real, load_data
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables, Tolerance
from softwave_min.runs.statistics import over_seas
from softwave_min.waves import wave_number

Floats = NDArray[np.float64]
Row = Mapping[str, float | int | str]

INTACT = "intact"
PAPERS_CASE = "mid_passive"
WINDOWS = {"whole": "", "settled": "_settled"}
"""Windows of an RMSE, start-up included or not, and the ending of their columns."""
ALL = "all"
"""Stands for all spectra together."""
READINGS = ("mean", "maximum")
"""What a rise 'across all spectra' can mean."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Choice:
    """What data/paper/actuator_failure.toml holds."""

    pose: tuple[str, ...]
    lowest_height: Positive
    """Significant heights from here on, in m."""
    rise: Real
    """In per cent, as those below."""
    lowest_rise: Real
    lowest_rise_case: str
    largest_spread: Real
    height_over_body: Real


@dataclass(frozen=True)
class Place:
    """One bar of the paper's figure: a sea and a pose."""

    wave: str
    pose: str
    height: float
    """Significant height, in m."""
    parameters: ParameterSet
    """Of the intact arm in this sea."""

    @property
    def seed(self) -> int:
        """Seed of the sea."""
        return self.parameters.sea.seed

    def run(self, case: str) -> Run:
        """The closed loops here with a state of the actuation."""
        return Run(
            f"{self.wave}-{self.pose}-{100 * self.height:.0f}cm-{case}-{self.seed}",
            closed_loops,
            LoopRun(
                CASES[case].of(self.parameters),
                (poses()[self.pose],),
                ("baseline", "nmpc") if case == INTACT else ("nmpc",),
            ),
        )


def choice() -> Choice:
    """The paper's poses, heights and numbers."""
    return load_data(Choice, "paper/actuator_failure.toml")


def places(parameters: ParameterSet) -> Iterator[Place]:
    """Spectra, poses, heights and random seas of the figure."""
    chosen = choice()
    for wave, of_wave in wave_cases().items():
        for pose in chosen.pose:
            for height in of_wave.significant_height:
                if height >= chosen.lowest_height:
                    for one in realisations(in_sea(parameters, wave, height)):
                        yield Place(wave, pose, height, one)


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """Every case at every place."""
    return [place.run(case) for place in places(parameters) for case in CASES]


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


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Errors and rises at every place, and what the paper says of them."""
    period = parameters.nmpc.control_period
    grid = grid_table(parameters, arrays)
    joints = pd.DataFrame(
        [row for place in places(parameters) for row in _joint_rows(place, arrays, period)]
    )
    return {
        "actuator_failure": grid,
        "rises": headline(grid),
        "spread": spread(grid),
        "statements": statements(grid),
        "passive_motion": joints,
        "excitation": excitation(grid, joints),
        "wave_size": pd.DataFrame(list(_size_rows(parameters))),
    }


def grid_table(
    parameters: ParameterSet, arrays: RunArrays, cases: Sequence[str] = tuple(CASES)
) -> pd.DataFrame:
    """Table 'actuator_failure': errors and rises at every place, in each of the cases."""
    period = parameters.nmpc.control_period
    return pd.DataFrame(
        [row for place in places(parameters) for row in _rows(place, arrays, cases, period)]
    )


def _rows(place: Place, arrays: RunArrays, cases: Sequence[str], period: float) -> Iterator[Row]:
    intact = arrays[place.run(INTACT).name]
    reference = _errors(intact, "nmpc", period)
    baseline = _errors(intact, "baseline", period)
    for case in cases:
        data = arrays[place.run(case).name]
        errors = _errors(data, "nmpc", period)
        row: dict[str, float | int | str] = {
            "wave": place.wave,
            "pose": place.pose,
            "Hs": place.height,
            "seed": place.seed,
            "case": case,
        }
        for ending in WINDOWS.values():
            row |= {
                f"e_mpc{ending}": errors[ending],
                f"e_pd_intact{ending}": baseline[ending],
                f"rise_percent{ending}": 100 * (errors[ending] / reference[ending] - 1),
            }
        yield row | {
            "solves_failed": failed_solves(data, "nmpc"),
            "fallbacks": fallbacks(data, "nmpc"),
        }


def _errors(data: Mapping[str, NDArray[Any]], controller: Any, period: float) -> dict[str, float]:
    return {"": whole_error(data, controller), "_settled": settled_error(data, controller, period)}


def _joint_rows(place: Place, arrays: RunArrays, period: float) -> Iterator[Row]:
    frequency = 1 / place.parameters.sea.peak_period
    for case, state in CASES.items():
        if state.segment == 0 or state.manner == "locked":
            continue
        for arm in (INTACT, case):
            angles = arrays[place.run(arm).name]["nmpc_q"][round(TRANSIENT / period) :]
            below, above = motion(angles[:, state.segment - 1], period, frequency)
            yield {
                "wave": place.wave,
                "pose": place.pose,
                "Hs": place.height,
                "seed": place.seed,
                "case": arm,
                "segment": state.segment,
                "peak_frequency_hz": frequency,
                "rms_below": below,
                "rms_above": above,
                "share_above": above**2 / (below**2 + above**2),
            }


def headline(grid: pd.DataFrame) -> pd.DataFrame:
    """Rises of the RMSE per spectrum and over all, with their spread over seas.

    Parameters
    ----------
    grid : DataFrame
        The table 'actuator_failure', or a part of its cases.

    Returns
    -------
    DataFrame
        A row for each failure, window, spectrum (and all) and reading of 'the rise': the
        mean or the maximum over poses and heights. ``rise``, ``low`` and ``high`` are
        median, 5 % and 95 % over seas, in per cent; ``paper`` is empty where the paper
        has no number.
    """
    chosen = choice()
    papers = {ALL: chosen.rise, chosen.lowest_rise_case: chosen.lowest_rise}
    rows: list[Row] = []
    for case, window, of_sea in _rises(grid):
        for wave, reading in product([*_waves(grid), ALL], READINGS):
            rows.append(
                {
                    "case": case,
                    "window": window,
                    "wave": wave,
                    "reading": reading,
                    **_interval("rise", of_sea[wave, reading].to_numpy()),
                    "paper": papers.get(wave, math.nan) if case == PAPERS_CASE else math.nan,
                }
            )
    return pd.DataFrame(rows)


def spread(grid: pd.DataFrame) -> pd.DataFrame:
    """How far the spectra's rises lie apart, and which is the lowest (C55, C56).

    ``points`` is the largest less the smallest rise, in percentage points; ``relative``
    is the same as a share of the smallest, in per cent.
    """
    chosen = choice()
    rows: list[Row] = []
    for case, window, of_sea in _rises(grid):
        for reading in READINGS:
            by_wave = np.array([of_sea[wave, reading] for wave in _waves(grid)])
            smallest = by_wave.min(axis=0)
            points = by_wave.max(axis=0) - smallest
            papers = case == PAPERS_CASE
            rows.append(
                {
                    "case": case,
                    "window": window,
                    "reading": reading,
                    "lowest": _waves(grid)[int(np.argmin(np.median(by_wave, axis=1)))],
                    **_interval("points", points),
                    **_interval("relative", 100 * points / np.abs(smallest), "relative_"),
                    "paper": chosen.largest_spread if papers else math.nan,
                    "paper_lowest": chosen.lowest_rise_case if papers else "",
                }
            )
    return pd.DataFrame(rows)


def _failures(grid: pd.DataFrame) -> list[str]:
    return [case for case in dict.fromkeys(grid["case"]) if case != INTACT]


def _waves(grid: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys(grid["wave"]))


def _rises(grid: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Case, window, and its rises: a row for each sea, columns (spectrum, reading)."""
    for case in _failures(grid):
        for window, ending in WINDOWS.items():
            of_case = grid[grid["case"] == case]
            columns = {}
            for wave in [*_waves(grid), ALL]:
                of_wave = of_case if wave == ALL else of_case[of_case["wave"] == wave]
                by_sea = of_wave.groupby("seed")[f"rise_percent{ending}"]
                columns[wave, "mean"], columns[wave, "maximum"] = by_sea.mean(), by_sea.max()
            yield case, window, pd.DataFrame(columns)


def _interval(name: str, values: Floats, prefix: str = "") -> Row:
    low, middle, high = over_seas(values)
    return {name: middle, f"{prefix}low": low, f"{prefix}high": high}


def statements(grid: pd.DataFrame) -> pd.DataFrame:
    """What the paper says of single cells, counted (C57, C59, C70).

    ``better`` cells are those in which the failed arm has the smaller error, of which
    ``better_at_largest`` at the largest height; in ``below_baseline`` of them the failed
    arm under the NMPC beats the intact one under the baseline.
    """
    rows: list[Row] = []
    for case in _failures(grid):
        cells = grid[grid["case"] == case]
        largest = cells["Hs"] == cells["Hs"].max()
        for window, ending in WINDOWS.items():
            better = cells[f"rise_percent{ending}"] < 0
            ratio = cells[f"e_mpc{ending}"] / cells[f"e_pd_intact{ending}"]
            rows.append(
                {
                    "case": case,
                    "window": window,
                    "cells": len(cells),
                    "better": int(better.sum()),
                    "better_at_largest": int((better & largest).sum()),
                    "below_baseline": int((ratio < 1).sum()),
                    "largest_ratio": float(ratio.max()),
                    "largest_error": float(cells[f"e_mpc{ending}"].max()),
                    "solves_failed": int(cells["solves_failed"].sum()),
                    "fallbacks": int(cells["fallbacks"].sum()),
                }
            )
    return pd.DataFrame(rows)


def excitation(grid: pd.DataFrame, joints: pd.DataFrame) -> pd.DataFrame:
    """Motion of the passive joint per spectrum beside the rise of the error (C60).

    Means over poses, heights and seas: rms of the angle below and above the peak
    frequency, in rad; the part above as a multiple of that of the actuated joint; the
    rise in per cent. Were the faster waves to excite the joint, and the joint to cause
    the error, both would fall from W1 to W3.
    """

    def above(of: pd.DataFrame) -> float:
        return float(of["rms_above"].mean())

    rows: list[Row] = []
    for case in [name for name in CASES if name in set(joints["case"]) - {INTACT}]:
        for wave in _waves(grid):
            of_joint = joints["segment"] == CASES[case].segment
            here = joints[of_joint & (joints["wave"] == wave)]
            passive = here[here["case"] == case]
            cells = grid[(grid["case"] == case) & (grid["wave"] == wave)]
            rows.append(
                {
                    "case": case,
                    "wave": wave,
                    "rms_below": float(passive["rms_below"].mean()),
                    "rms_above": above(passive),
                    "above_to_actuated": above(passive) / above(here[here["case"] == INTACT]),
                    "rise_percent": float(cells["rise_percent"].mean()),
                }
            )
    return pd.DataFrame(rows)


def _size_rows(parameters: ParameterSet) -> Iterator[Row]:
    """Largest height and length of each wave in lengths of the arm (C58)."""
    body = sum(parameters.arm.length)
    for wave, case in wave_cases().items():
        frequency = 2 * math.pi / case.peak_period
        number = wave_number(frequency, parameters.sea.depth, parameters.fluid.gravity)
        length = 2 * math.pi / float(number)
        height = max(case.significant_height)
        yield {
            "wave": wave,
            "body_length": body,
            "largest_height": height,
            "height_over_body": height / body,
            "wavelength": length,
            "wavelength_over_body": length / body,
            "paper": choice().height_over_body,
        }


EXPERIMENT = Experiment(
    name="actuator_failure",
    title="Poses held under waves with a failed segment, passive or locked",
    claims=(*(f"C{number}" for number in range(48, 61)), "C70"),
    runs=runs,
    tabulate=tabulate,
    prepare=prepare,
    tolerances={
        # Per cent of an error that is itself reproduced to 1e-4, hence points.
        column: Tolerance(absolute=0.05)
        for column in ("rise_percent", "rise_percent_settled", "rise", "low", "high", "points")
    },
)
