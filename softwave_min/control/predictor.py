r"""One control period of the arm under a held command, as a CasADi function.

A length H is gone in 1, in 2, ... in K steps of ``implicit_step``, and the ends T_1, ... T_K
are extrapolated to order K (Hairer & Wanner II, IV.9), which keeps their damping.
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
from softwave_min.arm.dynamics import solve_symmetric
from softwave_min.control.implicit_step import Held, ImplicitStep
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
    A = dx+/dx; B = dx+/dq_bar; and those of ``period_function``.
    """
    n = structure.segments
    x, q_bar = ca.SX.sym("x", 2 * n), ca.SX.sym("q_bar", n)
    given = Held.symbolic(structure)
    torque, slope = _command(given, q_bar)
    held = replace(given, command_torque=torque)
    length = steps.period / steps.substeps
    after = _Reached.start(x)
    for index in range(steps.substeps):
        start = index * length - steps.period / 2
        after = _extrapolated(held, after, start, length, steps.columns)
    others = {name: one for name, one in given.inputs.items() if name != "command_torque"}
    outputs = {
        "next": after.x,
        "A": after.by_state,
        "B": after.by_torque @ slope,
        **_period_outputs(held, x, after.x, slope),
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
    held = Held.symbolic(structure)
    q_bar = ca.SX.sym("q_bar", structure.segments)
    torque, slope = _command(held, q_bar)
    return dense_function(
        "command_torque",
        {"q_bar": q_bar, "gains": held.gains, "values": held.packed},
        {"torque": torque, "slope": slope},
    )


@cache
def period_function(structure: Structure) -> ca.Function:
    """What else the cost of a period needs.

    Inputs: x; the next x; the command's torque and its derivative by q_bar; gains; values.
    Outputs: tip of the next state; its Jacobian by q; torque at the start of the period; its
    derivatives by x and by q_bar.
    """
    n = structure.segments
    held = Held.symbolic(structure)
    x, after = ca.SX.sym("x", 2 * n), ca.SX.sym("next", 2 * n)
    slope = ca.SX.sym("slope", n, n)
    inputs = {
        "command_torque": held.command_torque,
        "command_slope": slope,
        "gains": held.gains,
        "values": held.packed,
    }
    return dense_function(
        "period_end",
        {"x": x, "next": after, **inputs},
        _period_outputs(held, x, after, slope),
    )


def _command(held: Held, q_bar: ca.SX) -> tuple[ca.SX, ca.SX]:
    arguments = (held.structure, held.values, q_bar)
    return held.loop.command_torque(*arguments), held.loop.command_slope(*arguments)


def _period_outputs(held: Held, x: ca.SX, after: ca.SX, slope: ca.SX) -> dict[str, ca.SX]:
    n = held.structure.segments
    end = mechanics(held.structure, after[:n], after[n:], held.values)
    return {
        "tip": end.tips[-1],
        "tip_jacobian": end.tip_jacobian,
        "torque": held.loop.torque_under(held.command_torque, x),
        "torque_by_state": held.loop.torque_by_state(),
        "torque_by_command": held.loop.torque_by_command(slope),
    }


def _extrapolated(
    held: Held, first: _Reached, start: float, length: float, columns: int
) -> _Reached:
    ends = []
    for parts in range(1, columns + 1):
        h, end = length / parts, first
        for part in range(parts):
            end = _implicit_step(held, end, start + part * h, h)
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


def _implicit_step(held: Held, first: _Reached, time: float, h: float) -> _Reached:
    """One linearly implicit step from ``time``, with derivatives.

    The step solves W d = r for the change d of the rates. Its derivative is
    -W^-1 d(W d - r): the vector is differentiated at fixed d, and never the
    solution of the linear system.
    """
    n = held.structure.segments
    step = ImplicitStep(held, first.x, time + h, h)
    matrix = step.matrix(step.matrix_sum())
    still = ca.SX.zeros(n)
    change = -solve_symmetric(matrix, step.residual(step.residual_sum(still), still))
    by_x = step.residual_by_state(step.residual_by_state_sum(change))
    rates = -solve_symmetric(
        matrix,
        ca.horzcat(by_x @ first.by_state, by_x @ first.by_torque + step.residual_by_torque()),
    )
    rates_by_state = first.by_state[n:, :] + rates[:, : 2 * n]
    rates_by_torque = first.by_torque[n:, :] + rates[:, 2 * n :]
    rate = first.x[n:] + change
    return _Reached(
        ca.vertcat(first.x[:n] + h * rate, rate),
        ca.vertcat(first.by_state[:n, :] + h * rates_by_state, rates_by_state),
        ca.vertcat(first.by_torque[:n, :] + h * rates_by_torque, rates_by_torque),
    )
