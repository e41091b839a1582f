"""Seas with spectra that were measured, whatever the format of the file."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from softwave_min.data import ParameterError, read_toml
from softwave_min.parameters import SeaParameters, validate
from softwave_min.waves.field import Sea
from softwave_min.waves.records.datawell import read_datawell
from softwave_min.waves.records.ndbc import read_ndbc
from softwave_min.waves.records.record import BuoyRecord
from softwave_min.waves.records.tabulated import read_table
from softwave_min.waves.records.text import read_lines, universal
from softwave_min.waves.records.wavenet import TIME, read_wavenet

FileFormat = Literal["detect", "ndbc", "datawell", "table", "wavenet"]

MEAN_PEAK_ENHANCEMENT = 3.3
"""The mean of gamma in the JONSWAP campaign."""


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class _Entry:
    """Where one named record is found."""

    file: str
    time: datetime | None = None
    file_format: FileFormat = "detect"
    peak_enhancement: Annotated[float, Field(ge=1, le=10)] = MEAN_PEAK_ENHANCEMENT


def read_spectrum(
    path: Path | str,
    time: datetime | None = None,
    file_format: FileFormat = "detect",
    *,
    peak_enhancement: float = MEAN_PEAK_ENHANCEMENT,
) -> BuoyRecord:
    """Read one measured spectrum.

    Parameters
    ----------
    path : Path or str
    time : datetime, optional
        Of the record, UTC unless it has a zone. It selects the record of an NDBC file with
        more than one (exactly) and of a WaveNet file (the nearest). A Datawell file and a
        table have one record and no time in it: they take this one.
    file_format : {'detect', 'ndbc', 'datawell', 'table', 'wavenet'}
        See ``read_<format>``. Unless it is named, the ending ``.spt`` or the first line decides.
    peak_enhancement : float
        JONSWAP's gamma, for a WaveNet file alone: it has height and period, no spectrum.

    Raises
    ------
    ParameterError
        One line with file, line and fault, or if there is no record of that time.
    """
    path = Path(path)
    moment = universal(time) if time else None
    found = _format_of(path) if file_format == "detect" else file_format
    if found == "ndbc":
        return _ndbc_record(path, moment)
    if found == "datawell":
        return read_datawell(path, moment)
    if found == "table":
        return read_table(path, moment)
    if moment is None:
        raise ParameterError(f"{path}: a WaveNet export holds many records: name a time")
    return read_wavenet(path, moment).record(peak_enhancement)


def named_records(path: Path) -> dict[str, BuoyRecord]:
    """Read the records that a file such as ``data/buoys/records.toml`` names.

    Each of its tables has a name, a ``file`` beside it and, as `read_spectrum`
    wants them, ``time``, ``file_format`` and ``peak_enhancement``.

    Raises
    ------
    ParameterError
        If the list or a file in it cannot be read, or a record is not there.
    """
    found = {}
    for name, table in read_toml(path).items():
        entry = validate(_Entry, table, source=f"{path}: {name}")
        file, gamma = path.parent / entry.file, entry.peak_enhancement
        found[name] = read_spectrum(file, entry.time, entry.file_format, peak_enhancement=gamma)
    return found


def measured_sea(record: BuoyRecord, parameters: SeaParameters, gravity: float) -> Sea:
    """`Sea.from_spectrum` with the spectrum of a record.

    Raises
    ------
    ParameterError
        If the record has no waves in the band.
    """
    try:
        return Sea.from_spectrum(record.spectrum, parameters, gravity)
    except ValueError as error:
        raise ParameterError(f"record of {record.time or 'no time'}: {error}") from None


def _format_of(path: Path) -> FileFormat:
    """The format of a file, by its ending or its first line."""
    if path.name.lower().removesuffix(".gz").endswith(".spt"):
        return "datawell"
    first = next(iter(read_lines(path)), "")
    if TIME in first:
        return "wavenet"
    if first.lstrip("#").startswith("YY"):
        return "ndbc"
    if "," in first:
        return "table"
    raise ParameterError(
        f"{path}:1: unknown format: expected the header of an NDBC or WaveNet file,"
        " 'f_hz, S_m2_per_hz', or a name ending in .spt"
    )


def _ndbc_record(path: Path, time: datetime | None) -> BuoyRecord:
    """The record of one time; without a time, the only one."""
    records = read_ndbc(path)
    if time is None:
        if len(records) == 1:
            return records[0]
        raise ParameterError(f"{path}: {len(records)} complete records: name a time")
    for record in records:
        if record.time == time:
            return record
    span = f"from {records[0].time} to {records[-1].time}" if records else "none at all"
    raise ParameterError(f"{path}: no complete record of {time}; there are {len(records)}, {span}")
