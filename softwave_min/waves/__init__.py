"""Seas: spectra, dispersion, and the flow of linear wave theory."""

from softwave_min.waves.buoy import BuoyRecord, buoy_record, measured_sea, named_records, read_ndbc
from softwave_min.waves.dispersion import wave_number
from softwave_min.waves.field import Sea
from softwave_min.waves.spectrum import Spectrum, jonswap_density, periodogram

__all__ = [
    "BuoyRecord",
    "Sea",
    "Spectrum",
    "buoy_record",
    "jonswap_density",
    "measured_sea",
    "named_records",
    "periodogram",
    "read_ndbc",
    "wave_number",
]
