"""Error and time of the plant's integrators over one minute of the baseline's loop.

Every method meets the same commands and the same sea, in the steepest of the paper's cases.
Its error is the largest distance of the tip from a reference, DOP853 at a relative tolerance
of 1e-11; CVODES at 1e-12 shows how good the reference is. Times stand beside their ratio to
that of the nominal plant. Methods of SciPy pay for Python in every evaluation, so their
evaluations are counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from softwave_min.data import data_folder
from softwave_min.parameters import ParameterSet, load_parameters
from softwave_min.simulation import Scenario, plant_of
from softwave_min.simulation.plant import rate_function
from softwave_min.waves import Sea

Floats = NDArray[np.float64]
Advance = Callable[[Floats, Floats, Floats], Floats]

P3 = (0.7, -3.7)
EXTRAPOLATIONS = ((1, 3), (1, 4), (1, 5), (2, 3), (2, 4), (4, 4), (2, 6), (8, 4))
"""Steps per period and columns."""
TOLERANCES = {
    "cvodes": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10),
    "runge_kutta": (1e-4, 1e-6, 1e-7, 1e-8),
    "LSODA": (1e-5, 1e-7, 1e-9),
    "Radau": (1e-4, 1e-6, 1e-8),
}


@dataclass(frozen=True)
class Measured:
    """One method at one accuracy over the whole run."""

    tips: Floats
    """(T + 1, 2), the tip at the control instants, in m."""
    seconds: float
    evaluations: int | None = None


def run(scenario: Scenario, advance: Advance) -> Measured:
    """Follow the planner's commands by one way to advance the state."""
    planned = scenario.planned_angles
    states = np.zeros((scenario.steps + 1, 2 * scenario.arm.segments))
    advance(states[0], planned[0], scenario.flow[0])  # what is made at the first call
    started = time.perf_counter()
    for step in range(scenario.steps):
        states[step + 1] = advance(states[step], planned[step], scenario.flow[step])
    seconds = time.perf_counter() - started
    return Measured(scenario.arm.tip(states[:, : scenario.arm.segments]), seconds)


def by_plant(scenario: Scenario, **numerics: Any) -> Measured:
    """One of the package's own plants."""
    parameters = scenario.parameters
    simulation = replace(parameters.simulation, largest_step=scenario.period, **numerics)
    chosen = replace(scenario, parameters=replace(parameters, simulation=simulation))
    return run(scenario, plant_of(chosen).advance)


def by_scipy(scenario: Scenario, method: Any, tolerance: float) -> Measured:
    """One of SciPy's methods."""
    rate, half = rate_function(scenario.arm.structure), scenario.period / 2
    fixed = scenario.gains, scenario.arm.values
    evaluations = 0

    def advance(state: Floats, q_bar: Floats, flow: Floats) -> Floats:
        nonlocal evaluations
        held = [ca.DM(part) for part in (q_bar, flow, *fixed)]

        def derivative(t: float, x: Floats) -> Floats:
            answer: Floats = rate(x, t, *held).full().ravel()
            return answer

        path = solve_ivp(
            derivative, (-half, half), state, method=method, rtol=tolerance, atol=tolerance / 100
        )
        evaluations += path.nfev
        end: Floats = path.y[:, -1]
        return end

    return replace(run(scenario, advance), evaluations=evaluations)


def study(scenario: Scenario) -> Iterator[tuple[str, Measured]]:
    """Every method at every accuracy, the reference first."""
    yield "DOP853 1e-11", by_scipy(scenario, "DOP853", 1e-11)
    tight = {"relative_tolerance": 1e-12, "absolute_tolerance": 1e-14}
    yield "cvodes 1e-12", by_plant(scenario, integrator="cvodes", **tight)
    for steps, columns in EXTRAPOLATIONS:
        numerics = {"extrapolated_steps": steps, "extrapolation_columns": columns}
        name = f"extrapolation {steps} x {columns}"
        yield name, by_plant(scenario, integrator="extrapolation", **numerics)
    for method, tolerances in TOLERANCES.items():
        for tolerance in tolerances:
            name = f"{method} {tolerance:.0e}"
            if method.islower():
                tight = {"relative_tolerance": tolerance, "absolute_tolerance": tolerance / 100}
                yield name, by_plant(scenario, integrator=method, **tight)
            else:
                yield name, by_scipy(scenario, method, tolerance)


def steepest(parameters: ParameterSet) -> Scenario:
    """Case W1 at H_s = 3 m and pose P3, where the water is fastest."""
    sea = replace(parameters.sea, significant_height=3.0, peak_period=6.1)
    parameters = replace(parameters, sea=sea)
    return Scenario.build(parameters, Sea.random(sea, parameters.fluid.gravity), P3)


def main() -> None:
    """Print the table."""
    parameters = load_parameters(data_folder() / "parameters" / "physical.toml")
    scenario, reference = steepest(parameters), None
    nominal = by_plant(scenario, integrator="extrapolation").seconds
    print(
        f"{'method':20} {'tip error, m':>12} {'time, s':>8} {'of nominal':>10} {'evaluations':>12}"
    )
    for name, measured in study(scenario):
        reference = measured.tips if reference is None else reference
        error = np.max(np.hypot(*(measured.tips - reference).T))
        count = "" if measured.evaluations is None else str(measured.evaluations)
        ratio = measured.seconds / nominal
        print(
            f"{name:20} {error:12.1e} {measured.seconds:8.2f} {ratio:10.1f} {count:>12}", flush=True
        )


if __name__ == "__main__":
    main()
