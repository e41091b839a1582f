"""What a control step costs, here and with other programs; what ``make bench`` runs.

    python bench/run.py [--quick] [--without-peers] [--output FOLDER]

The problems are those that a closed loop meets at P1 and P3 in sea W3 with a significant
height of 3 m. Every method runs on one core. The time is the processor's, so that other work
on the machine counts less. Written are
bench.csv (every method), growth.csv (time over horizon and segments), rti.csv (the closed
loop under real-time iteration), and bench.json: machine, versions, ratios.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from fatrop import Fatrop
from recording import CASE, HEIGHT, POSES, Recording, bench_parameters, record, scenario_at
from step_time import (
    COMPILED,
    INTERPRETED,
    REAL_TIME_STEPS,
    Method,
    Row,
    compiled_loop,
    engine_of,
    measure,
    own_methods,
    row_of,
    table,
)

from softwave_min.control.interior_point import InteriorPoint
from softwave_min.control.nmpc import Status
from softwave_min.experiments import example_case
from softwave_min.identity import ROOT
from softwave_min.native import compiler
from softwave_min.parameters import ParameterSet
from softwave_min.simulation import (
    NmpcController,
    Scenario,
    root_mean_square_error,
    simulate,
)
from softwave_min.store import machine, repository_state, table_text, write_atomically

BENCH = Path(__file__).resolve().parent
PEERS = ROOT / ".build" / "bench-venv"
IPOPT_TOLERANCE = 1e-8
"""IPOPT's own default."""
NOTEBOOK, DO_MPC = "IPOPT, as in a notebook", "do-mpc, default collocation"


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


def interior_point_methods(scenario: Scenario) -> Iterator[Method]:
    """IPOPT in two forms, fatrop in two."""
    problem = (scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)
    for name, expand in ((NOTEBOOK, False), ("IPOPT, written out", True)):
        yield Method(name, InteriorPoint(*problem, IPOPT_TOLERANCE, expand))
    yield Method("fatrop, exact Hessian, written out", Fatrop(*problem, gauss_newton=False))
    command = compiler()
    if command is not None:
        solver = Fatrop(*problem, gauss_newton=True, compiler=command)
        yield Method("fatrop, Gauss-Newton Hessian, compiled", solver)


def do_mpc_rows(recordings: Sequence[Recording], steps: int) -> tuple[list[Row], str]:
    """do-mpc's rows, measured in its own environment, and its version."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{pose}.npz" for pose in POSES]
        for path, recording in zip(paths, recordings, strict=True):
            recording.save(path)
        output = Path(folder) / "measured.npz"
        command = [peers_python(), "-W", "ignore", BENCH / "peers.py", *paths]
        arguments = ["--steps", str(steps), "--output", output]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        subprocess.run([*command, *arguments], check=True, cwd=folder, env=environment)
        measured = dict(np.load(output))
    expected = np.concatenate([recording.applied for recording in recordings])
    names = {"collocation": DO_MPC, "discrete": "do-mpc, the same discrete model"}
    rows = [
        row_of(
            name,
            measured[f"{key}.seconds"],
            measured[f"{key}.iterations"],
            int(measured[f"{key}.failed"].sum()),
            float(np.max(np.abs(measured[f"{key}.applied"] - expected))),
        )
        for key, name in names.items()
    ]
    return rows, str(measured["version"])


def peers_python() -> Path:
    """Interpreter of the peers' environment, which is made from bench.lock where it is not."""
    lock = BENCH / "bench.lock"
    stamp = PEERS / f"locked-{hashlib.sha256(lock.read_bytes()).hexdigest()[:16]}"
    python = PEERS / "bin" / "python"
    if not stamp.is_file():
        install = ["install", "--quiet", "--require-hashes", "-r", lock]
        uv = shutil.which("uv")
        if uv:
            make = [uv, "venv", "--quiet", "--clear", "--python", sys.executable, PEERS]
            fill = [uv, "pip", *install, "--python", python]
        else:
            make = [sys.executable, "-m", "venv", "--clear", PEERS]
            fill = [python, "-m", "pip", *install]
        for command in (make, fill):
            subprocess.run(command, check=True)
        stamp.touch()
    return python


def growth(parameters: ParameterSet, plan: Plan) -> pd.DataFrame:
    """Time of the compiled solver over the horizon and over the number of segments."""
    cases: list[tuple[str, int, ParameterSet]] = []
    for horizon in plan.horizons:
        nmpc = replace(parameters.nmpc, horizon=horizon)
        cases.append(("horizon", horizon, replace(parameters, nmpc=nmpc)))
    cases += [("segments", n, in_segments(parameters, n)) for n in plan.segments]
    rows = []
    for axis, value, changed in cases:
        scenario = scenario_at(changed, "P3", plan.growth_steps)
        recording = record(scenario)
        row = measure(Method(axis, engine_of(scenario)), [recording])
        short = engine_of(scenario, real_time=True, max_iterations=1)
        asked = (Status.CONVERGED, Status.ITERATION_LIMIT)
        one_step = measure(Method(axis, short, asked), [recording])
        rows.append(
            {
                "axis": axis,
                "value": value,
                "median_ms": row.median_ms,
                "percentile_95_ms": row.percentile_95_ms,
                "one_iteration_ms": one_step.median_ms,
                "iterations_median": row.iterations_median,
                "iterations_largest": row.iterations_largest,
                "failures": row.failures,
            }
        )
    return pd.DataFrame(rows)


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


def exponents(grown: pd.DataFrame) -> dict[str, float]:
    """Power of the value with which the time grows, fitted to the larger half of the values."""
    found = {}
    for axis, rows in grown.groupby("axis"):
        upper = rows[rows["value"] >= rows["value"].median()]
        if len(upper) < 2:
            continue
        for column in ("median_ms", "one_iteration_ms"):
            slope = np.polyfit(np.log(upper["value"]), np.log(upper[column]), 1)[0]
            found[f"{axis}, {column}"] = round(float(slope), 2)
    return found


def real_time_loops(parameters: ParameterSet, steps: int) -> pd.DataFrame:
    """Closed-loop RMSE of the example case, converged and after one, two and three steps."""
    duration = steps * parameters.nmpc.control_period
    parameters = replace(parameters, simulation=replace(parameters.simulation, duration=duration))
    rows = []
    for run in example_case.runs(parameters):
        if run.parameters.controller != "nmpc":
            continue
        converged = None
        for count in (None, *REAL_TIME_STEPS):
            scenario = example_case.scenario_of(run.parameters)
            p = scenario.parameters
            if count is not None:
                nmpc = replace(p.nmpc, real_time=True, max_iterations=count)
                scenario = replace(scenario, parameters=replace(p, nmpc=nmpc))
            loop = simulate(scenario, NmpcController(scenario))
            error = root_mean_square_error(loop.error)
            settled = root_mean_square_error(loop.error[len(loop.error) // 6 :])
            converged = converged or error
            rows.append(
                {
                    "run": run.name,
                    "steps": "converged" if count is None else str(count),
                    "rmse": error,
                    "rmse_settled": settled,
                    "change_percent": 100 * (error / converged - 1),
                    "fallbacks": int(np.count_nonzero(loop.source)),
                }
            )
    return pd.DataFrame(rows)


def ratios(rows: Iterable[Row]) -> dict[str, float]:
    """What the issue of speed comes down to."""
    median = {row.method: row.median_ms for row in rows}
    found = {}
    for own in (COMPILED, INTERPRETED):
        for peer in (DO_MPC, NOTEBOOK):
            if own in median and peer in median:
                found[f"{peer} / {own}"] = round(median[peer] / median[own], 1)
    return found


def processor() -> str:
    """Name of the processor, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if "model name" in line), "")


def compiler_version() -> str | None:
    """First line of what the compiler says of itself."""
    command = compiler()
    if command is None:
        return None
    answer = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
    return answer.stdout.splitlines()[0]


def peer_rows(
    scenario: Scenario, recordings: Sequence[Recording], steps: int
) -> tuple[list[Row], str]:
    """IPOPT, fatrop and do-mpc, and do-mpc's version."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        # CasADi's just-in-time compiler leaves files where it runs.
        rows = [measure(method, recordings) for method in interior_point_methods(scenario)]
    others, version = do_mpc_rows(recordings, steps)
    return rows + others, version


def circumstances(plan: Plan, load: float) -> dict[str, Any]:
    """Where and on what it was measured; ``load`` is the load average at the start."""
    return {
        "machine": {**machine(), "processor": processor(), "compiler": compiler_version()},
        "repository": repository_state(),
        "load_average": [round(load, 2), round(os.getloadavg()[0], 2)],
        "problems": {"case": CASE, "height": HEIGHT, "poses": POSES, "steps": plan.steps},
    }


def main() -> None:
    """Measure, print and write."""
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
    rows = [measure(method, recordings) for method in own_methods(scenarios[0])]
    if compiler() is not None:
        rows.append(compiled_loop(parameters, plan.loop_steps))
    print(table(rows), flush=True)
    summary: dict[str, Any] = {}
    if plan.peers and not given.without_peers:
        others, summary["do_mpc"] = peer_rows(scenarios[0], recordings, plan.steps)
        rows += others
        print(table(others), flush=True)
        summary["ratios"] = ratios(rows)
    _write(output, "bench", pd.DataFrame([vars(row) for row in rows]))
    in_real_time = real_time_loops(parameters, plan.loop_steps)
    print("\n" + in_real_time.to_string(index=False), flush=True)
    _write(output, "rti", in_real_time)
    if compiler() is not None:
        grown = growth(parameters, plan)
        print("\n" + grown.to_string(index=False), flush=True)
        _write(output, "growth", grown)
        summary["exponents"] = exponents(grown)
    text = json.dumps({**circumstances(plan, load), **summary}, indent=1, sort_keys=True)
    print("\n" + text)
    write_atomically(output / "bench.json", (text + "\n").encode())


def _write(folder: Path, stem: str, content: pd.DataFrame) -> None:
    write_atomically(folder / f"{stem}.csv", table_text(content).encode())


if __name__ == "__main__":
    one_thread = {"OMP_NUM_THREADS": "1"}
    if os.environ.items() >= one_thread.items():
        main()
    else:
        again = [sys.executable, *sys.argv]
        sys.exit(subprocess.run(again, env=os.environ | one_thread, check=False).returncode)
