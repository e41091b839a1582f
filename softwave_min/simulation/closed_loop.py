"""Plant, sea and controller, joined into one closed-loop run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from softwave_min.simulation.backends import plant_of
from softwave_min.simulation.controllers import (
    Command,
    Compiled,
    Controller,
    Factory,
    History,
    factory_of,
)
from softwave_min.simulation.scenario import Scenario

Floats = NDArray[np.float64]


class SimulationError(RuntimeError):
    """A run cannot go on: a number is not finite."""


@dataclass(frozen=True)
class ClosedLoop:
    """Record of one run; instants are the control instants, first and last included."""

    TRANSIENT: ClassVar[float] = 10.0
    """Seconds after which a run counts as settled."""

    time: Floats
    """(T + 1,), in s."""
    q: Floats
    """(T + 1, n), in rad."""
    qd: Floats
    """(T + 1, n), in rad/s."""
    q_bar: Floats
    """(T, n), command in force from each instant but the last, in rad."""
    tips: Floats
    """(T + 1, n, 2), tips of the segments, in m."""
    target: Floats
    """(T + 1, 2), desired tip, in m."""
    torque: Floats
    """(T, n), actuation torque just after each command, in N m."""
    wave_torque: Floats
    """(T, n), generalised load of the water at those instants, in N m."""
    status: NDArray[np.int64]
    """(T,), status of each solve, -1 where there was none."""
    iterations: NDArray[np.int64]
    """(T,), iterations of each solve, 0 where there was none."""
    source: NDArray[np.int64]
    """(T,), where each command comes from, see ``Source``."""

    @property
    def error(self) -> Floats:
        """Distance of the tip from its target, (T + 1,) in m."""
        offset = self.tips[:, -1] - self.target
        distance: Floats = np.hypot(offset[:, 0], offset[:, 1])
        return distance

    @property
    def rmse(self) -> float:
        """RMSE of the tip over the whole run, start included, in m."""
        return root_mean_square_error(self.error)

    @property
    def settled_rmse(self) -> float:
        """RMSE of the tip from ``TRANSIENT`` on, in m; NaN if the run ends before."""
        settled = self.error[round(self.TRANSIENT / self.time[1]) :]
        return root_mean_square_error(settled) if len(settled) else float("nan")


def root_mean_square_error(error: Floats) -> float:
    """RMSE of a series of distances, in m."""
    return float(np.sqrt(np.mean(error**2)))


def simulate(scenario: Scenario, controller: Controller | Factory | str) -> ClosedLoop:
    """Run plant and controller over the scenario.

    Parameters
    ----------
    scenario : Scenario
    controller : Controller, class of controllers or str
        A controller, or what makes one for the scenario: its class, or its name in
        ``CONTROLLERS``. One that is made here does the whole run in the compiled engine where
        that can, with the same numbers.

    Raises
    ------
    SimulationError
        If a state or the sea is not finite, naming the time.
    ValueError
        If there is no controller of that name.
    """
    if not np.all(np.isfinite(scenario.flow)):
        when = scenario.period * int(np.argmin(np.isfinite(scenario.flow).all(axis=1)))
        raise SimulationError(f"the sea is not finite from t = {when:.1f} s")
    if factory := factory_of(controller):
        controller = factory(scenario)
        history = controller.whole_run() if isinstance(controller, Compiled) else None
        if history and np.all(np.isfinite(history.states)):
            return _record(scenario, history)
    return _record(scenario, _stepped(scenario, cast(Controller, controller)))


def _stepped(scenario: Scenario, controller: Controller) -> History:
    plant = plant_of(scenario)
    states = np.tile(scenario.initial_state, (scenario.steps + 1, 1))
    commands: list[Command] = []
    for step in range(scenario.steps):
        _require_finite(scenario, states, step)
        commands.append(controller.command(step, states[step]))
        states[step + 1] = plant.advance(states[step], commands[-1].q_bar, scenario.flow[step])
    _require_finite(scenario, states, scenario.steps)
    solutions = [command.solution for command in commands]
    return History(
        states,
        q_bar=np.array([command.q_bar for command in commands]),
        status=np.array([-1 if one is None else one.status for one in solutions]),
        iterations=np.array([0 if one is None else one.iterations for one in solutions]),
        source=np.array([int(command.source) for command in commands]),
    )


def _require_finite(scenario: Scenario, states: Floats, step: int) -> None:
    if not np.all(np.isfinite(states[step])):
        raise SimulationError(f"the state is not finite at t = {scenario.times[step]:.1f} s")


def _record(scenario: Scenario, history: History) -> ClosedLoop:
    arm, steps = scenario.arm, scenario.steps
    q, qd = np.hsplit(history.states, 2)
    q_bar = history.q_bar
    proportional, derivative, actuated, _ = np.split(scenario.gains, 4)
    feedforward = arm.stiffness_vector(q_bar) + arm.gravity_vector(q_bar)
    feedback = proportional * (q_bar - q[:-1]) - derivative * qd[:-1]
    flow = scenario.flow[:steps]
    return ClosedLoop(
        time=scenario.times,
        q=q,
        qd=qd,
        q_bar=q_bar,
        tips=arm.segment_tips(q),
        target=scenario.targets[: steps + 1],
        torque=actuated * (feedforward + feedback),
        wave_torque=arm.fluid_load(q[:-1], qd[:-1], flow, time=-scenario.period / 2),
        status=history.status,
        iterations=history.iterations,
        source=history.source,
    )
