"""Closed loops of both controllers at one place of the grid, as runs of an experiment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softwave_min.experiments.paper import wave_cases
from softwave_min.parameters import FailureParameters, ParameterSet
from softwave_min.simulation import (
    ClosedLoop,
    Scenario,
    compile_engine,
    root_mean_square_error,
    simulate_baseline,
    simulate_nmpc,
)
from softwave_min.store import Run
from softwave_min.waves import Sea

__all__ = [
    "INTERVAL",
    "JUDGED",
    "TRANSIENT",
    "Controller",
    "LoopRun",
    "closed_loops",
    "failed_solves",
    "fallbacks",
    "in_sea",
    "judged",
    "kept",
    "over_seas",
    "prepare",
    "realisations",
    "scenario_of",
    "settled_error",
    "simulated",
    "whole_error",
    "with_failure",
]

Controller = Literal["baseline", "nmpc"]
Path = tuple[tuple[float, float], ...]
RunData = Mapping[str, NDArray[Any]]

INTERVAL = (0.05, 0.5, 0.95)
"""Quantiles over the random seas: a 90 % interval and its median."""
TRANSIENT = 10.0
"""Seconds after which a run counts as settled."""
JUDGED = ("error", "status", "source")
"""Fields of a closed loop by which it is judged."""


@dataclass(frozen=True)
class LoopRun:
    """All that determines the closed loops at one place of the grid."""

    parameters: ParameterSet
    """With the sea, its seed, and the failure."""
    path: Path
    """Desired tip at every control instant, in m; it stays at its last point."""
    controllers: tuple[Controller, ...] = ("baseline", "nmpc")


def in_sea(parameters: ParameterSet, case: str, significant_height: float) -> ParameterSet:
    """The parameters in one of the paper's wave cases, at a height in m."""
    period = wave_cases()[case].peak_period
    sea = replace(parameters.sea, peak_period=period, significant_height=significant_height)
    return replace(parameters, sea=sea)


def with_failure(
    parameters: ParameterSet, segment: int, manner: Literal["passive", "locked"]
) -> ParameterSet:
    """The parameters with a failed segment, numbered from 1."""
    known = parameters.failure.known
    return replace(parameters, failure=FailureParameters(segment, manner, known))


def realisations(parameters: ParameterSet) -> Iterator[ParameterSet]:
    """One parameter set for each random sea that is asked for, with its own noise."""
    for offset in range(parameters.sea.realisations):
        sea = replace(parameters.sea, seed=parameters.sea.seed + offset, realisations=1)
        preview = replace(parameters.preview, seed=parameters.preview.seed + offset)
        yield replace(parameters, sea=sea, preview=preview)


def scenario_of(run: LoopRun) -> Scenario:
    """Arm, sea and path of a run."""
    parameters = run.parameters
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    return Scenario.build(parameters, sea, np.array(run.path))


def prepare(run: Run) -> None:
    """Compile what the run needs, if its parameters are or hold a set."""
    found = getattr(run.parameters, "parameters", run.parameters)
    if isinstance(found, ParameterSet):
        compile_engine(found)


def closed_loops(run: LoopRun) -> dict[str, NDArray[Any]]:
    """Simulate each controller; ``<controller>_<field>`` for the fields of ``kept``."""
    scenario = scenario_of(run)
    found: dict[str, NDArray[Any]] = {}
    for controller in run.controllers:
        loop = simulated(scenario, controller)
        found |= {f"{controller}_{name}": array for name, array in kept(loop).items()}
    return found


def simulated(scenario: Scenario, controller: Controller) -> ClosedLoop:
    """One closed loop under a controller, by name."""
    return simulate_nmpc(scenario) if controller == "nmpc" else simulate_baseline(scenario)


def kept(loop: ClosedLoop) -> dict[str, NDArray[Any]]:
    """What is kept of a run of a sweep.

    Returns
    -------
    dict of ndarray
        ``error`` (T + 1,) in m; ``q`` (T + 1, n) in rad; ``tip`` (T + 1, 2) in m;
        ``wave_torque`` (T, n) in N m; ``status`` and ``source`` (T,).
    """
    return {
        "error": loop.error,
        "q": loop.q,
        "tip": loop.tips[:, -1],
        "wave_torque": loop.wave_torque,
        "status": loop.status,
        "source": loop.source,
    }


def judged(loop: ClosedLoop, name: str) -> dict[str, NDArray[Any]]:
    """``<name>_<field>`` for the fields in ``JUDGED``: all that the next four functions read."""
    return {f"{name}_{field}": getattr(loop, field) for field in JUDGED}


def whole_error(data: RunData, name: str) -> float:
    """RMSE of the loop ``name`` over the whole run, start included, in m."""
    return root_mean_square_error(data[f"{name}_error"])


def settled_error(data: RunData, name: str, period: float) -> float:
    """RMSE from ``TRANSIENT`` on, in m; ``period`` is the control period in s."""
    return root_mean_square_error(data[f"{name}_error"][round(TRANSIENT / period) :])


def failed_solves(data: RunData, name: str = "nmpc") -> int:
    """Solves that did not converge; each is in the run's ``<name>_status``."""
    return int(np.count_nonzero(data[f"{name}_status"] > 0))


def fallbacks(data: RunData, name: str = "nmpc") -> int:
    """Commands that came from the fallback; each is in the run's ``<name>_source``."""
    return int(np.count_nonzero(data[f"{name}_source"]))


def over_seas(values: ArrayLike) -> tuple[float, float, float]:
    """5 % quantile, median and 95 % quantile of a number over the random seas."""
    low, median, high = (float(one) for one in np.quantile(np.asarray(values, float), INTERVAL))
    return low, median, high
