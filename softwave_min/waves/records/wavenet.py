"""Sea states of Cefas WaveNet, which come without spectra."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from softwave_min.data import ParameterError
from softwave_min.parameters import SeaParameters
from softwave_min.waves.records.record import BuoyRecord
from softwave_min.waves.records.text import number, read_lines, universal
from softwave_min.waves.spectrum import Spectrum, jonswap_density

TIME = "Time (GMT)"
PERIOD = "Dominant (peak) wave period (s)"
HEIGHTS = ("Significant wave height (Hm0) (m)", "Significant wave height (m)")
MOST_DISTANT = timedelta(hours=1)
"""WaveNet's buoys report every half hour, some every hour."""
SHAPE = np.linspace(0.0, 10.0, 2001)
"""Multiples of the peak frequency at which the curve is sampled."""


@dataclass(frozen=True)
class SeaState:
    """What a buoy says of a sea without giving its spectrum."""

    time: datetime
    """Time of the record, UTC."""
    significant_height: float
    """H_m0, in m."""
    peak_period: float
    """T_p, in s."""

    def parameters(self, sea: SeaParameters) -> SeaParameters:
        """The parameters ``sea`` with this height and peak period."""
        height, period = self.significant_height, self.peak_period
        return replace(sea, significant_height=height, peak_period=period)

    def record(self, peak_enhancement: float) -> BuoyRecord:
        """The JONSWAP curve of this height, peak period and gamma, as a record."""
        frequency = SHAPE / self.peak_period
        curve = jonswap_density(frequency, 1.0, self.peak_period, peak_enhancement)
        density = Spectrum(frequency, curve).scaled_to(self.significant_height).density
        return BuoyRecord(self.time, tuple(frequency.tolist()), tuple(density.tolist()))


def read_wavenet(path: Path, time: datetime) -> SeaState:
    """Read the sea state nearest to a time (UTC) from a bulk export of Cefas WaveNet.

    A header with the columns ``Time (GMT)``, ``Dominant (peak) wave period (s)`` and
    ``Significant wave height (Hm0) (m)``, or without ``(Hm0)``, among others; then one
    row per record, its time as ``DD/MM/YYYY hh:mm`` or ``YYYY-MM-DD hh:mm``, with seconds
    or without. Columns are separated by tabs, or by commas if the header has no tab;
    separators at the end of a line are ignored.

    Raises
    ------
    ParameterError
        One line with file, line and fault: no such file or column, what is no time or
        number, no record within an hour, or height or period missing in the nearest.
    """
    lines = read_lines(path)
    separator = "\t" if lines and "\t" in lines[0] else ","
    columns = [name.strip() for name in lines[0].split(separator)] if lines else []
    height = next((name for name in HEIGHTS if name in columns), HEIGHTS[0])
    for name in (TIME, PERIOD, height):
        if name not in columns:
            raise ParameterError(f"{path}:1: not a WaveNet export: expected a column {name!r}")
    wanted = universal(time)
    rows = []
    for line, text in enumerate(lines[1:], start=2):
        cells = dict(zip(columns, (cell.strip() for cell in text.split(separator)), strict=False))
        if any(cells.values()):
            rows.append((_time(path, line, cells.get(TIME, "")), line, cells))
    nearest = min(rows, key=lambda row: abs(row[0] - wanted), default=None)
    if nearest is None or abs(nearest[0] - wanted) > MOST_DISTANT:
        raise ParameterError(f"{path}: no record within an hour of {wanted}")
    found, line, cells = nearest
    return SeaState(found, *(_value(path, line, cells, name) for name in (height, PERIOD)))


def _time(path: Path, line: int, text: str) -> datetime:
    day, _, clock = text.partition(" ")
    iso = "-".join(reversed(day.split("/")))
    try:
        return universal(datetime.fromisoformat(f"{iso} {clock}".strip()))
    except ValueError:
        raise ParameterError(
            f"{path}:{line}: {text!r} is not a time, DD/MM/YYYY hh:mm or YYYY-MM-DD hh:mm"
        ) from None


def _value(path: Path, line: int, cells: dict[str, str], column: str) -> float:
    """A number that cannot be negative or, in a sea, missing."""
    word = cells.get(column, "")
    value = number(path, line, word) if word else math.nan
    if math.isnan(value):
        raise ParameterError(f"{path}:{line}: {column!r} is missing at {cells[TIME]}")
    if not 0 < value < math.inf:
        raise ParameterError(f"{path}:{line}: {column!r} is {word}: expected a number > 0")
    return value
