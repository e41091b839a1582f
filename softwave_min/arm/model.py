r"""The arm in water as a NumPy object: what figures, tests and notebooks call."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from softwave_min.arm.kinematics import body_point, segment_bases
from softwave_min.arm.mechanics import LOAD_TERMS, Mechanics, Structure, Values, mechanics
from softwave_min.parameters import ArmParameters, FluidParameters

Floats = NDArray[np.float64]


class Arm:
    """A given arm in given water: NumPy in, NumPy out.

    States may be single, of shape (n,), or a series, of shape (T, n).

    Parameters
    ----------
    arm : ArmParameters
    fluid : FluidParameters
    """

    def __init__(self, arm: ArmParameters, fluid: FluidParameters) -> None:
        self.parameters = arm
        self.fluid = fluid
        self.structure = Structure(
            arm.segments, arm.quadrature_points, arm.rotary_inertia, fluid.morison
        )
        self.values: Floats = Values.packed(arm, fluid)

    @property
    def segments(self) -> int:
        """Number of segments, n."""
        return self.structure.segments

    def forward_kinematics(self, q: ArrayLike, segment: int, s: float) -> Floats:
        """Point h(s, q) at ``s`` in [0, 1] on a segment, in m: (2,) or (T, 2)."""
        function = _point_function(self.structure, segment, s)
        return self._column(function, "position", q, np.zeros_like(q, dtype=float))

    def jacobian(self, q: ArrayLike, segment: int, s: float) -> Floats:
        """J(s, q) of a point, in m/rad: (2, n) or (T, 2, n)."""
        function = _point_function(self.structure, segment, s)
        return self._matrix(function, "jacobian", 2, q, np.zeros_like(q, dtype=float))

    def jacobian_rate(self, q: ArrayLike, qd: ArrayLike, segment: int, s: float) -> Floats:
        """Time derivative of J(s, q) along qd, in m/(rad s): (2, n) or (T, 2, n)."""
        return self._matrix(_point_function(self.structure, segment, s), "jacobian_rate", 2, q, qd)

    def tip(self, q: ArrayLike) -> Floats:
        """Position of the arm's tip, in m: (2,) or (T, 2)."""
        last: Floats = self.segment_tips(q)[..., -1, :]
        return last

    def segment_tips(self, q: ArrayLike) -> Floats:
        """Position of each segment's tip, in m: (n, 2) or (T, n, 2)."""
        flat = self._column(_statics_function(self.structure, "tips"), "tips", q)
        tips: Floats = flat.reshape(*flat.shape[:-1], self.segments, 2)
        return tips

    def axis(self, q: ArrayLike, points_per_segment: int = 16) -> Floats:
        """Points along the whole axis, from the base, in m: (P, 2) or (T, P, 2)."""
        places = np.linspace(0, 1, points_per_segment + 1)
        base = self.forward_kinematics(q, 0, 0.0)
        rest = [
            self.forward_kinematics(q, segment, float(s))
            for segment in range(self.segments)
            for s in places[1:]
        ]
        return np.stack([base, *rest], axis=-2)

    def tip_jacobian(self, q: ArrayLike) -> Floats:
        """J(q) of the arm's tip, in m/rad: (2, n) or (T, 2, n)."""
        return self._matrix(_statics_function(self.structure, "tip_jacobian"), "tip_jacobian", 2, q)

    def body_inertia(self, q: ArrayLike) -> Floats:
        """M(q) of the body alone, in kg m^2: (n, n) or (T, n, n)."""
        function = _statics_function(self.structure, "body_inertia")
        return self._matrix(function, "body_inertia", self.segments, q)

    def added_inertia(self, q: ArrayLike) -> Floats:
        """Generalised added mass, in kg m^2: (n, n) or (T, n, n)."""
        function = _statics_function(self.structure, "added_inertia")
        return self._matrix(function, "added_inertia", self.segments, q)

    def gravity_vector(self, q: ArrayLike) -> Floats:
        """G(q), weight less buoyancy, in N m: (n,) or (T, n)."""
        return self._column(_statics_function(self.structure, "gravity"), "gravity", q)

    def kinetic_energy(self, q: ArrayLike, qd: ArrayLike) -> Floats:
        """Energy of the body and its added mass, in J: () or (T,)."""
        inertia, rate = self.body_inertia(q) + self.added_inertia(q), np.asarray(qd, dtype=float)
        energy: Floats = np.einsum("...i,...ij,...j->...", rate, inertia, rate) / 2
        return energy

    def potential_energy(self, q: ArrayLike) -> Floats:
        """Energy of weight, buoyancy and bending, in J: () or (T,)."""
        weight = self._column(
            _statics_function(self.structure, "gravity_potential"), "gravity_potential", q
        )[..., 0]
        angles = np.asarray(q, dtype=float)
        energy: Floats = weight + (self.stiffness_vector(q) * angles).sum(axis=-1) / 2
        return energy

    def stiffness_vector(self, q: ArrayLike) -> Floats:
        """K(q), in N m: (n,) or (T, n)."""
        torque: Floats = np.asarray(self.parameters.stiffness) * np.asarray(q, dtype=float)
        return torque

    def coriolis_vector(self, q: ArrayLike, qd: ArrayLike) -> Floats:
        """C(q, qd) qd of body and added mass, in N m: (n,) or (T, n)."""
        return self._column(_coriolis_function(self.structure), "coriolis", q, qd)

    def load_terms(
        self, q: ArrayLike, qd: ArrayLike, flow: Floats, time: float = 0.0
    ) -> dict[str, Floats]:
        """Generalised loads of the water by term and segment, in N m.

        Parameters
        ----------
        q, qd : array_like, (n,) or (T, n)
        flow : array, (F,) or (T, F)
            Coefficients of the flow, from ``Sea.taylor_velocity`` by ``pack_flow``.
        time : float
            Time from the expansion's own, in s.

        Returns
        -------
        dict of arrays, (n, n) or (T, n, n)
            By the names in ``LOAD_TERMS``. Entry (j, i): from segment i, on the bending
            angle j.
        """
        times = np.full((*np.asarray(q).shape[:-1], 1), time)
        answers = self._columns(_load_function(self.structure), LOAD_TERMS, q, qd, flow, times)
        return {
            term: _as_matrices(flat, self.segments)
            for term, flat in zip(LOAD_TERMS, answers, strict=True)
        }

    def fluid_load(self, q: ArrayLike, qd: ArrayLike, flow: Floats, time: float = 0.0) -> Floats:
        """F_E without the added mass, in N m: (n,) or (T, n). See ``load_terms``."""
        by_segment = np.add.reduce(list(self.load_terms(q, qd, flow, time).values()))
        load: Floats = by_segment.sum(axis=-1)
        return load

    def _columns(
        self, function: ca.Function, outputs: Sequence[str], *series: ArrayLike
    ) -> list[Floats]:
        """Call a function on a single state or on a series of them."""
        rows = [np.atleast_2d(np.asarray(one, dtype=float)) for one in series]
        values = np.repeat(self.values[:, None], len(rows[0]), axis=1)
        answer = function.call([*(ca.DM(row.T) for row in rows), ca.DM(values)])
        results = [np.asarray(answer[function.index_out(name)].full()).T for name in outputs]
        return results if np.ndim(series[0]) > 1 else [result[0] for result in results]

    def _column(self, function: ca.Function, output: str, *series: ArrayLike) -> Floats:
        return self._columns(function, (output,), *series)[0]

    def _matrix(self, function: ca.Function, output: str, rows: int, *series: ArrayLike) -> Floats:
        return _as_matrices(self._column(function, output, *series), rows)


def _as_matrices(flat: Floats, rows: int) -> Floats:
    """Matrices from their columns in a row: (..., rows, columns)."""
    return flat.reshape(*flat.shape[:-1], -1, rows).swapaxes(-1, -2)


def pack_flow(flow: NDArray[np.complex128]) -> Floats:
    """Real vector of the flow's coefficients, real parts first: (..., 2 (N+1) (M+1))."""
    flat = flow.reshape(*flow.shape[:-2], -1)
    return np.concatenate([flat.real, flat.imag], axis=-1)


def _symbols(structure: Structure) -> dict[str, ca.SX]:
    n = structure.segments
    sizes = {"q": n, "qd": n, "flow": structure.flow_size, "time": 1, "values": Values.size(n)}
    return {name: ca.SX.sym(name, size) for name, size in sizes.items()}


def _mechanics(structure: Structure, on: dict[str, ca.SX]) -> Mechanics:
    values = Values.unpacked(on["values"], structure.segments)
    return mechanics(structure, on["q"], on["qd"], values)


def _function(
    on: dict[str, ca.SX], inputs: tuple[str, ...], outputs: dict[str, ca.SX]
) -> ca.Function:
    """Function of some of the symbols, then the values; outputs are columns."""
    names = (*inputs, "values")
    columns = ca.cse([ca.vec(output) for output in outputs.values()])
    return ca.Function("arm", [on[name] for name in names], columns, list(names), list(outputs))


@cache
def _point_function(structure: Structure, segment: int, s: float) -> ca.Function:
    on = _symbols(structure)
    values = Values.unpacked(on["values"], structure.segments)
    bases = segment_bases(on["q"], on["qd"], values.length, values.base_position, values.base_angle)
    point = body_point(bases[segment], segment, on["q"], values.length[segment], s)
    rate = ca.jtimes(ca.vec(point.jacobian), on["q"], on["qd"])
    outputs = {"position": point.position, "jacobian": point.jacobian, "jacobian_rate": rate}
    return _function(on, ("q", "qd"), outputs)


@cache
def _statics_function(structure: Structure, term: str) -> ca.Function:
    """One of the terms that depend on q alone."""
    on = _symbols(structure)
    arm = _mechanics(structure, on)
    value = ca.vertcat(*arm.tips) if term == "tips" else getattr(arm, term)
    return _function(on, ("q",), {term: value})


@cache
def _coriolis_function(structure: Structure) -> ca.Function:
    on = _symbols(structure)
    return _function(on, ("q", "qd"), {"coriolis": _mechanics(structure, on).coriolis})


@cache
def _load_function(structure: Structure) -> ca.Function:
    on = _symbols(structure)
    terms = _mechanics(structure, on).load_terms(on["flow"], on["time"])
    return _function(on, ("q", "qd", "flow", "time"), terms)
