"""The compiled engine: ``engine.c`` beside C code that is generated of the model.

It takes the steps of ``GaussNewton`` and of ``ExtrapolatedPlant`` without an interpreter.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm, Structure
from softwave_min.control.compiled.lanes import lane_code
from softwave_min.control.implicit_step import slopes_sum, step_sum
from softwave_min.control.predictor import (
    command_function,
    extrapolation_weights,
    period_cost_function,
)
from softwave_min.control.problem import Problem, Solution, Status, Weights
from softwave_min.native import build
from softwave_min.parameters import NmpcParameters, SimulationParameters

Floats = NDArray[np.float64]
_DOUBLES = ctypes.POINTER(ctypes.c_double)
_INTS = ctypes.POINTER(ctypes.c_int)
ABREAST, PLACES = 2, 4
"""Columns of an extrapolation, and places of the quadrature, that a step takes at once."""
WIDE = 8
"""Periods that are differentiated at once."""


class _Integrator(ctypes.Structure):
    _fields_ = (
        ("steps", ctypes.c_int),
        ("columns", ctypes.c_int),
        ("weights", _DOUBLES),
        ("gains", _DOUBLES),
    )


class _Engine(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int) for name in ("segments", "horizon", "flow_size")),
        *((name, ctypes.c_int) for name in ("max_iterations", "real_time")),
        *((name, ctypes.c_double) for name in ("angle_bound", "tolerance", "period")),
        *((name, _Integrator) for name in ("predictor", "plant")),
        *((name, _DOUBLES) for name in ("values", "weights", "work")),
    )


class _Task(ctypes.Structure):
    _fields_ = tuple(
        (name, _DOUBLES) for name in ("state", "previous", "reference", "flow", "disturbance")
    )


class _Outcome(ctypes.Structure):
    _fields_ = (
        ("cost", ctypes.c_double),
        ("last_step", ctypes.c_double),
        ("status", ctypes.c_int),
        ("iterations", ctypes.c_int),
    )


class Engine:
    """One arm under given gains, weights and steps.

    Parameters
    ----------
    arm : Arm
    gains, plant_gains : array, (4 n,)
        Packed ``InnerLoop`` as the controller believes it to be, and as it is.
    nmpc : NmpcParameters
    plant : SimulationParameters

    Raises
    ------
    CompilerError
        If nothing can compile.
    """

    def __init__(
        self,
        arm: Arm,
        gains: Floats,
        plant_gains: Floats,
        nmpc: NmpcParameters,
        plant: SimulationParameters,
    ) -> None:
        self._library = _library(arm.structure)
        self._segments = arm.segments
        # The arrays must live as long as the pointers to them.
        self._kept = [arm.values, Weights.packed(nmpc)]
        self._engine = _Engine(
            arm.segments,
            nmpc.horizon,
            arm.structure.flow_size,
            nmpc.max_iterations,
            int(nmpc.real_time),
            nmpc.angle_bound,
            nmpc.tolerance,
            nmpc.control_period,
            self._integrator(nmpc.substeps, nmpc.extrapolation_columns, gains),
            self._integrator(plant.extrapolated_steps, plant.extrapolation_columns, plant_gains),
            *(_pointer(array) for array in self._kept[:2]),
        )
        self._kept.append(np.zeros(self._library.engine_work(ctypes.byref(self._engine))))
        self._engine.work = _pointer(self._kept[-1])
        self._outcome = _Outcome()

    def _integrator(self, steps: int, columns: int, gains: Floats) -> _Integrator:
        arrays = [extrapolation_weights(columns), np.array(gains, dtype=float)]
        self._kept += arrays
        return _Integrator(steps, columns, *(_pointer(array) for array in arrays))

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Minimise the cost from the inputs ``guess``, (K, n) in rad."""
        inputs = np.array(guess, dtype=float, order="C")
        forecast, outcome = problem.forecast, self._outcome
        parts = (
            problem.state,
            problem.previous,
            problem.reference,
            forecast.flow,
            forecast.disturbance,
        )
        arrays = [np.ascontiguousarray(array, dtype=float) for array in parts]
        task = _Task(*(_pointer(array) for array in arrays))
        self._library.nmpc_solve(
            ctypes.byref(self._engine), ctypes.byref(task), _pointer(inputs), ctypes.byref(outcome)
        )
        status = Status(outcome.status)
        return Solution(inputs, outcome.cost, status, outcome.iterations, outcome.last_step)

    def advance(self, state: Floats, q_bar: Floats, flow: Floats) -> Floats:
        """State of the plant one period later, (2 n,)."""
        end = np.empty(2 * self._segments)
        arrays = [np.ascontiguousarray(array, dtype=float) for array in (state, q_bar, flow)]
        self._library.plant_advance(
            ctypes.byref(self._engine), *(_pointer(array) for array in arrays), _pointer(end)
        )
        return end

    def follow(self, initial: Floats, q_bar: Floats, flow: Floats) -> Floats:
        """States of the plant, (T + 1, 2 n), under the commands ``q_bar``, (T, n)."""
        states = np.zeros((len(q_bar) + 1, 2 * self._segments))
        states[0] = initial
        arrays = [np.ascontiguousarray(array, dtype=float) for array in (q_bar, flow)]
        self._library.plant_follow(
            ctypes.byref(self._engine),
            len(q_bar),
            *(_pointer(array) for array in (*arrays, states)),
        )
        return states

    def run(
        self,
        initial: Floats,
        targets: Floats,
        flow: Floats,
        forecast: Floats,
        disturbance: Floats,
    ) -> tuple[Floats, Floats, NDArray[np.intc], NDArray[np.intc]]:
        """A whole closed loop: states (T + 1, 2 n), commands (T, n), statuses, iterations.

        ``initial`` is the first state, at rest under its own angles as command;
        ``disturbance`` holds the load noise of every forecast, (T, K, n). The loop ends
        before a step whose plan is not finite, and the arrays with it.
        """
        steps, horizon, n = disturbance.shape
        states, q_bar = np.zeros((steps + 1, 2 * n)), np.zeros((steps, n))
        states[0] = initial
        plan = np.tile(initial[:n], (horizon, 1))
        statuses, iterations = np.zeros(steps, np.intc), np.zeros(steps, np.intc)
        inputs = [np.ascontiguousarray(one) for one in (targets, flow, forecast, disturbance)]
        done = self._library.closed_loop(
            ctypes.byref(self._engine),
            steps,
            *(_pointer(array) for array in (*inputs, plan, states, q_bar)),
            *(array.ctypes.data_as(_INTS) for array in (statuses, iterations)),
        )
        return states[: done + 1], q_bar[:done], statuses[:done], iterations[:done]


def _pointer(array: Floats) -> ctypes._Pointer[ctypes.c_double]:
    return array.ctypes.data_as(_DOUBLES)


@cache
def _library(structure: Structure) -> ctypes.CDLL:
    own = Path(__file__).with_name("engine.c").read_text(encoding="utf-8")
    numbers = {"gains", "values"}
    constant = numbers | {"command_torque", "flow", "disturbance"}
    slopes, step = slopes_sum(structure), step_sum(structure)
    cost = period_cost_function(structure)
    pattern = cost.sparsity_out("slopes")
    macros = {
        "ABREAST": ABREAST,
        "WIDE": WIDE,
        "RESIDUALS": pattern.size2(),
        "SLOPE_STARTS": str(pattern.colind())[1:-1],
        "SLOPE_OF": str(pattern.row())[1:-1],
    }
    defined = "".join(f"#define {name} {value}\n" for name, value in macros.items())
    sources = {
        "engine.c": defined + own,
        "step.c": lane_code(step, ABREAST, constant, PLACES),
        "slopes.c": lane_code(slopes, WIDE, numbers | {"time", "h"}),
        "command.c": lane_code(command_function(structure), WIDE, numbers),
        "cost.c": lane_code(cost, WIDE, numbers | {"weights"}),
    }
    return loaded(build("engine", sources))


def loaded(path: Path) -> ctypes.CDLL:
    """The library with the types of its functions."""
    library = ctypes.CDLL(str(path))
    library.engine_work.restype = ctypes.c_long
    for function in (library.nmpc_solve, library.plant_advance, library.plant_follow):
        function.restype = None
    return library
