"""One measured spectrum, whatever the file that it came from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from softwave_min.data import ParameterError
from softwave_min.waves.spectrum import Spectrum


@dataclass(frozen=True)
class BuoyRecord:
    """One measured spectrum, as plain numbers: what a run rests on can be hashed."""

    time: datetime | None
    """Time of the record, UTC; none where the file does not tell."""
    frequency_hz: tuple[float, ...]
    """Ascending frequencies, in Hz."""
    density: tuple[float, ...]
    """Variance density, in m^2/Hz."""

    @property
    def spectrum(self) -> Spectrum:
        """The record as a `Spectrum`."""
        return Spectrum(np.array(self.frequency_hz), np.array(self.density))


def record_of_rows(
    path: Path, rows: Sequence[tuple[int, float, float]], time: datetime | None
) -> BuoyRecord:
    """A record from a file with one frequency a line: its number, f in Hz, S in m^2/Hz.

    Raises
    ------
    ParameterError
        If the rows are no spectrum, with the line.
    """
    if len(rows) < 2:
        raise ParameterError(f"{path}: a spectrum needs two or more rows; found {len(rows)}")
    last = -1.0
    for line, frequency, density in rows:
        if not (math.isfinite(frequency) and frequency >= 0):
            raise ParameterError(f"{path}:{line}: frequency: must be finite and not negative")
        if frequency <= last:
            raise ParameterError(f"{path}:{line}: frequency: must be above the row's before it")
        if not (math.isfinite(density) and density >= 0):
            raise ParameterError(f"{path}:{line}: density: must be finite and not negative")
        last = frequency
    _, frequencies, densities = zip(*rows, strict=True)
    return BuoyRecord(time, frequencies, densities)
