r"""The paper's nonlinear MPC: a Gauss-Newton method with bounds, in NumPy.

The states are eliminated (single shooting): the inputs alone are unknown. The cost is the sum
of squares of the residuals that ``control/problem.py`` states. In every iteration they are
linearised about the inputs, r + J d, and the step d minimises the squares of that within the
bounds (eq-nmpc-residual to eq-nmpc-qp in notebooks/nmpc.ipynb).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy  # whose parts are loaded when they are used
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.control.predictor import PeriodSteps, rollout_function
from softwave_min.control.preview import Forecast
from softwave_min.control.problem import (
    Problem,
    Solution,
    Status,
    Weights,
    residual_slopes_function,
)
from softwave_min.parameters import NmpcParameters

Floats = NDArray[np.float64]

SUFFICIENT_DECREASE = 1e-4
SHORTEST_STEP = 2.0**-12
ROUNDING = 1e-13
"""Relative error of a computed cost, which must not count as an increase."""
STEADY = 0.3
"""Contraction of the steps below which the next ones may be foretold ..."""
NEARLY = 100
"""... once a step is shorter than so many tolerances."""


@dataclass(frozen=True)
class Rollout:
    """Predicted tips under a sequence of inputs, and their derivatives."""

    states: Floats
    """(K, 2 n), the state after each period."""
    tips: Floats
    """(K, 2), the tip after each period, in m."""
    sensitivity: Floats
    """(2 K, n K), derivative of the tips by the inputs, in m/rad."""
    torques: Floats
    """(K, n), actuation torque at the start of each period, in N m."""
    torque_sensitivity: Floats
    """(n K, n K), derivative of the torques by the inputs, in N m/rad."""


class _Buffered:
    """A CasADi function that reads and writes arrays in place: to convert them would cost
    a tenth of a solve.
    """

    def __init__(self, function: ca.Function) -> None:
        buffer: Any
        buffer, self._evaluate = function.buffer()
        self._buffer = buffer
        # CasADi stores by columns, so that each array here holds the transpose.
        self.arguments = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self._results = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        for i, array in enumerate(self.arguments):
            buffer.set_arg(i, array.reshape(-1).data)
        for i, array in enumerate(self._results):
            buffer.set_res(i, array.reshape(-1).data)

    def __call__(self, *columns: Floats) -> list[Floats]:
        """Results for these first arguments, one column after the other; overwritten by the
        next call.
        """
        for array, given in zip(self.arguments, columns, strict=False):
            array[:] = np.reshape(given, array.shape)  # which refuses to fill up a horizon
        self._evaluate()
        return [array.T for array in self._results]


class GaussNewton:
    """Gauss-Newton SQP with bounds and line search, in NumPy: the readable statement.

    Real-time iteration takes ``max_iterations`` full steps, converged or not, without a line
    search. ``Engine`` takes the same steps without an interpreter.

    Parameters
    ----------
    arm : Arm
        Model that the predictor uses.
    gains : array, (4 n,)
        Packed ``InnerLoop``: the loop that the commands go to, as the model has it.
    parameters : NmpcParameters
    """

    def __init__(self, arm: Arm, gains: Floats, parameters: NmpcParameters) -> None:
        self.parameters = parameters
        self._segments = arm.segments
        self._values = arm.values
        self._gains = gains
        steps = PeriodSteps.of(parameters)
        self._rollout = _Buffered(rollout_function(arm.structure, steps, parameters.horizon))
        self._rollout.arguments[4][:], self._rollout.arguments[5][:] = gains, arm.values
        slopes = residual_slopes_function(arm.segments).map(parameters.horizon)
        self._residual_slopes = _Buffered(slopes)
        last, weights = self._residual_slopes.arguments[5:]
        last[-1], weights[:] = 1, Weights.packed(parameters)

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Minimise the cost from the inputs ``guess``, (K, n) in rad."""
        settings = self.parameters
        inputs = np.clip(guess, -settings.angle_bound, settings.angle_bound)
        residual, jacobian = self.residual(problem, inputs)
        cost = float(residual @ residual)
        if not np.isfinite(cost):
            return Solution(inputs, cost, Status.NOT_FINITE, 0, np.inf)
        size = np.inf
        for iteration in range(1, settings.max_iterations + 1):
            direction = self.step(inputs, residual, jacobian)
            slope = 2 * float(residual @ jacobian @ direction.ravel())
            former, size = size, float(np.max(np.abs(direction)))
            contraction = size / former if 0 < former < np.inf else np.inf
            short = size < settings.tolerance or self._foretold(size, contraction)
            if (iteration == settings.max_iterations) if settings.real_time else short:
                # The model of the cost is exact to third order in so short a step.
                status = Status.CONVERGED if short else Status.ITERATION_LIMIT
                return Solution(inputs + direction, cost + slope / 2, status, iteration, size)
            scale = 1.0
            while True:
                trial = inputs + scale * direction
                residual, jacobian = self.residual(problem, trial)
                found = float(residual @ residual)
                if self._accepted(found, cost, scale * slope):
                    break
                scale /= 2
                if scale < (1 if settings.real_time else SHORTEST_STEP):
                    return Solution(inputs, cost, Status.NO_DECREASE, iteration, size)
            inputs, cost, size = trial, found, scale * size
        return Solution(inputs, cost, Status.ITERATION_LIMIT, settings.max_iterations, size)

    def _accepted(self, found: float, cost: float, slope: float) -> bool:
        """Whether a step may be taken: in real time any whose prediction is finite."""
        if self.parameters.real_time:
            return bool(np.isfinite(found))
        return found <= (1 + ROUNDING) * cost + SUFFICIENT_DECREASE * slope

    def _foretold(self, size: float, contraction: float) -> bool:
        """Whether all steps after this one are short together: a geometric series, since
        Gauss-Newton converges linearly.
        """
        tolerance, rest = self.parameters.tolerance, size * contraction
        near = contraction < STEADY and size < NEARLY * tolerance
        return near and rest < (1 - contraction) * tolerance

    def residual(self, problem: Problem, inputs: Floats) -> tuple[Floats, Floats]:
        """Weighted residuals, whose sum of squares is the cost, and their Jacobian."""
        n, horizon = self._segments, self.parameters.horizon
        rollout = self.predict(problem.state, inputs, problem.forecast)
        former = np.vstack([problem.previous, inputs[:-1]])
        residual, *slopes = self._residual_slopes(
            rollout.tips, rollout.torques, inputs, former, problem.reference
        )
        # (K, rows, columns): the residuals of a period by what they depend on.
        by_tip, by_torque, by_command, by_former = (
            one.reshape(len(residual), horizon, -1).swapaxes(0, 1) for one in slopes
        )
        jacobian = by_tip @ rollout.sensitivity.reshape(horizon, 2, -1)
        jacobian += by_torque @ rollout.torque_sensitivity.reshape(horizon, n, -1)
        of_inputs, k = jacobian.reshape(horizon, -1, horizon, n), np.arange(horizon)
        of_inputs[k, :, k] += by_command
        of_inputs[k[1:], :, k[:-1]] += by_former[1:]
        return residual.flatten(order="F"), jacobian.reshape(residual.size, -1)

    def step(self, inputs: Floats, residual: Floats, jacobian: Floats) -> Floats:
        """Minimise the linearised sum of squares within the bounds, (K, n)."""
        bound = self.parameters.angle_bound
        factor = scipy.linalg.cho_factor(jacobian.T @ jacobian)
        step = -scipy.linalg.cho_solve(factor, jacobian.T @ residual)
        flat = inputs.ravel()
        if np.any(np.abs(flat + step) > bound):
            limits = (-bound - flat, bound - flat)
            nearest = scipy.optimize.lsq_linear(jacobian, -residual, limits, method="bvls").x
            step = np.clip(nearest, *limits)
        shaped: Floats = step.reshape(inputs.shape)
        return shaped

    def predict(self, state: Floats, inputs: Floats, forecast: Forecast) -> Rollout:
        """Roll the model out and differentiate the tips by the inputs."""
        n, horizon = self._segments, self.parameters.horizon
        given = (state, inputs, forecast.flow, forecast.disturbance)
        states, by_state, by_input, tips, jacobians, torques, torque_by_state, torque_by_input = (
            self._rollout(*given)
        )
        sensitivity = np.zeros((2 * horizon, n * horizon))
        torque_sensitivity = np.zeros((n * horizon, n * horizon))
        motion = np.zeros((2 * n, n * horizon))
        for k in range(horizon):
            states_at, inputs_at = slice(2 * n * k, 2 * n * (k + 1)), slice(n * k, n * (k + 1))
            torque_sensitivity[inputs_at] = torque_by_state[:, states_at] @ motion
            torque_sensitivity[inputs_at, inputs_at] = torque_by_input[:, inputs_at]
            motion = by_state[:, states_at] @ motion
            motion[:, inputs_at] = by_input[:, inputs_at]
            sensitivity[2 * k : 2 * k + 2] = jacobians[:, inputs_at] @ motion[:n]
        return Rollout(
            states.T.copy(), tips.T.copy(), sensitivity, torques.T.copy(), torque_sensitivity
        )
