"""The paper's headline numbers of a parameter set, from the closed loops that decide them.

The corners of the grid of error ratios stand for the whole of it, so that a set is judged in
seconds: for the calibration, the switches of the open points and the sensitivity study. Nothing
here reads a file; `cells` says which closed loops are meant.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softwave_min.data import ParameterError
from softwave_min.experiments.closed_loop import LoopRun, scenario_of, with_failure
from softwave_min.experiments.star_loops import scenario_on_star
from softwave_min.experiments.star_path import StarParameters
from softwave_min.parameters import ParameterSet
from softwave_min.simulation import (
    ClosedLoop,
    SimulationError,
    root_mean_square_error,
    simulate,
)

Cell = tuple[tuple[float, float], float]
"""Desired tip and significant height, in m."""


@dataclass(frozen=True)
class Cells:
    """Which closed loops stand for the paper's figures, in each wave case."""

    peak_periods: tuple[tuple[str, float], ...]
    """Of the wave cases by name, in s."""
    grid: tuple[Cell, ...]
    failures: tuple[Cell, ...]
    """Those that are also run with a failed segment."""
    failed_segment: int
    star: StarParameters
    star_height: float
    """Significant height on the star, in m."""


@dataclass(frozen=True)
class HeadlineRun:
    """A parameter set to be judged, and by which closed loops."""

    parameters: ParameterSet
    cells: Cells

    def __post_init__(self) -> None:
        segments, failed = self.parameters.arm.segments, self.cells.failed_segment
        if failed > segments:
            raise ParameterError(
                f"the headline numbers need a segment {failed}: the arm has {segments}"
            )

    def in_sea(self, peak_period: float, significant_height: float) -> ParameterSet:
        """The parameters with another sea."""
        sea = self.parameters.sea
        sea = replace(sea, peak_period=peak_period, significant_height=significant_height)
        return replace(self.parameters, sea=sea)


def headline_numbers(run: HeadlineRun) -> dict[str, NDArray[Any]]:
    """The numbers of a set by name, and how many solves did not converge.

    Returns
    -------
    dict of scalars
        For each wave case ``largest_reduction_*`` and ``lowest_reduction_*`` over the grid in
        per cent, ``rise_*`` of the error after the failure in per cent, and ``star_*``, the
        RMSE on the star's path in m; ``rise``, their mean, and ``rise_spread``, their range;
        ``cells_below_one``, the per cent of cells in which the NMPC is better;
        ``solves_failed``.
    """
    tally = _Tally()
    numbers: dict[str, float] = {}
    ratios: dict[str, list[float]] = {}
    for case, period in run.cells.peak_periods:
        ratios[case] = list(_ratios(run, period, tally))
        numbers[f"largest_reduction_{case}"] = 100 * (1 - min(ratios[case]))
        numbers[f"lowest_reduction_{case}"] = 100 * (1 - max(ratios[case]))
        numbers[f"rise_{case}"] = float(np.mean(list(_rises(run, period, tally))))
        numbers[f"star_{case}"] = _star_error(run, period, tally)
    rises = [numbers[f"rise_{case}"] for case in ratios]
    numbers["rise"] = float(np.mean(rises))
    numbers["rise_spread"] = max(rises) - min(rises)
    numbers["cells_below_one"] = 100 * float(np.mean(np.concatenate(list(ratios.values())) < 1))
    found: dict[str, NDArray[Any]] = {name: np.array(value) for name, value in numbers.items()}
    return {**found, "solves_failed": np.array(tally.failed)}


def attempted_numbers(run: HeadlineRun) -> dict[str, NDArray[Any]]:
    """`headline_numbers`, or under ``failure`` why the closed loops of the set cannot run."""
    try:
        return headline_numbers(run)
    except (SimulationError, ArithmeticError, np.linalg.LinAlgError) as error:
        return {"failure": np.array(str(error))}


@dataclass
class _Tally:
    """Closed loops so far, each run once, and the solves that did not converge."""

    failed: int = 0
    errors: dict[tuple[LoopRun, str], float] = dataclasses.field(default_factory=dict)

    def error(self, run: LoopRun, controller: str) -> float:
        """RMSE of a closed loop over the whole run, in m."""
        key = (run, controller)
        if key not in self.errors:
            self.errors[key] = self.error_of(simulate(scenario_of(run), controller))
        return self.errors[key]

    def error_of(self, loop: ClosedLoop) -> float:
        """RMSE of a loop that is run once anyway."""
        self.failed += int(np.count_nonzero(loop.status > 0))
        return root_mean_square_error(loop.error)


def _ratios(run: HeadlineRun, period: float, tally: _Tally) -> Iterator[float]:
    for target, height in run.cells.grid:
        cell = LoopRun(run.in_sea(period, height), (target,))
        yield tally.error(cell, "nmpc") / tally.error(cell, "baseline")


def _rises(run: HeadlineRun, period: float, tally: _Tally) -> Iterator[float]:
    for target, height in run.cells.failures:
        cell = LoopRun(run.in_sea(period, height), (target,))
        manner = run.parameters.failure.manner
        failed = with_failure(cell.parameters, run.cells.failed_segment, manner)
        before = tally.error(cell, "nmpc")
        yield 100 * (tally.error(replace(cell, parameters=failed), "nmpc") / before - 1)


def _star_error(run: HeadlineRun, period: float, tally: _Tally) -> float:
    parameters = run.in_sea(period, run.cells.star_height)
    return tally.error_of(simulate(scenario_on_star(parameters, run.cells.star), "nmpc"))
