"""The paper's headline numbers of a parameter set, from the closed loops that decide them.

The corners of the grid of error ratios stand for the whole of it, so that a set is judged in
seconds: for the calibration, the register's switches and the sensitivity study.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.experiments import star
from softwave_min.experiments.closed_loop import LoopRun, scenario_of, with_failure
from softwave_min.experiments.places import in_sea
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import Count, ParameterSet, Positive, load_data
from softwave_min.simulation import SimulationError, root_mean_square_error, simulate


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class Cells:
    """Which closed loops stand for the paper's figures."""

    grid: tuple[tuple[str, Positive], ...]
    """Pose and significant height in m, in every wave case."""
    failure_poses: tuple[str, ...]
    failure_heights: tuple[Positive, ...]
    """In m."""
    failed_segment: Count


@dataclass(frozen=True)
class HeadlineRun:
    """A parameter set to be judged, and by which closed loops."""

    parameters: ParameterSet
    cells: Cells


def headline_cells() -> Cells:
    """Those of data/studies/headline_cells.toml."""
    return load_data(Cells, "studies/headline_cells.toml")


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
    for case in wave_cases():
        ratios[case] = list(_ratios(run, case, tally))
        numbers[f"largest_reduction_{case}"] = 100 * (1 - min(ratios[case]))
        numbers[f"lowest_reduction_{case}"] = 100 * (1 - max(ratios[case]))
        numbers[f"rise_{case}"] = float(np.mean(list(_rises(run, case, tally))))
        numbers[f"star_{case}"] = _star_error(run, case, tally)
    rises = [numbers[f"rise_{case}"] for case in wave_cases()]
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
            loop = simulate(scenario_of(run), controller)
            self.failed += int(np.count_nonzero(loop.status > 0))
            self.errors[key] = root_mean_square_error(loop.error)
        return self.errors[key]


def _ratios(run: HeadlineRun, case: str, tally: _Tally) -> Iterator[float]:
    for pose, height in run.cells.grid:
        cell = LoopRun(in_sea(run.parameters, case, height), (poses()[pose],))
        yield tally.error(cell, "nmpc") / tally.error(cell, "baseline")


def _rises(run: HeadlineRun, case: str, tally: _Tally) -> Iterator[float]:
    for height in run.cells.failure_heights:
        intact = in_sea(run.parameters, case, height)
        failed = with_failure(intact, run.cells.failed_segment, run.parameters.failure.manner)
        for pose in run.cells.failure_poses:
            cell = LoopRun(intact, (poses()[pose],))
            before = tally.error(cell, "nmpc")
            yield 100 * (tally.error(replace(cell, parameters=failed), "nmpc") / before - 1)


def _star_error(run: HeadlineRun, case: str, tally: _Tally) -> float:
    chosen = star.choice()
    parameters = in_sea(run.parameters, case, chosen.significant_height)
    loop = simulate(star.scenario_of(parameters, chosen.path), "nmpc")
    tally.failed += int(np.count_nonzero(loop.status > 0))
    return root_mean_square_error(loop.error)
