"""Closed loops whose NMPC takes the present value of a signal for its whole horizon."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softwave_min.control.problem import Problem, Solution, Solver
from softwave_min.simulation import ClosedLoop, NmpcController, Scenario, simulate, solver_of

Floats = NDArray[np.float64]
Hold = Callable[[Problem], Problem]


def hold_flow(problem: Problem) -> Problem:
    """The problem with the flow of the present period; the load noise stays as it is."""
    forecast = problem.forecast
    return replace(problem, forecast=replace(forecast, flow=_first_throughout(forecast.flow)))


def hold_reference(problem: Problem) -> Problem:
    """The problem with the next point of the reference."""
    return replace(problem, reference=_first_throughout(problem.reference))


def _first_throughout(values: Floats) -> Floats:
    return np.array(np.broadcast_to(values[0], values.shape))


@dataclass(frozen=True)
class ZeroOrderHold:
    """A solver in whose problem a signal is held."""

    solver: Solver
    hold: Hold

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Solve the problem with the hold."""
        return self.solver.solve(self.hold(problem), guess)


def simulate_with_hold(scenario: Scenario, hold: Hold) -> ClosedLoop:
    """The arm under NMPC with the scenario's solver, a signal held in each of its problems."""
    return simulate(scenario, NmpcController(scenario, ZeroOrderHold(solver_of(scenario), hold)))
