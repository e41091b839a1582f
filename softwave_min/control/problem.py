r"""The optimal control problem, stated once.

.. math:: \min_{\bar q_0 \dots \bar q_{K-1}} \sum_{k=0}^{K-1} \|r_k\|^2
   \quad\text{s.t.}\quad |\bar q_k| \le \bar q_{\max}

over the predicted motion of the arm under the forecast flow (paper, eq. 13). ``residuals``
states r_k, the weighted residuals of one control period. Every solver takes its cost from
there, so that a term added to them is a term of every solver.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cache
from typing import Protocol, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.control.preview import Forecast
from softwave_min.control.summed import dense_function
from softwave_min.parameters import NmpcParameters

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Period:
    """What the cost of one control period may depend on, as symbols."""

    tip: ca.SX
    """(2,), tip at the end of the period, in m."""
    torque: ca.SX
    """(n,), actuation torque at its start, in N m."""
    command: ca.SX
    """(n,), commanded angles over the period, q_bar_k, in rad."""
    former: ca.SX
    """(n,), those of the period before, q_bar_{k-1}, in rad."""
    reference: ca.SX
    """(2,), desired tip at the end, in m."""
    last: ca.SX
    """1 in the last period of the horizon, else 0."""

    @classmethod
    def symbolic(cls, segments: int) -> Self:
        """Symbols for everything."""
        sizes = (2, segments, segments, segments, 2, 1)
        names = (field.name for field in fields(cls))
        return cls(*(ca.SX.sym(*pair) for pair in zip(names, sizes, strict=True)))


@dataclass(frozen=True)
class Weights:
    """Symbols of the settings of the cost; each has the name of its ``NmpcParameters``."""

    tip_weight: ca.SX
    terminal_weight: ca.SX
    step_weight: ca.SX
    torque_bound: ca.SX
    torque_weight: ca.SX

    @classmethod
    def size(cls) -> int:
        """Length of the packed vector."""
        return len(fields(cls))

    @classmethod
    def unpacked(cls, vector: ca.SX) -> Self:
        """Take the packed vector apart."""
        return cls(*ca.vertsplit(vector))

    @classmethod
    def packed(cls, parameters: NmpcParameters) -> Floats:
        """Vector of the numbers, in the order of the fields."""
        return np.array([float(getattr(parameters, field.name)) for field in fields(cls)])


def residuals(period: Period, weights: Weights) -> dict[str, ca.SX]:
    """Weighted residuals of one period by name: the cost is the sum of their squares.

    The paper's sum ends before the last predicted tip, which ``terminal_weight`` adds; a
    ``torque_bound`` of 0 is none.
    """
    bound = weights.torque_bound
    beyond = period.torque - bound * ca.sign(period.torque)
    terms = {
        "tip_error": (
            weights.tip_weight * ca.if_else(period.last, weights.terminal_weight, 1),
            period.tip - period.reference,
        ),
        "change_of_command": (weights.step_weight, period.command - period.former),
        "torque_beyond_bound": (
            ca.if_else(bound > 0, weights.torque_weight, 0),
            ca.if_else(ca.fabs(period.torque) > bound, beyond, 0),
        ),
    }
    return {name: _root(weight) * error for name, (weight, error) in terms.items()}


def _root(weight: ca.SX) -> ca.SX:
    """Square root of a weight. That of 0 must not be differentiated, not even by a solver that
    multiplies the derivative by 0.
    """
    positive = weight > 0
    return ca.if_else(positive, ca.sqrt(ca.if_else(positive, weight, 1)), 0)


@cache
def residual_function(segments: int) -> ca.Function:
    """Residuals of one period, stacked.

    Inputs: those of ``Period``; packed ``Weights``.
    """
    inputs, _, residual = _stacked(segments)
    return dense_function("residual", inputs, {"residual": residual})


@cache
def residual_slopes_function(segments: int) -> ca.Function:
    """``residual_function`` with its derivatives by tip, torque, command and former command."""
    inputs, period, residual = _stacked(segments)
    outputs = {"residual": residual}
    for name in ("tip", "torque", "command", "former"):
        outputs[f"by_{name}"] = ca.jacobian(residual, getattr(period, name))
    return dense_function("residual_slopes", inputs, outputs)


def _stacked(segments: int) -> tuple[dict[str, ca.SX], Period, ca.SX]:
    period, packed = Period.symbolic(segments), ca.SX.sym("weights", Weights.size())
    residual = ca.vertcat(*residuals(period, Weights.unpacked(packed)).values())
    return {**vars(period), "weights": packed}, period, residual


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


class Solver(Protocol):
    """What solves the optimal control problem."""

    def solve(self, problem: Problem, guess: Floats) -> Solution:
        """Minimise the cost from the inputs ``guess``, (K, n) in rad."""
