"""do-mpc on recorded problems. Runs in the bench's own environment, see ``run.py``.

    python peers.py RECORDING...

It is asked for a few problems at a time, so that it takes turns with the others. Two
formulations, both with the package's default settings: the arm as a continuous model, which
do-mpc discretises by its own collocation; and the predictor's step as a discrete model, which
is the very problem that the other methods solve.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # about its optional parts
    import do_mpc

from recording import Recording, bench_parameters

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.control.baseline import InnerLoop
from softwave_min.control.predictor import PeriodSteps
from softwave_min.control.problem import Period, Weights, residuals
from softwave_min.control.reference.interior_point import transition_function
from softwave_min.parameters import NmpcParameters, ParameterSet

Floats = NDArray[np.float64]
FORMULATIONS = ("collocation", "discrete")


class Peer:
    """do-mpc's controller for the bench's optimal control problem."""

    def __init__(self, parameters: ParameterSet, formulation: str) -> None:
        self._arm = Arm(parameters.arm, parameters.fluid)
        self._parameters = parameters
        self._structure = self._arm.structure
        self._continuous = formulation == "collocation"
        self._mpc = self._controller(self._model())

    def restart(self, state: Floats, guess: Floats) -> None:
        """Begin a closed loop."""
        self._mpc.reset_history()
        self._mpc.x0, self._mpc.u0 = state, guess[0]
        self._mpc.set_initial_guess()

    def solve(self, recording: Recording, index: int) -> tuple[Floats, int, bool]:
        """Applied input, iterations and success; the guess is do-mpc's own former solution."""
        periods = len(recording.reference[index])
        reference = np.vstack([recording.reference[index][:1], recording.reference[index]])
        flow = recording.flow[index]
        parts = (
            self._held_flow(flow) if self._continuous else flow,
            recording.disturbance[index],
        )
        forecasts = [np.vstack([part, part[-1:]]) for part in parts]
        template = self._template
        for k in range(periods + 1):
            template["_tvp", k] = np.concatenate([*(one[k] for one in forecasts), reference[k]])
        self._mpc.u0 = recording.previous[index]
        applied = self._mpc.make_step(recording.state[index]).ravel()
        stats = self._mpc.solver_stats
        return applied, stats["iter_count"], stats["success"]

    def _held_flow(self, flow: Floats) -> Floats:
        """Flow in the middle of each period: what do-mpc can hold over a step."""
        return flow[:, :: self._structure.time_order + 1]

    def _model(self) -> do_mpc.model.Model:
        n, structure = self._arm.segments, self._structure
        model = do_mpc.model.Model("continuous" if self._continuous else "discrete", "SX")
        x = model.set_variable("_x", "x", shape=(2 * n, 1))
        q_bar = model.set_variable("_u", "q_bar", shape=(n, 1))
        size = structure.flow_size
        if self._continuous:
            size //= structure.time_order + 1
        flow = model.set_variable("_tvp", "flow", shape=(size, 1))
        load = model.set_variable("_tvp", "disturbance", shape=(n, 1))
        model.set_variable("_tvp", "reference", shape=(2, 1))
        law = _rate if self._continuous else _transition
        model.set_rhs("x", law(self._parameters, structure)(x, q_bar, flow, load, *self._fixed()))
        model.setup()
        return model

    def _fixed(self) -> tuple[ca.DM, ca.DM]:
        gains = InnerLoop.packed(self._parameters.baseline, None)
        return ca.DM(gains), ca.DM(self._arm.values)

    def _controller(self, model: do_mpc.model.Model) -> do_mpc.controller.MPC:
        nmpc = self._parameters.nmpc
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon = nmpc.horizon
        mpc.settings.t_step = nmpc.control_period
        mpc.settings.supress_ipopt_output()
        tip = _tip(self._structure)(model.x["x"], ca.DM(self._arm.values))
        error = nmpc.tip_weight * ca.sumsqr(tip - model.tvp["reference"])
        _refuse_what_is_not_stated(nmpc, self._arm.segments)
        mpc.set_objective(mterm=ca.SX(nmpc.terminal_weight) * error, lterm=error)
        mpc.set_rterm(q_bar=nmpc.step_weight)
        for side, sign in (("lower", -1), ("upper", 1)):
            mpc.bounds[side, "_u", "q_bar"] = sign * nmpc.angle_bound
        self._template = mpc.get_tvp_template()
        mpc.set_tvp_fun(lambda _: self._template)
        mpc.setup()
        return mpc


def _refuse_what_is_not_stated(nmpc: NmpcParameters, segments: int) -> None:
    """The cost is stated anew for do-mpc, which has a form of its own: without soft bounds."""
    weights = Weights.unpacked(ca.SX.sym("weights", Weights.size()))
    terms = set(residuals(Period.symbolic(segments), weights))
    stated = {"tip_error", "change_of_command"}
    if nmpc.torque_bound == 0:
        stated.add("torque_beyond_bound")
    if terms - stated:
        raise ValueError(f"the cost for do-mpc lacks: {', '.join(sorted(terms - stated))}")


Law = Callable[..., ca.SX]


def _rate(parameters: ParameterSet, structure: Structure) -> Law:
    """Derivative of the state under the flow held from the middle of the period."""
    n, columns = structure.segments, structure.time_order + 1

    def law(x: ca.SX, q_bar: ca.SX, held: ca.SX, load: ca.SX, gains: ca.DM, values: ca.DM) -> ca.SX:
        unpacked = Values.unpacked(ca.SX(values), n)
        terms = mechanics(structure, x[:n], x[n:], unpacked)
        loop = InnerLoop.unpacked(ca.SX(gains), n)
        flow = ca.SX(structure.flow_size, 1)
        flow[::columns] = held
        force = loop.torque(structure, unpacked, q_bar, x) + terms.fluid_load(flow, 0) + load
        return ca.vertcat(x[n:], terms.acceleration(force, loop.locked))

    if parameters.fluid.morison != "paper":
        raise ValueError("the flow's acceleration is not told to do-mpc")
    return law


def _transition(parameters: ParameterSet, structure: Structure) -> Law:
    nmpc = parameters.nmpc
    function = transition_function(structure, PeriodSteps.of(nmpc))
    return lambda *inputs: function(*inputs)[0]


def _tip(structure: Structure) -> Law:
    n = structure.segments

    def tip(x: ca.SX, values: ca.DM) -> ca.SX:
        unpacked = Values.unpacked(ca.SX(values), n)
        return mechanics(structure, x[:n], ca.SX.zeros(n), unpacked).tips[-1]

    return tip


class Server:
    """Answers what ``run.py`` asks, formulation by formulation."""

    def __init__(self, recordings: list[Recording]) -> None:
        self._places = [
            (recording, index) for recording in recordings for index in range(len(recording.state))
        ]
        parameters = bench_parameters()
        self._peers = {name: Peer(parameters, name) for name in FORMULATIONS}

    def answer(self, formulation: str, indices: range) -> list[dict[str, Any]]:
        """Time, input, iterations and success of these problems, in their order."""
        return [self._sample(self._peers[formulation], *self._places[i]) for i in indices]

    def _sample(self, peer: Peer, recording: Recording, index: int) -> dict[str, Any]:
        if index == 0:
            peer.restart(recording.state[0], recording.guess[0])
        started = time.process_time()
        applied, iterations, success = peer.solve(recording, index)
        seconds = time.process_time() - started
        return {
            "seconds": seconds,
            "iterations": iterations,
            "failed": not success,
            "applied": applied.tolist(),
        }


def main() -> None:
    """Say the version, then answer each line of the input, [formulation, first, end]."""
    server = Server([Recording.load(Path(path)) for path in sys.argv[1:]])
    print(json.dumps(do_mpc.__version__), flush=True)
    for line in sys.stdin:
        formulation, first, end = json.loads(line)
        print(json.dumps(server.answer(formulation, range(first, end))), flush=True)


if __name__ == "__main__":
    main()
