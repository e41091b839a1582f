"""The paper's numbers and choices beside its tables: each stands once, in ``data/paper/``.

They are read anew wherever they are asked for, so that who makes a table or a figure of them
is known to depend on their file.
"""

from __future__ import annotations

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from softwave_min.parameters import Positive, Real, load_data

_FROZEN = ConfigDict(extra="forbid")

CONTROLLER = "nmpc"
"""The controller that the paper's numbers are of."""


@dataclass(frozen=True, config=_FROZEN)
class Reduction:
    """Extreme reductions of the error in a wave case, in per cent, with their poses."""

    largest: Real
    largest_pose: str
    smallest: Real
    smallest_pose: str


@dataclass(frozen=True, config=_FROZEN)
class ErrorRatio:
    """What the paper says of its Fig. error_bar."""

    reduction: dict[str, Reduction]
    """By wave case."""
    cells: dict[str, Real]


@dataclass(frozen=True, config=_FROZEN)
class ActuatorFailure:
    """What the paper says of its Fig. actuation_failure_rmse."""

    pose: tuple[str, ...]
    lowest_height: Positive
    """Significant heights from here on, in m."""
    rise: Real
    """In per cent, as those below."""
    lowest_rise: Real
    lowest_rise_case: str
    largest_spread: Real
    height_over_body: Real


@dataclass(frozen=True, config=_FROZEN)
class ExampleCase:
    """What is chosen for the paper's Fig. example_case beside the sea of the parameters."""

    pose: str
    measured: str
    """Name of the record in data/buoys/records.toml that the second sea is made of."""


@dataclass(frozen=True, config=_FROZEN)
class Records:
    """The paper's Fig. spectra: height of the seas in m, and length of the records in s."""

    significant_height: Positive
    window: Positive


def error_ratio() -> ErrorRatio:
    """Reductions of the error in the grid."""
    return load_data(ErrorRatio, "paper/error_ratio.toml")


def actuator_failure() -> ActuatorFailure:
    """Poses, heights and rises of the error with a failed segment."""
    return load_data(ActuatorFailure, "paper/actuator_failure.toml")


def example_case() -> ExampleCase:
    """Pose and measured sea of the example."""
    return load_data(ExampleCase, "paper/example_case.toml")


def spectra() -> Records:
    """Height and length of the three records."""
    return load_data(Records, "paper/spectra.toml")
