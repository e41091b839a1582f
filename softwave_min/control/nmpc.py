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

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import lsq_linear

from softwave_min.arm import Arm
from softwave_min.control.predictor import rollout_function
from softwave_min.control.preview import Forecast
from softwave_min.parameters import BaselineParameters, NmpcParameters

__all__ = ["Nmpc", "Rollout", "Solution", "Status"]

Floats = NDArray[np.float64]

SUFFICIENT_DECREASE = 1e-4
SHORTEST_STEP = 2.0**-12


class Status(IntEnum):
    """How a solve ended."""

    CONVERGED = 0
    """The last step was shorter than the tolerance."""
    ITERATION_LIMIT = 1
    """The iterations ran out; the inputs are the best found."""
    NO_DECREASE = 2
    """No step along the Gauss-Newton direction lowered the cost."""
    NOT_FINITE = 3
    """The prediction left the finite numbers from the very first guess."""


@dataclass(frozen=True)
class Rollout:
    """Predicted tips under a sequence of inputs, and their derivatives."""

    states: Floats
    """(K, 2 n), the state after each period."""
    tips: Floats
    """(K, 2), the tip after each period, in m."""
    sensitivity: Floats
    """(2 K, n K), derivative of the tips by the inputs, in m/rad."""


@dataclass(frozen=True)
class Solution:
    """Plan of one solve."""

    inputs: Floats
    """(K, n), commanded angles, in rad; the first is applied."""
    tips: Floats
    """(K, 2), predicted tips, in m."""
    cost: float
    """Value of the cost, x_0's constant term aside."""
    status: Status
    iterations: int
    """Gauss-Newton steps taken."""
    last_step: float
    """Largest change of an input in the last step, in rad."""


class Nmpc:
    """The optimal control problem and its solver.

    Parameters
    ----------
    arm : Arm
        Model that the predictor uses.
    baseline : BaselineParameters
        Gains of the inner feed-forward + PD loop.
    parameters : NmpcParameters
    """

    def __init__(self, arm: Arm, baseline: BaselineParameters, parameters: NmpcParameters) -> None:
        self.parameters = parameters
        self._segments = arm.segments
        self._values = arm.values
        self._gains = np.array([*baseline.proportional_gain, *baseline.derivative_gain])
        self._rollout = rollout_function(
            arm.structure, parameters.control_period, parameters.substeps, parameters.horizon
        )
        self._tip_scale = self._tip_scales()
        self._difference = self._difference_matrix()

    def solve(
        self,
        state: Floats,
        previous: Floats,
        reference: Floats,
        forecast: Forecast,
        guess: Floats,
    ) -> Solution:
        """Minimise the cost from ``guess``.

        Parameters
        ----------
        state : array, (2 n,)
            Present (q, qd).
        previous : array, (n,)
            Command in force until now, q_bar_{-1}.
        reference : array, (K, 2)
            Desired tip after each period, in m.
        forecast : Forecast
        guess : array, (K, n)
            First inputs, for instance the shifted former plan.
        """
        bound = self.parameters.angle_bound
        inputs = np.clip(guess, -bound, bound)
        rollout = self.predict(state, inputs, forecast)
        residual = self._residual(inputs, previous, reference, rollout)
        if not np.all(np.isfinite(residual)):
            return self._solution(inputs, rollout, residual, Status.NOT_FINITE, 0, np.inf)
        size = np.inf
        for iteration in range(1, self.parameters.max_iterations + 1):
            direction = self._gauss_newton_step(inputs, residual, rollout)
            slope = float(self._gradient(residual, rollout) @ direction.ravel())
            scale = 1.0
            while True:
                trial = inputs + scale * direction
                trial_rollout = self.predict(state, trial, forecast)
                trial_residual = self._residual(trial, previous, reference, trial_rollout)
                decrease = residual @ residual - trial_residual @ trial_residual
                if decrease >= -SUFFICIENT_DECREASE * scale * slope:
                    break
                # At the minimum rounding decides the sign: a step this short is the end.
                if scale * np.max(np.abs(direction)) < self.parameters.tolerance:
                    break
                scale /= 2
                if scale < SHORTEST_STEP:
                    return self._solution(
                        inputs, rollout, residual, Status.NO_DECREASE, iteration, size
                    )
            inputs, rollout, residual = trial, trial_rollout, trial_residual
            size = float(np.max(np.abs(scale * direction)))
            if size < self.parameters.tolerance:
                return self._solution(inputs, rollout, residual, Status.CONVERGED, iteration, size)
        return self._solution(inputs, rollout, residual, Status.ITERATION_LIMIT, iteration, size)

    def predict(self, state: Floats, inputs: Floats, forecast: Forecast) -> Rollout:
        """Roll the model out and differentiate the tips by the inputs."""
        n, horizon = self._segments, self.parameters.horizon
        answer = self._rollout.call(
            [
                state,
                inputs.T,
                forecast.flow.T,
                forecast.disturbance.T,
                np.tile(self._gains[:, None], horizon),
                np.tile(self._values[:, None], horizon),
            ]
        )
        states, by_state, by_input, tips, jacobians = (part.full() for part in answer)
        sensitivity = np.zeros((2 * horizon, n * horizon))
        motion = np.zeros((2 * n, n * horizon))
        for k in range(horizon):
            motion = by_state[:, 2 * n * k : 2 * n * (k + 1)] @ motion
            motion[:, n * k : n * (k + 1)] = by_input[:, n * k : n * (k + 1)]
            sensitivity[2 * k : 2 * k + 2] = jacobians[:, n * k : n * (k + 1)] @ motion[:n]
        return Rollout(states.T, tips.T, sensitivity)

    def _tip_scales(self) -> Floats:
        """Square roots of the weights of the tip residuals, (2 K,)."""
        weight = np.full(self.parameters.horizon, self.parameters.tip_weight)
        weight[-1] *= self.parameters.terminal_weight
        return np.repeat(np.sqrt(weight), 2)

    def _difference_matrix(self) -> Floats:
        """Weighted map from the stacked inputs to their changes, q_bar_{-1} aside."""
        size = self._segments * self.parameters.horizon
        difference: Floats = np.eye(size) - np.eye(size, k=-self._segments)
        return float(np.sqrt(self.parameters.step_weight)) * difference

    def _residual(
        self, inputs: Floats, previous: Floats, reference: Floats, rollout: Rollout
    ) -> Floats:
        changes = self._difference @ inputs.ravel()
        changes[: self._segments] -= np.sqrt(self.parameters.step_weight) * previous
        return np.concatenate([self._tip_scale * (rollout.tips - reference).ravel(), changes])

    def _jacobian(self, rollout: Rollout) -> Floats:
        return np.vstack([self._tip_scale[:, None] * rollout.sensitivity, self._difference])

    def _gradient(self, residual: Floats, rollout: Rollout) -> Floats:
        gradient: Floats = 2 * self._jacobian(rollout).T @ residual
        return gradient

    def _gauss_newton_step(self, inputs: Floats, residual: Floats, rollout: Rollout) -> Floats:
        """Minimise the linearised sum of squares within the bounds, (K, n)."""
        bound = self.parameters.angle_bound
        jacobian = self._jacobian(rollout)
        step = -cho_solve(cho_factor(jacobian.T @ jacobian), jacobian.T @ residual)
        flat = inputs.ravel()
        if np.any(np.abs(flat + step) > bound):
            limits = (-bound - flat, bound - flat)
            step = lsq_linear(jacobian, -residual, limits, method="bvls").x
            step = np.clip(step, *limits)
        shaped: Floats = step.reshape(inputs.shape)
        return shaped

    def _solution(
        self,
        inputs: Floats,
        rollout: Rollout,
        residual: Floats,
        status: Status,
        iterations: int,
        last_step: float,
    ) -> Solution:
        cost = float(residual @ residual)
        return Solution(inputs, rollout.tips, cost, status, iterations, last_step)
