r"""Steps of both controllers as convex programs, posed in cvxpy.

Each program is written as on paper, compiled once, and then only given new numbers.
They are there to read and to compare with; the controllers' own steps are faster.
"""

from __future__ import annotations

from functools import cache

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.control.baseline import KinematicPlanner
from softwave_min.control.nmpc import GaussNewton
from softwave_min.control.problem import Problem, Solution
from softwave_min.parameters import BaselineParameters, NmpcParameters

Floats = NDArray[np.float64]

SETTINGS = {
    "solver": cp.OSQP,
    "warm_start": False,
    "polishing": True,
    "eps_abs": 1e-10,
    "eps_rel": 1e-10,
    "max_iter": 100_000,
}
"""Polishing solves for the bounds found active: digits enough to compare number by number.
Without a warm start, an answer depends on the numbers asked alone."""


def sqp_step(problem: Problem, inputs: Floats, solver: GaussNewton) -> Floats:
    """The step that ``solver`` takes from ``inputs``, (K, n) in rad.

    With the prediction linearised at ``inputs``, the optimal control problem is a convex
    quadratic program: one iteration of sequential quadratic programming.
    """
    return _linearised(solver.parameters, inputs.shape[1]).step(problem, inputs, solver)


class ConvexGaussNewton(GaussNewton):
    """``GaussNewton`` with every step posed and solved in cvxpy: slow, and to read."""

    _posed: Problem

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Minimise the cost from the inputs ``guess``, (K, n) in rad."""
        self._posed = problem
        return super().solve(problem, guess)

    def step(self, inputs: Floats, residual: Floats, jacobian: Floats) -> Floats:  # noqa: ARG002
        """Minimise the linearised sum of squares within the bounds, (K, n)."""
        step = sqp_step(self._posed, inputs, self)
        bound = self.parameters.angle_bound
        kept: Floats = np.clip(inputs + step, -bound, bound) - inputs
        return kept


class _LinearisedProblem:
    r"""The optimal control problem of ``control/nmpc.py`` with a linear prediction.

    .. math:: \min_{\bar q_0 \dots \bar q_{K-1}} \sum_{k=0}^{K-1}
       Q_k \|\hat x_k + S_k (\bar q - \hat{\bar q}) - x_{r,k}\|^2
       + R\, \|\bar q_k - \bar q_{k-1}\|^2 \quad\text{s.t.}\quad |\bar q_k| \le \bar q_{\max}

    with the tips :math:`\hat x` predicted under :math:`\hat{\bar q}` and their
    derivative S; and likewise the torques that exceed a soft bound.
    """

    def __init__(self, parameters: NmpcParameters, segments: int) -> None:
        horizon, size = parameters.horizon, parameters.horizon * segments
        self._bound = parameters.torque_bound
        self._inputs = cp.Variable((horizon, segments))
        self._previous = cp.Parameter((1, segments))
        # What the linear prediction is for inputs of zero, less what is desired.
        self._offset, self._slope = cp.Parameter(2 * horizon), cp.Parameter((2 * horizon, size))
        self._excess, self._excess_slope = cp.Parameter(size), cp.Parameter((size, size))

        inputs = cp.vec(self._inputs, order="C")
        errors = self._offset + self._slope @ inputs
        steps = cp.diff(cp.vstack([self._previous, self._inputs]), axis=0)
        cost = parameters.tip_weight * (
            cp.sum_squares(errors[:-2]) + parameters.terminal_weight * cp.sum_squares(errors[-2:])
        ) + parameters.step_weight * cp.sum_squares(steps)
        if parameters.torque_bound > 0:
            excess = self._excess + self._excess_slope @ inputs
            cost += parameters.torque_weight * cp.sum_squares(excess)
        limit = parameters.angle_bound
        bounds = [-limit <= self._inputs, self._inputs <= limit]
        self._problem = cp.Problem(cp.Minimize(cost), bounds)

    def step(self, problem: Problem, inputs: Floats, solver: GaussNewton) -> Floats:
        """Change of the inputs that minimises the cost."""
        flat = inputs.ravel()
        rollout = solver.predict(problem.state, inputs, problem.forecast)
        error = (rollout.tips - problem.reference).ravel()
        self._previous.value = problem.previous[None]
        self._offset.value = error - rollout.sensitivity @ flat
        self._slope.value = rollout.sensitivity
        if self._bound > 0:
            torques = rollout.torques.ravel()
            excess = torques - np.clip(torques, -self._bound, self._bound)
            slope = (excess != 0)[:, None] * rollout.torque_sensitivity
            self._excess.value, self._excess_slope.value = excess - slope @ flat, slope
        self._problem.solve(**SETTINGS)
        change: Floats = self._inputs.value - inputs
        return change


_linearised = cache(_LinearisedProblem)


class ConvexPlanner(KinematicPlanner):
    r"""The kinematic planner's step as a convex program, which can keep bounds.

    .. math:: \min_{\Delta\bar q}\
       \|J \Delta\bar q - K_e (\bar x - h(\bar q)) \Delta t\|^2
       + \lambda^2 \|\Delta\bar q\|^2
       \quad\text{s.t.}\quad |\bar q + \Delta\bar q| \le \bar q_{\max}

    Where no bound is active, it is the step of ``KinematicPlanner``.

    Parameters
    ----------
    arm : Arm
    parameters : BaselineParameters
        With some damping: without it the redundant arm's step is not unique.
    period : float
        Time between two steps, in s.
    angle_bound : float
        Bound on every commanded angle, in rad.

    Raises
    ------
    ValueError
        If the damping is zero.
    """

    def __init__(
        self, arm: Arm, parameters: BaselineParameters, period: float, angle_bound: float
    ) -> None:
        super().__init__(arm, parameters, period)
        if parameters.damping == 0:
            raise ValueError("the planner's convex program needs damping > 0")
        self._bound = angle_bound
        self._change = cp.Variable(arm.segments)
        self._jacobian = cp.Parameter((2, arm.segments))
        self._displacement = cp.Parameter(2)
        self._angles = cp.Parameter(arm.segments)
        miss = cp.sum_squares(self._jacobian @ self._change - self._displacement)
        cost = miss + parameters.damping**2 * cp.sum_squares(self._change)
        moved = self._angles + self._change
        bounds = [-angle_bound <= moved, moved <= angle_bound]
        self._problem = cp.Problem(cp.Minimize(cost), bounds)

    def step(self, q_bar: Floats, target: Floats) -> Floats:
        """Commanded angles one period later, (n,) in rad."""
        velocity = self._parameters.task_gain * (target - self._arm.tip(q_bar))
        self._jacobian.value = self._arm.tip_jacobian(q_bar)
        self._displacement.value = self._period * velocity
        self._angles.value = q_bar
        self._problem.solve(**SETTINGS)
        moved: Floats = np.clip(q_bar + self._change.value, -self._bound, self._bound)
        return moved

    def path(self, q: Floats, targets: Floats) -> Floats:
        """Commanded angles of a whole run, (T, n)."""
        q_bar = self.first_posture(q, targets[0])
        commanded = []
        for target in targets:
            q_bar = self.step(q_bar, target)
            commanded.append(q_bar)
        return np.array(commanded)


SOLVER = ConvexGaussNewton
