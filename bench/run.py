"""What a control step costs, here and with other programs.

    python bench/run.py [--quick] [--without-peers] [--output FOLDER]

The problems are those that a closed loop meets at P1 and P3 in sea W3 with a significant
height of 3 m. Every method runs on one core and takes its turn every few problems; the time
is the processor's, so that other work on the machine counts less. Written are steps.csv (every
method), loops.csv (solver and plant together in the compiled engine), growth.csv (time over
horizon and segments), real_time.csv (the closed loop under real-time iteration), bars.csv (what
was asked for) and machine.json. Ends with status 1 if a bar is missed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from environment import BENCH, FORMULATIONS, PeerMethod, Peers, circumstances, on_one_core
from fatrop import Fatrop
from recording import PARAMETER_SET, POSES, Recording, bench_parameters, record, scenario_at
from step_time import (
    COMPILED,
    INTERPRETED,
    PASSES,
    REAL_TIME_STEPS,
    Method,
    Row,
    SolverMethod,
    engine_of,
    measure,
    own_methods,
    table,
)

from softwave_min.control.problem import Status
from softwave_min.control.reference.interior_point import InteriorPoint
from softwave_min.experiments import example_case
from softwave_min.experiments.closed_loop import scenario_of
from softwave_min.native import compiler
from softwave_min.parameters import DEFAULT_SET, ParameterSet
from softwave_min.runs.store import table_text, write_atomically
from softwave_min.simulation import (
    Scenario,
    preview_of,
    root_mean_square_error,
    simulate,
)

IPOPT_TOLERANCE = 1e-8
"""IPOPT's own default."""
NOTEBOOK = "IPOPT, as in a notebook"


@dataclass(frozen=True)
class Plan:
    """How much to measure."""

    steps: int
    growth_steps: int
    horizons: tuple[int, ...]
    segments: tuple[int, ...]
    loop_steps: int
    peers: bool


FULL = Plan(120, 60, (10, 15, 20, 30, 40, 50, 60), (2, 3, 4, 5, 6, 7, 8), 600, True)
QUICK = Plan(5, 5, (10, 20), (3,), 20, False)


def interior_point_methods(
    scenario: Scenario, recordings: Sequence[Recording]
) -> Iterator[SolverMethod]:
    """IPOPT in two forms, fatrop in two."""
    problem = (scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)
    for name, expand in ((NOTEBOOK, False), ("IPOPT, written out", True)):
        yield SolverMethod(name, InteriorPoint(*problem, IPOPT_TOLERANCE, expand), recordings)
    exact = Fatrop(*problem, gauss_newton=False)
    yield SolverMethod("fatrop, exact Hessian, written out", exact, recordings)
    command = compiler()
    if command is not None:
        solver = Fatrop(*problem, gauss_newton=True, compiler=command)
        yield SolverMethod("fatrop, Gauss-Newton Hessian, compiled", solver, recordings)


def step_rows(
    scenario: Scenario, recordings: Sequence[Recording], peers: bool
) -> tuple[list[Row], dict[str, str]]:
    """Every method in one run, and the versions of the peers."""
    methods: list[Method] = [*own_methods(scenario, recordings)]
    if not peers:
        return measure(methods), {}
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),  # CasADi's just-in-time compiler leaves files where it runs
        Peers(recordings, Path(folder)) as process,
    ):
        methods += interior_point_methods(scenario, recordings)
        methods += [PeerMethod(process, name, recordings) for name in FORMULATIONS]
        return measure(methods), {"do-mpc": process.version}


def compiled_loops(parameters: ParameterSet, steps: int) -> pd.DataFrame:
    """Solver and plant in one call of the compiled engine; time per control period."""
    rows = []
    for pose in POSES:
        scenario = scenario_at(parameters, pose, steps)
        engine, preview = engine_of(scenario), preview_of(scenario)
        noise = preview.disturbances(steps)
        given = (scenario.initial_state, scenario.targets, scenario.flow, preview.flow, noise)
        milliseconds = []
        for _ in range(PASSES):
            started = time.process_time()
            _, _, status, iterations = engine.run(*given)
            milliseconds.append(1e3 * (time.process_time() - started) / steps)
        rows.append(
            {
                "pose": pose,
                "steps": steps,
                "mean_ms": float(np.median(milliseconds)),
                "slowest_run_ms": max(milliseconds),
                "iterations_mean": float(np.mean(iterations)),
                "failures": int(np.count_nonzero(status)) + steps - len(status),
            }
        )
    return pd.DataFrame(rows)


def growth(parameters: ParameterSet, plan: Plan) -> pd.DataFrame:
    """Time of the compiled solver over the horizon and over the number of segments."""
    cases: list[tuple[str, int, ParameterSet]] = []
    for horizon in plan.horizons:
        nmpc = replace(parameters.nmpc, horizon=horizon)
        cases.append(("horizon", horizon, replace(parameters, nmpc=nmpc)))
    cases += [("segments", n, in_segments(parameters, n)) for n in plan.segments]
    converged, one_step = [], []
    asked = (Status.CONVERGED, Status.ITERATION_LIMIT)
    for axis, value, changed in cases:
        scenario = scenario_at(changed, "P3", plan.growth_steps)
        recordings, name = [record(scenario)], f"{axis} {value}"
        converged.append(SolverMethod(name, engine_of(scenario), recordings))
        short = engine_of(scenario, real_time=True, max_iterations=1)
        one_step.append(SolverMethod(f"{name}, one iteration", short, recordings, asked))
    rows = measure([*converged, *one_step])
    return pd.DataFrame(
        {
            "axis": axis,
            "value": value,
            "median_ms": row.median_ms,
            "percentile_95_ms": row.percentile_95_ms,
            "one_iteration_ms": single.median_ms,
            "iterations_median": row.iterations_median,
            "iterations_largest": row.iterations_largest,
            "failures": row.failures,
        }
        for (axis, value, _), row, single in zip(
            cases, rows[: len(cases)], rows[len(cases) :], strict=True
        )
    )


def in_segments(parameters: ParameterSet, count: int) -> ParameterSet:
    """The same arm in ``count`` segments: bending stiffness, damping and gains per length."""
    arm, baseline = parameters.arm, parameters.baseline
    finer = count / arm.segments

    def spread(values: Sequence[float], factor: float) -> tuple[float, ...]:
        return (factor * float(np.mean(values)),) * count

    return replace(
        parameters,
        arm=replace(
            arm,
            length=spread(arm.length, 1 / finer),
            diameter=spread(arm.diameter, 1.0),
            density=spread(arm.density, 1.0),
            stiffness=spread(arm.stiffness, finer),
            damping=spread(arm.damping, finer),
        ),
        baseline=replace(
            baseline,
            proportional_gain=spread(baseline.proportional_gain, finer),
            derivative_gain=spread(baseline.derivative_gain, finer),
        ),
    )


def exponent(grown: pd.DataFrame, axis: str) -> float:
    """Power of the value with which the median time grows: a straight line in log and log."""
    rows = grown[grown["axis"] == axis]
    return float(np.polyfit(np.log(rows["value"]), np.log(rows["median_ms"]), 1)[0])


def real_time_loops(parameters: ParameterSet, steps: int) -> pd.DataFrame:
    """Closed-loop RMSE of the example case, converged and after one, two and three steps.

    Under the bench's parameters: these errors are not those of the book's example case.
    """
    duration = steps * parameters.nmpc.control_period
    parameters = replace(parameters, simulation=replace(parameters.simulation, duration=duration))
    rows = []
    for run in example_case.runs(parameters):
        if run.parameters.controllers != ("nmpc",):
            continue
        converged = None
        for count in (None, *REAL_TIME_STEPS):
            scenario = scenario_of(run.parameters)
            p = scenario.parameters
            if count is not None:
                nmpc = replace(p.nmpc, real_time=True, max_iterations=count)
                scenario = replace(scenario, parameters=replace(p, nmpc=nmpc))
            loop = simulate(scenario, "nmpc")
            error = root_mean_square_error(loop.error)
            converged = converged or error
            rows.append(
                {
                    "sea": run.name.removesuffix("-nmpc"),
                    "steps": "converged" if count is None else str(count),
                    "rmse": error,
                    "rmse_settled": root_mean_square_error(loop.error[len(loop.error) // 6 :]),
                    "change_percent": 100 * (error / converged - 1),
                    "fallbacks": int(np.count_nonzero(loop.source)),
                }
            )
    return pd.DataFrame(rows)


def bars(
    rows: Sequence[Row], in_real_time: pd.DataFrame, loops: pd.DataFrame, grown: pd.DataFrame
) -> pd.DataFrame:
    """What was asked for beforehand, beside what was measured."""
    median = {row.method: row.median_ms for row in rows}
    found: list[tuple[str, float, str, float]] = []
    peer = median.get(FORMULATIONS["collocation"])
    if peer is not None and COMPILED in median:
        found += [
            ("do-mpc's median over ours", peer / median[COMPILED], "at least", 100),
            ("notebook IPOPT's over ours", median[NOTEBOOK] / median[COMPILED], "at least", 250),
        ]
    if peer is not None:
        share = median[INTERPRETED] / peer
        found.append(("ours interpreted over do-mpc's median", share, "at most", 0.1))
    if len(loops):
        slowest = float(loops["mean_ms"].max())
        found.append(("closed loop in C, ms a step", slowest, "at most", 0.35))
    for axis, limit in (("horizon", 2), ("segments", 3)):
        if len(grown) and np.count_nonzero(grown["axis"] == axis) > 1:
            power = exponent(grown, axis)
            found.append((f"growth with the {axis}, exponent", power, "at most", limit))
    own = [row for row in rows if row.method in (COMPILED, INTERPRETED)]
    deviation = max(row.deviation for row in own)
    found.append(("deviation of the applied input, rad", deviation, "at most", 1e-5))
    excess = max(row.cost_excess for row in own)
    found.append(("relative difference of the cost", excess, "at most", 1e-8))
    worst = float(in_real_time.loc[in_real_time["steps"] == "3", "change_percent"].abs().max())
    found.append(("RMSE of three real-time steps, change in %", worst, "at most", 1.0))
    content = pd.DataFrame(found, columns=["bar", "measured", "sense", "limit"])
    sign = np.where(content["sense"] == "at least", 1, -1)
    met = sign * content["measured"] >= sign * content["limit"]
    content["verdict"] = np.where(met, "pass", "MISSED")
    return content


def main() -> int:
    """Measure, print and write; the exit status says whether every bar is met."""
    parser = argparse.ArgumentParser(description="What a control step costs.")
    parser.add_argument("--quick", action="store_true", help="a few steps of each, no peers")
    parser.add_argument("--without-peers", action="store_true", help="install nothing")
    parser.add_argument("--output", type=Path, default=BENCH / "results")
    given = parser.parse_args()
    plan, output = QUICK if given.quick else FULL, given.output.resolve()
    load = os.getloadavg()[0]

    parameters = bench_parameters()
    scenarios = [scenario_at(parameters, pose, plan.steps) for pose in POSES]
    recordings = [record(scenario) for scenario in scenarios]
    rows, versions = step_rows(scenarios[0], recordings, plan.peers and not given.without_peers)
    print(table(rows), flush=True)
    in_real_time = real_time_loops(parameters, plan.loop_steps)
    loops, grown = pd.DataFrame(), pd.DataFrame()
    if compiler() is not None:
        loops, grown = compiled_loops(parameters, plan.loop_steps), growth(parameters, plan)
    asked = bars(rows, in_real_time, loops, grown)
    tables = {
        "steps": pd.DataFrame([vars(row) for row in rows]),
        "real_time": in_real_time,
        "loops": loops,
        "growth": grown,
        "bars": asked,
    }
    remarks = {
        "real_time": f"the example case under the parameter set '{PARAMETER_SET}'; the book's own"
        f" errors of it are under '{DEFAULT_SET}'"
    }
    for stem in ("real_time", "loops", "growth", "bars"):
        remark = f": {remarks[stem]}" if stem in remarks else ""
        print(f"\n{stem}{remark}\n{tables[stem].to_string(index=False)}", flush=True)
    _write(output, tables, {**circumstances(load), "parameters": PARAMETER_SET, **versions})
    return int(not given.quick and (asked["verdict"] == "MISSED").any())


def _write(folder: Path, tables: dict[str, pd.DataFrame], where: dict[str, Any]) -> None:
    for stem, content in tables.items():
        if len(content):
            write_atomically(folder / f"{stem}.csv", table_text(content).encode())
    write_atomically(folder / "machine.json", (json.dumps(where, indent=1) + "\n").encode())


if __name__ == "__main__":
    on_one_core()
    sys.exit(main())
