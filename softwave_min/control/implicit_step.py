r"""One linearly implicit step of the arm under the command of a period, and its derivatives.

The arm is stiff: with added mass the eigenvalues of M span about three decades, and the
derivative gain acts on the smallest. An implicit Euler step of length h,
:math:`M(\dot q^+ - \dot q) = h f(q^+, \dot q^+)` and :math:`q^+ = q + h \dot q^+`, with the
resultant f of all forces linearised about (q, q'), is a linear system W d = r for the change
d of the rates (eq-nmpc-step in notebooks/nmpc.ipynb, eq-dyn-implicit in dynamics.ipynb):

.. math:: \underbrace{[M + h(D + \beta + S) + h^2 (k + \alpha)]}_W\,
          \underbrace{(\dot q^+ - \dot q)}_d
          = \underbrace{h f - h^2 (k + \alpha)\, \dot q}_r, \qquad q^+ = q + h \dot q^+,

with S the slope of the drag by the rates and the flow taken at the end of the step. What else
f depends on is taken as it is at the start.

The derivative of d by anything is :math:`-W^{-1} \partial (W d - r)` at fixed d: the residual
W d - r is differentiated, and never the solution of the linear system. The residual is a sum
over the quadrature points,

.. math:: W d - r = \sum_p w_p \Bigl[J_p^T F(z_p) + \frac{\partial\theta_p}{\partial q}\,
          \mu(z_p)\Bigr] + \text{what acts on the bending angles directly},

of force F and moment mu on a section in the motion z (``SectionMotion``). So its derivative
needs those of F and mu by z, and that of z by (q, q'), which the kinematics gives in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
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
class PeriodInputs:
    """What is constant over a control period, as symbols."""

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


@dataclass(frozen=True)
class SectionMotion:
    """What force and moment on a section depend on, z; or a derivative of or by each part."""

    angle: ca.SX
    """Direction of the tangent, in rad."""
    spin: ca.SX
    """Its rate, in rad/s."""
    velocity: ca.SX
    """(2,), in m/s."""
    relative_velocity: ca.SX
    """(2,), velocity less that of the water, in m/s."""
    flow_rate: ca.SX
    """(2,), rate of the water's velocity, in m/s^2."""
    convective_acceleration: ca.SX
    """(2,), J' q', in m/s^2."""
    change: ca.SX
    """(2,), of the velocity in the step, J d, in m/s."""

    @classmethod
    def symbolic(cls) -> Self:
        """Symbols for everything."""
        sizes = {"angle": 1, "spin": 1}
        return cls(**{name: ca.SX.sym(name, sizes.get(name, 2)) for name in cls.__annotations__})

    @classmethod
    def of_columns(cls, matrix: ca.SX) -> Self:
        """Columns of a matrix, shared out in the order of the parts."""
        return cls(*ca.horzsplit(matrix, [0, 1, 2, 4, 6, 8, 10, 12]))

    @property
    def parts(self) -> list[ca.SX]:
        """All parts in their order."""
        return list(vars(self).values())


@cache
def step_function(structure: Structure) -> ca.Function:
    """Change of the rates in one step, d = qd+ - qd.

    Inputs: x = (q, qd); the time at the end of the step, from the middle of the period; the
    step's length h; and those of ``PeriodInputs``.
    """
    return step_sum(structure).plain()


@cache
def step_sum(structure: Structure) -> Summed:
    """``step_function`` as a sum over quadrature points."""
    n, lower = structure.segments, ca.Sparsity.lower(structure.segments)
    own, given = _step_inputs(n), PeriodInputs.symbolic(structure)
    place, sums = ca.SX.sym("place"), ca.SX.sym("sums", lower.nnz() + n)
    local, step = (ImplicitStep(given, **own, rule=rule) for rule in ([(place, 1.0)], None))
    return Summed.of(
        "implicit_step",
        {**own, **given.inputs},
        place,
        ca.vertcat(_lower(local.matrix_sum()), local.residual_sum()),
        sums,
        {"change": step.change(_symmetric(sums, n), sums[lower.nnz() :])},
        structure.rule,
    )


@cache
def slopes_sum(structure: Structure) -> Summed:
    """Derivatives of the rates after a step by x and by the command's torque.

    Inputs: those of ``step_function`` and, after x, the change d that it gave.
    """
    n, lower = structure.segments, ca.Sparsity.lower(structure.segments)
    own, given = _step_inputs(n), PeriodInputs.symbolic(structure)
    place, sums = ca.SX.sym("place"), ca.SX.sym("sums", lower.nnz() + 2 * n * n)
    local, step = (ImplicitStep(given, **own, rule=rule) for rule in ([(place, 1.0)], None))
    change = ca.SX.sym("change", n)
    by_state_sum = ca.reshape(sums[lower.nnz() :], n, 2 * n)
    by_state, by_torque = step.slopes(_symmetric(sums, n), by_state_sum)
    return Summed.of(
        "implicit_slopes",
        {"x": own.pop("x"), "change": change, **own, **given.inputs},
        place,
        ca.vertcat(_lower(local.matrix_sum()), ca.vec(local.residual_by_state_sum(change))),
        sums,
        {"by_state": by_state, "by_torque": by_torque},
        structure.rule,
    )


def _step_inputs(segments: int) -> dict[str, ca.SX]:
    sizes = {"x": 2 * segments, "time": 1, "h": 1}
    return {name: ca.SX.sym(name, size) for name, size in sizes.items()}


def _lower(matrix: ca.SX) -> ca.SX:
    """Lower triangle, column by column."""
    lower = ca.Sparsity.lower(matrix.shape[0])
    triangle: ca.SX = ca.project(ca.densify(matrix), lower)
    return ca.sparsity_cast(triangle, ca.Sparsity.dense(lower.nnz(), 1))


def _symmetric(sums: ca.SX, n: int) -> ca.SX:
    """The matrix whose lower triangle the sums begin with."""
    lower = ca.Sparsity.lower(n)
    return ca.tril2symm(ca.SX(lower, sums[: lower.nnz()]))


class ImplicitStep:
    """The linear system W d = r of one step, for the change d of the rates.

    The sums over the quadrature points are methods of their own, ``*_sum``; what they give is
    handed to ``change`` and ``slopes``.

    Parameters
    ----------
    given : PeriodInputs
    x : SX, (2 n,)
        State (q, qd) from which the step goes.
    time, h : SX or float
        Time of the flow, from the middle of the period, and the step's length, in s.
    rule : Rule, optional
        Quadrature of the sums, if not the structure's.
    """

    def __init__(
        self,
        given: PeriodInputs,
        x: ca.SX,
        time: ca.SX | float,
        h: ca.SX | float,
        rule: Rule | None = None,
    ) -> None:
        self._given, self._x, self._h = given, x, h
        self._q, self._qd = ca.vertsplit(x, given.structure.segments)
        self._values, self._loop = given.values, given.loop
        self._arm = mechanics(given.structure, self._q, self._qd, given.values, rule)
        self._spring = self._values.stiffness + self._loop.actuated * self._loop.proportional
        self._damper = self._values.damping + self._loop.actuated * self._loop.derivative
        self._flow, self._flow_rate = flow_coefficients(given.flow, time, given.structure)

    def change(self, matrix_sum: ca.SX, residual_sum: ca.SX) -> ca.SX:
        """Change d of the rates, (n,)."""
        return -solve_symmetric(self._matrix(matrix_sum), self._residual(residual_sum))

    def slopes(self, matrix_sum: ca.SX, residual_by_state_sum: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Derivatives of the rates after the step, by x and by the command's torque."""
        n = self._given.structure.segments
        by_state = self._residual_by_state(residual_by_state_sum)
        by_torque = -self._h * ca.diag((1 - self._loop.locked) * self._loop.actuated)
        changes = -solve_symmetric(self._matrix(matrix_sum), ca.horzcat(by_state, by_torque))
        rate_itself = ca.horzcat(ca.SX.zeros(n, n), ca.SX.eye(n))
        return rate_itself + changes[:, : 2 * n], changes[:, 2 * n :]

    def matrix_sum(self) -> ca.SX:
        """Part of W: inertia and slope of the drag, n x n, symmetric."""
        total = ca.SX.zeros(self._q.numel(), self._q.numel())
        if self._given.structure.rotary_inertia:
            total += self._arm.rotary_inertia
        for section, point, weight, _ in self._arm.points:
            relative = point.velocity - flow_at(self._flow, self._arm.offset(point))
            response = self._force_by_change(section, point.angle, relative)
            total += weight * point.jacobian.T @ response @ point.jacobian
        return total

    def residual_sum(self) -> ca.SX:
        """Part of -r: forces and moments on the sections at d = 0, (n,)."""
        still = ca.SX.zeros(self._q.numel())
        total = ca.SX.zeros(self._q.numel())
        for section, point, weight, _ in self._arm.points:
            force, moment = self._section_force(section, self._motion(point, still))
            total += weight * (point.jacobian.T @ force + point.angle_jacobian * moment)
        return total

    def residual_by_state_sum(self, change: ca.SX) -> ca.SX:
        """Part of the derivative of W d - r by (q, qd) at fixed d, n x 2 n."""
        n = self._q.numel()
        total = ca.SX.zeros(n, 2 * n)
        for section, point, weight, _ in self._arm.points:
            motion = self._motion(point, change)
            force, _ = self._section_force(section, motion)
            slopes = ca.horzcat(*self._section_slopes(section, motion).parts)
            by_angles, by_rates = (
                ca.vertcat(*one.parts) for one in self._motion_by_state(point, change)
            )
            reach = weight * ca.horzcat(point.jacobian.T, point.angle_jacobian)
            own = point.hessian_along(weight * force)
            total += ca.horzcat(own + reach @ (slopes @ by_angles), reach @ (slopes @ by_rates))
        return total

    def _matrix(self, matrix_sum: ca.SX) -> ca.SX:
        """W; a locked angle has a row of its own."""
        total = matrix_sum + ca.diag(self._h * self._damper + self._h**2 * self._spring)
        free = ca.diag(1 - self._loop.locked)
        return free @ total @ free + ca.diag(self._loop.locked)

    def _residual(self, residual_sum: ca.SX) -> ca.SX:
        """-r, in N m s; for a locked angle its rate, which the step ends."""
        torque = self._loop.torque_under(self._given.command_torque, self._x)
        passive = self._values.stiffness * self._q + self._values.damping * self._qd
        total = (
            residual_sum
            + self._h * (passive - torque - self._given.disturbance)
            + self._h**2 * self._spring * self._qd
        )
        return (1 - self._loop.locked) * total + self._loop.locked * self._qd

    def _residual_by_state(self, residual_by_state_sum: ca.SX) -> ca.SX:
        """Derivative of W d - r by (q, qd) at fixed d, n x 2 n."""
        h = self._h
        direct = ca.horzcat(
            h * ca.diag(self._spring), ca.diag(h * self._damper + h**2 * self._spring)
        )
        free, locked = ca.diag(1 - self._loop.locked), ca.diag(self._loop.locked)
        rate = ca.horzcat(ca.SX.zeros(*locked.shape), locked)
        return free @ (residual_by_state_sum + direct) + rate

    def _motion(self, point: BodyPoint, change: ca.SX) -> SectionMotion:
        offset = self._arm.offset(point)
        return SectionMotion(
            angle=point.angle,
            spin=point.angular_velocity,
            velocity=point.velocity,
            relative_velocity=point.velocity - flow_at(self._flow, offset),
            flow_rate=flow_at(self._flow_rate, offset),
            convective_acceleration=point.convective_acceleration,
            change=point.product(change),
        )

    def _motion_by_state(
        self, point: BodyPoint, change: ca.SX
    ) -> tuple[SectionMotion, SectionMotion]:
        """Derivatives of ``_motion`` by q and by qd, each part n columns wide."""
        n, jacobian = self._given.structure.segments, point.jacobian
        offset, jacobian_rate = self._arm.offset(point), point.gradient_of_product(self._qd)
        turning, nothing = ca.SX(point.angle_jacobian.T), ca.SX.zeros(2, n)
        by_angles = SectionMotion(
            angle=turning,
            spin=ca.SX.zeros(1, n),
            velocity=jacobian_rate,
            relative_velocity=jacobian_rate - flow_gradient(self._flow, offset) @ jacobian,
            flow_rate=flow_gradient(self._flow_rate, offset) @ jacobian,
            convective_acceleration=point.gradient_of_convective_acceleration(),
            change=point.gradient_of_product(change),
        )
        by_rates = SectionMotion(
            angle=ca.SX.zeros(1, n),
            spin=turning,
            velocity=jacobian,
            relative_velocity=jacobian,
            flow_rate=nothing,
            convective_acceleration=2 * jacobian_rate,
            change=nothing,
        )
        return by_angles, by_rates

    def _force_by_change(self, section: Section, angle: ca.SX, relative: ca.SX) -> ca.SX:
        """Derivative of the force by the change of the velocity, 2 x 2."""
        axes = ca.horzsplit(ca.SX.eye(2))
        mass = section.mass * ca.SX.eye(2)
        mass += ca.horzcat(*(section.added_force(angle, axis) for axis in axes))
        return mass + self._h * section.drag_slope(angle, relative)

    def _section_force(self, section: Section, motion: SectionMotion) -> tuple[ca.SX, ca.SX]:
        """Force F and moment mu on a section, in N s and N m s."""
        drag, _, _ = section.implicit_drag(motion.angle, motion.relative_velocity, motion.change)
        force, moment = self._force_without_drag(section, motion)
        return force + self._h * drag, moment

    def _force_without_drag(self, section: Section, motion: SectionMotion) -> tuple[ca.SX, ca.SX]:
        h, angle = self._h, motion.angle
        accelerated = motion.change + h * motion.convective_acceleration
        convection, moment = section.added_convection(angle, motion.spin, motion.velocity)
        force = (
            section.mass * accelerated
            + section.added_force(angle, accelerated)
            + h * (convection - section.weight - section.inertia_load(angle, motion.flow_rate))
        )
        return force, h * moment

    def _section_slopes(self, section: Section, motion: SectionMotion) -> SectionMotion:
        """Derivatives of (F, mu) by each part of the motion, 3 rows each.

        Those of the drag are stated, since it has a corner; all others are CasADi's.
        """
        z, h = SectionMotion.symbolic(), self._h
        wrench = ca.vertcat(*self._force_without_drag(section, z))
        smooth = ca.jacobian(wrench, ca.vertcat(*z.parts))
        slopes = SectionMotion.of_columns(ca.substitute([smooth], z.parts, motion.parts)[0])
        angle, relative = motion.angle, motion.relative_velocity
        _, by_angle, by_relative = section.implicit_drag(angle, relative, motion.change)

        def with_drag(smooth: ca.SX, drag: ca.SX) -> ca.SX:
            return smooth + ca.vertcat(h * drag, ca.SX.zeros(1, drag.shape[1]))

        return replace(
            slopes,
            angle=with_drag(slopes.angle, by_angle),
            relative_velocity=with_drag(slopes.relative_velocity, by_relative),
            change=with_drag(slopes.change, section.drag_slope(angle, relative)),
        )
