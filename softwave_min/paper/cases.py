"""The paper's tables, as data."""

from __future__ import annotations

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from softwave_min.parameters import Positive, Real, load_data

Point = tuple[Real, Real]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class WaveCase:
    """A row of the paper's Table 'wave_cases'."""

    name: str
    peak_period: Positive
    """T_p, in s."""
    significant_height: tuple[Positive, ...]
    """The heights H_s to which the spectrum is scaled, in m."""


def wave_cases() -> dict[str, WaveCase]:
    """Table 'wave_cases' of the paper, by name."""
    rows = load_data(dict[str, tuple[WaveCase, ...]], "paper/wave_cases.toml")
    return {row.name: row for row in rows["case"]}


def poses() -> dict[str, Point]:
    """Table 'poses' of the paper: desired tip (x, z), in m."""
    return load_data(dict[str, Point], "paper/poses.toml")
