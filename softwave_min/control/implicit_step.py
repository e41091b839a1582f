r"""One linearly implicit step of the arm under a held command, and its derivatives.

The arm is stiff: with added mass the eigenvalues of M span about three decades,
and the derivative gain acts on the smallest. The step is linearly implicit,

.. math:: [M + h(D + \beta + S) + h^2 (k + \alpha)]\,(\dot q^+ - \dot q)
          = h f - h^2 (k + \alpha)\, \dot q, \qquad q^+ = q + h \dot q^+,

with f the resultant of all forces, S the slope of the drag by the rates and the
flow taken at the end of the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Self

import casadi as ca

from softwave_min.arm import Section, Structure, Values, mechanics
from softwave_min.arm.dynamics import solve_symmetric
from softwave_min.arm.hydrodynamics import flow_at, flow_gradient
from softwave_min.arm.kinematics import BodyPoint
from softwave_min.arm.mechanics import Rule, flow_coefficients
from softwave_min.control.baseline import InnerLoop
from softwave_min.control.summed import Summed


@dataclass(frozen=True)
class Held:
    """What is held over a control period."""

    structure: Structure
    command_torque: ca.SX
    """See ``InnerLoop.command_torque``."""
    flow: ca.SX
    """Coefficients of the flow, expanded about the middle of the period."""
    disturbance: ca.SX
    """Additional generalised load, in N m."""
    gains: ca.SX
    packed: ca.SX

    @classmethod
    def symbolic(cls, structure: Structure) -> Self:
        """Symbols for everything."""
        n = structure.segments
        return cls(
            structure,
            command_torque=ca.SX.sym("command_torque", n),
            flow=ca.SX.sym("flow", structure.flow_size),
            disturbance=ca.SX.sym("disturbance", n),
            gains=ca.SX.sym("gains", InnerLoop.size(n)),
            packed=ca.SX.sym("values", Values.size(n)),
        )

    @property
    def inputs(self) -> dict[str, ca.SX]:
        """Inputs of the functions of this module, the step's own aside."""
        return {
            "command_torque": self.command_torque,
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


@cache
def step_function(structure: Structure) -> ca.Function:
    """Change of the rates in one step, d = qd+ - qd.

    Inputs: x = (q, qd); the time at the end of the step, from the middle of the period; the
    step's length h; and those of ``Held``.
    """
    return step_sum(structure).plain()


@cache
def step_sum(structure: Structure) -> Summed:
    """``step_function`` as a sum over quadrature points."""
    n = structure.segments
    held, x, time, h = _symbols(structure)
    place, still = ca.SX.sym("place"), ca.SX.zeros(n)
    local, step = ImplicitStep(held, x, time, h, [(place, 1.0)]), ImplicitStep(held, x, time, h)
    lower = ca.Sparsity.lower(n)
    sums = ca.SX.sym("sums", lower.nnz() + n)
    matrix = step.matrix(ca.tril2symm(ca.SX(lower, sums[: lower.nnz()])))
    change = -solve_symmetric(matrix, step.residual(sums[lower.nnz() :], still))
    return Summed.of(
        "implicit_step",
        {"x": x, "time": time, "h": h, **held.inputs},
        place,
        ca.vertcat(_lower(local.matrix_sum()), local.residual_sum(still)),
        sums,
        {"change": change},
        structure.rule,
    )


@cache
def slopes_sum(structure: Structure) -> Summed:
    """Derivatives of the rates after a step by x and by the command's torque.

    Inputs: those of ``step_function`` and, after x, the change d that it gave.
    """
    n = structure.segments
    held, x, time, h = _symbols(structure)
    place, change = ca.SX.sym("place"), ca.SX.sym("change", n)
    local, step = ImplicitStep(held, x, time, h, [(place, 1.0)]), ImplicitStep(held, x, time, h)
    lower = ca.Sparsity.lower(n)
    sums = ca.SX.sym("sums", lower.nnz() + 2 * n * n)
    matrix = step.matrix(ca.tril2symm(ca.SX(lower, sums[: lower.nnz()])))
    by_state = step.residual_by_state(ca.reshape(sums[lower.nnz() :], n, 2 * n))
    slopes = -solve_symmetric(matrix, ca.horzcat(by_state, step.residual_by_torque()))
    rate_itself = ca.horzcat(ca.SX.zeros(n, n), ca.SX.eye(n))
    return Summed.of(
        "implicit_slopes",
        {"x": x, "change": change, "time": time, "h": h, **held.inputs},
        place,
        ca.vertcat(_lower(local.matrix_sum()), ca.vec(local.residual_by_state_sum(change))),
        sums,
        {"by_state": rate_itself + slopes[:, : 2 * n], "by_torque": slopes[:, 2 * n :]},
        structure.rule,
    )


def _symbols(structure: Structure) -> tuple[Held, ca.SX, ca.SX, ca.SX]:
    x = ca.SX.sym("x", 2 * structure.segments)
    return Held.symbolic(structure), x, ca.SX.sym("time"), ca.SX.sym("h")


def _lower(matrix: ca.SX) -> ca.SX:
    """Lower triangle, column by column."""
    lower = ca.Sparsity.lower(matrix.shape[0])
    triangle: ca.SX = ca.project(ca.densify(matrix), lower)
    return ca.sparsity_cast(triangle, ca.Sparsity.dense(lower.nnz(), 1))


class ImplicitStep:
    """The linear system W d = r of one step, for the change d of the rates.

    Its residual W d - r is a sum over the quadrature points,
    J^T f(z) + (dtheta/dq) mu(z), of the force and the moment on a section in the
    motion z, and of the terms that act on the bending angles directly. So its
    derivative needs that of f and mu by z, and of z by the state, which the
    kinematics gives in closed form. The sums are methods of their own, ``*_sum``.

    Parameters
    ----------
    held : Held
    x : SX, (2 n,)
        State (q, qd) from which the step goes.
    time, h : SX or float
        Time of the flow, from the middle of the period, and the step's length, in s.
    rule : Rule, optional
        Quadrature of the sums, if not the structure's.
    """

    def __init__(
        self,
        held: Held,
        x: ca.SX,
        time: ca.SX | float,
        h: ca.SX | float,
        rule: Rule | None = None,
    ) -> None:
        n = held.structure.segments
        self._held, self._x, self._h = held, x, h
        self._q, self._qd = ca.vertsplit(x, n)
        self._values = held.values
        self._arm = mechanics(held.structure, self._q, self._qd, held.values, rule)
        self._loop = loop = held.loop
        self._spring = self._values.stiffness + loop.actuated * loop.proportional
        self._damper = self._values.damping + loop.actuated * loop.derivative
        self._flow, self._flow_rate = flow_coefficients(held.flow, time, held.structure)

    def matrix(self, points: ca.SX) -> ca.SX:
        """W, of which ``points`` is the sum; a locked angle has a row of its own."""
        total = points + ca.diag(self._h * self._damper + self._h**2 * self._spring)
        free = ca.diag(1 - self._loop.locked)
        return free @ total @ free + ca.diag(self._loop.locked)

    def matrix_sum(self) -> ca.SX:
        """Inertia and slope of the drag: n x n, symmetric."""
        total = ca.SX.zeros(self._q.numel(), self._q.numel())
        if self._held.structure.rotary_inertia:
            total += self._arm.rotary_inertia
        for section, point, weight, _ in self._arm.points:
            relative = point.velocity - flow_at(self._flow, self._arm.offset(point))
            response = self._response(section, point.angle, relative)
            total += weight * point.jacobian.T @ response @ point.jacobian
        return total

    def residual(self, points: ca.SX, change: ca.SX) -> ca.SX:
        """W d - r, in N m s, of which ``points`` is the sum; for a locked angle its rate after
        the step.
        """
        h, values = self._h, self._values
        torque = self._loop.torque_under(self._held.command_torque, self._x)
        passive = values.stiffness * self._q + values.damping * self._qd
        total = (
            points
            + h * (passive - torque - self._held.disturbance)
            + h**2 * self._spring * self._qd
            + (h * self._damper + h**2 * self._spring) * change
        )
        locked = self._loop.locked
        return (1 - locked) * total + locked * (self._qd + change)

    def residual_sum(self, change: ca.SX) -> ca.SX:
        """Forces and moments on the sections, (n,)."""
        total = ca.SX.zeros(self._q.numel())
        if self._held.structure.rotary_inertia:
            total += self._arm.rotary_inertia @ change
        for section, point, weight, _ in self._arm.points:
            force, moment = self._section_force(section, *self._motion(point, change))
            total += weight * (point.jacobian.T @ force + point.angle_jacobian * moment)
        return total

    def residual_by_state(self, points: ca.SX) -> ca.SX:
        """Derivative of the residual by (q, qd) at fixed d, n x 2 n, of which ``points`` is
        the sum.
        """
        h = self._h
        direct = ca.horzcat(
            h * ca.diag(self._spring), ca.diag(h * self._damper + h**2 * self._spring)
        )
        free, locked = ca.diag(1 - self._loop.locked), ca.diag(self._loop.locked)
        return free @ (points + direct) + ca.horzcat(ca.SX.zeros(*locked.shape), locked)

    def residual_by_state_sum(self, change: ca.SX) -> ca.SX:
        """That of ``residual_sum``."""
        n = self._q.numel()
        total = ca.SX.zeros(n, 2 * n)
        for section, point, weight, _ in self._arm.points:
            motion = self._motion(point, change)
            force, _ = self._section_force(section, *motion)
            slopes = self._section_slopes(section, motion)
            reach = weight * ca.horzcat(point.jacobian.T, point.angle_jacobian)
            angle_wise, rate_wise = self._motion_by_state(point, change)
            by_angle = point.hessian_along(weight * force) + reach @ (slopes @ angle_wise)
            total += ca.horzcat(by_angle, reach @ (slopes @ rate_wise))
        return total

    def residual_by_torque(self) -> ca.SX:
        """Derivative of the residual by the command's torque, n x n, in s."""
        return -self._h * ca.diag((1 - self._loop.locked) * self._loop.actuated)

    def _motion(self, point: BodyPoint, change: ca.SX) -> tuple[ca.SX, ...]:
        offset = self._arm.offset(point)
        return (
            point.angle,
            point.angular_velocity,
            point.velocity,
            point.velocity - flow_at(self._flow, offset),
            flow_at(self._flow_rate, offset),
            point.convective_acceleration,
            point.product(change),
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
            jacobian_rate - flow_gradient(self._flow, offset) @ jacobian,
            flow_gradient(self._flow_rate, offset) @ jacobian,
            point.gradient_of_convective_acceleration(),
            point.gradient_of_product(change),
        )
        by_rate = ca.vertcat(
            ca.SX.zeros(1, n), turning, jacobian, jacobian, still, 2 * jacobian_rate, still
        )
        return by_angle, by_rate

    def _response(self, section: Section, angle: ca.SX, relative: ca.SX) -> ca.SX:
        """Derivative of the force by d, 2 x 2."""
        axes = ca.horzsplit(ca.SX.eye(2))
        mass = section.mass * ca.SX.eye(2)
        mass += ca.horzcat(*(section.added_force(angle, axis) for axis in axes))
        return mass + self._h * section.drag_slope(angle, relative)

    def _section_force(
        self, section: Section, angle: ca.SX, *vectors: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """Force and moment on a section in the residual, in N s and N m s."""
        drag, _, _ = section.implicit_drag(angle, vectors[2], vectors[-1])
        force, moment = self._force_without_drag(section, angle, *vectors)
        return force + self._h * drag, moment

    def _force_without_drag(
        self, section: Section, angle: ca.SX, spin: ca.SX, *vectors: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        velocity, _, flow_rate, convective, change = vectors
        h = self._h
        accelerated = change + h * convective
        convection, moment = section.added_convection(angle, spin, velocity)
        force = (
            section.mass * accelerated
            + section.added_force(angle, accelerated)
            + h * (convection - section.weight - section.inertia_load(angle, flow_rate))
        )
        return force, h * moment

    def _section_slopes(self, section: Section, motion: tuple[ca.SX, ...]) -> ca.SX:
        """Derivative of (force, moment) by the stacked motion, 3 x 12."""
        symbols = [ca.SX.sym("z", *part.shape) for part in motion]
        wrench = ca.vertcat(*self._force_without_drag(section, *symbols))
        smooth = ca.jacobian(wrench, ca.vertcat(*symbols))
        slopes = ca.substitute([smooth], symbols, list(motion))[0]
        angle, relative, change = motion[0], motion[3], motion[-1]
        _, by_angle, by_relative = section.implicit_drag(angle, relative, change)
        # Rows of the force; columns of the angle, the relative velocity and the change.
        slopes[:2, 0] += self._h * by_angle
        slopes[:2, 4:6] += self._h * by_relative
        slopes[:2, 10:] += self._h * section.drag_slope(angle, relative)
        return slopes
