r"""The arm itself, integrated over one control period at a time.

Three integrators: linearly implicit Euler steps with extrapolation, the default, whose
error is measured against a tight reference in the tests; CVODES of SUNDIALS; and the
paper's fifth-order Runge-Kutta method with variable step.
"""

from __future__ import annotations

from functools import cache
from typing import Protocol

import casadi as ca
import numpy as np
import scipy  # whose parts are loaded when they are used
from numpy.typing import NDArray

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.control.baseline import InnerLoop
from softwave_min.control.implicit_step import step_function
from softwave_min.control.predictor import command_function, extrapolation_weights
from softwave_min.parameters import SimulationParameters

Floats = NDArray[np.float64]


class Plant(Protocol):
    """Anything that moves the state on by a control period.

    Those below are made of the arm, the packed ``InnerLoop``, the parameters and the
    control period in s.
    """

    def advance(self, state: Floats, q_bar: Floats, flow: Floats) -> Floats:
        """State (q, qd) one period later, (2 n,); NaN where it cannot be integrated.

        ``q_bar`` is the command held over the period, (n,) in rad; ``flow`` the packed
        flow, expanded about the middle of the period, (F,).
        """


@cache
def rate_function(structure: Structure) -> ca.Function:
    """Rate of the state (q, qd) under the inner loop.

    Inputs: x; time from the middle of the period; q_bar; flow; gains; values.
    """
    n = structure.segments
    x, time = ca.SX.sym("x", 2 * n), ca.SX.sym("time")
    q_bar, flow = ca.SX.sym("q_bar", n), ca.SX.sym("flow", structure.flow_size)
    gains, packed = ca.SX.sym("gains", InnerLoop.size(n)), ca.SX.sym("values", Values.size(n))
    values = Values.unpacked(packed, n)
    terms = mechanics(structure, x[:n], x[n:], values)
    loop = InnerLoop.unpacked(gains, n)
    force = loop.torque(structure, values, q_bar, x) + terms.fluid_load(flow, time)
    rate = ca.vertcat(x[n:], terms.acceleration(force, loop.locked))
    inputs = [x, time, q_bar, flow, gains, packed]
    return ca.Function("rate", inputs, ca.cse([rate]))


class CvodesPlant:
    """SUNDIALS' variable-order BDF."""

    def __init__(
        self, arm: Arm, gains: Floats, parameters: SimulationParameters, period: float
    ) -> None:
        self._fixed = np.concatenate([gains, arm.values])
        self._integrator = _cvodes(arm.structure, parameters, period)

    def advance(self, state: Floats, q_bar: Floats, flow: Floats) -> Floats:
        """State one period later; see ``Plant``."""
        held = np.concatenate([q_bar, flow, self._fixed])
        try:
            end: Floats = self._integrator(x0=state, p=held)["xf"].full().ravel()
        except RuntimeError:  # CasADi's, for any failure of CVODES
            return np.full_like(state, np.nan)
        return end


@cache
def _cvodes(structure: Structure, parameters: SimulationParameters, period: float) -> ca.Function:
    n = structure.segments
    x, time = ca.SX.sym("x", 2 * n), ca.SX.sym("time")
    sizes = [n, structure.flow_size, InnerLoop.size(n), Values.size(n)]
    held = [ca.SX.sym("held", size) for size in sizes]
    rate = rate_function(structure)(x, time, *held)
    problem = {"x": x, "t": time, "p": ca.vertcat(*held), "ode": rate}
    options = {
        "reltol": parameters.relative_tolerance,
        "abstol": parameters.absolute_tolerance,
        "max_step_size": parameters.largest_step,
        "max_num_steps": 100_000,
        "show_eval_warnings": False,
    }
    return ca.integrator("plant", "cvodes", problem, -period / 2, period / 2, options)


class RungeKuttaPlant:
    """Dormand and Prince's fifth-order method with variable step."""

    def __init__(
        self, arm: Arm, gains: Floats, parameters: SimulationParameters, period: float
    ) -> None:
        self._rate = rate_function(arm.structure)
        self._gains, self._values = gains, arm.values
        self._parameters = parameters
        self._half = period / 2

    def advance(self, state: Floats, q_bar: Floats, flow: Floats) -> Floats:
        """State one period later; see ``Plant``."""

        def rate(time: float, x: Floats) -> Floats:
            answer: Floats = self._rate(x, time, q_bar, flow, self._gains, self._values).full()
            return answer.ravel()

        run = scipy.integrate.solve_ivp(
            rate,
            (-self._half, self._half),
            state,
            method="RK45",
            rtol=self._parameters.relative_tolerance,
            atol=self._parameters.absolute_tolerance,
            max_step=self._parameters.largest_step,
            # SciPy's own choice of it never ends where the rate is not finite.
            first_step=min(self._parameters.largest_step, self._half),
        )
        end: Floats = run.y[:, -1] if run.success else np.full_like(state, np.nan)
        return end


class ExtrapolatedPlant:
    """Linearly implicit Euler steps with the harmonic sequence, extrapolated.

    A step of length H is taken in 1, 2, ... K parts, and the ends are extrapolated to order
    K (Hairer & Wanner II, IV.9). ``Engine.advance`` does the same without an interpreter.
    """

    def __init__(
        self, arm: Arm, gains: Floats, parameters: SimulationParameters, period: float
    ) -> None:
        self._step = step_function(arm.structure)
        self._command = command_function(arm.structure)
        self._constants = (gains, arm.values)
        self._count = parameters.extrapolated_steps
        self._weights = extrapolation_weights(parameters.extrapolation_columns)
        self._period = period

    def advance(self, state: Floats, q_bar: Floats, flow: Floats) -> Floats:
        """State one period later; see ``Plant``."""
        torque, _ = self._command(q_bar, *self._constants)
        held = (torque, flow, np.zeros(len(q_bar)), *self._constants)
        length = self._period / self._count
        for index in range(self._count):
            start = index * length - self._period / 2
            state = self._extrapolated(state, held, start, length)
        return state

    def _extrapolated(
        self, state: Floats, held: tuple[ca.DM | Floats, ...], start: float, length: float
    ) -> Floats:
        total, n = np.zeros_like(state), len(state) // 2
        for parts, weight in enumerate(self._weights, start=1):
            h, q, rate = length / parts, state[:n], state[n:]
            for part in range(1, parts + 1):
                x = np.concatenate([q, rate])
                rate = rate + self._step(x, start + part * h, h, *held).full().ravel()
                q = q + h * rate
            total += weight * np.concatenate([q, rate])
        return total
