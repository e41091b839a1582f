"""Seas: spectra, dispersion, and the flow of linear wave theory."""

from softwave_min.waves.buoy import measured_sea, named_records, read_spectrum
from softwave_min.waves.datawell import read_datawell
from softwave_min.waves.dispersion import wave_number
from softwave_min.waves.field import Sea
from softwave_min.waves.ndbc import read_ndbc
from softwave_min.waves.record import BuoyRecord
from softwave_min.waves.spectrum import Spectrum, jonswap_density, periodogram
from softwave_min.waves.tabulated import read_table
from softwave_min.waves.wavenet import SeaState, read_wavenet

__all__ = [
    "BuoyRecord",
    "Sea",
    "SeaState",
    "Spectrum",
    "jonswap_density",
    "measured_sea",
    "named_records",
    "periodogram",
    "read_datawell",
    "read_ndbc",
    "read_spectrum",
    "read_table",
    "read_wavenet",
    "wave_number",
]
