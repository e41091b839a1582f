"""Arms, waters and states that the tests of the arm draw from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
from hypothesis import strategies as st

from softwave_min.arm import Arm, Structure, Values, mechanics
from softwave_min.parameters import ArmParameters, FluidParameters

MODES = ("paper", "textbook")

UNEQUAL = ArmParameters(
    length=(0.4, 0.25, 0.15),
    diameter=(0.08, 0.05, 0.03),
    density=(1300.0, 1080.0, 950.0),
    stiffness=(3.0, 1.0, 0.4),
    damping=(0.5, 0.3, 0.1),
    base_position=(0.7, -3.2),
    base_angle=0.4,
    quadrature_points=8,
    rotary_inertia=True,
)
"""No two segments alike; so many quadrature points that sums are integrals."""


def uniform(segments: int, **changes: object) -> ArmParameters:
    """The nominal arm with any number of segments."""
    alike = {"length": 0.3, "diameter": 0.05, "density": 1080.0, "stiffness": 1.0, "damping": 0.3}
    nominal = {
        **{name: (value,) * segments for name, value in alike.items()},
        "base_position": (0.0, -4.0),
        "base_angle": 0.0,
        "quadrature_points": 8,
        "rotary_inertia": False,
    }
    return ArmParameters(**{**nominal, **changes})


WATER = FluidParameters(
    density=1025.0,
    gravity=9.81,
    inertia_coefficient=1.8,
    drag_coefficient=1.1,
    friction_coefficient=0.07,
    morison="paper",
)


def water(morison: str, **changes: float) -> FluidParameters:
    """`WATER` in one reading of the Morison load."""
    return replace(WATER, morison=morison, **changes)


@dataclass(frozen=True)
class Case:
    """An arm in water at one state."""

    arm: Arm
    q: np.ndarray
    qd: np.ndarray


def numbers(lowest: float, highest: float) -> st.SearchStrategy[float]:
    return st.floats(lowest, highest, allow_subnormal=False)


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Any arm of one to five segments, rarely alike, in any water, in any state."""
    n = draw(st.integers(1, 5))

    def each(lowest: float, highest: float) -> tuple[float, ...]:
        return tuple(draw(st.lists(numbers(lowest, highest), min_size=n, max_size=n)))

    arm = ArmParameters(
        length=each(0.1, 1.0),
        diameter=each(0.02, 0.15),
        density=each(500.0, 2000.0),
        stiffness=each(0.0, 10.0),
        damping=each(0.0, 1.0),
        base_position=(draw(numbers(-5, 5)), draw(numbers(-15, -5))),
        base_angle=draw(numbers(-np.pi, np.pi)),
        quadrature_points=4,
        rotary_inertia=draw(st.booleans()),
    )
    fluid = FluidParameters(
        density=draw(numbers(500.0, 1100.0)),
        gravity=9.81,
        inertia_coefficient=draw(numbers(1.0, 3.0)),
        drag_coefficient=draw(numbers(0.0, 2.0)),
        friction_coefficient=draw(numbers(0.0, 0.2)),
        morison=draw(st.sampled_from(MODES)),
    )
    # A bend of exactly zero is where the map is singular in its closed form.
    q = [draw(st.just(0.0) | numbers(-2 * np.pi, 2 * np.pi)) for _ in range(n)]
    return Case(Arm(arm, fluid), np.array(q), np.array(each(-5.0, 5.0)))


SIXTH_ORDER = np.array([-1, 9, -45, 45, -9, 1]) / 60
OFFSETS = np.array([-3, -2, -1, 1, 2, 3])


def derivative(function, at: np.ndarray, direction: np.ndarray, step: float = 0.02) -> np.ndarray:
    """Directional derivative of a function of a series of states, to about ``step``^6."""
    values = function(at + step * OFFSETS[:, None] * direction)
    return np.tensordot(SIXTH_ORDER, values, axes=1) / step


def gradient(function, at: np.ndarray, step: float = 0.02) -> np.ndarray:
    """Derivatives along each coordinate, stacked first."""
    return np.stack([derivative(function, at, axis, step) for axis in np.eye(len(at))])


@cache
def acceleration_function(structure: Structure) -> ca.Function:
    """Angular accelerations from (q, q', generalised force, values, locked)."""
    n = structure.segments
    q, qd, force, locked = (ca.SX.sym(name, n) for name in ("q", "qd", "force", "locked"))
    packed = ca.SX.sym("values", Values.size(n))
    terms = mechanics(structure, q, qd, Values.unpacked(packed, n))
    answer = ca.cse(terms.acceleration(force, locked))
    return ca.Function("acceleration", [q, qd, force, packed, locked], [answer])
