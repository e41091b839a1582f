r"""The paper's model-based kinematic controller.

A planner moves the commanded bending angles towards the target,

.. math:: \dot{\bar q} = J^{+}(\bar q)\, K_e\,(\bar x - h(\bar q)),

and a feed-forward with PD feedback turns them into torques,

.. math:: \tau = K(\bar q) + G(\bar q) + \alpha(\bar q - q) - \beta \dot q

(paper, eqs. 14 and 15). The torque law is also the inner loop of the NMPC.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.arm.dynamics import solve_symmetric
from softwave_min.control.preview import Preview
from softwave_min.parameters import BaselineParameters, FailureParameters

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class InnerLoop:
    """Symbols (or numbers) of the feed-forward + PD law and of a failure, each (n,)."""

    proportional: ca.SX
    """Diagonal of alpha, in N m/rad."""
    derivative: ca.SX
    """Diagonal of beta, in N m s/rad."""
    actuated: ca.SX
    """1 where the segment's torque acts, 0 where it has failed."""
    locked: ca.SX
    """1 where the bending angle cannot change, else 0."""

    @staticmethod
    def size(segments: int) -> int:
        """Length of the packed vector."""
        return 4 * segments

    @classmethod
    def unpacked(cls, vector: ca.SX, segments: int) -> InnerLoop:
        """Take the packed vector apart."""
        return cls(*ca.vertsplit(vector, segments))

    @staticmethod
    def packed(gains: BaselineParameters, failure: FailureParameters | None) -> Floats:
        """Vector of the numbers; without ``failure`` all segments work."""
        n = len(gains.proportional_gain)
        failed, locked = np.zeros(n), np.zeros(n)
        if failure is not None and failure.segment:
            failed[failure.segment - 1] = 1.0
            locked[failure.segment - 1] = float(failure.manner == "locked")
        return np.concatenate(
            [gains.proportional_gain, gains.derivative_gain, 1.0 - failed, locked]
        )

    def command_torque(self, structure: Structure, values: Values, q_bar: ca.SX) -> ca.SX:
        """What the command adds to the torque: K q_bar + G(q_bar) + alpha q_bar, in N m."""
        gravity = mechanics(structure, q_bar, ca.SX.zeros(q_bar.shape), values).gravity
        return (values.stiffness + self.proportional) * q_bar + gravity

    def command_slope(self, structure: Structure, values: Values, q_bar: ca.SX) -> ca.SX:
        """Derivative of ``command_torque`` by the command, n x n, in N m/rad."""
        commanded = mechanics(structure, q_bar, ca.SX.zeros(q_bar.shape), values)
        return ca.diag(values.stiffness + self.proportional) + commanded.gravity_gradient

    def torque_under(self, command_torque: ca.SX, x: ca.SX) -> ca.SX:
        """Torque in the state x = (q, qd), in N m."""
        q, qd = ca.vertsplit(x, x.numel() // 2)
        return self.actuated * (command_torque - self.proportional * q - self.derivative * qd)

    def torque(self, structure: Structure, values: Values, q_bar: ca.SX, x: ca.SX) -> ca.SX:
        """Torque under the command ``q_bar`` in the state x = (q, qd), in N m."""
        return self.torque_under(self.command_torque(structure, values, q_bar), x)

    def torque_by_command(self, command_slope: ca.SX) -> ca.SX:
        """Derivative of the torque by the command, n x n, in N m/rad."""
        return ca.diag(self.actuated) @ command_slope

    def torque_by_state(self) -> ca.SX:
        """Derivative of the torque by (q, qd), n x 2 n."""
        gains = ca.horzcat(ca.diag(self.proportional), ca.diag(self.derivative))
        return -ca.diag(self.actuated) @ gains


class KinematicPlanner:
    """The planner, stepped once per control period by Euler's rule.

    The pseudo-inverse is singular on the straight arm, from which every run
    starts: there the tip can move across the arm only, and nothing says which way
    to bend. The planner therefore starts from a small bend of every segment
    towards the target, and damps the inverse, J^T (J J^T + damping^2 I)^-1, which
    leaves its fixed point h(q_bar) = x_bar as it is.

    Parameters
    ----------
    arm : Arm
    parameters : BaselineParameters
    period : float
        Time between two steps, in s.
    """

    def __init__(self, arm: Arm, parameters: BaselineParameters, period: float) -> None:
        self._arm = arm
        self._parameters = parameters
        self._period = period

    def first_posture(self, q: Floats, target: Floats) -> Floats:
        """Posture that the planner starts from on an arm at ``q``, (n,) in rad."""
        base, tip = np.asarray(self._arm.parameters.base_position), self._arm.tip(q)
        along, towards = tip - base, target - base
        side = np.sign(along[0] * towards[1] - along[1] * towards[0]) or 1.0
        return q + side * self._parameters.initial_bend

    def step(self, q_bar: Floats, target: Floats) -> Floats:
        """Commanded angles one period later, (n,) in rad."""
        moved: Floats = self._moved(q_bar, target[None])[0]
        return moved

    def path(self, q: Floats, targets: Floats) -> Floats:
        """Commanded angles of a whole run, (T, n): the planner never looks at the arm."""
        return self._moved(self.first_posture(q, targets[0]), targets)

    def _moved(self, q_bar: Floats, targets: Floats) -> Floats:
        count, gains = len(targets), self._parameters
        settings = np.array([gains.task_gain, gains.damping, self._period])
        fixed = (np.repeat(one[:, None], count, axis=1) for one in (settings, self._arm.values))
        follow = planner_function(self._arm.structure).mapaccum(count)
        moved: Floats = np.asarray(follow(q_bar, targets.T, *fixed).full()).T
        return moved


@cache
def planner_function(structure: Structure) -> ca.Function:
    """One Euler step of the planner.

    Inputs: q_bar; target; (K_e, damping, period); values. Output: the next q_bar.
    """
    n = structure.segments
    q_bar, target = ca.SX.sym("q_bar", n), ca.SX.sym("target", 2)
    settings, packed = ca.SX.sym("settings", 3), ca.SX.sym("values", Values.size(n))
    gain, damping, period = ca.vertsplit(settings)
    arm = mechanics(structure, q_bar, ca.SX.zeros(n), Values.unpacked(packed, n))
    jacobian, velocity = arm.tip_jacobian, gain * (target - arm.tips[-1])
    rate = _least_change(jacobian, damping, velocity)
    return ca.Function(
        "planner", [q_bar, target, settings, packed], ca.cse([q_bar + period * rate])
    )


def _least_change(jacobian: ca.SX, damping: ca.SX, motion: ca.SX) -> ca.SX:
    """Change of the angles for a motion of the tip, by the damped inverse of its Jacobian."""
    gram = jacobian @ jacobian.T + damping**2 * ca.SX.eye(2)
    return jacobian.T @ solve_symmetric(gram, motion)


class Correction:
    r"""What two fairer opponents add to the planner's command; neither is in the paper.

    The torque law stays as it is. Linearised about its command it is a spring,

    .. math:: \tau(\bar q + \delta) \approx \tau(\bar q) + S\,\delta, \qquad
       S = \mathrm{diag}(k + \alpha) + \partial G/\partial q,

    so that what the torque should gain can be asked for by the command. With the plan
    :math:`\bar q_p` the command is

    .. math:: \bar q = \bar q_w - S^{-1}(\bar q_w)\,\hat\tau_E, \qquad
       \bar q_w = \bar q_p + J^{+}(\bar q_p)\,w, \qquad
       \dot w = K_I\,\bigl(h(\bar q_p) - h(q)\bigr).

    *Integral action* (``integral_gain``). A load at rest bends the arm by
    :math:`q - \bar q = S^{-1}\tau_E`. w comes to rest only where the tip is on the plan's. The
    offset from the plan is integrated, not that from the target, lest the way to the target
    wind w up. For a slow motion the tip follows w with the arm's lag T, so that the loop is
    :math:`K_I/(s(1 + Ts))`.

    *Load feed-forward* (``load_feedforward``). The estimate is the model's load of the flow that
    the preview tells of the present, with its noise, on an arm held still at q: the torque
    gains what cancels it. The arm's own velocity is left out, as that part of the drag
    damps the arm.

    Parameters
    ----------
    arm : Arm
    parameters : BaselineParameters
    period : float
        Control period, in s.
    preview : Preview
        What the NMPC is told. Of each forecast only the present is used.
    """

    def __init__(
        self, arm: Arm, parameters: BaselineParameters, period: float, preview: Preview
    ) -> None:
        self._arm = arm
        self._parameters = parameters
        self._period = period
        self._preview = preview
        self._command = _correction_function(arm.structure)
        loop = InnerLoop.packed(parameters, None)
        self._fixed = (parameters.damping, loop, arm.values)
        self._integral = np.zeros(2)
        self._former: Floats | None = None

    def command(self, step: int, state: Floats, planned: Floats) -> Floats:
        """Command of the period that starts at ``step``, (n,) in rad.

        ``planned`` is the planner's own. To be called once per period, in their order.
        """
        q = state[: self._arm.segments]
        self._integrate(q)
        self._former = planned
        load = self._load(step, q) if self._parameters.load_feedforward else np.zeros_like(q)
        answer = self._command(planned, self._integral, load, *self._fixed)
        command: Floats = answer.full().ravel()
        return command

    def _integrate(self, q: Floats) -> None:
        if self._former is not None and self._parameters.integral_gain:
            offset = self._arm.tip(self._former) - self._arm.tip(q)
            self._integral += self._period * self._parameters.integral_gain * offset

    def _load(self, step: int, q: Floats) -> Floats:
        """Estimated load at the start of a period, (n,) in N m; its flow is that of the middle."""
        present = self._preview.at(step)
        still = np.zeros_like(q)
        load = self._arm.fluid_load(q, still, present.flow[0], time=-self._period / 2)
        estimate: Floats = load + present.disturbance[0]
        return estimate


@cache
def _correction_function(structure: Structure) -> ca.Function:
    """Command with the corrections: see ``Correction``.

    Inputs: plan; w; estimated load; damping; gains; values.
    """
    n = structure.segments
    plan, w, load = ca.SX.sym("plan", n), ca.SX.sym("w", 2), ca.SX.sym("load", n)
    damping, gains = ca.SX.sym("damping"), ca.SX.sym("gains", InnerLoop.size(n))
    packed = ca.SX.sym("values", Values.size(n))
    values, loop = Values.unpacked(packed, n), InnerLoop.unpacked(gains, n)
    jacobian = mechanics(structure, plan, ca.SX.zeros(n), values).tip_jacobian
    moved = plan + _least_change(jacobian, damping, w)
    slope = loop.torque_by_command(loop.command_slope(structure, values, moved))
    command = moved - solve_symmetric(slope, load)
    inputs = [plan, w, load, damping, gains, packed]
    return ca.Function("correction", inputs, ca.cse([command]))
