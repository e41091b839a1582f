"""The paper's Fig. example_case: one pose, both controllers, in two seas (C24-C29).

The same pose is held once in the paper's random sea, and once in a sea with a
measured spectrum, scaled to the same height.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.data import data_folder
from softwave_min.experiments.closed_loop import TRANSIENT, prepare
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet, Positive, load_data
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables
from softwave_min.simulation import ClosedLoop, Scenario, root_mean_square_error, simulate
from softwave_min.waves import Sea
from softwave_min.waves.records import BuoyRecord, measured_sea, named_records

Floats = NDArray[np.float64]
Row = Mapping[str, float | int | str]

SEAS = ("jonswap", "measured")
CONTROLLERS: tuple[str, ...] = ("baseline", "nmpc")
KEY_QUANTILE = 0.9
"""A moment is a key moment where the wave torque exceeds this quantile of itself."""
KEY_GAP = 0.5
"""Seconds; key moments closer than this are one."""


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Choice:
    """What data/paper/example_case.toml fixes."""

    case: str
    significant_height: Positive
    pose: str
    measured: str


@dataclass(frozen=True)
class ExampleRun:
    """All that determines one closed loop of the example."""

    parameters: ParameterSet
    target: tuple[float, float]
    record: BuoyRecord | None
    """Measured spectrum, or None for the JONSWAP sea of the parameters."""
    controller: str


def sea_of(run: ExampleRun) -> Sea:
    """The sea that a run is in."""
    sea, gravity = run.parameters.sea, run.parameters.fluid.gravity
    if run.record is None:
        return Sea.random(sea, gravity)
    return measured_sea(run.record, sea, gravity)


def scenario_of(run: ExampleRun) -> Scenario:
    """Arm, sea and target of a run."""
    return Scenario.build(run.parameters, sea_of(run), run.target)


def closed_loop(run: ExampleRun) -> dict[str, NDArray[Any]]:
    """Simulate one run; the arrays are the fields of ``ClosedLoop``."""
    return vars(simulate(scenario_of(run), run.controller))


def choice() -> Choice:
    """Sea, height and pose of the example."""
    return load_data(Choice, "paper/example_case.toml")


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """Both controllers in both seas."""
    chosen = choice()
    sea = replace(
        parameters.sea,
        significant_height=chosen.significant_height,
        peak_period=wave_cases()[chosen.case].peak_period,
    )
    records = {
        "jonswap": None,
        "measured": named_records(data_folder() / "buoys" / "records.toml")[chosen.measured],
    }
    return [
        Run(
            f"{name}-{controller}",
            closed_loop,
            ExampleRun(
                replace(parameters, sea=sea), poses()[chosen.pose], records[name], controller
            ),
        )
        for name in SEAS
        for controller in CONTROLLERS
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
    peak_period = wave_cases()[choice().case].peak_period
    loops = {name: ClosedLoop(**one) for name, one in arrays.items()}
    summary: list[Row] = []
    joints: list[Row] = []
    moments: list[Row] = []
    for sea in SEAS:
        for controller in CONTROLLERS:
            loop = loops[f"{sea}-{controller}"]
            labels: Row = {"sea": sea, "controller": controller, "peak_period": peak_period}
            summary.append({**labels, **_summary_row(loop)})
            joints.extend(
                {"sea": sea, "controller": controller, **row} for row in _joint_rows(loop, period)
            )
        nmpc = loops[f"{sea}-nmpc"]
        moments.extend(
            {"sea": sea, "start": start, "end": end}
            for start, end in key_moments(nmpc.time, nmpc.wave_torque)
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
    title="One pose under waves: both controllers, in a JONSWAP and in a measured sea",
    claims=("C24", "C25", "C26", "C27", "C28", "C29"),
    runs=runs,
    tabulate=tabulate,
    prepare=prepare,
)
