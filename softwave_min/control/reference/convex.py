r"""Steps of both controllers as convex programs, posed in cvxpy.

Each program is written as on paper, compiled once, and then only given new numbers.
They are there to read and to compare with; the controllers' own steps are faster.
A program that is not solved ends in an ``UnsolvedError``: there is no step to take.
"""

from __future__ import annotations

import warnings
from functools import cache

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.control.baseline import KinematicPlanner
from softwave_min.control.nmpc import GaussNewton
from softwave_min.control.problem import Problem
from softwave_min.parameters import BaselineParameters

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


class UnsolvedError(RuntimeError):
    """A convex program has no answer to the accuracy asked for."""


def solve(program: cp.Problem) -> None:
    """Solve a program.

    Raises
    ------
    UnsolvedError
        If its status is any but optimal.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that it may be inaccurate: the error says so
            program.solve(**SETTINGS)
    except cp.SolverError as error:
        raise UnsolvedError(f"cvxpy: {error}") from error
    if program.status != cp.OPTIMAL:
        raise UnsolvedError(f"cvxpy: the program is {program.status}")


def sqp_step(problem: Problem, inputs: Floats, solver: GaussNewton) -> Floats:
    """The step that ``solver`` takes from ``inputs``, (K, n) in rad.

    With the residuals linearised at ``inputs``, the optimal control problem is a convex
    quadratic program: one iteration of sequential quadratic programming.
    """
    return _posed_step(inputs, *solver.residual(problem, inputs), solver.parameters.angle_bound)


class ConvexGaussNewton(GaussNewton):
    """``GaussNewton`` with every step posed and solved in cvxpy: slow, and to read."""

    def step(self, inputs: Floats, residual: Floats, jacobian: Floats) -> Floats:
        """Minimise the linearised sum of squares within the bounds, (K, n)."""
        bound = self.parameters.angle_bound
        step = _posed_step(inputs, residual, jacobian, bound)
        kept: Floats = np.clip(inputs + step, -bound, bound) - inputs
        return kept


def _posed_step(inputs: Floats, residual: Floats, jacobian: Floats, bound: float) -> Floats:
    step: Floats = _linearised(*jacobian.shape, bound).step(inputs.ravel(), residual, jacobian)
    return step.reshape(inputs.shape)


class _LinearisedProblem:
    r"""The optimal control problem with the residuals of ``control/problem.py`` linearised.

    .. math:: \min_\delta\ \|r + J_r\,\delta\|^2
       \quad\text{s.t.}\quad |\bar q + \delta| \le \bar q_{\max}

    (eq-nmpc-qp in notebooks/nmpc.ipynb).
    """

    def __init__(self, rows: int, columns: int, bound: float) -> None:
        self._change, self._inputs = cp.Variable(columns), cp.Parameter(columns)
        self._residual, self._jacobian = cp.Parameter(rows), cp.Parameter((rows, columns))
        cost = cp.sum_squares(self._residual + self._jacobian @ self._change)
        moved = self._inputs + self._change
        self._program = cp.Problem(cp.Minimize(cost), [-bound <= moved, moved <= bound])

    def step(self, inputs: Floats, residual: Floats, jacobian: Floats) -> Floats:
        """Change of the inputs that minimises the cost."""
        self._inputs.value, self._residual.value = inputs, residual
        self._jacobian.value = jacobian
        solve(self._program)
        change: Floats = self._change.value
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
        solve(self._problem)
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
