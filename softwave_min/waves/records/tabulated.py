"""Spectra as tables of two columns."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from softwave_min.data import ParameterError
from softwave_min.waves.records.record import BuoyRecord, record_of_rows
from softwave_min.waves.records.text import read_lines

COLUMNS = ("f_hz", "S_m2_per_hz")


def read_table(path: Path, time: datetime | None = None) -> BuoyRecord:
    """Read a CSV file ``f_hz, S_m2_per_hz``, plain or compressed (``.gz``).

    The names may stand in the first line or not; other names are refused, for they may
    stand for other units. Empty lines are skipped. The record is given ``time``, UTC, for
    the file has none in it.

    Raises
    ------
    ParameterError
        One line with file, line and fault.
    """
    rows = []
    for line, text in enumerate(read_lines(path), start=1):
        words = tuple(word.strip() for word in text.split(","))
        if words == ("",) or (line == 1 and words == COLUMNS):
            continue
        try:
            frequency, density = (float(word) for word in words)
        except ValueError:
            expected = f"expected two numbers, '{', '.join(COLUMNS)}'"
            raise ParameterError(f"{path}:{line}: {text!r}: {expected}") from None
        rows.append((line, frequency, density))
    return record_of_rows(path, rows, time)
