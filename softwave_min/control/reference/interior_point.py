r"""The optimal control problem by multiple shooting and IPOPT: the reference.

The states stay unknown, and the prediction becomes a constraint,

.. math:: \min_{\bar q_0 \dots \bar q_{K-1},\ x_1 \dots x_K} J
   \quad\text{s.t.}\quad x_{k+1} = f(x_k, \bar q_k), \quad |\bar q_k| \le \bar q_{\max},

with the cost J of ``control/problem.py``. Exact second derivatives and an interior-point
method: nothing is shared with the Gauss-Newton method but the predictor's own outputs.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm, Structure, Values
from softwave_min.control.baseline import InnerLoop
from softwave_min.control.predictor import PeriodSteps, stage_function
from softwave_min.control.problem import (
    Problem,
    Solution,
    Status,
    Weights,
    residual_function,
)
from softwave_min.parameters import NmpcParameters

Floats = NDArray[np.float64]

MAX_ITERATIONS = 500
STATUS = {
    "Solve_Succeeded": Status.CONVERGED,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Invalid_Number_Detected": Status.NOT_FINITE,
}
"""What IPOPT's answers mean; all others say that it found no way on."""


class InteriorPoint:
    """Solver of the optimal control problem to a tight tolerance.

    Of ``parameters``, it reads what states the problem; the settings of the
    Gauss-Newton method mean nothing to it.

    Parameters
    ----------
    arm : Arm
        Model that the predictor uses.
    gains : array, (4 n,)
        Packed ``InnerLoop``: the loop that the commands go to, as the model has it.
    parameters : NmpcParameters
    tolerance : float
        IPOPT's, on the scaled conditions of optimality.
    expand : bool
        Whether all periods are written out as one expression, which takes ten times
        longer to build and less time to solve.
    """

    def __init__(
        self,
        arm: Arm,
        gains: Floats,
        parameters: NmpcParameters,
        tolerance: float = 1e-10,
        expand: bool = False,
    ) -> None:
        model = (arm.structure, PeriodSteps.of(parameters))
        self._solver = _ipopt(*model, parameters.horizon, tolerance, expand)
        self._rollout = transition_function(*model).mapaccum("rollout", parameters.horizon)
        self._fixed = (gains, arm.values, Weights.packed(parameters))
        self._bound = parameters.angle_bound
        self._shape = (parameters.horizon, 3 * arm.segments)

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Minimise the cost from the inputs ``guess``, (K, n) in rad, and their motion."""
        inputs = np.clip(guess, -self._bound, self._bound)
        limit = np.full(self._shape, np.inf)
        limit[:, : inputs.shape[1]] = self._bound
        answer = self._solver(
            x0=np.hstack([inputs, self._states(problem, inputs)]).ravel(),
            p=np.concatenate([part.ravel() for part in self._given(problem)]),
            lbx=-limit.ravel(),
            ubx=limit.ravel(),
            lbg=0,
            ubg=0,
        )
        report = self._solver.stats()
        # Over the states as well; there is no history where the first evaluation failed.
        steps = report.get("iterations", {}).get("d_norm", [np.inf])
        status = STATUS.get(report["return_status"], Status.NO_DECREASE)
        found = answer["x"].full().reshape(self._shape)[:, : inputs.shape[1]]
        return Solution(
            np.clip(found, -self._bound, self._bound),
            np.nan if status is Status.NOT_FINITE else float(answer["f"]),
            status,
            report["iter_count"],
            steps[-1],
        )

    def _states(self, problem: Problem, inputs: Floats) -> Floats:
        """States after every period under ``inputs``, (K, 2 n)."""
        forecast = problem.forecast
        columns = (inputs.T, forecast.flow.T, forecast.disturbance.T)
        repeated = (np.tile(one[:, None], len(inputs)) for one in self._fixed[:2])
        states: Floats = self._rollout(problem.state, *columns, *repeated)[0].full().T
        return states

    def _given(self, problem: Problem) -> list[Floats]:
        """Numbers of one instance, in the order of ``_multiple_shooting``."""
        instance = [problem.state, problem.previous, problem.reference]
        return [*instance, problem.forecast.flow, problem.forecast.disturbance, *self._fixed]


@cache
def transition_function(structure: Structure, steps: PeriodSteps) -> ca.Function:
    """Next state, its tip and the torque of one period: ``stage_function`` without derivatives.

    Automatic differentiation of this one is exact to any order.
    """
    stage = stage_function(structure, steps)
    inputs = stage.sx_in()
    after = dict(zip(stage.name_out(), stage(*inputs), strict=True))
    outputs = ["next", "tip", "torque"]
    expressions = ca.cse([after[name] for name in outputs])
    return ca.Function("transition", inputs, expressions, stage.name_in(), outputs)


@cache
def _ipopt(
    structure: Structure,
    steps: PeriodSteps,
    horizon: int,
    tolerance: float,
    expand: bool,
) -> ca.Function:
    transition = transition_function(structure, steps)
    options: dict[str, Any] = {
        "expand": expand,
        "print_time": False,
        "show_eval_warnings": False,
        "calc_lam_p": False,
        "ipopt.sb": "yes",
        "ipopt.print_level": 0,
        "ipopt.tol": tolerance,
        "ipopt.acceptable_iter": 0,
        "ipopt.max_iter": MAX_ITERATIONS,
        "ipopt.bound_relax_factor": 0.0,
    }
    problem = _multiple_shooting(transition, structure.segments, horizon)
    return ca.nlpsol("interior_point", "ipopt", problem, options)


def _multiple_shooting(transition: ca.Function, n: int, horizon: int) -> Any:
    """The nonlinear program; its unknowns are (q_bar_k, x_{k+1}), period by period."""
    state, previous = ca.MX.sym("state", 2 * n), ca.MX.sym("previous", n)
    reference = ca.MX.sym("reference", 2, horizon)
    flow = ca.MX.sym("flow", transition.size1_in("flow"), horizon)
    disturbance = ca.MX.sym("disturbance", n, horizon)
    gains, values = ca.MX.sym("gains", InnerLoop.size(n)), ca.MX.sym("values", Values.size(n))
    weights, residual = ca.MX.sym("weights", Weights.size()), residual_function(n)
    unknown: list[ca.MX] = []
    gaps: list[ca.MX] = []
    cost = ca.MX(0)
    x, before = state, previous
    for k in range(horizon):
        q_bar, after = ca.MX.sym(f"q_bar_{k}", n), ca.MX.sym(f"x_{k + 1}", 2 * n)
        reached, tip, torque = transition(x, q_bar, flow[:, k], disturbance[:, k], gains, values)
        stated = residual(
            tip=tip,
            torque=torque,
            command=q_bar,
            former=before,
            reference=reference[:, k],
            last=k + 1 == horizon,
            weights=weights,
        )
        cost += ca.sumsqr(stated["residual"])
        gaps.append(reached - after)
        unknown += [q_bar, after]
        x, before = after, q_bar
    given = ca.veccat(state, previous, reference, flow, disturbance, gains, values, weights)
    return {"x": ca.vertcat(*unknown), "p": given, "f": cost, "g": ca.vertcat(*gaps)}


SOLVER = InteriorPoint
