"""Seas: spectra, dispersion, and the flow of linear wave theory."""

from softwave_min.waves.dispersion import wave_number
from softwave_min.waves.field import Sea
from softwave_min.waves.spectrum import Spectrum, jonswap_density, periodogram

__all__ = ["Sea", "Spectrum", "jonswap_density", "periodogram", "wave_number"]
