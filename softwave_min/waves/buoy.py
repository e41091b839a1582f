"""Spectra measured by wave buoys."""

from __future__ import annotations

import gzip
import zlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.parameters import ParameterError, SeaParameters, read_toml, validate
from softwave_min.waves.field import Sea
from softwave_min.waves.spectrum import Spectrum

__all__ = ["BuoyRecord", "buoy_record", "measured_sea", "named_records", "read_ndbc"]

MISSING = 999.0
"""What the archive has for a density that is missing; the real-time form has 'MM'."""


@dataclass(frozen=True)
class BuoyRecord:
    """One measured spectrum, as plain numbers: what a run rests on can be hashed."""

    time: datetime
    """Time of the record, UTC."""
    frequency_hz: tuple[float, ...]
    """Ascending frequencies, in Hz."""
    density: tuple[float, ...]
    """Variance density, in m^2/Hz."""

    @property
    def spectrum(self) -> Spectrum:
        """The record as a `Spectrum`."""
        return Spectrum(np.array(self.frequency_hz), np.array(self.density))


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class _Entry:
    """Where one named record is found."""

    file: str
    time: datetime


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
    lines = _lines(path)
    header = lines[0].split() if lines else []
    if [name.lstrip("#")[:2].upper() for name in header[:4]] != ["YY", "MM", "DD", "HH"]:
        raise ParameterError(
            f"{path}:1: not an NDBC spectral file: the header must begin 'YYYY MM DD hh [mm]'"
        )
    stamp = 5 if header[4:5] == ["mm"] else 4
    paired = header[-1] == ">"
    frequencies = () if paired else _numbers(path, 1, header[stamp:])
    records = []
    for number, line in enumerate(lines[1:], start=2):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        time = _time(path, number, words[:stamp])
        if paired:
            pairs = [word.strip("()") for word in words[stamp + 1 :]]
            densities = _numbers(path, number, pairs[0::2])
            frequencies = _numbers(path, number, pairs[1::2])
        else:
            densities = _numbers(path, number, words[stamp:])
        record = BuoyRecord(time, frequencies, densities)
        _check(path, number, record)
        if MISSING not in densities:
            records.append(record)
    return tuple(sorted(records, key=lambda record: record.time))


def buoy_record(path: Path, time: datetime) -> BuoyRecord:
    """Read the record of one time (UTC) from an NDBC spectral file.

    Raises
    ------
    ParameterError
        If the file cannot be read, or has no complete record of that time.
    """
    records = read_ndbc(path)
    for record in records:
        if record.time == time:
            return record
    span = f"from {records[0].time} to {records[-1].time}" if records else "none at all"
    raise ParameterError(f"{path}: no complete record of {time}; there are {len(records)}, {span}")


def named_records(path: Path) -> dict[str, BuoyRecord]:
    """Read the records that a file such as ``data/buoys/records.toml`` names.

    Each of its tables has a name, a ``file`` beside it and a ``time`` in UTC.

    Raises
    ------
    ParameterError
        If the list or a file in it cannot be read, or a record is not there.
    """
    entries = {
        name: validate(_Entry, table, source=f"{path}: {name}")
        for name, table in read_toml(path).items()
    }
    return {
        name: buoy_record(path.parent / entry.file, entry.time) for name, entry in entries.items()
    }


def measured_sea(record: BuoyRecord, parameters: SeaParameters, gravity: float) -> Sea:
    """A sea with a measured spectrum in place of the JONSWAP curve.

    Height, depth, band, number of components and phases come from ``parameters``, as in
    `Sea.random`; the record gives the shape. ``peak_period`` and ``peak_enhancement``
    are not read.

    Raises
    ------
    ParameterError
        If the record has no waves in the band.
    """
    try:
        return Sea.from_spectrum(
            record.spectrum.scaled_to(parameters.significant_height),
            (parameters.lowest_frequency_hz, parameters.highest_frequency_hz),
            parameters.components,
            depth=parameters.depth,
            gravity=gravity,
            rng=np.random.default_rng(parameters.seed),
        )
    except ValueError as error:
        raise ParameterError(f"record of {record.time}: {error}") from None


def _lines(path: Path) -> list[str]:
    try:
        content = path.read_bytes()
        if path.suffix == ".gz":
            content = gzip.decompress(content)
        return content.decode("ascii").splitlines()
    except FileNotFoundError:
        raise ParameterError(f"{path}: no such file") from None
    except (OSError, EOFError, zlib.error) as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from None
    except UnicodeDecodeError:
        raise ParameterError(f"{path}: not a text file") from None


def _time(path: Path, number: int, words: list[str]) -> datetime:
    try:
        year, month, day, hour = (int(word) for word in words[:4])
        minute = int(words[4]) if len(words) > 4 else 0
        # archives up to 1998 write the year with two digits
        return datetime(year + 1900 if year < 100 else year, month, day, hour, minute)
    except ValueError:
        raise ParameterError(
            f"{path}:{number}: {' '.join(words)!r} is not a time, YYYY MM DD hh [mm]"
        ) from None


def _numbers(path: Path, number: int, words: list[str]) -> tuple[float, ...]:
    values = []
    for word in words:
        try:
            values.append(MISSING if word == "MM" else float(word))
        except ValueError:
            raise ParameterError(f"{path}:{number}: {word!r} is not a number") from None
    return tuple(values)


def _check(path: Path, number: int, record: BuoyRecord) -> None:
    if len(record.density) != len(record.frequency_hz):
        raise ParameterError(
            f"{path}:{number}: {len(record.density)} densities"
            f" for {len(record.frequency_hz)} frequencies"
        )
    try:
        record.spectrum.moment(0)
    except ValueError as error:
        raise ParameterError(f"{path}:{number}: {error}") from None
