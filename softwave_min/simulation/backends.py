"""Which implementation runs: compiled where there is a compiler, interpreted elsewhere.

All of them give the same numbers. The references bring heavy libraries and are imported only
where a parameter set asks for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module

from softwave_min.control.compiled.engine import Engine
from softwave_min.control.nmpc import GaussNewton
from softwave_min.control.problem import Solver
from softwave_min.native import compiler
from softwave_min.parameters import ParameterSet
from softwave_min.simulation.plant import CvodesPlant, ExtrapolatedPlant, Plant, RungeKuttaPlant
from softwave_min.simulation.scenario import Scenario
from softwave_min.waves import Sea

REFERENCES: Mapping[str, str] = {
    "interior_point": "softwave_min.control.reference.interior_point",
    "convex": "softwave_min.control.reference.convex",
}
"""Modules of the reference solvers by ``nmpc.solver``; each names its class ``SOLVER``."""


def modules_of(parameters: ParameterSet) -> tuple[str, ...]:
    """Modules that a run under the parameters imports because of their values."""
    return tuple(REFERENCES[one] for one in (parameters.nmpc.solver,) if one in REFERENCES)


def engine_or_none(scenario: Scenario) -> Engine | None:
    """The compiled engine where there is a compiler."""
    if compiler() is None:
        return None
    gains, parameters = (scenario.believed_gains, scenario.gains), scenario.parameters
    return Engine(scenario.arm, *gains, parameters.nmpc, parameters.simulation)


def compile_engine(parameters: ParameterSet) -> None:
    """Compile what closed loops under the parameters need; nothing without a compiler."""
    still = Sea.still(parameters.sea.depth, parameters.fluid.gravity)
    brief = replace(parameters.simulation, duration=parameters.nmpc.control_period)
    target = parameters.arm.base_position
    engine_or_none(Scenario.build(replace(parameters, simulation=brief), still, target))


def solver_of(scenario: Scenario) -> Solver:
    """The solver that the scenario's parameters ask for, compiled where possible."""
    arguments = (scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)
    name = scenario.parameters.nmpc.solver
    if name in REFERENCES:
        solver: Solver = import_module(REFERENCES[name]).SOLVER(*arguments)
        return solver
    return engine_or_none(scenario) or GaussNewton(*arguments)


def plant_of(scenario: Scenario) -> Plant:
    """The plant with the integrator that the parameters ask for, compiled where possible."""
    parameters = scenario.parameters
    arguments = (scenario.arm, scenario.gains, parameters.simulation, scenario.period)
    match parameters.simulation.integrator:
        case "cvodes":
            return CvodesPlant(*arguments)
        case "runge_kutta":
            return RungeKuttaPlant(*arguments)
        case "extrapolation":
            return engine_or_none(scenario) or ExtrapolatedPlant(*arguments)
