"""Closed loops as runs of an experiment, and the numbers that are read off them.

Whatever computes a run stands in a module that knows the library alone: a run is a function of
its parameters, and reads no file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from softwave_min.parameters import FailureParameters, ParameterSet
from softwave_min.simulation import (
    CONTROLLERS,
    REFERENCE,
    ClosedLoop,
    Scenario,
    root_mean_square_error,
    simulate,
)
from softwave_min.waves import Sea, Spectrum

Path = tuple[tuple[float, float], ...]
RunData = Mapping[str, NDArray[Any]]
Window = Literal["whole", "settled"]

TRANSIENT = ClosedLoop.TRANSIENT
"""Seconds after which a run counts as settled."""
WINDOWS: Mapping[Window, str] = {"whole": "", "settled": "_settled"}
"""Windows of an RMSE, start-up included or not, and the ending of their columns."""
SUMMARY_FIELDS = ("error", "status", "source")
"""Fields of a closed loop that errors, failed solves and fallbacks are read off."""


def controllers() -> tuple[str, ...]:
    """Names of all controllers that are compared, the reference included."""
    return tuple(CONTROLLERS)


def others() -> tuple[str, ...]:
    """Names of those that are compared with the reference."""
    return tuple(name for name in CONTROLLERS if name != REFERENCE)


@dataclass(frozen=True)
class LoopRun:
    """All that determines the closed loops on one path in one sea."""

    parameters: ParameterSet
    """With the sea, its seed, and the failure."""
    path: Path
    """Desired tip at every control instant, in m; it stays at its last point."""
    controllers: tuple[str, ...] = field(default_factory=controllers)
    spectrum: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    """Frequencies in Hz and densities in m^2/Hz, taken in place of the JONSWAP curve and
    scaled to the parameters' height."""


def with_failure(
    parameters: ParameterSet, segment: int, manner: Literal["passive", "locked"]
) -> ParameterSet:
    """The parameters with a failed segment, numbered from 1."""
    known = parameters.failure.known
    return replace(parameters, failure=FailureParameters(segment, manner, known))


def sea_of(run: LoopRun) -> Sea:
    """The sea of a run: random phases, and the JONSWAP or the measured spectrum."""
    sea, gravity = run.parameters.sea, run.parameters.fluid.gravity
    if run.spectrum is None:
        return Sea.random(sea, gravity)
    frequency_hz, density = (np.array(one) for one in run.spectrum)
    return Sea.from_spectrum(Spectrum(frequency_hz, density), sea, gravity)


def scenario_of(run: LoopRun) -> Scenario:
    """Arm, sea and path of a run."""
    return Scenario.build(run.parameters, sea_of(run), np.array(run.path))


def closed_loops(run: LoopRun) -> dict[str, NDArray[Any]]:
    """Simulate each controller, and keep what tables are made of.

    Returns
    -------
    dict of ndarray
        ``<controller>_error`` (T + 1,) in m; ``_q`` (T + 1, n) in rad; ``_tip`` (T + 1, 2)
        in m; ``_wave_torque`` (T, n) in N m; ``_status`` and ``_source`` (T,).
    """
    scenario = scenario_of(run)
    found: dict[str, NDArray[Any]] = {}
    for name in run.controllers:
        loop = simulate(scenario, name)
        found |= summary_arrays(loop, name)
        found |= {f"{name}_q": loop.q, f"{name}_tip": loop.tips[:, -1]}
        found[f"{name}_wave_torque"] = loop.wave_torque
    return found


def errors_alone(run: LoopRun) -> dict[str, NDArray[Any]]:
    """`closed_loops` with ``SUMMARY_FIELDS`` and no more, where there are many of them."""
    found = closed_loops(run).items()
    return {name: array for name, array in found if name.endswith(SUMMARY_FIELDS)}


def whole_record(run: LoopRun) -> dict[str, NDArray[Any]]:
    """Simulate a run of one controller; the arrays are the fields of ``ClosedLoop``."""
    (controller,) = run.controllers
    return vars(simulate(scenario_of(run), controller))


def summary_arrays(loop: ClosedLoop, name: str) -> dict[str, NDArray[Any]]:
    """``<name>_<field>`` for ``SUMMARY_FIELDS``: all that the next four functions read."""
    return {f"{name}_{one}": getattr(loop, one) for one in SUMMARY_FIELDS}


def whole_error(data: RunData, name: str) -> float:
    """RMSE of the loop ``name`` over the whole run, start included, in m."""
    return root_mean_square_error(data[f"{name}_error"])


def settled_error(data: RunData, name: str, period: float) -> float:
    """RMSE from ``TRANSIENT`` on, in m; ``period`` is the control period in s."""
    return root_mean_square_error(data[f"{name}_error"][round(TRANSIENT / period) :])


def errors(data: RunData, names: Sequence[str], period: float) -> dict[str, float]:
    """RMSE of each loop in each of the ``WINDOWS``, in m, by its name and the window's ending."""
    whole = {name: whole_error(data, name) for name in names}
    return whole | {f"{name}_settled": settled_error(data, name, period) for name in names}


def failed_solves(data: RunData, *names: str) -> int:
    """Solves of the named loops that did not converge; each is in its ``<name>_status``."""
    return sum(int(np.count_nonzero(data[f"{name}_status"] > 0)) for name in names)


def fallbacks(data: RunData, *names: str) -> int:
    """Commands of the named loops that came from a fallback; each is in its ``<name>_source``."""
    return sum(int(np.count_nonzero(data[f"{name}_source"])) for name in names)
