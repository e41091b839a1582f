"""Closed loops whose NMPC takes what it is told of the present to last for its whole horizon."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softwave_min.control.problem import Problem, Solution, Solver
from softwave_min.simulation import ClosedLoop, NmpcController, Scenario, simulate, solver_of

Floats = NDArray[np.float64]
Telling = Callable[[Problem], Problem]


def held_flow(problem: Problem) -> Problem:
    """The problem with the flow of the present period; the load noise stays as it is."""
    forecast = problem.forecast
    return replace(problem, forecast=replace(forecast, flow=_held(forecast.flow)))


def held_reference(problem: Problem) -> Problem:
    """The problem with the next point of the reference."""
    return replace(problem, reference=_held(problem.reference))


def _held(values: Floats) -> Floats:
    return np.array(np.broadcast_to(values[0], values.shape))


@dataclass(frozen=True)
class Told:
    """A solver that is told another problem than the one at hand."""

    solver: Solver
    telling: Telling

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Solve the problem as told."""
        return self.solver.solve(self.telling(problem), guess)


def simulate_told(scenario: Scenario, telling: Telling) -> ClosedLoop:
    """The arm under NMPC with the scenario's solver, told another problem in each step."""
    return simulate(scenario, NmpcController(scenario, Told(solver_of(scenario), telling)))
