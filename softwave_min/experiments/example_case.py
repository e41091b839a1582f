"""The paper's Fig. example_case: one pose, all controllers, in two seas (C24-C29).

The same pose is held once in the sea of the parameter set, which is the paper's where a
shipped set is taken, and once in a sea with a measured spectrum, scaled to the same height.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from softwave_min.data import data_folder
from softwave_min.experiments.closed_loop import (
    TRANSIENT,
    LoopRun,
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
    record = named_records(data_folder() / "buoys" / "records.toml")[chosen.measured]
    spectra = {"jonswap": None, "measured": (record.frequency_hz, record.density)}
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
    starts = time[: len(level)][level > np.quantile(level, KEY_QUANTILE)]
    ends = starts + (time[1] - time[0])
    apart = np.flatnonzero(starts[1:] - ends[:-1] >= KEY_GAP) + 1
    parts = zip(np.split(starts, apart), np.split(ends, apart), strict=True)
    return [(float(start[0]), float(end[-1])) for start, end in parts if len(start)]


def lag_and_correlation(first: Floats, second: Floats, period: float) -> tuple[float, float]:
    """Delay of ``second`` behind ``first``, in s, at which they correlate most, and how much.

    The strongest correlation by magnitude within two seconds either way.
    """
    reach = round(2.0 / period)
    a, b = first - first.mean(), second - second.mean()
    scale = np.sqrt((a @ a) * (b @ b))
    shifts = np.arange(-reach, reach + 1)
    products = [a[: len(a) - s] @ b[s:] if s >= 0 else a[-s:] @ b[: len(b) + s] for s in shifts]
    values = products / scale
    best = int(np.argmax(np.abs(values)))
    return float(shifts[best] * period), float(values[best])


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Summary of the runs, the joints' statistics, and the key moments."""
    summary: list[Row] = []
    joints: list[Row] = []
    moments: list[Row] = []
    for sea, name in product(SEAS, controllers()):
        loop = ClosedLoop(**arrays[f"{sea}-{name}"])
        labels: Row = {"sea": sea, "controller": name}
        peak = {"peak_period": parameters.sea.peak_period}
        summary.append({**labels, **peak, **_summary_row(loop)})
        joints += [{**labels, **row} for row in _joint_rows(loop, parameters.nmpc.control_period)]
        if name == others()[0]:
            key = key_moments(loop.time, loop.wave_torque)
            moments += [{"sea": sea, "start": start, "end": end} for start, end in key]
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


def _joint_rows(loop: ClosedLoop, period: float) -> Iterator[Row]:
    settled = loop.time[:-1] >= TRANSIENT
    pairs = zip(loop.wave_torque[settled].T, loop.torque[settled].T, strict=True)
    for segment, (wave, torque) in enumerate(pairs, start=1):
        lag, correlation = lag_and_correlation(wave, torque, period)
        yield {
            "segment": segment,
            "wave_torque_rms": root_mean_square_error(wave),
            "torque_rms": root_mean_square_error(torque),
            "torque_lag": lag,
            "torque_correlation": correlation,
        }


EXPERIMENT = Experiment(
    name="example_case",
    title="One pose under waves: all controllers, in a JONSWAP and in a measured sea",
    claims=("C24", "C25", "C26", "C27", "C28", "C29"),
    runs=runs,
    tabulate=tabulate,
)
