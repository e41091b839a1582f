"""The paper's Fig. various_setpoints: which poses an arm with a failed segment holds (C44-C47).

Each pose is asked for twice. The kinematics say how close any posture at rest brings
the tip, whatever the controller. The NMPC, in still water and from the straight arm,
says which posture it ends in.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any, Literal

import casadi as ca
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import binary_erosion
from scipy.optimize import least_squares

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.experiments.closed_loop import LoopRun, closed_loops, prepare, with_failure
from softwave_min.paper.cases import poses
from softwave_min.parameters import (
    ArmParameters,
    FailureParameters,
    FluidParameters,
    ParameterSet,
)
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables, Tolerance

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Row = Mapping[str, float | int | str | bool]


@dataclass(frozen=True)
class Case:
    """A state of the actuation."""

    segment: int
    """Number of the failed segment, from 1; 0 for none."""
    manner: Literal["passive", "locked"]
    words: str
    """For legends."""

    def of(self, parameters: ParameterSet) -> ParameterSet:
        """The parameters with this failure."""
        return with_failure(parameters, self.segment, self.manner)


CASES = {
    "intact": Case(0, "passive", "all segments"),
    "mid_passive": Case(2, "passive", "second segment passive"),
    "tip_passive": Case(3, "passive", "third segment passive"),
    "mid_locked": Case(2, "locked", "second segment locked"),
    "tip_locked": Case(3, "locked", "third segment locked"),
}
REACHED = 1e-3
"""A tip closer to its target than this, in m, has reached it."""
REST = 15.0
"""Seconds in still water after which the NMPC's posture is taken."""
CELL = 0.01
"""Side of a cell of the map of the workspace, in m."""
NODES = {2: 65, 3: 27}
"""Angles on each axis of the grid on which tips are computed, by the number of actuated
angles. A cubic spline through 65 errs by less than 1e-5 m."""
STARTS = 5
"""Postures, the nearest of a grid, from which the least squares start."""


@dataclass(frozen=True)
class Reach:
    """All that determines where an arm's tip can be at rest."""

    arm: ArmParameters
    fluid: FluidParameters
    failure: FailureParameters
    angle_bound: float
    """Bound on every actuated angle, in rad."""
    targets: tuple[tuple[float, float], ...]
    """Desired tips, in m."""


class RestingArm:
    """Postures at rest in still water, as functions of the actuated angles.

    A working segment stands where it is told to. A locked one stays straight. A passive
    one hangs: no torque acts on it but those of its stiffness and of weight and
    buoyancy, so that G_f(q) + k_f q_f = 0, its row of the equations of motion.

    Parameters
    ----------
    arm : Arm
    failure : FailureParameters

    Raises
    ------
    ValueError
        If a passive segment has no stiffness: nothing then says how it hangs.
    """

    def __init__(self, arm: Arm, failure: FailureParameters) -> None:
        self.arm = arm
        self.actuated = arm.segments - (failure.segment > 0)
        """Number of angles that can be chosen, m."""
        hanging = failure.segment > 0 and failure.manner == "passive"
        if hanging and arm.parameters.stiffness[failure.segment - 1] == 0:
            raise ValueError("a passive segment without stiffness has no posture of its own")
        self._function = _rest_function(arm.structure, failure.segment, failure.manner)

    def postures(self, actuated: ArrayLike) -> Floats:
        """All angles from the actuated ones: (m,) to (n,), or (T, m) to (T, n), in rad."""
        return self._evaluated("posture", actuated)

    def tips(self, actuated: ArrayLike) -> Floats:
        """Tip at rest, in m: (2,) or (T, 2)."""
        return self._evaluated("tip", actuated)

    def jacobian(self, actuated: ArrayLike) -> Floats:
        """Derivative of the tip at rest by the actuated angles, in m/rad: (2, m)."""
        return self._evaluated("jacobian", actuated).reshape(-1, 2).T

    def _evaluated(self, output: str, actuated: ArrayLike) -> Floats:
        angles = np.asarray(actuated, dtype=float)
        values = np.repeat(self.arm.values[:, None], np.atleast_2d(angles).shape[0], axis=1)
        try:
            answer = self._function(a=ca.DM(np.atleast_2d(angles).T), values=ca.DM(values))
        except RuntimeError:
            raise ArithmeticError("found no equilibrium of the passive segment") from None
        rows: Floats = answer[output].full().T
        return rows if angles.ndim > 1 else rows[0]


@cache
def _rest_function(structure: Structure, failed: int, manner: str) -> ca.Function:
    n = structure.segments
    q, packed = ca.SX.sym("q", n), ca.SX.sym("values", Values.size(n))
    values = Values.unpacked(packed, n)
    terms = mechanics(structure, q, ca.SX.zeros(n), values)
    tip = ca.Function("tip", [q, packed], [terms.tips[-1]])
    chosen = ca.MX.sym("chosen", n - (failed > 0))
    numbers = ca.MX.sym("numbers", Values.size(n))
    angles = ca.vertsplit(chosen)
    if failed:
        hanging = ca.MX(0)
        if manner == "passive":
            balance = (terms.gravity + values.stiffness * q)[failed - 1]
            others = [q[i] for i in range(n) if i != failed - 1]
            problem = {"x": q[failed - 1], "p": ca.vertcat(*others, packed), "g": balance}
            root = ca.rootfinder("root", "newton", problem, {"abstol": 1e-12})
            hanging = root(x0=0, p=ca.vertcat(chosen, numbers))["x"]
        angles.insert(failed - 1, hanging)
    posture = ca.vertcat(*angles)
    place = tip(posture, numbers)
    return ca.Function(
        "rest",
        [chosen, numbers],
        [posture, place, ca.vec(ca.jacobian(place, chosen))],
        ["a", "values"],
        ["posture", "tip", "jacobian"],
    )


def nearest_posture(
    resting: RestingArm, bound: float, target: ArrayLike, starts: Floats
) -> tuple[Floats, float]:
    """Posture at rest whose tip is closest to a target, by bounded least squares.

    Parameters
    ----------
    resting : RestingArm
    bound : float
        On every actuated angle, in rad.
    target : array_like, (2,)
        In m.
    starts : ndarray, (S, m)
        Actuated angles to start from, in rad, until one reaches the target.

    Returns
    -------
    posture : ndarray, (n,)
        In rad; the best of all starts.
    distance : float
        What is left between tip and target, in m.
    """

    def offset(angles: Floats) -> Floats:
        left: Floats = resting.tips(angles) - np.asarray(target)
        return left

    best, closest = starts[0], np.inf
    for start in starts:
        fit = least_squares(
            offset,
            start,
            jac=resting.jacobian,
            bounds=(-bound, bound),
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
        distance = float(np.linalg.norm(fit.fun))
        if distance < closest:
            best, closest = fit.x, distance
        if closest < REACHED / 1000:
            break
    return resting.postures(best), closest


def _grid_of_angles(count: int, angles: int, bound: float) -> Floats:
    """All combinations of evenly spaced angles, (count^angles, angles) in rad."""
    axis = np.linspace(-bound, bound, count)
    return np.stack(np.meshgrid(*[axis] * angles, indexing="ij"), axis=-1).reshape(-1, angles)


def workspace(resting: RestingArm, bound: float, cell: float = CELL) -> Booleans:
    """Map of the places that the tip can be at rest.

    The plane is cut into square cells about the base; a cell is True where the tip of
    one of a dense set of postures falls into it. Neighbours in that set are less than
    a cell apart.

    Returns
    -------
    ndarray of bool, (N, N)
        Entry (i, j): the cell with its lower left corner at
        base + cell (i - N/2, j - N/2).
    """
    reach = sum(resting.arm.parameters.length)
    half = int(np.ceil(reach / cell)) + 1
    hit = np.zeros((2 * half) ** 2, dtype=bool)
    base = np.asarray(resting.arm.parameters.base_position)
    for tips in _dense_tips(resting, bound, cell / reach):
        column, row = np.floor((tips - base) / cell).astype(int).T + half
        hit[column * 2 * half + row] = True
    return hit.reshape(2 * half, 2 * half)


def _dense_tips(resting: RestingArm, bound: float, step: float) -> Iterator[Floats]:
    """Tips of postures whose last two actuated angles are less than ``step`` rad apart."""
    arm, leading = resting.arm, resting.actuated - 2
    nodes = np.linspace(-bound, bound, NODES[2])
    last_two = _grid_of_angles(NODES[2], 2, bound)
    angles = np.hstack([np.zeros((len(last_two), leading)), last_two])
    on_grid = resting.tips(angles).reshape(NODES[2], NODES[2], 2)
    # Without redundancy each place counts on few postures; with it, on a whole family.
    spacing = 2 * step if leading else step / 2
    dense = np.linspace(-bound, bound, int(np.ceil(2 * bound / spacing)) + 1)
    tips = np.stack(
        [RectBivariateSpline(nodes, nodes, on_grid[..., i])(dense, dense).ravel() for i in (0, 1)],
        axis=-1,
    )
    if not leading:
        yield tips
        return
    # What lies beyond the leading segments moves with their end as a rigid body.
    straight = arm.segment_tips(np.zeros(arm.segments))[leading - 1]
    for bend in product(dense, repeat=leading):
        posture = np.append(bend, np.zeros(2))
        cosine, sine = np.cos(sum(bend)), np.sin(sum(bend))
        turn = np.array([[cosine, -sine], [sine, cosine]])
        yield arm.segment_tips(posture)[leading - 1] + (tips - straight) @ turn.T


def area(cells: Booleans, cell: float = CELL) -> tuple[float, float]:
    """Area of a map of cells, and the error of its resolution, in m^2.

    Cells on the rim count half: the rim may pass anywhere through them.
    """
    inner = np.count_nonzero(binary_erosion(cells))
    rim = np.count_nonzero(cells) - inner
    return float((inner + rim / 2) * cell**2), float(rim / 2 * cell**2)


def reach(question: Reach) -> dict[str, NDArray[Any]]:
    """Distance left to each target and the map of the workspace.

    Returns
    -------
    dict of ndarray
        ``distance`` (P,) in m; ``posture`` (P, n) in rad; ``workspace`` (N, N).
    """
    resting = RestingArm(Arm(question.arm, question.fluid), question.failure)
    bound, m = question.angle_bound, resting.actuated
    grid = _grid_of_angles(NODES[m], m, bound)
    tips = resting.tips(grid)
    answers = [
        nearest_posture(
            resting,
            bound,
            target,
            grid[np.argsort(np.linalg.norm(tips - np.asarray(target), axis=1))[:STARTS]],
        )
        for target in question.targets
    ]
    return {
        "posture": np.array([posture for posture, _ in answers]),
        "distance": np.array([distance for _, distance in answers]),
        "workspace": workspace(resting, bound),
    }


def at_rest(parameters: ParameterSet) -> dict[str, NDArray[Any]]:
    """Where the NMPC ends for each pose.

    Returns
    -------
    dict of ndarray
        ``q`` (P, n) in rad, ``error`` (P,) in m, at the end of the run; ``status`` and
        ``source`` (P, T).
    """
    loops = [closed_loops(LoopRun(parameters, (pose,), ("nmpc",))) for pose in poses().values()]
    return {
        "q": np.array([loop["nmpc_q"][-1] for loop in loops]),
        "error": np.array([loop["nmpc_error"][-1] for loop in loops]),
        "status": np.array([loop["nmpc_status"] for loop in loops]),
        "source": np.array([loop["nmpc_source"] for loop in loops]),
    }


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """For each case, what the kinematics allow and where the NMPC ends."""
    still = replace(
        parameters,
        sea=replace(parameters.sea, significant_height=0.0, realisations=1),
        simulation=replace(parameters.simulation, duration=REST),
    )
    found: list[Run] = []
    for name, case in CASES.items():
        failed = case.of(still)
        question = Reach(
            failed.arm,
            failed.fluid,
            failed.failure,
            failed.nmpc.angle_bound,
            tuple(poses().values()),
        )
        found += [Run(f"rest-{name}", at_rest, failed), Run(f"reach-{name}", reach, question)]
    return found


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:  # noqa: ARG001
    """Poses and areas of the workspace, for each case."""
    setpoints = [row for name in CASES for row in _pose_rows(name, arrays)]
    areas = {name: area(arrays[f"reach-{name}"]["workspace"]) for name in CASES}
    whole = areas["intact"][0]
    return {
        "setpoints": pd.DataFrame(setpoints),
        "workspace": pd.DataFrame(
            {"case": name, "area": size, "resolution": error, "share": size / whole}
            for name, (size, error) in areas.items()
        ),
    }


def _pose_rows(name: str, arrays: RunArrays) -> Iterator[Row]:
    allowed, held = arrays[f"reach-{name}"], arrays[f"rest-{name}"]
    for index, pose in enumerate(poses()):
        distance = float(allowed["distance"][index])
        angles = {f"q{i + 1}": float(angle) for i, angle in enumerate(held["q"][index])}
        yield {
            "case": name,
            "pose": pose,
            **angles,
            "error": float(held["error"][index]),
            "distance_left": distance,
            "reachable": distance < REACHED,
            "solves_failed": int(np.count_nonzero(held["status"][index] > 0)),
            "fallbacks": int(np.count_nonzero(held["source"][index])),
        }


EXPERIMENT = Experiment(
    name="setpoints",
    title="Postures at the paper's poses and the workspace, with and without a failed segment",
    claims=("C15", "C16", "C17", "C18", "C19", "C20", "C44", "C45", "C46", "C47", "C70"),
    runs=runs,
    tabulate=tabulate,
    prepare=prepare,
    tolerances={
        # A cell of the map more or less, as rounding decides.
        "area": Tolerance(absolute=2e-3),
        "resolution": Tolerance(absolute=2e-3),
        "share": Tolerance(absolute=2e-3),
        # Along the arm's redundancy the last digits of an angle cost nothing.
        **{column: Tolerance(absolute=1e-3) for column in ("q1", "q2", "q3")},
    },
)
