"""The paper's Fig. example_case: one pose, all controllers, in two seas (C24-C29).

The same pose is held once in the sea of the parameter set, which is the paper's where a
shipped set is taken, and once in a sea with a measured spectrum, scaled to the same height.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from softwave_min.data import data_folder
from softwave_min.experiments.closed_loop import (
    TRANSIENT,
    LoopRun,
    MeasuredSpectrum,
    controllers,
    others,
    whole_record,
)
from softwave_min.experiments.places import in_realisation
from softwave_min.paper.cases import poses
from softwave_min.paper.numbers import example_case
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables
from softwave_min.simulation import ClosedLoop, root_mean_square_error
from softwave_min.waves.records import named_records

Floats = NDArray[np.float64]
Row = Mapping[str, float | int | str]

SEAS = ("jonswap", "measured")
KEY_QUANTILE = 0.9
"""A moment is a key moment where the wave torque exceeds this quantile of itself."""
KEY_GAP = 0.5
"""Seconds; key moments closer than this are one."""


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """Every controller in both seas, each of them one run with all its signals."""
    chosen = example_case()
    record = named_records(data_folder() / "buoys" / "records.toml")[chosen.measured].spectrum
    measured = MeasuredSpectrum(tuple(record.frequency_hz.tolist()), tuple(record.density.tolist()))
    spectra = {"jonswap": None, "measured": measured}
    first, path = in_realisation(parameters, 0), (poses()[chosen.pose],)
    return [
        Run(f"{sea}-{name}", whole_record, LoopRun(first, path, (name,), spectra[sea]))
        for sea in SEAS
        for name in controllers()
    ]


def key_moments(time: Floats, wave_torque: Floats) -> list[tuple[float, float]]:
    """Intervals in which large wave loads act on the arm, in s.

    The norm of the generalised wave load over the segments exceeds its quantile
    ``KEY_QUANTILE`` over the window; intervals less than ``KEY_GAP`` apart are joined.
    """
    level = np.linalg.norm(wave_torque, axis=1)
    period = float(time[1] - time[0])
    intervals: list[tuple[float, float]] = []
    for instant in time[: len(level)][level > np.quantile(level, KEY_QUANTILE)]:
        if intervals and instant - intervals[-1][1] < KEY_GAP:
            intervals[-1] = (intervals[-1][0], float(instant) + period)
        else:
            intervals.append((float(instant), float(instant) + period))
    return intervals


def lag_and_correlation(first: Floats, second: Floats, period: float) -> tuple[float, float]:
    """Delay of ``second`` behind ``first``, in s, at which they correlate most, and how much.

    The strongest correlation by magnitude within two seconds either way.
    """
    reach = round(2.0 / period)
    a, b = first - first.mean(), second - second.mean()
    scale = np.sqrt((a @ a) * (b @ b))
    shifts = np.arange(-reach, reach + 1)
    values = [
        (a[: len(a) - s] @ b[s:] if s >= 0 else a[-s:] @ b[: len(b) + s]) / scale for s in shifts
    ]
    best = int(np.argmax(np.abs(values)))
    return float(shifts[best] * period), float(values[best])


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Summary of the runs, the joints' statistics, and the key moments."""
    period = parameters.nmpc.control_period
    summary: list[Row] = []
    joints: list[Row] = []
    moments: list[Row] = []
    for sea in SEAS:
        for name in controllers():
            loop = ClosedLoop(**arrays[f"{sea}-{name}"])
            labels: Row = {"sea": sea, "controller": name}
            period_of_peak = {"peak_period": parameters.sea.peak_period}
            summary.append({**labels, **period_of_peak, **_summary_row(loop)})
            joints.extend({**labels, **row} for row in _joint_rows(loop, period))
        shown = ClosedLoop(**arrays[f"{sea}-{others()[0]}"])
        moments.extend(
            {"sea": sea, "start": start, "end": end}
            for start, end in key_moments(shown.time, shown.wave_torque)
        )
    return {
        "example_case": pd.DataFrame(summary),
        "joints": pd.DataFrame(joints),
        "key_moments": pd.DataFrame(moments),
    }


def _summary_row(loop: ClosedLoop) -> Row:
    settled = loop.time >= TRANSIENT
    offset = (loop.tips[:, -1] - loop.target)[settled]
    solved = loop.status[loop.status >= 0]
    return {
        "rmse": root_mean_square_error(loop.error),
        "rmse_settled": root_mean_square_error(loop.error[settled]),
        "largest_error_settled": float(loop.error[settled].max()),
        "deviation_x_settled": float(offset[:, 0].std()),
        "deviation_z_settled": float(offset[:, 1].std()),
        "solves": len(solved),
        "solves_failed": int(np.count_nonzero(solved)),
        "fallbacks": int(np.count_nonzero(loop.source)),
        "iterations_mean": float(loop.iterations.mean()),
        "iterations_largest": int(loop.iterations.max()),
    }


def _joint_rows(loop: ClosedLoop, period: float) -> list[Row]:
    settled = loop.time[:-1] >= TRANSIENT
    rows: list[Row] = []
    for segment in range(loop.torque.shape[1]):
        wave, torque = loop.wave_torque[settled, segment], loop.torque[settled, segment]
        lag, correlation = lag_and_correlation(wave, torque, period)
        rows.append(
            {
                "segment": segment + 1,
                "wave_torque_rms": root_mean_square_error(wave),
                "torque_rms": root_mean_square_error(torque),
                "torque_lag": lag,
                "torque_correlation": correlation,
            }
        )
    return rows


EXPERIMENT = Experiment(
    name="example_case",
    title="One pose under waves: all controllers, in a JONSWAP and in a measured sea",
    claims=("C24", "C25", "C26", "C27", "C28", "C29"),
    runs=runs,
    tabulate=tabulate,
)
