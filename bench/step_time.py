"""Time of a control step on recorded problems, all methods side by side."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from recording import Recording

from softwave_min.control.compiled.engine import Engine
from softwave_min.control.nmpc import GaussNewton
from softwave_min.control.problem import Problem, Solver, Status
from softwave_min.native import compiler
from softwave_min.simulation import Scenario

__all__ = [
    "COMPILED",
    "INTERPRETED",
    "REAL_TIME_STEPS",
    "Method",
    "Row",
    "Sample",
    "SolverMethod",
    "engine_of",
    "measure",
    "own_methods",
    "table",
]

Floats = NDArray[np.float64]

REAL_TIME_STEPS = (1, 2, 3)
CHUNK = 12
"""Problems that a method solves before the next one has its turn."""
QUICK = 0.02
"""A solver that takes less than this, in s, solves each problem more than once."""
PASSES = 5
COMPILED, INTERPRETED = "Gauss-Newton SQP, compiled", "Gauss-Newton SQP, interpreted"


@dataclass(frozen=True)
class Sample:
    """One solve."""

    seconds: float
    """Of the processor, not of the clock on the wall."""
    iterations: int
    failed: bool
    """Whether it did not end as it was asked to."""
    applied: Floats
    """(n,), the first input, in rad."""
    cost: float
    """NaN where the cost is another one."""


class Method(Protocol):
    """Anything that solves the recorded problems in their order."""

    name: str
    expected: Floats
    """(N, n), converged input of every problem, in rad."""
    least: Floats
    """(N,), converged cost of every problem."""

    def solve(self, indices: range) -> list[Sample]:
        """Solve the problems of these indices."""


@dataclass
class SolverMethod:
    """A solver of this package's interface."""

    name: str
    solver: Solver
    recordings: Sequence[Recording]
    asked: tuple[Status, ...] = (Status.CONVERGED,)
    """How its solves may end."""
    judge: GaussNewton | None = None
    """Evaluates the cost of a plan exactly; otherwise the solver's own word counts."""
    expected: Floats = field(init=False)
    least: Floats = field(init=False)
    _problems: list[tuple[Problem, Floats]] = field(init=False)

    def __post_init__(self) -> None:
        self.expected = np.concatenate([recording.applied for recording in self.recordings])
        self.least = np.concatenate([recording.cost for recording in self.recordings])
        self._problems = [pair for recording in self.recordings for pair in recording]
        self.solver.solve(*self._problems[0])

    def solve(self, indices: range) -> list[Sample]:
        """Solve these problems; of a quick solver's times the median counts."""
        passes = [[self._sample(index) for index in indices]]
        if np.median([sample.seconds for sample in passes[0]]) < QUICK:
            passes += [[self._sample(index) for index in indices] for _ in range(PASSES - 1)]
        return [
            replace(same[0], seconds=float(np.median([sample.seconds for sample in same])))
            for same in zip(*passes, strict=True)
        ]

    def _sample(self, index: int) -> Sample:
        problem, guess = self._problems[index]
        started = time.process_time()
        solution = self.solver.solve(problem, guess)
        seconds = time.process_time() - started
        failed = solution.status not in self.asked
        cost = solution.cost
        if self.judge is not None:
            residual, _ = self.judge.residual(problem, solution.inputs)
            cost = float(residual @ residual)
        return Sample(seconds, solution.iterations, failed, solution.inputs[0], cost)


@dataclass(frozen=True)
class Row:
    """What was measured of one method."""

    method: str
    solves: int
    median_ms: float
    percentile_95_ms: float
    iterations_median: float
    iterations_largest: int
    failures: int
    """Solves that did not end as they were asked to."""
    deviation: float
    """Largest difference of an applied input from the converged one, in rad."""
    cost_excess: float
    """Largest relative difference of a cost from the converged one."""


def measure(methods: Sequence[Method]) -> list[Row]:
    """Solve every problem with every method, a few problems at a time in turn.

    What else the machine does meets all methods alike, and their ratios are fair.
    """
    samples: list[list[Sample]] = [[] for _ in methods]
    gc.collect()
    gc.disable()
    for first in range(0, max(len(method.expected) for method in methods), CHUNK):
        for method, found in zip(methods, samples, strict=True):
            found.extend(method.solve(range(first, min(first + CHUNK, len(method.expected)))))
    gc.enable()
    return [_row(method, found) for method, found in zip(methods, samples, strict=True)]


def _row(method: Method, samples: Sequence[Sample]) -> Row:
    middle, most = np.percentile([1e3 * sample.seconds for sample in samples], [50, 95])
    iterations = [sample.iterations for sample in samples]
    applied = np.array([sample.applied for sample in samples])
    return Row(
        method.name,
        len(samples),
        float(middle),
        float(most),
        float(np.median(iterations)),
        max(iterations),
        sum(sample.failed for sample in samples),
        float(np.max(np.abs(applied - method.expected))),
        float(np.max(np.abs([sample.cost for sample in samples] / method.least - 1))),
    )


def engine_of(scenario: Scenario, **nmpc: object) -> Engine:
    """The compiled solver with some settings changed."""
    p = scenario.parameters
    settings = replace(p.nmpc, **nmpc)
    return Engine(scenario.arm, scenario.believed_gains, scenario.gains, settings, p.simulation)


def own_methods(scenario: Scenario, recordings: Sequence[Recording]) -> Iterator[SolverMethod]:
    """The package's own solvers: converged and real-time iteration, compiled and not."""
    settings = scenario.parameters.nmpc
    readable = GaussNewton(scenario.arm, scenario.believed_gains, settings)
    if compiler() is not None:
        yield SolverMethod(COMPILED, engine_of(scenario), recordings, judge=readable)
        for count in REAL_TIME_STEPS:
            yield SolverMethod(
                f"real-time iteration, {count} step{'s' * (count > 1)}, compiled",
                engine_of(scenario, real_time=True, max_iterations=count),
                recordings,
                (Status.CONVERGED, Status.ITERATION_LIMIT),
                readable,
            )
    yield SolverMethod(INTERPRETED, readable, recordings, judge=readable)


def table(rows: Iterable[Row]) -> str:
    """Rows as text."""
    columns = [
        ("method", "median", "95 %", "iterations", "failed", "deviation"),
        ("", "ms", "ms", "median/max", "", "rad"),
    ]
    lines = ["{:52} {:>9} {:>9} {:>11} {:>9} {:>10}".format(*names) for names in columns]
    lines += [
        f"{row.method:52} {row.median_ms:9.3f} {row.percentile_95_ms:9.3f}"
        f" {row.iterations_median:8.0f}/{row.iterations_largest:<2d}"
        f" {row.failures:5d}/{row.solves:<3d} {row.deviation:10.1e}"
        for row in rows
    ]
    return "\n".join(lines)
