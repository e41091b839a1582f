"""Time of one control step on recorded problems, solver by solver.

    python step_time.py [--steps N]

prints it for this package's own solvers; ``run.py`` measures their peers as well.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from recording import POSES, Recording, bench_parameters, record, scenario_at

from softwave_min.control.engine import Engine
from softwave_min.control.nmpc import GaussNewton, Solution, Solver, Status
from softwave_min.control.preview import Preview, noise_deviation, told_flow
from softwave_min.native import compiler
from softwave_min.parameters import ParameterSet
from softwave_min.simulation import Scenario

__all__ = [
    "COMPILED",
    "INTERPRETED",
    "REAL_TIME_STEPS",
    "Method",
    "Row",
    "compiled_loop",
    "engine_of",
    "measure",
    "own_methods",
    "row_of",
    "table",
]

Floats = NDArray[np.float64]

REAL_TIME_STEPS = (1, 2, 3)
QUICK = 0.02
"""A solver whose step takes less than this, in s, is timed more than once."""
PASSES = 5
COMPILED, INTERPRETED = "Gauss-Newton SQP, compiled", "Gauss-Newton SQP, interpreted"


@dataclass(frozen=True)
class Method:
    """A solver, and how its solves may end."""

    name: str
    solver: Solver
    asked: tuple[Status, ...] = (Status.CONVERGED,)


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


def row_of(
    method: str, seconds: Floats, iterations: Floats, failures: int, deviation: float
) -> Row:
    """Statistics of one method."""
    middle, most = (float(one) for one in np.percentile(1e3 * seconds, [50, 95]))
    typical, largest = float(np.median(iterations)), int(np.max(iterations))
    return Row(method, len(seconds), middle, most, typical, largest, failures, deviation)


def measure(method: Method, recordings: Sequence[Recording]) -> Row:
    """Solve every recorded problem; a quick solver several times, of which the median counts."""
    problems = [pair for recording in recordings for pair in recording]
    method.solver.solve(*problems[0])
    seconds, solutions = _one_pass(method.solver, problems)
    if np.median(seconds) < QUICK:
        again = [_one_pass(method.solver, problems)[0] for _ in range(PASSES - 1)]
        seconds = np.median([seconds, *again], axis=0)
    expected = np.concatenate([recording.applied for recording in recordings])
    applied = np.array([solution.inputs[0] for solution in solutions])
    return row_of(
        method.name,
        seconds,
        np.array([solution.iterations for solution in solutions]),
        sum(solution.status not in method.asked for solution in solutions),
        float(np.max(np.abs(applied - expected))),
    )


def _one_pass(
    solver: Solver, problems: Iterable[tuple[object, Floats]]
) -> tuple[Floats, list[Solution]]:
    seconds, solutions = [], []
    gc.collect()
    gc.disable()
    for problem, guess in problems:
        started = time.process_time()
        solution = solver.solve(problem, guess)
        seconds.append(time.process_time() - started)
        solutions.append(solution)
    gc.enable()
    return np.array(seconds), solutions


def engine_of(scenario: Scenario, **nmpc: object) -> Engine:
    """The compiled solver with some settings changed."""
    p = scenario.parameters
    settings = replace(p.nmpc, **nmpc)
    return Engine(scenario.arm, scenario.believed_gains, scenario.gains, settings, p.simulation)


def own_methods(scenario: Scenario) -> Iterator[Method]:
    """The package's own solvers: converged and real-time iteration, compiled and not."""

    def interpreted(**nmpc: object) -> GaussNewton:
        settings = replace(scenario.parameters.nmpc, **nmpc)
        return GaussNewton(scenario.arm, scenario.believed_gains, settings)

    builders = {"compiled": lambda **nmpc: engine_of(scenario, **nmpc), "interpreted": interpreted}
    if compiler() is None:
        del builders["compiled"]
    for how, build in builders.items():
        yield Method(COMPILED if how == "compiled" else INTERPRETED, build())
        for count in REAL_TIME_STEPS:
            yield Method(
                f"real-time iteration, {count} step{'s' * (count > 1)}, {how}",
                build(real_time=True, max_iterations=count),
                (Status.CONVERGED, Status.ITERATION_LIMIT),
            )


def compiled_loop(parameters: ParameterSet, steps: int) -> Row:
    """Solver and plant in one call of the compiled engine; its runs' mean times of a step."""
    seconds, iterations, failures = [], [], 0
    for pose in POSES:
        scenario = scenario_at(parameters, pose, steps)
        p, engine = scenario.parameters, engine_of(scenario)
        spread = noise_deviation(p.preview, scenario.held_loads)
        preview = Preview(scenario.flow, spread, p.nmpc.horizon, p.preview)
        noise = np.array([preview.at(step).disturbance for step in range(steps)])
        told = told_flow(p.preview, scenario.flow)
        first = np.concatenate([scenario.initial_angles, np.zeros(scenario.arm.segments)])
        for _ in range(PASSES):
            started = time.process_time()
            run = engine.run(first, scenario.targets, scenario.flow, told, noise)
            seconds.append((time.process_time() - started) / steps)
        iterations.append(run[3])
        failures += int(np.count_nonzero(run[2])) + steps - len(run[2])
    counts = np.concatenate(iterations)
    row = row_of("closed loop with plant, compiled", np.array(seconds), counts, failures, np.nan)
    return replace(row, solves=len(counts))


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


def main() -> None:
    """Time this package's own solvers."""
    parser = argparse.ArgumentParser(description="Time of a control step of each own solver.")
    parser.add_argument("--steps", type=int, default=120, help="steps of each recorded loop")
    steps = parser.parse_args().steps
    scenarios = [scenario_at(bench_parameters(), pose, steps) for pose in POSES]
    recordings = [record(scenario) for scenario in scenarios]
    rows = [measure(method, recordings) for method in own_methods(scenarios[0])]
    if compiler() is not None:
        rows.append(compiled_loop(bench_parameters(), steps))
    print(table(rows))


if __name__ == "__main__":
    main()
