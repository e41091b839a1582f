"""Closed loops as runs of an experiment, and the numbers that are read off them.

Whatever computes a run stands in a module that knows the library alone: a run is a function of
its parameters, and reads no file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from softwave_min.parameters import FailureParameters, ParameterSet
from softwave_min.runs.experiment import Run
from softwave_min.simulation import (
    CONTROLLERS,
    ClosedLoop,
    Scenario,
    compile_engine,
    root_mean_square_error,
    simulate,
)
from softwave_min.waves import Sea

Path = tuple[tuple[float, float], ...]
RunData = Mapping[str, NDArray[Any]]
Window = Literal["whole", "settled"]

TRANSIENT = ClosedLoop.TRANSIENT
"""Seconds after which a run counts as settled."""
WINDOWS: Mapping[Window, str] = {"whole": "", "settled": "_settled"}
"""Windows of an RMSE, start-up included or not, and the ending of their columns."""
SUMMARY_FIELDS = ("error", "status", "source")
"""Fields of a closed loop that errors, failed solves and fallbacks are read off."""


@dataclass(frozen=True)
class LoopRun:
    """All that determines the closed loops at one place of the grid."""

    parameters: ParameterSet
    """With the sea, its seed, and the failure."""
    path: Path
    """Desired tip at every control instant, in m; it stays at its last point."""
    controllers: tuple[str, ...] = field(default_factory=lambda: tuple(CONTROLLERS))


def with_failure(
    parameters: ParameterSet, segment: int, manner: Literal["passive", "locked"]
) -> ParameterSet:
    """The parameters with a failed segment, numbered from 1."""
    known = parameters.failure.known
    return replace(parameters, failure=FailureParameters(segment, manner, known))


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
        loop = simulate(scenario, controller)
        found |= {f"{controller}_{name}": array for name, array in kept(loop).items()}
    return found


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


def summary_arrays(loop: ClosedLoop, name: str) -> dict[str, NDArray[Any]]:
    """``<name>_<field>`` for ``SUMMARY_FIELDS``: all that the next four functions read."""
    return {f"{name}_{one}": getattr(loop, one) for one in SUMMARY_FIELDS}


def whole_error(data: RunData, name: str) -> float:
    """RMSE of the loop ``name`` over the whole run, start included, in m."""
    return root_mean_square_error(data[f"{name}_error"])


def settled_error(data: RunData, name: str, period: float) -> float:
    """RMSE from ``TRANSIENT`` on, in m; ``period`` is the control period in s."""
    return root_mean_square_error(data[f"{name}_error"][round(TRANSIENT / period) :])


def failed_solves(data: RunData, *names: str) -> int:
    """Solves of the named loops that did not converge; each is in its ``<name>_status``."""
    return sum(int(np.count_nonzero(data[f"{name}_status"] > 0)) for name in names)


def fallbacks(data: RunData, *names: str) -> int:
    """Commands of the named loops that came from a fallback; each is in its ``<name>_source``."""
    return sum(int(np.count_nonzero(data[f"{name}_source"])) for name in names)
