"""Plausible ranges of the parameters that the paper leaves open, and sets with others of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.parameters import ParameterSet, Positive, load_data

GRADATION = "gradation"
"""Ratio of the proportional gains of neighbouring segments, base over tip."""
GAIN = "baseline.proportional_gain"
SIGNIFICANT_DIGITS = 4


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class PlausibleRange:
    """The plausible range of a parameter that the paper does not state."""

    field: str
    """Section and name in the parameter set, or 'gradation'."""
    symbol: str
    unit: str
    low: Positive
    high: Positive
    scale: Literal["linear", "log"]
    open_point: str
    """Id of the point that it belongs to."""
    argument: str
    """Why the range is plausible."""

    def at(self, share: float) -> float:
        """Value at a share of the range, 0 to 1."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + share * (self.high - self.low))

    def share(self, value: float) -> float:
        """Share of the range at a value."""
        if self.scale == "log":
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)


def plausible_ranges() -> tuple[PlausibleRange, ...]:
    """The ranges that are searched."""
    return load_data(dict[str, tuple[PlausibleRange, ...]], "studies/plausible_ranges.toml")[
        "range"
    ]


def open_fields() -> list[str]:
    """Fields of the open parameters, in the order of their ranges."""
    return [one.field for one in plausible_ranges()]


def value_in(parameters: ParameterSet, field: str) -> float:
    """Value of an open parameter: that of a plain number, or the geometric mean over segments."""
    if field == GRADATION:
        gains = parameters.baseline.proportional_gain
        return float((gains[0] / gains[-1]) ** (1 / max(len(gains) - 1, 1)))
    section, name = field.split(".")
    found = getattr(getattr(parameters, section), name)
    if isinstance(found, tuple):
        return float(found[0] if len(set(found)) == 1 else np.exp(np.mean(np.log(found))))
    return float(found)


def with_values(parameters: ParameterSet, values: Mapping[str, float]) -> ParameterSet:
    """The parameters with other values of open parameters, alike in all segments.

    The proportional gains fall geometrically from the base to the tip by ``gradation``.
    """
    for field, value in values.items():
        if field == GRADATION:
            continue
        section, name = field.split(".")
        part = getattr(parameters, section)
        entry: Any = value
        if isinstance(getattr(part, name), tuple):
            entry = (value,) * parameters.arm.segments
        parameters = replace(parameters, **{section: replace(part, **{name: entry})})
    if GRADATION in values or GAIN in values:
        steps = (parameters.arm.segments - 1) / 2 - np.arange(parameters.arm.segments)
        ratio = values.get(GRADATION, 1.0)
        gains = tuple(rounded(value_in(parameters, GAIN) * ratio**step) for step in steps)
        parameters = replace(
            parameters, baseline=replace(parameters.baseline, proportional_gain=gains)
        )
    return parameters


def rounded(value: float) -> float:
    """The value as a set's file has it."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")
