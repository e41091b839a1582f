r"""One control period of the arm under a held command, as a CasADi function.

The arm is stiff: with added mass the eigenvalues of M span about three decades,
and the derivative gain acts on the smallest. The step is linearly implicit,

.. math:: [M + h(D + \beta + S) + h^2 (k + \alpha)]\,(\dot q^+ - \dot q)
          = h f - h^2 (k + \alpha)\, \dot q, \qquad q^+ = q + h \dot q^+,

with f the resultant of all forces, S the slope of the drag by the rates and the
flow taken at the end of the step. One full and two half steps are extrapolated
to second order (Hairer & Wanner II, IV.9), which keeps the damping.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi as ca

from softwave_min.arm import Structure, Values, mechanics
from softwave_min.arm.dynamics import solve_symmetric
from softwave_min.control.baseline import feedforward_pd

__all__ = ["rollout_function", "stage_function"]


@dataclass(frozen=True)
class _Period:
    """What is held over a control period."""

    structure: Structure
    q_bar: ca.SX
    flow: ca.SX
    disturbance: ca.SX
    gains: ca.SX
    packed: ca.SX

    @property
    def symbols(self) -> list[ca.SX]:
        """Inputs of every function of this period, the state aside."""
        return [self.q_bar, self.flow, self.disturbance, self.gains, self.packed]

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


@cache
def stage_function(structure: Structure, period: float, substeps: int) -> ca.Function:
    """State, tip and their derivatives one control period later.

    Inputs: x = (q, qd); q_bar; flow of the period, expanded about its middle;
    disturbance, an additional generalised load; gains; values. Outputs: the next x;
    A = dx+/dx; B = dx+/dq_bar; tip of the next state; its Jacobian by q.
    """
    n = structure.segments
    x = ca.SX.sym("x", 2 * n)
    held = _Period(
        structure,
        q_bar=ca.SX.sym("q_bar", n),
        flow=ca.SX.sym("flow", structure.flow_size),
        disturbance=ca.SX.sym("disturbance", n),
        gains=ca.SX.sym("gains", 2 * n),
        packed=ca.SX.sym("values", Values.size(n)),
    )
    step = period / substeps
    after = _Reached(x, ca.SX.eye(2 * n), ca.SX.zeros(2 * n, n))
    for index in range(substeps):
        after = _extrapolated(held, after, index * step - period / 2, step)
    end = mechanics(structure, after.x[:n], after.x[n:], held.values)
    outputs = [after.x, after.by_state, after.by_command, end.tips[-1], end.tip_jacobian]
    return ca.Function(
        "stage",
        [x, *held.symbols],
        ca.cse([ca.densify(output) for output in outputs]),
        ["x", "q_bar", "flow", "disturbance", "gains", "values"],
        ["next", "A", "B", "tip", "tip_jacobian"],
    )


@cache
def rollout_function(
    structure: Structure, period: float, substeps: int, horizon: int
) -> ca.Function:
    """``stage_function`` over a whole horizon in one call; columns are stages."""
    return stage_function(structure, period, substeps).mapaccum("rollout", horizon)


def _extrapolated(held: _Period, first: _Reached, start: float, step: float) -> _Reached:
    whole = _implicit_step(held, first, start, step)
    half = _implicit_step(held, first, start, step / 2)
    halves = _implicit_step(held, half, start + step / 2, step / 2)
    return _Reached(
        2 * halves.x - whole.x,
        2 * halves.by_state - whole.by_state,
        2 * halves.by_command - whole.by_command,
    )


def _implicit_step(held: _Period, first: _Reached, time: float, h: float) -> _Reached:
    """One linearly implicit step from ``time``, with derivatives.

    The step solves W d = r for the change d of the rates. Its derivative is
    W^-1 (dr - dW d): the vector r - W d is differentiated at fixed d, and never
    the solution of the linear system.
    """
    n = held.structure.segments
    x, change = ca.SX.sym("x", 2 * n), ca.SX.sym("change", n)
    matrix, right = _linear_system(held, x, time + h, h)
    residual = right - matrix @ change
    system = ca.Function(
        "system",
        [x, change, *held.symbols],
        [matrix, right, ca.jacobian(residual, x), ca.jacobian(residual, held.q_bar)],
    )
    matrix, right, _, _ = system(first.x, 0, *held.symbols)
    change = solve_symmetric(matrix, right)
    _, _, by_x, by_q_bar = system(first.x, change, *held.symbols)
    rates = solve_symmetric(
        matrix, ca.horzcat(by_x @ first.by_state, by_x @ first.by_command + by_q_bar)
    )
    rates_by_state = first.by_state[n:, :] + rates[:, : 2 * n]
    rates_by_command = first.by_command[n:, :] + rates[:, 2 * n :]
    rate = first.x[n:] + change
    return _Reached(
        ca.vertcat(first.x[:n] + h * rate, rate),
        ca.vertcat(first.by_state[:n, :] + h * rates_by_state, rates_by_state),
        ca.vertcat(first.by_command[:n, :] + h * rates_by_command, rates_by_command),
    )


def _linear_system(held: _Period, x: ca.SX, time: float, h: float) -> tuple[ca.SX, ca.SX]:
    """Matrix W and right-hand side r of one step whose flow is that at ``time``."""
    n, values = held.structure.segments, held.values
    q, qd = x[:n], x[n:]
    terms = mechanics(held.structure, q, qd, values)
    torque = feedforward_pd(held.structure, values, held.gains, held.q_bar, x)
    force = torque + terms.fluid_load(held.flow, time) + held.disturbance - terms.passive_force(q)
    proportional, derivative = ca.vertsplit(held.gains, n)
    spring = values.stiffness + proportional
    damper = ca.diag(values.damping + derivative) + terms.drag_slope(held.flow, time)
    matrix = terms.inertia + h * damper + h**2 * ca.diag(spring)
    return matrix, h * force - h**2 * spring * qd
