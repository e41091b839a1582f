"""Plant, sea and controller, joined into one closed-loop run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softwave_min.arm import Arm, pack_flow
from softwave_min.control.baseline import Correction, InnerLoop, KinematicPlanner
from softwave_min.control.engine import Engine
from softwave_min.control.nmpc import GaussNewton, Problem, Solution, Solver, Status
from softwave_min.control.preview import Preview, noise_deviation
from softwave_min.native import compiler
from softwave_min.parameters import ParameterSet
from softwave_min.plant import CvodesPlant, ExtrapolatedPlant, Plant, RungeKuttaPlant
from softwave_min.waves import Sea

__all__ = [
    "BaselineController",
    "ClosedLoop",
    "Command",
    "Controller",
    "NmpcController",
    "Scenario",
    "SimulationError",
    "Source",
    "compile_engine",
    "engine_or_none",
    "plant_of",
    "preview_of",
    "root_mean_square_error",
    "simulate",
    "simulate_baseline",
    "simulate_nmpc",
]

Floats = NDArray[np.float64]


class SimulationError(RuntimeError):
    """A run cannot go on: a number is not finite."""


class Source(IntEnum):
    """Where a command comes from."""

    CONTROLLER = 0
    """The controller itself."""
    FORMER_PLAN = 1
    """A solve failed: the plan of an earlier one goes on."""
    PLANNER = 2
    """Solves failed for a whole horizon: the kinematic planner takes over."""


@dataclass(frozen=True)
class Command:
    """What a controller answers at one instant."""

    q_bar: Floats
    """Commanded angles for the coming period, (n,) in rad."""
    solution: Solution | None = None
    """The solve behind it, where there was one."""
    source: Source = Source.CONTROLLER


class Controller(Protocol):
    """Anything that turns the state at an instant into a command."""

    def command(self, step: int, state: Floats) -> Command:
        """Command for the control period that starts at ``step``."""


@dataclass(frozen=True)
class Scenario:
    """An arm, a sea over the whole run, and the tip's desired path."""

    parameters: ParameterSet
    arm: Arm
    targets: Floats
    """(steps + 1 + K, 2), desired tip at every control instant, in m."""
    flow: Floats
    """(steps + K, F), packed flow of every control period."""
    initial_angles: Floats
    """(n,), bending angles of the arm at rest at t = 0, in rad."""

    @classmethod
    def build(
        cls,
        parameters: ParameterSet,
        sea: Sea,
        target: ArrayLike,
        initial_angles: ArrayLike | None = None,
    ) -> Scenario:
        """Bring the tip to ``target`` from rest, straight unless ``initial_angles`` say else.

        ``target`` is one point (x, z), in m, or the desired point at every control
        instant, (steps + 1 + K, 2); a shorter path stays at its last point.
        """
        arm = Arm(parameters.arm, parameters.fluid)
        steps, horizon = _steps(parameters), parameters.nmpc.horizon
        path = np.atleast_2d(np.asarray(target, dtype=float))
        targets = path[np.minimum(np.arange(steps + 1 + horizon), len(path) - 1)]
        return cls(
            parameters,
            arm,
            targets,
            expanded_flow(parameters, arm, sea),
            np.zeros(arm.segments) if initial_angles is None else np.asarray(initial_angles, float),
        )

    @property
    def initial_state(self) -> Floats:
        """(q, qd) at rest at t = 0, (2 n,)."""
        return np.concatenate([self.initial_angles, np.zeros(self.arm.segments)])

    @property
    def gains(self) -> Floats:
        """Packed inner loop of the plant, with the failure if there is one."""
        return InnerLoop.packed(self.parameters.baseline, self.parameters.failure)

    @property
    def believed_gains(self) -> Floats:
        """Packed inner loop as the NMPC's model has it."""
        failure = self.parameters.failure
        return InnerLoop.packed(self.parameters.baseline, failure if failure.known else None)

    @property
    def period(self) -> float:
        """Control period, in s."""
        return self.parameters.nmpc.control_period

    @property
    def steps(self) -> int:
        """Control periods in the run."""
        return _steps(self.parameters)

    @property
    def times(self) -> Floats:
        """Control instants, (steps + 1,) in s."""
        instants: Floats = self.period * np.arange(self.steps + 1, dtype=float)
        return instants

    @cached_property
    def planned_angles(self) -> Floats:
        """The kinematic planner's commands, (steps + K, n) in rad."""
        planner = KinematicPlanner(self.arm, self.parameters.baseline, self.period)
        return planner.path(self.initial_angles, self.targets[1:])

    @cached_property
    def held_loads(self) -> Floats:
        """Wave loads on an arm held still at the planned angles, (steps, n) in N m.

        The signal that the preview's signal-to-noise ratio refers to: it depends
        on sea and target, and on no controller's success.
        """
        angles = self.planned_angles[: self.steps]
        return self.arm.fluid_load(angles, np.zeros_like(angles), self.flow[: self.steps])


def _steps(parameters: ParameterSet) -> int:
    return round(parameters.simulation.duration / parameters.nmpc.control_period)


def expanded_flow(parameters: ParameterSet, arm: Arm, sea: Sea) -> Floats:
    """Packed flow about the arm in every control period, horizon included.

    Row i is expanded about the base and the middle of period i, and is what plant
    and preview both read.
    """
    period = parameters.nmpc.control_period
    count = _steps(parameters) + parameters.nmpc.horizon
    middles = period * (np.arange(count) + 0.5)
    structure = arm.structure
    coefficients = sea.taylor_velocity(
        parameters.arm.base_position, middles, structure.space_order, structure.time_order
    )
    return pack_flow(coefficients)


def engine_or_none(scenario: Scenario) -> Engine | None:
    """The compiled engine where there is a compiler."""
    if compiler() is None:
        return None
    parameters = scenario.parameters
    return Engine(
        scenario.arm,
        scenario.believed_gains,
        scenario.gains,
        parameters.nmpc,
        parameters.simulation,
    )


def compile_engine(parameters: ParameterSet) -> None:
    """Compile what closed loops under the parameters need; nothing without a compiler."""
    still = Sea.still(parameters.sea.depth, parameters.fluid.gravity)
    brief = replace(parameters.simulation, duration=parameters.nmpc.control_period)
    target = parameters.arm.base_position
    engine_or_none(Scenario.build(replace(parameters, simulation=brief), still, target))


def solver_of(scenario: Scenario) -> Solver:
    """The solver that the scenario's parameters ask for, compiled where possible."""
    arguments = (scenario.arm, scenario.believed_gains, scenario.parameters.nmpc)
    # The references are imported where asked for: they bring heavy libraries.
    match scenario.parameters.nmpc.solver:
        case "gauss_newton":
            return engine_or_none(scenario) or GaussNewton(*arguments)
        case "interior_point":
            from softwave_min.control.interior_point import InteriorPoint  # noqa: PLC0415

            return InteriorPoint(*arguments)
        case "convex":
            from softwave_min.control.convex import ConvexGaussNewton  # noqa: PLC0415

            return ConvexGaussNewton(*arguments)


def plant_of(scenario: Scenario) -> Plant:
    """The plant with the integrator that the parameters ask for, compiled where possible."""
    parameters = scenario.parameters
    arguments = (scenario.arm, scenario.gains, parameters.simulation, scenario.period)
    match parameters.simulation.integrator:
        case "cvodes":
            return CvodesPlant(*arguments)
        case "runge_kutta":
            return RungeKuttaPlant(*arguments)
        case "extrapolation":
            return engine_or_none(scenario) or ExtrapolatedPlant(*arguments)


def preview_of(scenario: Scenario) -> Preview:
    """What the NMPC is told of the scenario's sea, from the first forecast on."""
    parameters = scenario.parameters
    deviation = noise_deviation(parameters.preview, scenario.held_loads)
    return Preview(scenario.flow, deviation, parameters.nmpc.horizon, parameters.preview)


class BaselineController:
    """Feed-forward + PD behind the kinematic planner, corrected where the parameters say so."""

    def __init__(self, scenario: Scenario) -> None:
        self._planned = scenario.planned_angles
        self._correction = _correction_or_none(scenario)

    def command(self, step: int, state: Floats) -> Command:
        """Next planned angles; the planner does not look at the state, a correction does."""
        planned = self._planned[step]
        if self._correction is None:
            return Command(planned)
        return Command(self._correction.command(step, state, planned))


def _correction_or_none(scenario: Scenario) -> Correction | None:
    gains = scenario.parameters.baseline
    if not gains.corrected:
        return None
    return Correction(scenario.arm, gains, scenario.period, preview_of(scenario))


class NmpcController:
    """The NMPC behind its preview, warm-started with its shifted former plan.

    A plan that is not finite is not applied. The former plan goes on in its place, and
    when that is used up the kinematic planner; both are recorded with the command.
    """

    def __init__(self, scenario: Scenario, solver: Solver | None = None) -> None:
        self._solver = solver or solver_of(scenario)
        self._horizon = scenario.parameters.nmpc.horizon
        self._preview = preview_of(scenario)
        self._targets = scenario.targets
        self._planned = scenario.planned_angles
        self._previous = scenario.initial_angles
        self._plan = np.tile(scenario.initial_angles, (self._horizon, 1))
        self._failures = 0

    def command(self, step: int, state: Floats) -> Command:
        """First input of the optimal plan from ``state``."""
        reference = self._targets[step + 1 : step + 1 + self._horizon]
        problem = Problem(state, self._previous, reference, self._preview.at(step))
        solution = self._solver.solve(problem, self._plan)
        source = Source.CONTROLLER
        if solution.status is not Status.NOT_FINITE:
            self._failures, plan = 0, solution.inputs
        else:
            self._failures += 1
            plan, source = self._plan, Source.FORMER_PLAN
            if self._failures >= self._horizon:
                plan, source = np.tile(self._planned[step], (self._horizon, 1)), Source.PLANNER
        self._previous = plan[0]
        self._plan = np.vstack([plan[1:], plan[-1:]])
        return Command(plan[0], solution, source)


@dataclass(frozen=True)
class ClosedLoop:
    """Record of one run; instants are the control instants, first and last included."""

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


def root_mean_square_error(error: Floats) -> float:
    """RMSE of a series of distances, in m."""
    return float(np.sqrt(np.mean(error**2)))


@dataclass(frozen=True)
class _History:
    """What plant and controller did."""

    states: Floats
    q_bar: Floats
    status: NDArray[np.int64]
    iterations: NDArray[np.int64]
    source: NDArray[np.int64]


def simulate(scenario: Scenario, controller: Controller) -> ClosedLoop:
    """Run plant and controller over the scenario.

    Raises
    ------
    SimulationError
        If a state or the sea is not finite, naming the time.
    """
    if not np.all(np.isfinite(scenario.flow)):
        when = scenario.period * int(np.argmin(np.isfinite(scenario.flow).all(axis=1)))
        raise SimulationError(f"the sea is not finite from t = {when:.1f} s")
    return _record(scenario, _stepped(scenario, controller))


def simulate_baseline(scenario: Scenario) -> ClosedLoop:
    """``simulate`` with the baseline; the same numbers, faster where there is a compiler.

    Raises
    ------
    SimulationError
        As ``simulate``.
    """
    parameters = scenario.parameters
    planned_alone = not parameters.baseline.corrected
    fast = planned_alone and parameters.simulation.integrator == "extrapolation"
    if fast and (engine := engine_or_none(scenario)):
        q_bar = scenario.planned_angles[: scenario.steps]
        states = engine.follow(scenario.initial_state, q_bar, scenario.flow)
        if np.all(np.isfinite(states)):
            none, zeros = np.full(scenario.steps, -1), np.zeros(scenario.steps, int)
            return _record(scenario, _History(states, q_bar, none, zeros, zeros))
    return simulate(scenario, BaselineController(scenario))


def simulate_nmpc(scenario: Scenario) -> ClosedLoop:
    """``simulate`` with the NMPC that the parameters ask for; the same numbers, faster.

    With a compiler and the default plant the whole loop runs in the engine. It ends early
    where a plan is not finite; then the run is stepped from the start, with the fallback.

    Raises
    ------
    SimulationError
        As ``simulate``.
    """
    parameters = scenario.parameters
    asked = (parameters.nmpc.solver, parameters.simulation.integrator)
    fast = asked == ("gauss_newton", "extrapolation")
    if fast and (engine := engine_or_none(scenario)):
        history = _compiled(scenario, engine)
        if len(history.q_bar) == scenario.steps and np.all(np.isfinite(history.states)):
            return _record(scenario, history)
    return simulate(scenario, NmpcController(scenario))


def _compiled(scenario: Scenario, engine: Engine) -> _History:
    preview = preview_of(scenario)
    states, q_bar, status, iterations = engine.run(
        scenario.initial_state,
        scenario.targets,
        scenario.flow,
        preview.flow,
        preview.disturbances(scenario.steps),
    )
    source = np.full(len(q_bar), int(Source.CONTROLLER))
    return _History(states, q_bar, status.astype(int), iterations.astype(int), source)


def _stepped(scenario: Scenario, controller: Controller) -> _History:
    plant = plant_of(scenario)
    states = np.tile(scenario.initial_state, (scenario.steps + 1, 1))
    commands: list[Command] = []
    for step in range(scenario.steps):
        _require_finite(scenario, states, step)
        commands.append(controller.command(step, states[step]))
        states[step + 1] = plant.advance(states[step], commands[-1].q_bar, scenario.flow[step])
    _require_finite(scenario, states, scenario.steps)
    solutions = [command.solution for command in commands]
    return _History(
        states,
        q_bar=np.array([command.q_bar for command in commands]),
        status=np.array([-1 if one is None else one.status for one in solutions]),
        iterations=np.array([0 if one is None else one.iterations for one in solutions]),
        source=np.array([int(command.source) for command in commands]),
    )


def _require_finite(scenario: Scenario, states: Floats, step: int) -> None:
    if not np.all(np.isfinite(states[step])):
        raise SimulationError(f"the state is not finite at t = {scenario.times[step]:.1f} s")


def _record(scenario: Scenario, history: _History) -> ClosedLoop:
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
