"""Closed-loop runs: scenario, plant, controllers by name, and what comes of them."""

from softwave_min.simulation.backends import compile_engine, engine_or_none, plant_of, solver_of
from softwave_min.simulation.closed_loop import (
    ClosedLoop,
    SimulationError,
    root_mean_square_error,
    simulate,
)
from softwave_min.simulation.controllers import (
    CONTROLLERS,
    REFERENCE,
    BaselineController,
    Command,
    Controller,
    Factory,
    NmpcController,
    Source,
    preview_of,
)
from softwave_min.simulation.scenario import Scenario

__all__ = [
    "CONTROLLERS",
    "REFERENCE",
    "BaselineController",
    "ClosedLoop",
    "Command",
    "Controller",
    "Factory",
    "NmpcController",
    "Scenario",
    "SimulationError",
    "Source",
    "compile_engine",
    "engine_or_none",
    "plant_of",
    "preview_of",
    "root_mean_square_error",
    "simulate",
    "solver_of",
]
