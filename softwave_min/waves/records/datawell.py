"""Spectra of Datawell's wave buoys: files ``.spt``."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from softwave_min.data import ParameterError
from softwave_min.waves.records.record import BuoyRecord, record_of_rows
from softwave_min.waves.records.text import number, read_lines

HEADER_LINES = 12
COLUMNS = "f, S/Smax, direction, spread, skewness, kurtosis"
HEIGHT_TOLERANCE = 0.2
"""The buoy sums the spectrum in its own way; a wrong unit makes more of a difference."""


def read_datawell(path: Path, time: datetime | None = None) -> BuoyRecord:
    """Read a spectrum of a Datawell buoy, plain or compressed (``.gz``).

    Twelve lines with one quantity each: transmission index, H_s in cm, T_z in s,
    S_max in m^2/Hz, two temperatures, battery, three offsets, heading, inclination of
    the magnetic field. Then one row per frequency, separated by commas: f in Hz,
    S/S_max, direction, spread, skewness, kurtosis. Only H_s, S_max and the first two
    columns are read.

    The record is given ``time``, UTC, for the file has none in it.

    Raises
    ------
    ParameterError
        One line with file, line and fault; also if the spectrum has another
        significant height than the header, by more than 20 %.
    """
    # the last lines of the header may end in a degree sign of any encoding
    lines = read_lines(path, "latin-1")
    header, rows = lines[:HEADER_LINES], lines[HEADER_LINES:]
    expected = f"expected {HEADER_LINES} lines of one number each, then rows of '{COLUMNS}'"
    for line, text in enumerate(header, start=1):
        if "," in text:
            raise ParameterError(f"{path}:{line}: not a Datawell .spt file: {expected}")
    if not rows:
        raise ParameterError(f"{path}:{len(lines)}: ends in its header: {expected}")
    highest = number(path, 4, header[3])
    densities = []
    for line, text in enumerate(rows, start=HEADER_LINES + 1):
        if not text.strip():
            continue
        words = text.split(",")
        if len(words) != len(COLUMNS.split(",")):
            raise ParameterError(f"{path}:{line}: {text!r}: expected '{COLUMNS}'")
        frequency, relative = (number(path, line, word.strip()) for word in words[:2])
        densities.append((line, frequency, relative * highest))
    record = record_of_rows(path, densities, time)
    height = number(path, 2, header[1]) / 100
    found = record.spectrum.significant_height
    if not abs(found - height) <= HEIGHT_TOLERANCE * height:
        raise ParameterError(
            f"{path}:2: H_s is {height:g} m, but the spectrum's {found:.2f} m:"
            " expected H_s in cm and, in line 4, S_max in m^2/Hz"
        )
    return record
