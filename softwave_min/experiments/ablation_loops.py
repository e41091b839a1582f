"""Closed loops with one part changed: what computes the runs of `ablations`; reads no file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import NDArray

from softwave_min.experiments.closed_loop import LoopRun, scenario_of, summary_arrays
from softwave_min.experiments.star_loops import scenario_on_star
from softwave_min.experiments.star_path import StarParameters
from softwave_min.experiments.zero_order_hold import hold_flow, simulate_with_hold
from softwave_min.parameters import ParameterSet
from softwave_min.simulation import ClosedLoop, Scenario, simulate

NMPC, BASELINE = "nmpc", "baseline"
"""Names of the nominal loops, and of their controllers."""

Changes = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Ablation:
    """A closed loop with one part changed."""

    name: str
    group: str
    label: str
    controller: str
    changes: Changes = ()
    """Fields of the parameter set as 'section.name', and their values."""
    flow_on_hold: bool = False
    """Whether the NMPC takes the present flow to last."""
    opponent: str = ""
    """Loop of the other controller that it is compared with; the nominal one if empty."""

    @property
    def rival(self) -> str:
        """Loop of the other controller that it is compared with."""
        return self.opponent or (BASELINE if self.controller == NMPC else NMPC)


@dataclass(frozen=True)
class AblationRun:
    """All that determines the loops at one pose, or on the star, in one sea."""

    parameters: ParameterSet
    target: tuple[float, float] | StarParameters
    ablations: tuple[Ablation, ...]


def varied(parameters: ParameterSet, changes: Changes) -> ParameterSet:
    """The parameters with other values of the fields 'section.name'."""
    for field, value in changes:
        section, name = field.split(".")
        part = replace(getattr(parameters, section), **{name: value})
        parameters = replace(parameters, **{section: part})
    return parameters


def loops(run: AblationRun) -> dict[str, NDArray[Any]]:
    """Simulate all ablations; ``summary_arrays`` of each, by its name."""
    found: dict[str, NDArray[Any]] = {}
    for one in run.ablations:
        parameters = varied(run.parameters, one.changes)
        if isinstance(run.target, StarParameters):
            scenario = scenario_on_star(parameters, run.target)
        else:
            scenario = scenario_of(LoopRun(parameters, (run.target,)))
        found |= summary_arrays(loop_of(scenario, one), one.name)
    return found


def loop_of(scenario: Scenario, ablation: Ablation) -> ClosedLoop:
    """The closed loop of an ablation, whose changes the scenario has already."""
    if ablation.flow_on_hold:
        return simulate_with_hold(scenario, hold_flow)
    return simulate(scenario, ablation.controller)
