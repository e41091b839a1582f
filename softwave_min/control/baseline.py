r"""The paper's model-based kinematic controller.

A planner moves the commanded bending angles towards the target,

.. math:: \dot{\bar q} = J^{+}(\bar q)\, K_e\,(\bar x - h(\bar q)),

and a feed-forward with PD feedback turns them into torques,

.. math:: \tau = K(\bar q) + G(\bar q) + \alpha(\bar q - q) - \beta \dot q

(paper, eqs. 14 and 15). The torque law is also the inner loop of the NMPC.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.parameters import BaselineParameters

__all__ = ["KinematicPlanner", "feedforward_pd"]

Floats = NDArray[np.float64]


def feedforward_pd(
    structure: Structure, values: Values, gains: ca.SX, q_bar: ca.SX, x: ca.SX
) -> ca.SX:
    """Torque of the feed-forward + PD law, in N m.

    ``gains`` is (2 n,): the diagonals of alpha, in N m/rad, and beta, in N m s/rad;
    ``x`` is the state (q, qd).
    """
    q, qd = ca.vertsplit(x, structure.segments)
    proportional, derivative = ca.vertsplit(gains, structure.segments)
    gravity = mechanics(structure, q_bar, ca.SX.zeros(q_bar.shape), values).gravity
    feedforward = values.stiffness * q_bar + gravity
    return feedforward + proportional * (q_bar - q) - derivative * qd


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
        jacobian = self._arm.tip_jacobian(q_bar)
        velocity = self._parameters.task_gain * (target - self._arm.tip(q_bar))
        gram = jacobian @ jacobian.T + self._parameters.damping**2 * np.eye(2)
        rate: Floats = jacobian.T @ np.linalg.solve(gram, velocity)
        return q_bar + self._period * rate

    def path(self, q: Floats, targets: Floats) -> Floats:
        """Commanded angles of a whole run, (T, n): the planner never looks at the arm."""
        q_bar = self.first_posture(q, targets[0])
        commanded = []
        for target in targets:
            q_bar = self.step(q_bar, target)
            commanded.append(q_bar)
        return np.array(commanded)
