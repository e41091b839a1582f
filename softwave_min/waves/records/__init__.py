"""Measured seas: records of wave buoys in the formats that a reader may bring."""

from softwave_min.waves.records.buoy import measured_sea, named_records, read_spectrum
from softwave_min.waves.records.datawell import read_datawell
from softwave_min.waves.records.ndbc import read_ndbc
from softwave_min.waves.records.record import BuoyRecord
from softwave_min.waves.records.tabulated import read_table
from softwave_min.waves.records.wavenet import SeaState, read_wavenet

__all__ = [
    "BuoyRecord",
    "SeaState",
    "measured_sea",
    "named_records",
    "read_datawell",
    "read_ndbc",
    "read_spectrum",
    "read_table",
    "read_wavenet",
]
