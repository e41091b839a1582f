"""The controllers by name: what turns the state at an instant into a command.

A controller of your own is a class made of a scenario with a method ``command``, and an entry
in ``CONTROLLERS``: the grid, its tables and its figures then have it as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from softwave_min.control.baseline import Correction
from softwave_min.control.preview import Preview, noise_deviation
from softwave_min.control.problem import Problem, Solution, Solver, Status
from softwave_min.simulation.backends import engine_or_none, solver_of
from softwave_min.simulation.scenario import Scenario

Floats = NDArray[np.float64]


class Source(IntEnum):
    """Where a command comes from."""

    CONTROLLER = 0
    """The controller itself."""
    FORMER_PLAN = 1
    """A solve failed: the plan of an earlier one goes on."""
    PLANNER = 2
    """Solves failed for a whole horizon: the kinematic planner takes over."""


@dataclass(frozen=True)
class Command:
    """What a controller answers at one instant."""

    q_bar: Floats
    """Commanded angles for the coming period, (n,) in rad."""
    solution: Solution | None = None
    """The solve behind it, where there was one."""
    source: Source = Source.CONTROLLER


class Controller(Protocol):
    """Anything that turns the state at an instant into a command."""

    def command(self, step: int, state: Floats) -> Command:
        """Command for the control period that starts at ``step``."""


@dataclass(frozen=True)
class History:
    """What plant and controller did."""

    states: Floats
    """(T + 1, 2 n)"""
    q_bar: Floats
    """(T, n), in rad."""
    status: NDArray[np.int64]
    """(T,), status of each solve, -1 where there was none."""
    iterations: NDArray[np.int64]
    """(T,)"""
    source: NDArray[np.int64]
    """(T,), see ``Source``."""


@runtime_checkable
class Compiled(Protocol):
    """A controller whose whole run the compiled engine can do: the same numbers, faster."""

    def whole_run(self) -> History | None:
        """The run from its start; None where it has to be stepped."""


def preview_of(scenario: Scenario) -> Preview:
    """What the NMPC is told of the scenario's sea, from the first forecast on."""
    parameters = scenario.parameters
    deviation = noise_deviation(parameters.preview, scenario.held_loads)
    return Preview(scenario.flow, deviation, parameters.nmpc.horizon, parameters.preview)


class BaselineController:
    """Feed-forward + PD behind the kinematic planner, corrected where the parameters say so."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._planned = scenario.planned_angles
        self._correction = _correction_or_none(scenario)

    def command(self, step: int, state: Floats) -> Command:
        """Next planned angles; the planner does not look at the state, a correction does."""
        planned = self._planned[step]
        if self._correction is None:
            return Command(planned)
        return Command(self._correction.command(step, state, planned))

    def whole_run(self) -> History | None:
        """The plant under the planner's commands; None if they depend on the state."""
        scenario = self._scenario
        fast = scenario.parameters.simulation.integrator == "extrapolation"
        if self._correction or not fast or not (engine := engine_or_none(scenario)):
            return None
        q_bar = self._planned[: scenario.steps]
        states = engine.follow(scenario.initial_state, q_bar, scenario.flow)
        none, zeros = np.full(scenario.steps, -1), np.zeros(scenario.steps, int)
        return History(states, q_bar, none, zeros, zeros)


def _correction_or_none(scenario: Scenario) -> Correction | None:
    gains = scenario.parameters.baseline
    if not gains.corrected:
        return None
    return Correction(scenario.arm, gains, scenario.period, preview_of(scenario))


class NmpcController:
    """The NMPC behind its preview, warm-started with its shifted former plan.

    A plan that is not finite is not applied. The former plan goes on in its place, and
    when that is used up the kinematic planner; both are recorded with the command.
    """

    def __init__(self, scenario: Scenario, solver: Solver | None = None) -> None:
        self._scenario = scenario
        self._solver = solver or solver_of(scenario)
        self._horizon = scenario.parameters.nmpc.horizon
        self._preview = preview_of(scenario)
        self._targets = scenario.targets
        self._planned = scenario.planned_angles
        self._previous = scenario.initial_angles
        self._plan = np.tile(scenario.initial_angles, (self._horizon, 1))
        self._failures = 0

    def command(self, step: int, state: Floats) -> Command:
        """First input of the optimal plan from ``state``."""
        reference = self._targets[step + 1 : step + 1 + self._horizon]
        problem = Problem(state, self._previous, reference, self._preview.at(step))
        solution = self._solver.solve(problem, self._plan)
        source = Source.CONTROLLER
        if solution.status is not Status.NOT_FINITE:
            self._failures, plan = 0, solution.inputs
        else:
            self._failures += 1
            plan, source = self._plan, Source.FORMER_PLAN
            if self._failures >= self._horizon:
                plan, source = np.tile(self._planned[step], (self._horizon, 1)), Source.PLANNER
        self._previous = plan[0]
        self._plan = np.vstack([plan[1:], plan[-1:]])
        return Command(plan[0], solution, source)

    def whole_run(self) -> History | None:
        """The loop in the engine; None where a plan is not finite, which needs the fallback."""
        scenario, parameters = self._scenario, self._scenario.parameters
        asked = (parameters.nmpc.solver, parameters.simulation.integrator)
        fast = asked == ("gauss_newton", "extrapolation")
        if not fast or not (engine := engine_or_none(scenario)):
            return None
        preview = preview_of(scenario)
        states, q_bar, status, iterations = engine.run(
            scenario.initial_state,
            scenario.targets,
            scenario.flow,
            preview.flow,
            preview.disturbances(scenario.steps),
        )
        if len(q_bar) < scenario.steps:
            return None
        source = np.full(len(q_bar), int(Source.CONTROLLER))
        return History(states, q_bar, status.astype(int), iterations.astype(int), source)


REFERENCE = "baseline"
"""The controller that the others are compared with."""
CONTROLLERS: Mapping[str, Callable[[Scenario], Controller]] = {
    REFERENCE: BaselineController,
    "nmpc": NmpcController,
}
"""Every controller that the experiments compare."""
