"""A parameter set with another number of segments."""

from __future__ import annotations

from dataclasses import asdict

from softwave_min.parameters import ParameterSet, validate

PER_SEGMENT = {
    "arm": ("length", "diameter", "density", "stiffness", "damping"),
    "baseline": ("proportional_gain", "derivative_gain"),
}


def with_segments(parameters: ParameterSet, segments: int) -> ParameterSet:
    """The set with the first segment's values in all of them, and the length that it had."""
    entries = asdict(parameters)
    for section, names in PER_SEGMENT.items():
        for name in names:
            entries[section][name] = entries[section][name][:1] * segments
    entries["arm"]["length"] = [sum(parameters.arm.length) / segments] * segments
    return validate(ParameterSet, entries, source="test")
