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
    file = load_data(dict[str, tuple[PlausibleRange, ...]], "studies/plausible_ranges.toml")
    return file["range"]


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
    segments = parameters.arm.segments
    entries: dict[str, Any] = {field: values[field] for field in values if field != GRADATION}
    if GRADATION in values or GAIN in values:
        mean = values.get(GAIN, value_in(parameters, GAIN))
        steps = (segments - 1) / 2 - np.arange(segments)
        ratio = values.get(GRADATION, 1.0)
        entries[GAIN] = tuple(rounded(mean * ratio**step) for step in steps)
    for field, value in entries.items():
        section, name = field.split(".")
        part = getattr(parameters, section)
        each = isinstance(getattr(part, name), tuple) and not isinstance(value, tuple)
        part = replace(part, **{name: (value,) * segments if each else value})
        parameters = replace(parameters, **{section: part})
    return parameters


def rounded(value: float) -> float:
    """The value as a set's file has it."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")
