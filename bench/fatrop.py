"""The same optimal control problem for CasADi's fatrop, an interior-point method for OCPs.

Its unknowns are x_0, u_0, x_1, ... with the former command in the state, as it needs
them; its Hessian is either exact or that of Gauss and Newton.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.control.predictor import PeriodSteps
from softwave_min.control.problem import (
    Problem,
    Solution,
    Status,
    Weights,
    residual_function,
)
from softwave_min.control.reference.interior_point import transition_function
from softwave_min.parameters import NmpcParameters

__all__ = ["Fatrop"]

Floats = NDArray[np.float64]

FLAGS = ["-O1", "-march=native"]


class Fatrop:
    """Solver of the optimal control problem.

    Parameters
    ----------
    arm : Arm
    gains : array, (4 n,)
        Packed ``InnerLoop``.
    parameters : NmpcParameters
    gauss_newton : bool
        Whether to leave the second derivatives of model and tip out of the Hessian.
    compiler : sequence of str, optional
        Command that compiles the functions of the program; they are interpreted without.
    """

    def __init__(
        self,
        arm: Arm,
        gains: Floats,
        parameters: NmpcParameters,
        gauss_newton: bool,
        compiler: Sequence[str] = (),
    ) -> None:
        self._n, self._horizon = arm.segments, parameters.horizon
        self._transition = transition_function(arm.structure, PeriodSteps.of(parameters))
        self._fixed = (gains, arm.values)
        self._rollout = self._transition.mapaccum(parameters.horizon)
        program, residual, equality = self._program(arm.structure, parameters)
        self._limits = np.where(equality, 0.0, parameters.angle_bound)
        options: dict[str, Any] = {
            "structure_detection": "auto",
            "equality": [bool(one) for one in equality],
            "print_time": False,
            "fatrop.print_level": 0,
            "fatrop.tol": 1e-8,
            "expand": not (gauss_newton or compiler),
        }
        if gauss_newton:
            options["cache"] = {"nlp_hess_l": _gauss_newton_hessian(program, residual)}
        if compiler:
            options |= {"jit": True, "compiler": "shell"}
            options["jit_options"] = {"compiler": " ".join(compiler), "flags": FLAGS}
        self._solver = ca.nlpsol("fatrop", "fatrop", program, options)

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Minimise the cost from the inputs ``guess``, (K, n) in rad, and their motion."""
        n, forecast = self._n, problem.forecast
        forecasts = (forecast.flow, forecast.disturbance)
        repeated = [np.tile(one[:, None], self._horizon) for one in self._fixed]
        columns = (part.T for part in (guess, *forecasts))
        states = self._rollout(problem.state, *columns, *repeated)[0].full().T
        states = np.hstack(
            [np.vstack([problem.state, states]), np.vstack([problem.previous, guess])]
        )
        unknown = np.hstack([states[:-1], guess]).ravel()
        given = (problem.state, problem.previous, problem.reference, *forecasts)
        answer = self._solver(
            x0=np.concatenate([unknown, states[-1]]),
            p=np.concatenate([part.ravel() for part in given]),
            lbg=-self._limits,
            ubg=self._limits,
        )
        stats = self._solver.stats()
        found = answer["x"].full().ravel()[: -3 * n].reshape(self._horizon, 4 * n)
        status = Status.CONVERGED if stats["success"] else Status.NO_DECREASE
        cost = float(answer["f"])
        return Solution(found[:, 3 * n :], cost, status, stats["iter_count"], np.nan)

    def _program(
        self, structure: Structure, parameters: NmpcParameters
    ) -> tuple[dict[str, ca.MX], ca.MX, list[bool]]:
        """The nonlinear program, the residuals of its cost, and what is an equality."""
        n, horizon = self._n, self._horizon
        first, reference = ca.MX.sym("first", 3 * n), ca.MX.sym("reference", 2, horizon)
        flow = ca.MX.sym("flow", structure.flow_size, horizon)
        disturbance = ca.MX.sym("disturbance", n, horizon)
        gains, values = (ca.DM(one) for one in self._fixed)
        tip, residual = _tip_function(structure), residual_function(n)
        weights = ca.DM(Weights.packed(parameters))
        states = [ca.MX.sym(f"x_{k}", 3 * n) for k in range(horizon + 1)]
        unknown, constraints, residuals, equality = [states[0]], [], [], []
        for k in range(horizon):
            q_bar = ca.MX.sym(f"q_bar_{k}", n)
            reached, _, torque = self._transition(
                states[k][: 2 * n], q_bar, flow[:, k], disturbance[:, k], gains, values
            )
            constraints.append(states[k + 1] - ca.vertcat(reached, q_bar))
            equality += 3 * n * [True]
            if k == 0:
                constraints.append(states[0] - first)
                equality += 3 * n * [True]
            constraints.append(q_bar)
            equality += n * [False]
            unknown += [q_bar, states[k + 1]]
            stated = residual(
                tip=tip(states[k + 1][:n], values),
                torque=torque,
                command=q_bar,
                former=states[k][2 * n :],
                reference=reference[:, k],
                last=k + 1 == horizon,
                weights=weights,
            )
            residuals.append(stated["residual"])
        stacked = ca.vertcat(*residuals)
        program = {
            "x": ca.vertcat(*unknown),
            "p": ca.veccat(first, reference, flow, disturbance),
            "f": ca.sumsqr(stacked),
            "g": ca.vertcat(*constraints),
        }
        return program, stacked, equality


def _tip_function(structure: Structure) -> ca.Function:
    n = structure.segments
    q, packed = ca.SX.sym("q", n), ca.SX.sym("values", Values.size(n))
    arm = mechanics(structure, q, ca.SX.zeros(n), Values.unpacked(packed, n))
    return ca.Function("tip", [q, packed], ca.cse([arm.tips[-1]]))


def _gauss_newton_hessian(program: dict[str, ca.MX], residual: ca.MX) -> ca.Function:
    """In the place of CasADi's own second derivative of the Lagrangian."""
    x = program["x"]
    cost, gaps = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", program["g"].shape[0])
    slope = ca.jacobian(residual, x)
    gradient = ca.gradient(cost * program["f"] + ca.dot(gaps, program["g"]), x)
    return ca.Function(
        "nlp_hess_l",
        [x, program["p"], cost, gaps],
        [gradient, 2 * cost * slope.T @ slope],
        ["x", "p", "lam_f", "lam_g"],
        ["grad_gamma_x", "hess_gamma_x_x"],
    )
