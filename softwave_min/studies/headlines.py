"""The paper's headline numbers of a parameter set, from the closed loops that decide them.

The corners of the grid of error ratios stand for the whole of it, so that a set is judged in
seconds: for the calibration, the switches of the open points and the sensitivity study. Nothing
here reads a file; `cells` says which closed loops are meant.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softwave_min.data import ParameterError
from softwave_min.experiments.closed_loop import LoopRun, scenario_of, with_failure
from softwave_min.experiments.star_loops import scenario_on_star
from softwave_min.experiments.star_path import StarParameters
from softwave_min.parameters import ParameterSet
from softwave_min.simulation import ClosedLoop, SimulationError, root_mean_square_error, simulate

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
    """The numbers of a set by name, and how many solves did not converge: scalars.

    For each wave case ``largest_reduction_*`` and ``lowest_reduction_*`` over the grid in
    per cent, ``rise_*`` of the error after the failure in per cent, and ``star_*``, the RMSE
    on the star's path in m; ``rise``, the mean of the rises, and ``rise_spread``, their range;
    ``cells_below_one``, the per cent of cells in which the NMPC is better; ``solves_failed``.
    """
    loops, cells = _Loops(run), run.cells
    numbers: dict[str, float] = {}
    ratios: list[float] = []
    rises: list[float] = []
    for case, period in cells.peak_periods:
        here = [
            loops.error(period, one) / loops.error(period, one, "baseline") for one in cells.grid
        ]
        after = [
            100 * (loops.error(period, one, failed=True) / loops.error(period, one) - 1)
            for one in cells.failures
        ]
        ratios += here
        rises.append(float(np.mean(after)))
        numbers |= {
            f"largest_reduction_{case}": 100 * (1 - min(here)),
            f"lowest_reduction_{case}": 100 * (1 - max(here)),
            f"rise_{case}": rises[-1],
            f"star_{case}": loops.star_error(period),
        }
    numbers |= {
        "rise": float(np.mean(rises)),
        "rise_spread": max(rises) - min(rises),
        "cells_below_one": 100 * float(np.mean(np.array(ratios) < 1)),
        "solves_failed": loops.failed,
    }
    return {name: np.array(value) for name, value in numbers.items()}


def attempted_numbers(run: HeadlineRun) -> dict[str, NDArray[Any]]:
    """`headline_numbers`, or under ``failure`` why the closed loops of the set cannot run."""
    try:
        return headline_numbers(run)
    except (SimulationError, ArithmeticError, np.linalg.LinAlgError) as error:
        return {"failure": np.array(str(error))}


@dataclass
class _Loops:
    """Closed loops so far, each run once, and the solves that did not converge."""

    run: HeadlineRun
    failed: int = 0
    errors: dict[tuple[LoopRun, str], float] = field(default_factory=dict)

    def error(
        self, period: float, cell: Cell, controller: str = "nmpc", *, failed: bool = False
    ) -> float:
        """RMSE over the whole run, in m; ``failed`` is with the failed segment."""
        target, height = cell
        parameters = self.run.in_sea(period, height)
        if failed:
            manner = parameters.failure.manner
            parameters = with_failure(parameters, self.run.cells.failed_segment, manner)
        loop = LoopRun(parameters, (target,))
        if (loop, controller) not in self.errors:
            found = simulate(scenario_of(loop), controller)
            self.errors[loop, controller] = self._error_of(found)
        return self.errors[loop, controller]

    def star_error(self, period: float) -> float:
        """RMSE on the star under NMPC, in m."""
        parameters = self.run.in_sea(period, self.run.cells.star_height)
        return self._error_of(simulate(scenario_on_star(parameters, self.run.cells.star), "nmpc"))

    def _error_of(self, loop: ClosedLoop) -> float:
        self.failed += int(np.count_nonzero(loop.status > 0))
        return root_mean_square_error(loop.error)
