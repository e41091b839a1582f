"""Optimal control problems as a closed loop meets them, recorded for every method alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softwave_min.control.preview import Forecast
from softwave_min.control.problem import Problem, Solution, Solver
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet, parameter_set
from softwave_min.simulation import NmpcController, Scenario, simulate, solver_of
from softwave_min.waves import Sea

__all__ = ["PARAMETER_SET", "POSES", "Recording", "bench_parameters", "record", "scenario_at"]

Floats = NDArray[np.float64]

POSES = ("P1", "P3")
CASE, HEIGHT = "W3", 3.0
PARAMETER_SET = "physical"
"""Shipped parameter set that is measured; the book's results are of the default one."""


def bench_parameters() -> ParameterSet:
    """The nominal parameters in the sea of the measurement."""
    nominal = parameter_set(PARAMETER_SET)
    sea = replace(
        nominal.sea, peak_period=wave_cases()[CASE].peak_period, significant_height=HEIGHT
    )
    return replace(nominal, sea=sea)


def scenario_at(parameters: ParameterSet, pose: str, steps: int) -> Scenario:
    """The first ``steps`` control periods at a pose."""
    duration = steps * parameters.nmpc.control_period
    parameters = replace(parameters, simulation=replace(parameters.simulation, duration=duration))
    return Scenario.build(
        parameters, Sea.random(parameters.sea, parameters.fluid.gravity), poses()[pose]
    )


@dataclass(frozen=True)
class Recording:
    """Problems in the order of a closed loop, stacked along the first axis."""

    state: Floats
    previous: Floats
    reference: Floats
    flow: Floats
    disturbance: Floats
    guess: Floats
    """The shifted former plan: what every solver that takes a guess starts from."""
    applied: Floats
    """(N, n), the inputs applied by the solver that was recorded, in rad."""
    cost: Floats
    """(N,), its cost of each problem."""

    def __iter__(self) -> Iterator[tuple[Problem, Floats]]:
        for i in range(len(self.state)):
            forecast = Forecast(self.flow[i], self.disturbance[i])
            problem = Problem(self.state[i], self.previous[i], self.reference[i], forecast)
            yield problem, self.guess[i]

    def save(self, path: Path) -> None:
        """Write an .npz file."""
        np.savez(path, **vars(self))

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Read what ``save`` wrote."""
        with np.load(path) as archive:
            return cls(**{field.name: archive[field.name] for field in fields(cls)})


class _Recorder:
    """Passes problems on to a solver, and keeps them."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self.rows: list[tuple[Floats, ...]] = []

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        solution = self._solver.solve(problem, guess)
        forecast = (problem.forecast.flow, problem.forecast.disturbance)
        given = (problem.state, problem.previous, problem.reference, *forecast, guess)
        self.rows.append((*given, solution.inputs[0], np.asarray(solution.cost)))
        return solution


def record(scenario: Scenario) -> Recording:
    """The closed loop of a scenario under a tightly converged solver."""
    nmpc = replace(scenario.parameters.nmpc, tolerance=1e-10, max_iterations=200)
    converging = replace(scenario, parameters=replace(scenario.parameters, nmpc=nmpc))
    recorder = _Recorder(solver_of(converging))
    simulate(converging, NmpcController(converging, recorder))
    return Recording(*(np.array(column) for column in zip(*recorder.rows, strict=True)))
