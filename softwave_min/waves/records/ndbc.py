"""Spectra of the US National Data Buoy Center."""

from __future__ import annotations

from datetime import datetime
from operator import attrgetter
from pathlib import Path

from softwave_min.data import ParameterError
from softwave_min.waves.records.record import BuoyRecord
from softwave_min.waves.records.text import number, read_lines

MISSING = 999.0
"""What the archive has for a density that is missing; the real-time form has 'MM'."""


def read_ndbc(path: Path) -> tuple[BuoyRecord, ...]:
    """Read all records of a spectral file of the US National Data Buoy Center.

    Both of its forms are understood, plain or compressed (``.gz``):

    - archive: a header ``YYYY MM DD hh [mm]`` followed by the frequencies; each row a
      time and one density per frequency;
    - real time (``.data_spec``): a header ``#YY MM DD hh mm Sep_Freq < spec_1 (freq_1)
      ... >``; each row a time, the separation frequency and pairs ``density (frequency)``.

    A record with a missing density (999 or MM) is no spectrum and is left out.

    Returns
    -------
    tuple of BuoyRecord
        Ascending in time.

    Raises
    ------
    ParameterError
        One line with file, line and fault.
    """
    lines = read_lines(path)
    header = lines[0].split() if lines else []
    if [name.lstrip("#")[:2].upper() for name in header[:4]] != ["YY", "MM", "DD", "HH"]:
        raise ParameterError(
            f"{path}:1: not an NDBC spectral file: the header must begin 'YYYY MM DD hh [mm]'"
        )
    stamp = 5 if header[4:5] == ["mm"] else 4
    paired = header[-1] == ">"
    frequencies = () if paired else _numbers(path, 1, header[stamp:])
    records: list[BuoyRecord] = []
    for line, text in enumerate(lines[1:], start=2):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        time = _time(path, line, words[:stamp])
        if paired:
            pairs = [word.strip("()") for word in words[stamp + 1 :]]
            densities = _numbers(path, line, pairs[0::2])
            frequencies = _numbers(path, line, pairs[1::2])
        else:
            densities = _numbers(path, line, words[stamp:])
        record = _checked(path, line, BuoyRecord(time, frequencies, densities))
        if MISSING not in densities:
            records.append(record)
    return tuple(sorted(records, key=attrgetter("time")))


def _time(path: Path, line: int, words: list[str]) -> datetime:
    try:
        year, month, day, hour = (int(word) for word in words[:4])
        minute = int(words[4]) if len(words) > 4 else 0
        # archives up to 1998 write the year with two digits
        return datetime(year + 1900 if year < 100 else year, month, day, hour, minute)
    except ValueError:
        raise ParameterError(
            f"{path}:{line}: {' '.join(words)!r} is not a time, YYYY MM DD hh [mm]"
        ) from None


def _numbers(path: Path, line: int, words: list[str]) -> tuple[float, ...]:
    return tuple(MISSING if word == "MM" else number(path, line, word) for word in words)


def _checked(path: Path, line: int, record: BuoyRecord) -> BuoyRecord:
    if len(record.density) != len(record.frequency_hz):
        counts = f"{len(record.density)} densities for {len(record.frequency_hz)} frequencies"
        raise ParameterError(f"{path}:{line}: {counts}")
    try:
        _ = record.spectrum
    except ValueError as error:
        raise ParameterError(f"{path}:{line}: {error}") from None
    return record
