r"""The paper's nonlinear MPC.

.. math:: \min_{\bar q_0 \dots \bar q_{K-1}} \sum_{k=0}^{K-1}
   (x_k - x_{r,k})^T Q (x_k - x_{r,k}) + \Delta\bar q_k^T R\, \Delta\bar q_k
   \quad\text{s.t.}\quad |\bar q_k| \le \bar q_{\max}

(paper, eq. 13) over the predicted motion of the arm under the forecast flow. The
states are eliminated (single shooting): the inputs alone are unknown, and the
cost is a sum of squares, which a Gauss-Newton method with bounds minimises.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

import casadi as ca
import numpy as np
import scipy  # whose parts are loaded when they are used
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.control.predictor import PeriodSteps, rollout_function
from softwave_min.control.preview import Forecast
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


class Status(IntEnum):
    """How a solve ended."""

    CONVERGED = 0
    """The last step, or by their contraction all that would follow it, was shorter than
    the tolerance."""
    ITERATION_LIMIT = 1
    """The iterations ran out; the inputs are the best found."""
    NO_DECREASE = 2
    """No step along the Gauss-Newton direction lowered the cost."""
    NOT_FINITE = 3
    """The prediction left the finite numbers from the very first guess."""


@dataclass(frozen=True)
class Problem:
    """One instance of the optimal control problem."""

    state: Floats
    """(2 n,), present (q, qd)."""
    previous: Floats
    """(n,), command in force until now, q_bar_{-1}, in rad."""
    reference: Floats
    """(K, 2), desired tip after each period, in m."""
    forecast: Forecast
    """Flow and load noise of the coming periods."""


class Solver(Protocol):
    """What solves the optimal control problem."""

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Minimise the cost from the inputs ``guess``, (K, n) in rad."""


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


@dataclass(frozen=True)
class Solution:
    """Plan of one solve."""

    inputs: Floats
    """(K, n), commanded angles, in rad; the first is applied."""
    cost: float
    """Value of the cost, x_0's constant term aside."""
    status: Status
    iterations: int
    """Gauss-Newton steps taken."""
    last_step: float
    """Largest change of an input in the last step, in rad."""


def scales(parameters: NmpcParameters) -> tuple[float, float, float]:
    """Square roots of the weights: of a tip error, of the last one, of an input's change."""
    tip = float(np.sqrt(parameters.tip_weight))
    last = tip * float(np.sqrt(parameters.terminal_weight))
    return tip, last, float(np.sqrt(parameters.step_weight))


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

    ``Engine`` takes the same steps without an interpreter.

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
        each, last, _ = scales(parameters)
        self._tip_scale = np.repeat([each] * (parameters.horizon - 1) + [last], 2)
        self._difference = self._difference_matrix()

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Minimise the cost from the inputs ``guess``, (K, n) in rad."""
        settings = self.parameters
        inputs = np.clip(guess, -settings.angle_bound, settings.angle_bound)
        residual, jacobian = self.residual(problem, inputs)
        cost = float(residual @ residual)
        if not np.isfinite(cost):
            return Solution(inputs, cost, Status.NOT_FINITE, 0, np.inf)
        size = contraction = np.inf
        for iteration in range(1, settings.max_iterations + 1):
            direction = self.step(inputs, residual, jacobian)
            slope = 2 * float(residual @ jacobian @ direction.ravel())
            former, size = size, float(np.max(np.abs(direction)))
            if iteration > 1:
                contraction = size / former
            short = size < settings.tolerance or self._foretold(size, contraction)
            if short or (settings.real_time and iteration == settings.max_iterations):
                # The model of the cost is exact to third order in so short a step.
                status = Status.CONVERGED if short else Status.ITERATION_LIMIT
                return Solution(inputs + direction, cost + slope / 2, status, iteration, size)
            scale = 1.0
            while True:
                trial = inputs + scale * direction
                residual, jacobian = self.residual(problem, trial)
                found = float(residual @ residual)
                if found <= (1 + ROUNDING) * cost + SUFFICIENT_DECREASE * scale * slope:
                    break
                scale /= 2
                if scale < SHORTEST_STEP:
                    return Solution(inputs, cost, Status.NO_DECREASE, iteration, size)
            inputs, cost, size = trial, found, scale * size
        return Solution(inputs, cost, Status.ITERATION_LIMIT, settings.max_iterations, size)

    def _foretold(self, size: float, contraction: float) -> bool:
        """Whether all steps after this one are short together: a geometric series, since
        Gauss-Newton converges linearly.
        """
        tolerance, rest = self.parameters.tolerance, size * contraction
        near = contraction < STEADY and size < NEARLY * tolerance
        return near and rest < (1 - contraction) * tolerance

    def residual(self, problem: Problem, inputs: Floats) -> tuple[Floats, Floats]:
        """Weighted residuals, whose sum of squares is the cost, and their Jacobian."""
        rollout = self.predict(problem.state, inputs, problem.forecast)
        changes = self._difference @ inputs.ravel()
        changes[: self._segments] -= np.sqrt(self.parameters.step_weight) * problem.previous
        errors = self._tip_scale * (rollout.tips - problem.reference).ravel()
        parts = [errors, changes]
        slopes = [self._tip_scale[:, None] * rollout.sensitivity, self._difference]
        bound = self.parameters.torque_bound
        if bound > 0:
            scale = np.sqrt(self.parameters.torque_weight)
            torques = rollout.torques.ravel()
            parts.append(scale * (torques - np.clip(torques, -bound, bound)))
            exceeds = scale * (np.abs(torques) > bound)
            slopes.append(exceeds[:, None] * rollout.torque_sensitivity)
        return np.concatenate(parts), np.vstack(slopes)

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

    def _difference_matrix(self) -> Floats:
        """Weighted map from the stacked inputs to their changes, q_bar_{-1} aside."""
        size = self._segments * self.parameters.horizon
        difference: Floats = np.eye(size) - np.eye(size, k=-self._segments)
        return float(np.sqrt(self.parameters.step_weight)) * difference
