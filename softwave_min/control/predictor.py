r"""One control period of the arm under a held command, as a CasADi function.

The arm is stiff: with added mass the eigenvalues of M span about three decades,
and the derivative gain acts on the smallest. The step is linearly implicit,

.. math:: [M + h(D + \beta + S) + h^2 (k + \alpha)]\,(\dot q^+ - \dot q)
          = h f - h^2 (k + \alpha)\, \dot q, \qquad q^+ = q + h \dot q^+,

with f the resultant of all forces, S the slope of the drag by the rates and the
flow taken at the end of the step. A length H is gone in 1, in 2, ... in K such steps, and
the ends T_1, ... T_K are extrapolated to order K (Hairer & Wanner II, IV.9), which keeps
the damping.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Section, Structure, Values, mechanics
from softwave_min.arm.dynamics import solve_symmetric
from softwave_min.arm.hydrodynamics import flow_at, flow_gradient
from softwave_min.arm.kinematics import BodyPoint
from softwave_min.arm.mechanics import flow_coefficients
from softwave_min.control.baseline import InnerLoop
from softwave_min.parameters import NmpcParameters

__all__ = [
    "PeriodSteps",
    "extrapolation_weights",
    "period_function",
    "rollout_function",
    "slopes_function",
    "stage_function",
    "step_function",
]


@dataclass(frozen=True)
class _Period:
    """What is held over a control period."""

    structure: Structure
    q_bar: ca.SX
    flow: ca.SX
    disturbance: ca.SX
    gains: ca.SX
    packed: ca.SX

    @classmethod
    def symbolic(cls, structure: Structure) -> Self:
        """Symbols for everything."""
        n = structure.segments
        return cls(
            structure,
            q_bar=ca.SX.sym("q_bar", n),
            flow=ca.SX.sym("flow", structure.flow_size),
            disturbance=ca.SX.sym("disturbance", n),
            gains=ca.SX.sym("gains", InnerLoop.size(n)),
            packed=ca.SX.sym("values", Values.size(n)),
        )

    @property
    def inputs(self) -> dict[str, ca.SX]:
        """Inputs of every function of this period, the state aside."""
        return {
            "q_bar": self.q_bar,
            "flow": self.flow,
            "disturbance": self.disturbance,
            "gains": self.gains,
            "values": self.packed,
        }

    @property
    def loop(self) -> InnerLoop:
        """The inner loop by name."""
        return InnerLoop.unpacked(self.gains, self.structure.segments)

    @property
    def values(self) -> Values:
        """The parameters by name."""
        return Values.unpacked(self.packed, self.structure.segments)


@dataclass(frozen=True)
class _Reached:
    """A state with its derivatives by the period's first state and by the command."""

    x: ca.SX
    by_state: ca.SX
    by_command: ca.SX

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
    x = ca.SX.sym("x", 2 * n)
    held = _Period.symbolic(structure)
    length = steps.period / steps.substeps
    after = _Reached.start(x)
    for index in range(steps.substeps):
        start = index * length - steps.period / 2
        after = _extrapolated(held, after, start, length, steps.columns)
    outputs = {
        "next": after.x,
        "A": after.by_state,
        "B": after.by_command,
        **_period_outputs(held, x, after.x),
    }
    return _function("predictor_stage", {"x": x, **held.inputs}, outputs)


@cache
def rollout_function(structure: Structure, steps: PeriodSteps, horizon: int) -> ca.Function:
    """``stage_function`` over a whole horizon in one call; columns are stages."""
    return stage_function(structure, steps).mapaccum("rollout", horizon)


@cache
def step_function(structure: Structure) -> ca.Function:
    """State after one linearly implicit step, without derivatives.

    Inputs: x; the time at the end of the step, from the middle of the period; the step's
    length h; and as ``stage_function`` has them q_bar, flow, disturbance, gains, values.
    """
    n = structure.segments
    held = _Period.symbolic(structure)
    x, time, h = ca.SX.sym("x", 2 * n), ca.SX.sym("time"), ca.SX.sym("h")
    step = _ImplicitStep(held, x, time, h)
    change = -solve_symmetric(step.matrix(), step.residual(ca.SX.zeros(n)))
    rate = x[n:] + change
    reached = ca.vertcat(x[:n] + h * rate, rate)
    return _function(
        "implicit_step", {"x": x, "time": time, "h": h, **held.inputs}, {"next": reached}
    )


@cache
def slopes_function(structure: Structure) -> ca.Function:
    """Derivatives of ``step_function`` by x and by q_bar, from the same inputs."""
    held = _Period.symbolic(structure)
    x, time, h = ca.SX.sym("x", 2 * structure.segments), ca.SX.sym("time"), ca.SX.sym("h")
    reached = _implicit_step(held, _Reached.start(x), time - h, h)
    return _function(
        "implicit_slopes",
        {"x": x, "time": time, "h": h, **held.inputs},
        {"A": reached.by_state, "B": reached.by_command},
    )


@cache
def period_function(structure: Structure) -> ca.Function:
    """What else the cost of a period needs.

    Inputs: x; the next x; q_bar; gains; values. Outputs: tip of the next state; its
    Jacobian by q; torque at the start of the period; its derivatives by x and by q_bar.
    """
    n = structure.segments
    held = _Period.symbolic(structure)
    x, after = ca.SX.sym("x", 2 * n), ca.SX.sym("next", 2 * n)
    inputs = {name: held.inputs[name] for name in ("q_bar", "gains", "values")}
    outputs = _period_outputs(held, x, after)
    return _function("period_end", {"x": x, "next": after, **inputs}, outputs)


def _period_outputs(held: _Period, x: ca.SX, after: ca.SX) -> dict[str, ca.SX]:
    n = held.structure.segments
    end = mechanics(held.structure, after[:n], after[n:], held.values)
    return {
        "tip": end.tips[-1],
        "tip_jacobian": end.tip_jacobian,
        "torque": held.loop.torque(held.structure, held.values, held.q_bar, x),
        "torque_by_state": held.loop.torque_by_state(),
        "torque_by_command": held.loop.torque_by_command(held.structure, held.values, held.q_bar),
    }


def _function(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
    dense = [ca.densify(output) for output in outputs.values()]
    return ca.Function(name, list(inputs.values()), ca.cse(dense), list(inputs), list(outputs))


def _extrapolated(
    held: _Period, first: _Reached, start: float, length: float, columns: int
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
        combined(end.by_command for end in ends),
    )


def _implicit_step(
    held: _Period, first: _Reached, time: ca.SX | float, h: ca.SX | float
) -> _Reached:
    """One linearly implicit step from ``time``, with derivatives.

    The step solves W d = r for the change d of the rates. Its derivative is
    -W^-1 d(W d - r): the vector is differentiated at fixed d, and never the
    solution of the linear system.
    """
    n = held.structure.segments
    step = _ImplicitStep(held, first.x, time + h, h)
    matrix = step.matrix()
    change = -solve_symmetric(matrix, step.residual(ca.SX.zeros(n)))
    by_x = step.residual_by_state(change)
    rates = -solve_symmetric(
        matrix,
        ca.horzcat(by_x @ first.by_state, by_x @ first.by_command + step.residual_by_command()),
    )
    rates_by_state = first.by_state[n:, :] + rates[:, : 2 * n]
    rates_by_command = first.by_command[n:, :] + rates[:, 2 * n :]
    rate = first.x[n:] + change
    return _Reached(
        ca.vertcat(first.x[:n] + h * rate, rate),
        ca.vertcat(first.by_state[:n, :] + h * rates_by_state, rates_by_state),
        ca.vertcat(first.by_command[:n, :] + h * rates_by_command, rates_by_command),
    )


class _ImplicitStep:
    """The linear system of one step, with the flow of ``time``.

    Its residual W d - r is a sum over the quadrature points,
    J^T f(z) + (dtheta/dq) mu(z), of the force and the moment on a section in the
    motion z, and of the terms that act on the bending angles directly. So its
    derivative needs that of f and mu by z, and of z by the state, which the
    kinematics gives in closed form.
    """

    def __init__(self, held: _Period, x: ca.SX, time: ca.SX | float, h: ca.SX | float) -> None:
        n = held.structure.segments
        self._held, self._h = held, h
        self._q, self._qd = ca.vertsplit(x, n)
        self._values = held.values
        self._arm = mechanics(held.structure, self._q, self._qd, held.values)
        self._loop = loop = held.loop
        self._spring = self._values.stiffness + loop.actuated * loop.proportional
        self._damper = self._values.damping + loop.actuated * loop.derivative
        self._flow, self._flow_rate = flow_coefficients(held.flow, time, held.structure)

    def matrix(self) -> ca.SX:
        """W; a locked angle has a row of its own."""
        total = ca.diag(self._h * self._damper + self._h**2 * self._spring)
        if self._held.structure.rotary_inertia:
            total += self._arm.rotary_inertia
        for section, point, weight, _ in self._arm.points:
            columns = [
                self._change_force(section, point, column)
                for column in ca.horzsplit(point.jacobian)
            ]
            total += weight * point.jacobian.T @ ca.horzcat(*columns)
        free = ca.diag(1 - self._loop.locked)
        return free @ total @ free + ca.diag(self._loop.locked)

    def residual(self, change: ca.SX) -> ca.SX:
        """W d - r, in N m s; for a locked angle its rate after the step."""
        h, values = self._h, self._values
        x = ca.vertcat(self._q, self._qd)
        torque = self._loop.torque(self._held.structure, values, self._held.q_bar, x)
        passive = values.stiffness * self._q + values.damping * self._qd
        total = (
            h * (passive - torque - self._held.disturbance)
            + h**2 * self._spring * self._qd
            + (h * self._damper + h**2 * self._spring) * change
        )
        if self._held.structure.rotary_inertia:
            total += self._arm.rotary_inertia @ change
        for section, point, weight, _ in self._arm.points:
            force, moment = self._section_force(section, *self._motion(point, change))
            total += weight * (point.jacobian.T @ force + point.angle_jacobian * moment)
        locked = self._loop.locked
        return (1 - locked) * total + locked * (self._qd + change)

    def residual_by_state(self, change: ca.SX) -> ca.SX:
        """Derivative of the residual by (q, qd) at fixed d, n x 2 n."""
        h = self._h
        by_angle = h * ca.diag(self._spring)
        by_rate = ca.diag(h * self._damper + h**2 * self._spring)
        for section, point, weight, _ in self._arm.points:
            motion = self._motion(point, change)
            force, _ = self._section_force(section, *motion)
            slopes = self._section_slopes(section, motion)
            reach = ca.horzcat(point.jacobian.T, point.angle_jacobian)
            angle_wise, rate_wise = self._motion_by_state(point, change)
            by_angle += weight * (point.hessian_along(force) + reach @ slopes @ angle_wise)
            by_rate += weight * reach @ slopes @ rate_wise
        free, locked = ca.diag(1 - self._loop.locked), ca.diag(self._loop.locked)
        return ca.horzcat(free @ by_angle, free @ by_rate + locked)

    def residual_by_command(self) -> ca.SX:
        """Derivative of the residual by the commanded angles, n x n."""
        held = self._held
        slope = self._loop.torque_by_command(held.structure, self._values, held.q_bar)
        return -self._h * ca.diag(1 - self._loop.locked) @ slope

    def _motion(self, point: BodyPoint, change: ca.SX) -> tuple[ca.SX, ...]:
        offset = self._arm.offset(point)
        return (
            point.angle,
            point.angular_velocity,
            point.velocity,
            flow_at(self._flow, offset),
            flow_at(self._flow_rate, offset),
            point.convective_acceleration,
            point.jacobian @ change,
        )

    def _motion_by_state(self, point: BodyPoint, change: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Derivatives of the stacked motion by q and by qd."""
        n = self._held.structure.segments
        offset, jacobian = self._arm.offset(point), point.jacobian
        turning, still = point.angle_jacobian.T, ca.SX.zeros(2, n)
        jacobian_rate = point.gradient_of_product(self._qd)
        by_angle = ca.vertcat(
            turning,
            ca.SX.zeros(1, n),
            jacobian_rate,
            flow_gradient(self._flow, offset) @ jacobian,
            flow_gradient(self._flow_rate, offset) @ jacobian,
            point.gradient_of_convective_acceleration(),
            point.gradient_of_product(change),
        )
        by_rate = ca.vertcat(
            ca.SX.zeros(1, n), turning, jacobian, still, still, 2 * jacobian_rate, still
        )
        return by_angle, by_rate

    def _section_force(
        self, section: Section, angle: ca.SX, spin: ca.SX, *vectors: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """Force and moment on a section in the residual, in N s and N m s."""
        velocity, flow, flow_rate, convective, change = vectors
        h = self._h
        accelerated = change + h * convective
        convection, moment = section.added_convection(angle, spin, velocity)
        loads = section.loads(angle, velocity, flow, flow_rate)
        force = (
            section.mass * accelerated
            + section.added_force(angle, accelerated)
            + h * section.drag_slope(angle, velocity, flow, change)
            + h * (convection - section.weight - sum(loads, start=ca.SX.zeros(2)))
        )
        return force, h * moment

    def _change_force(self, section: Section, point: BodyPoint, change: ca.SX) -> ca.SX:
        """The part of the force that grows with d."""
        flow = flow_at(self._flow, self._arm.offset(point))
        slope = section.drag_slope(point.angle, point.velocity, flow, change)
        return section.mass * change + section.added_force(point.angle, change) + self._h * slope

    def _section_slopes(self, section: Section, motion: tuple[ca.SX, ...]) -> ca.SX:
        """Derivative of (force, moment) by the stacked motion, 3 x 12."""
        symbols = [ca.SX.sym("z", *part.shape) for part in motion]
        wrench = ca.vertcat(*self._section_force(section, *symbols))
        slopes = ca.jacobian(wrench, ca.vertcat(*symbols))
        return ca.substitute([slopes], symbols, list(motion))[0]
