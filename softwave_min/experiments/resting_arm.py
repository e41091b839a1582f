"""Postures at rest of an arm with or without a failed segment, and what its tip reaches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import scipy  # whose parts are loaded when they are used
from numpy.typing import ArrayLike, NDArray

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.experiments.closed_loop import LoopRun, closed_loops
from softwave_min.parameters import ArmParameters, FailureParameters, FluidParameters, ParameterSet

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Point = tuple[float, float]

REACHED = 1e-3
"""A tip closer to its target than this, in m, has reached it."""
CELL = 0.01
"""Side of a cell of the map of the workspace, in m."""
NODES = {1: 65, 2: 65, 3: 27}
"""Angles on each axis of the grid on which tips are computed, by the number of actuated
angles. A cubic spline through 65 errs by less than 1e-5 m."""
SAMPLES = 20_000
"""Postures in place of that grid where there are more angles."""
LEADING, COARSE = 100, 33
"""Choices of the angles before the last two, and nodes of the last two, where a segment hangs
and every combination would be too many."""
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
    targets: tuple[Point, ...]
    """Desired tips, in m."""


class RestingArm:
    """Postures at rest in still water, as functions of the actuated angles.

    A working segment stands where it is told to. A locked one stays straight. A passive
    one hangs: no torque acts on it but those of its stiffness and of weight and
    buoyancy, so that G_f(q) + k_f q_f = 0, its row of the equations of motion. One without
    stiffness is a ValueError: nothing then says how it hangs.
    """

    def __init__(self, arm: Arm, failure: FailureParameters) -> None:
        self.arm = arm
        self.actuated = tuple(i for i in range(arm.segments) if i != failure.segment - 1)
        """Segments whose angles can be chosen, from 0."""
        self.hangs = failure.segment > 0 and failure.manner == "passive"
        """Whether a segment hangs by its weight."""
        if self.hangs and arm.parameters.stiffness[failure.segment - 1] == 0:
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

    ``bound`` on every actuated angle in rad, ``target`` (2,) in m, ``starts`` (S, m): actuated
    angles in rad to start from, until one reaches the target.

    Returns
    -------
    posture : ndarray, (n,)
        In rad; the best of all starts.
    distance : float
        What is left between tip and target, in m.
    """

    def offset(angles: Floats) -> Floats:
        return np.asarray(resting.tips(angles) - np.asarray(target))

    best, closest = starts[0], np.inf
    for start in starts:
        fit = scipy.optimize.least_squares(
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


def _spread_angles(count: int, angles: int, bound: float) -> Floats:
    """Evenly spread choices of many angles, (count, angles) in rad: Halton's sequence."""
    return bound * (2 * scipy.stats.qmc.Halton(angles, scramble=False).random(count) - 1)


def workspace(resting: RestingArm, bound: float, cell: float = CELL) -> Booleans:
    """Map of the places that the tip can be at rest, (N, N).

    The plane is cut into square cells about the base, that of (i, j) with its lower left
    corner at base + cell (i - N/2, j - N/2); it is True where the tip of one of a dense set
    of postures falls into it. Neighbours in that set are less than a cell apart. Where a
    segment hangs and more than two angles are actuated, the set is dense in the last two of
    them alone, and the map lacks a little of its rim.
    """
    reach = sum(resting.arm.parameters.length)
    half = int(np.ceil(reach / cell)) + 1
    base = np.asarray(resting.arm.parameters.base_position)
    step, leading = cell / reach, resting.actuated[:-2]

    def hit(parts: Iterable[Floats]) -> Booleans:
        found = np.zeros((2 * half) ** 2, dtype=bool)
        for tips in parts:
            column, row = np.floor((tips - base) / cell).astype(int).T + half
            found[column * 2 * half + row] = True
        return found.reshape(2 * half, 2 * half)

    if len(resting.actuated) < 2:
        return hit([resting.tips(_axis(bound, step / 2)[:, None])])
    if not leading:
        # Without redundancy each place counts on few postures; with it, on a whole family.
        return hit([_last_two(resting, np.zeros(0), _axis(bound, step / 2))])
    bends = _axis(bound, 2 * step)
    if resting.hangs:
        choices = _spread_angles(LEADING, len(leading), bound)
        return hit(_last_two(resting, chosen, bends, COARSE) for chosen in choices)
    points = _last_two(resting, np.zeros(len(leading)), bends)
    for segment in reversed(leading):
        cells = hit(_swept(resting.arm, segment, bends, points))
        points = base + cell * (np.argwhere(cells) - half + 0.5)
    return cells


def _axis(bound: float, spacing: float) -> Floats:
    """Angles at most ``spacing`` apart, in rad."""
    return np.linspace(-bound, bound, int(np.ceil(2 * bound / spacing)) + 1)


def _last_two(resting: RestingArm, leading: Floats, dense: Floats, count: int = NODES[2]) -> Floats:
    """Tips for all pairs of the last two actuated angles, the others as given."""
    nodes = np.linspace(dense[0], dense[-1], count)
    last_two = _grid_of_angles(count, 2, dense[-1])
    angles = np.hstack([np.tile(leading, (len(last_two), 1)), last_two])
    on_grid = resting.tips(angles).reshape(count, count, 2)
    return np.stack(
        [
            scipy.interpolate.RectBivariateSpline(nodes, nodes, on_grid[..., i])(
                dense, dense
            ).ravel()
            for i in (0, 1)
        ],
        axis=-1,
    )


def _swept(arm: Arm, segment: int, bends: Floats, points: Floats) -> Iterator[Floats]:
    """Points beyond a segment that was straight, which move with its end as a rigid body."""
    straight = arm.segment_tips(np.zeros(arm.segments))[segment]
    for bend in bends:
        end = arm.segment_tips(bend * np.eye(arm.segments)[segment])[segment]
        cosine, sine = np.cos(bend), np.sin(bend)
        yield end + (points - straight) @ np.array([[cosine, sine], [-sine, cosine]])


def area(cells: Booleans, cell: float = CELL) -> tuple[float, float]:
    """Area of a map of cells, and the error of its resolution, in m^2.

    Cells on the rim count half: the rim may pass anywhere through them.
    """
    inner = np.count_nonzero(scipy.ndimage.binary_erosion(cells))
    rim = np.count_nonzero(cells) - inner
    return float((inner + rim / 2) * cell**2), float(rim / 2 * cell**2)


def reach(question: Reach) -> dict[str, NDArray[Any]]:
    """``distance`` (P,) left to each target, in m; ``posture`` (P, n) in rad; ``workspace``."""
    resting = RestingArm(Arm(question.arm, question.fluid), question.failure)
    bound, m = question.angle_bound, len(resting.actuated)
    grid = _grid_of_angles(NODES[m], m, bound) if m in NODES else _spread_angles(SAMPLES, m, bound)
    tips = resting.tips(grid)
    postures, distances = [], []
    for target in question.targets:
        nearest = np.argsort(np.linalg.norm(tips - np.asarray(target), axis=1))[:STARTS]
        posture, distance = nearest_posture(resting, bound, target, grid[nearest])
        postures.append(posture)
        distances.append(distance)
    return {
        "posture": np.array(postures),
        "distance": np.array(distances),
        "workspace": workspace(resting, bound),
    }


@dataclass(frozen=True)
class RestRun:
    """All that determines where the NMPC ends in still water."""

    parameters: ParameterSet
    targets: tuple[Point, ...]


def at_rest(run: RestRun) -> dict[str, NDArray[Any]]:
    """Where the NMPC ends for each target: ``q`` (P, n) in rad and ``error`` (P,) in m.

    Beside them ``status`` and ``source`` (P, T) of all of the run.
    """
    loops = [closed_loops(LoopRun(run.parameters, (target,), ("nmpc",))) for target in run.targets]
    return {
        "q": np.array([loop["nmpc_q"][-1] for loop in loops]),
        "error": np.array([loop["nmpc_error"][-1] for loop in loops]),
        "status": np.array([loop["nmpc_status"] for loop in loops]),
        "source": np.array([loop["nmpc_source"] for loop in loops]),
    }
