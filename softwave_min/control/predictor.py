r"""One control period of the arm under its command, and what it costs, as CasADi functions.

A length H is gone in 1, in 2, ... in K steps of ``implicit_step``, and the ends T_1, ... T_K
are extrapolated to order K (Hairer & Wanner II, IV.9; eq-nmpc-extrapolation in
notebooks/nmpc.ipynb), which keeps their damping.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Structure, mechanics
from softwave_min.control.implicit_step import ImplicitStep, PeriodInputs
from softwave_min.control.problem import Period, Weights, residual_slopes_function
from softwave_min.control.summed import dense_function
from softwave_min.parameters import NmpcParameters


@dataclass(frozen=True)
class _Reached:
    """A state with its derivatives by the period's first state and by the command's torque."""

    x: ca.SX
    by_state: ca.SX
    by_torque: ca.SX

    @classmethod
    def start(cls, x: ca.SX) -> Self:
        """The period's first state."""
        segments = x.numel() // 2
        return cls(x, ca.SX.eye(2 * segments), ca.SX.zeros(2 * segments, segments))


@dataclass(frozen=True)
class PeriodSteps:
    """How a control period is integrated by the predictor."""

    period: float
    """In s."""
    substeps: int
    """Extrapolated steps that make a period."""
    columns: int
    """K, the order of the extrapolation."""

    @classmethod
    def of(cls, parameters: NmpcParameters) -> Self:
        """Those that the parameters ask for."""
        return cls(parameters.control_period, parameters.substeps, parameters.extrapolation_columns)


def extrapolation_weights(columns: int) -> NDArray[np.float64]:
    r"""Weights of the ends T_1, ... T_K in the extrapolation, (K,).

    .. math:: w_j = \prod_{i \ne j} \frac{j}{j - i}
    """
    steps = np.arange(1.0, columns + 1)
    others = steps[:, None] - steps + np.eye(columns)
    factors = np.where(np.eye(columns) > 0, 1.0, steps[:, None] / others)
    weights: NDArray[np.float64] = factors.prod(axis=1)
    return weights


@cache
def stage_function(structure: Structure, steps: PeriodSteps) -> ca.Function:
    """State, tip and their derivatives one control period later.

    Inputs: x = (q, qd); q_bar; flow of the period, expanded about its middle;
    disturbance, an additional generalised load; gains; values. Outputs: the next x;
    A = dx+/dx; B = dx+/dq_bar (eq-nmpc-sensitivity in notebooks/nmpc.ipynb); and those of
    ``_end_of_period``.
    """
    n = structure.segments
    x, q_bar = ca.SX.sym("x", 2 * n), ca.SX.sym("q_bar", n)
    symbols = PeriodInputs.symbolic(structure)
    torque, slope = _command(symbols, q_bar)
    given = replace(symbols, command_torque=torque)
    length = steps.period / steps.substeps
    after = _Reached.start(x)
    for index in range(steps.substeps):
        start = index * length - steps.period / 2
        after = _extrapolated(given, after, start, length, steps.columns)
    others = {name: one for name, one in symbols.inputs.items() if name != "command_torque"}
    outputs = {
        "next": after.x,
        "A": after.by_state,
        "B": after.by_torque @ slope,
        **_end_of_period(given, x, after.x, slope),
    }
    return dense_function("predictor_stage", {"x": x, "q_bar": q_bar, **others}, outputs)


@cache
def rollout_function(structure: Structure, steps: PeriodSteps, horizon: int) -> ca.Function:
    """``stage_function`` over a whole horizon in one call; columns are stages."""
    return stage_function(structure, steps).mapaccum("rollout", horizon)


@cache
def command_function(structure: Structure) -> ca.Function:
    """What a command adds to the torque of a period, and its derivative.

    Inputs: q_bar; gains; values.
    """
    given = PeriodInputs.symbolic(structure)
    q_bar = ca.SX.sym("q_bar", structure.segments)
    torque, slope = _command(given, q_bar)
    return dense_function(
        "command_torque",
        {"q_bar": q_bar, "gains": given.gains, "values": given.packed},
        {"torque": torque, "slope": slope},
    )


@cache
def period_cost_function(structure: Structure) -> ca.Function:
    """Residuals of one period (``problem.residuals``) with their derivatives.

    Inputs: x; the next x; the command's torque and its derivative by q_bar; those of
    ``problem.Period`` but tip and torque; weights; gains; values. Outputs: the residuals; their
    derivatives by (next q, x, q_bar, former q_bar), transposed and without what is always zero.
    """
    n = structure.segments
    given, period = PeriodInputs.symbolic(structure), Period.symbolic(n)
    x, after = ca.SX.sym("x", 2 * n), ca.SX.sym("next", 2 * n)
    slope, weights = ca.SX.sym("slope", n, n), ca.SX.sym("weights", Weights.size())
    end = _end_of_period(given, x, after, slope)
    rest = {name: one for name, one in vars(period).items() if name not in ("tip", "torque")}
    residual, by_tip, by_torque, by_command, by_former = residual_slopes_function(n)(
        end["tip"], end["torque"], *rest.values(), weights
    )
    slopes = [
        by_tip @ end["tip_jacobian"],
        by_torque @ end["torque_by_state"],
        by_command + by_torque @ end["torque_by_command"],
        by_former,
    ]
    inputs = {
        "x": x,
        "next": after,
        "command_torque": given.command_torque,
        "command_slope": slope,
        **rest,
        "weights": weights,
        "gains": given.gains,
        "values": given.packed,
    }
    outputs = ca.cse([residual, ca.sparsify(ca.horzcat(*slopes).T)])
    names = (list(inputs), ["residual", "slopes"])
    return ca.Function("period_cost", list(inputs.values()), outputs, *names)


def _command(given: PeriodInputs, q_bar: ca.SX) -> tuple[ca.SX, ca.SX]:
    arguments = (given.structure, given.values, q_bar)
    return given.loop.command_torque(*arguments), given.loop.command_slope(*arguments)


def _end_of_period(given: PeriodInputs, x: ca.SX, after: ca.SX, slope: ca.SX) -> dict[str, ca.SX]:
    """Tip of the next state and its Jacobian by q; the torque at the start of the period and
    its derivatives by x and by q_bar.
    """
    n = given.structure.segments
    end = mechanics(given.structure, after[:n], after[n:], given.values)
    return {
        "tip": end.tips[-1],
        "tip_jacobian": end.tip_jacobian,
        "torque": given.loop.torque_under(given.command_torque, x),
        "torque_by_state": given.loop.torque_by_state(),
        "torque_by_command": given.loop.torque_by_command(slope),
    }


def _extrapolated(
    given: PeriodInputs, first: _Reached, start: float, length: float, columns: int
) -> _Reached:
    ends = []
    for parts in range(1, columns + 1):
        h, end = length / parts, first
        for part in range(parts):
            end = _implicit_step(given, end, start + part * h, h)
        ends.append(end)
    weights = extrapolation_weights(columns)

    def combined(parts: Iterable[ca.SX]) -> ca.SX:
        weighted = (weight * part for weight, part in zip(weights, parts, strict=True))
        return sum(weighted, start=ca.SX(0))

    return _Reached(
        combined(end.x for end in ends),
        combined(end.by_state for end in ends),
        combined(end.by_torque for end in ends),
    )


def _implicit_step(given: PeriodInputs, first: _Reached, time: float, h: float) -> _Reached:
    """One linearly implicit step from ``time``, with derivatives by the chain rule."""
    n = given.structure.segments
    step = ImplicitStep(given, first.x, time + h, h)
    matrix_sum = step.matrix_sum()
    change = step.change(matrix_sum, step.residual_sum())
    by_state, by_torque = step.slopes(matrix_sum, step.residual_by_state_sum(change))
    rate = first.x[n:] + change
    rate_by_state = by_state @ first.by_state
    rate_by_torque = by_state @ first.by_torque + by_torque
    return _Reached(
        ca.vertcat(first.x[:n] + h * rate, rate),
        ca.vertcat(first.by_state[:n, :] + h * rate_by_state, rate_by_state),
        ca.vertcat(first.by_torque[:n, :] + h * rate_by_torque, rate_by_torque),
    )
