"""Typed, validated parameter sets, loaded from the files in ``data/``.

Every value is SI. A set is a tree of frozen dataclasses; each field declares its
type and its range once, and pydantic enforces both when a set is made, from a
file or in code.
"""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, Field, Strict, TypeAdapter, ValidationError, model_validator
from pydantic.dataclasses import dataclass

from softwave_min.data import ParameterError, data_folder, note_read, read_toml

SET_NAMES = ("calibrated", "physical")
"""The parameter sets that ship: files in ``data/parameters/``."""
DEFAULT_SET = "calibrated"
"""The one that the paper's experiments are computed with."""

T = TypeVar("T")

Real = Annotated[float, Strict(), Field(allow_inf_nan=False)]
Positive = Annotated[float, Strict(), Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Strict(), Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Strict(), Field(ge=1)]
Seed = Annotated[int, Strict(), Field(ge=0)]
Order = Annotated[int, Strict(), Field(ge=1, le=8)]
Flag = Annotated[bool, Strict()]
Tolerance = Annotated[float, Strict(), Field(gt=0, le=1e-3, allow_inf_nan=False)]
Angle = Annotated[float, Strict(), Field(ge=-2 * math.pi, le=2 * math.pi, allow_inf_nan=False)]
Vector = Annotated[tuple[Real, ...], Field(min_length=1)]
PositiveVector = Annotated[tuple[Positive, ...], Field(min_length=1)]
NonNegativeVector = Annotated[tuple[NonNegative, ...], Field(min_length=1)]

_FROZEN = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_FROZEN)
class ArmParameters:
    """A planar arm of constant-curvature segments; one entry per segment, base first."""

    length: PositiveVector
    """Arc length of each segment, L, in m."""
    diameter: PositiveVector
    """Diameter of the cross-section, d_s, in m."""
    density: PositiveVector
    """Density of the body, rho_s, in kg/m^3."""
    stiffness: NonNegativeVector
    """Bending stiffness k of each segment's angle, in N m/rad."""
    damping: NonNegativeVector
    """Passive damping of each segment's angle, in N m s/rad."""
    base_position: tuple[Real, Real]
    """Position (x, z) of the base, in m; z is measured up from the mean surface."""
    base_angle: Angle
    """Direction of the base tangent, counter-clockwise from +x, in rad."""
    quadrature_points: Annotated[int, Strict(), Field(ge=2, le=16)]
    """Gauss-Legendre points on each segment for mass, buoyancy and fluid load."""
    rotary_inertia: Flag
    """Whether the rotation of the cross-sections carries kinetic energy."""

    @model_validator(mode="after")
    def _one_entry_per_segment(self) -> Self:
        per_segment = ("length", "diameter", "density", "stiffness", "damping")
        counts = {name: len(getattr(self, name)) for name in per_segment}
        if len(set(counts.values())) > 1:
            found = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise ValueError(f"as many entries as segments in each of: {found}")
        return self

    @property
    def segments(self) -> int:
        """Number of segments, n."""
        return len(self.length)


@dataclass(frozen=True, config=_FROZEN)
class FluidParameters:
    """The water and the coefficients of the Morison load."""

    density: NonNegative
    """Density of the water, rho_f, in kg/m^3 (0: the arm in a vacuum)."""
    gravity: Positive
    """Acceleration of gravity g, in m/s^2."""
    inertia_coefficient: Annotated[float, Strict(), Field(ge=1, le=3, allow_inf_nan=False)]
    """C_m = 1 + C_a, dimensionless."""
    drag_coefficient: NonNegative
    """Normal drag C_d, dimensionless."""
    friction_coefficient: NonNegative
    """Tangential drag C_f, dimensionless."""
    morison: Literal["paper", "textbook"]
    """'paper': C_m on the body's acceleration, no fluid acceleration, C_f on the
    frontal area d_s L. 'textbook': C_a on the body's acceleration, C_m on the
    fluid's, C_f on the wetted area pi d_s L."""


@dataclass(frozen=True, config=_FROZEN)
class SeaParameters:
    """A random sea: its spectrum and how it is sampled."""

    significant_height: NonNegative
    """H_s = 4 sqrt(m_0), in m."""
    peak_period: Positive
    """T_p, in s."""
    peak_enhancement: Annotated[float, Strict(), Field(ge=1, le=10, allow_inf_nan=False)]
    """JONSWAP's gamma, dimensionless."""
    depth: Positive
    """Water depth d, in m."""
    components: Count
    """Number of wave components N."""
    lowest_frequency_hz: Positive
    """Lower edge of the band that is sampled, in Hz."""
    highest_frequency_hz: Positive
    """Upper edge of the band that is sampled, in Hz."""
    seed: Seed
    """Seed of the random phases."""
    realisations: Count
    """Number of random seas in an experiment: those of ``seed``, ``seed`` + 1, ..."""

    @model_validator(mode="after")
    def _band_is_ascending(self) -> Self:
        if self.lowest_frequency_hz >= self.highest_frequency_hz:
            raise ValueError("lowest_frequency_hz below highest_frequency_hz")
        return self


@dataclass(frozen=True, config=_FROZEN)
class BaselineParameters:
    """Feed-forward + PD with the kinematic planner."""

    proportional_gain: NonNegativeVector
    """Diagonal of alpha, in N m/rad."""
    derivative_gain: NonNegativeVector
    """Diagonal of beta, in N m s/rad."""
    task_gain: Positive
    """Planner gain K_e, in 1/s."""
    damping: NonNegative
    """Damping of the planner's pseudo-inverse, in m (0: Moore-Penrose)."""
    initial_bend: Angle
    """Bend given to every segment of the planner's first posture, towards the
    target, in rad: the straight arm is singular."""
    integral_gain: NonNegative = 0.0
    """Integral action on the tip's offset from the plan, K_I in 1/s; 0 for none, as in the
    paper. See ``control.baseline.Correction``."""
    load_feedforward: Flag = False
    """Whether the load of the present flow is fed forward; not in the paper."""

    @property
    def corrected(self) -> bool:
        """Whether the commands depend on the state and the flow, not on the plan alone."""
        return self.integral_gain > 0 or self.load_feedforward


@dataclass(frozen=True, config=_FROZEN)
class FailureParameters:
    """A segment whose actuation has failed."""

    segment: Annotated[int, Strict(), Field(ge=0)]
    """Number of the failed segment, from 1; 0 for none."""
    manner: Literal["passive", "locked"]
    """'passive': no torque; 'locked': the bending angle cannot change."""
    known: Flag
    """Whether the NMPC's model has the failure."""


@dataclass(frozen=True, config=_FROZEN)
class NmpcParameters:
    """The optimal control problem of the paper and how it is solved."""

    control_period: Positive
    """Time between two inputs, Delta t, in s."""
    horizon: Annotated[int, Strict(), Field(ge=1, le=200)]
    """Number of control periods looked ahead, K."""
    tip_weight: Positive
    """Q = tip_weight * I on the tip error, in 1/m^2."""
    step_weight: Positive
    """R = step_weight * I on the change of the commanded angles, in 1/rad^2."""
    terminal_weight: NonNegative
    """Weight of the last predicted tip error, as a multiple of Q. The paper
    prints a sum to K - 1, hence 0."""
    angle_bound: Annotated[float, Strict(), Field(gt=0, le=2 * math.pi, allow_inf_nan=False)]
    """Bound on every commanded angle, |q_bar_i|, in rad."""
    torque_bound: NonNegative
    """Soft bound on every actuation torque, in N m; 0 for none, as in the paper."""
    torque_weight: NonNegative
    """Weight of the square of what exceeds it, in 1/(N m)^2."""
    solver: Literal["gauss_newton", "interior_point", "convex"]
    """'gauss_newton': the fast one, compiled where possible. 'interior_point': IPOPT, the
    reference. 'convex': the same steps, each posed in cvxpy."""
    substeps: Annotated[int, Strict(), Field(ge=1, le=64)]
    """Extrapolated steps of the predictor per control period."""
    extrapolation_columns: Order
    """Order of the predictor's extrapolation."""
    max_iterations: Annotated[int, Strict(), Field(ge=1, le=1000)]
    """Most Gauss-Newton steps per solve."""
    tolerance: Positive
    """A solve has converged when its last step, or by their contraction all that would
    follow it, is shorter than this, in rad."""
    real_time: Flag
    """Whether to take ``max_iterations`` full steps and no more, converged or not."""


@dataclass(frozen=True, config=_FROZEN)
class PreviewParameters:
    """What the controller is told of the coming sea."""

    waves: Flag
    """Whether it is told of the waves at all; otherwise it believes in still water."""
    delay_periods: Annotated[int, Strict(), Field(ge=0)]
    """Control periods by which the forecast is late."""
    bias: Annotated[float, Strict(), Field(ge=-1, le=10, allow_inf_nan=False)]
    """Relative error of the forecast flow."""
    noise: Literal["none", "decibel", "ratio"]
    """How 'SNR' is read: no noise, 10 log10 of the power ratio, or the power ratio."""
    signal_to_noise: Positive
    """The SNR itself, 20 in the paper."""
    redrawn: Flag
    """Whether each forecast draws new noise; otherwise the noise belongs to the
    time it speaks of and is the same in every forecast."""
    seed: Seed
    """Seed of the noise."""


@dataclass(frozen=True, config=_FROZEN)
class SimulationParameters:
    """One closed-loop run of the plant."""

    duration: Positive
    """Length of the run, in s."""
    integrator: Literal["extrapolation", "cvodes", "runge_kutta"]
    """'extrapolation': linearly implicit Euler steps, extrapolated. 'cvodes': SUNDIALS'
    variable-order BDF. 'runge_kutta': the paper's, fifth order with variable step."""
    relative_tolerance: Tolerance
    """Relative tolerance of a variable-step integrator."""
    absolute_tolerance: Tolerance
    """Absolute tolerance of a variable-step integrator, in rad and rad/s."""
    largest_step: Positive
    """Longest step of a variable-step integrator, in s."""
    extrapolated_steps: Annotated[int, Strict(), Field(ge=1, le=1000)]
    """Extrapolated steps per control period."""
    extrapolation_columns: Order
    """Order of the extrapolation."""


@dataclass(frozen=True, config=_FROZEN)
class ParameterSet:
    """Everything that a closed-loop run needs, bar its target."""

    arm: ArmParameters
    fluid: FluidParameters
    sea: SeaParameters
    baseline: BaselineParameters
    nmpc: NmpcParameters
    preview: PreviewParameters
    simulation: SimulationParameters
    failure: FailureParameters

    @model_validator(mode="after")
    def _segments_match(self) -> Self:
        if self.failure.segment > self.arm.segments:
            raise ValueError(f"failure.segment at most {self.arm.segments}")
        for name in ("proportional_gain", "derivative_gain"):
            count = len(getattr(self.baseline, name))
            if count != self.arm.segments:
                expected = f"{self.arm.segments} entries in baseline.{name}, one per segment"
                raise ValueError(f"{expected}; found {count}")
        return self


def parameter_set(name: str = DEFAULT_SET) -> ParameterSet:
    """Load a shipped parameter set by its name.

    Raises
    ------
    ParameterError
        If there is none of that name.
    """
    if name not in SET_NAMES:
        raise ParameterError(f"no parameter set {name!r}; there are: {', '.join(SET_NAMES)}")
    return load_parameters(data_folder() / "parameters" / f"{name}.toml")


def load_parameters(source: Path | str = DEFAULT_SET) -> ParameterSet:
    """Load a parameter set: one that ships, by its name, or a TOML file.

    Raises
    ------
    ParameterError
        Naming the file, the field, the value and the allowed range.
    """
    if isinstance(source, str) and source.isidentifier():
        return parameter_set(source)
    return validate(ParameterSet, read_toml(Path(source)), source=source)


def load_data(kind: type[T], name: str) -> T:
    """Make a ``kind`` from a file in ``data/``, such as ``paper/poses.toml``.

    Raises
    ------
    ParameterError
        As `validate`.
    """
    path = data_folder() / name
    note_read(path)
    version = path.stat().st_mtime_ns if path.is_file() else 0
    loaded: T = _loaded(kind, path, version)  # type: ignore[arg-type]
    return loaded


@cache
def _loaded(kind: Any, path: Path, version: int) -> Any:  # noqa: ARG001
    """Keep what was made of a version of a file: every place of the grid asks for its pose."""
    return validate(kind, read_toml(path), source=path)


def validate(kind: type[T], values: Any, source: Path | str) -> T:
    """Make a ``kind`` from plain ``values``; errors name ``source``.

    Raises
    ------
    ParameterError
        One line that names source, field, value and allowed range.
    """
    try:
        return TypeAdapter(kind).validate_python(values)
    except ValidationError as error:
        raise ParameterError(f"{source}: {_first_complaint(kind, error)}") from None


def _first_complaint(kind: Any, error: ValidationError) -> str:
    problem = error.errors(include_url=False)[0]
    location = problem["loc"]
    field = ".".join(str(part) for part in location) or "file"
    match problem["type"]:
        case "value_error":
            return f"{field}: must have {problem['ctx']['error']}"
        case "unexpected_keyword_argument":
            known = ", ".join(_field_names(_annotation(kind, location[:-1])))
            return f"{field} = {problem['input']!r}: unknown field; known here: {known}"
    allowed = _in_words(_annotation(kind, location)) or problem["msg"]
    if problem["type"] in {"missing", "missing_argument"}:
        return f"{field}: missing; must be {allowed}"
    return f"{field} = {problem['input']!r}: must be {allowed}"


def _annotation(kind: Any, location: tuple[int | str, ...]) -> Any:
    """Type that is declared at a place inside ``kind``, with its range."""
    for part in location:
        while get_origin(kind) is Annotated:
            kind = get_args(kind)[0]
        if is_dataclass(kind):
            kind = get_type_hints(kind, include_extras=True).get(str(part))
        else:
            inner = [one for one in get_args(kind) if one is not Ellipsis]
            kind = inner[-1] if inner else None
    return kind


def _in_words(annotation: Any) -> str:
    """The allowed values: 'a number > 0', 'a list of 2 numbers', 'true or false', ..."""
    limits: list[str] = []
    while get_origin(annotation) is Annotated:
        annotation, *notes = get_args(annotation)
        limits = [*_limits(notes), *limits]
    if get_origin(annotation) is Literal:
        return " or ".join(repr(value) for value in get_args(annotation))
    if get_origin(annotation) is tuple:
        parts = get_args(annotation)
        count = "" if parts[-1] is Ellipsis else f"{len(parts)} entries, each "
        return f"a list of {count}{_in_words(parts[0])}"
    if is_dataclass(annotation):
        return f"a table of {', '.join(_field_names(annotation))}"
    return " and ".join([_KINDS.get(annotation, ""), *limits]).replace(" and ", " ", 1)


_KINDS = {
    bool: "true or false",
    float: "a finite number",
    int: "a whole number",
    str: "text",
}


def _limits(notes: list[Any]) -> list[str]:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    found = [limit for note in notes for limit in getattr(note, "metadata", [])]
    return [
        f"{signs[name]} {getattr(limit, name):g}"
        for limit in found
        for name in signs
        if hasattr(limit, name)
    ]


def _field_names(kind: Any) -> list[str]:
    return [field.name for field in fields(kind)] if is_dataclass(kind) else []
