"""Variance density spectra of the surface elevation, one-sided, over frequency in Hz."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy  # whose parts are loaded when they are used
from numpy.typing import ArrayLike, NDArray

WIDTH_BELOW_PEAK = 0.07
WIDTH_ABOVE_PEAK = 0.09
LOWEST_RATIO = 1e-2
"""Below this f/f_p the density is zero in double precision, and f^-4 may overflow."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A variance density S(f), linear between its samples and zero outside them.

    Samples that are not as said below are a ValueError; they are kept as read-only copies.
    """

    frequency_hz: NDArray[np.float64]
    """N >= 2 of them, ascending, not negative, finite."""
    density: NDArray[np.float64]
    """S >= 0 at each of them, in m^2/Hz."""

    def __post_init__(self) -> None:
        for name in ("frequency_hz", "density"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.frequency_hz.ndim != 1 or self.frequency_hz.shape != self.density.shape:
            raise ValueError("frequency_hz and density: must be two vectors of one length")
        if not (len(self.frequency_hz) >= 2 and self.frequency_hz[0] >= 0):
            raise ValueError("frequency_hz: must be two or more values, none negative")
        if not np.all(np.diff(self.frequency_hz) > 0) or not np.isfinite(self.frequency_hz[-1]):
            raise ValueError("frequency_hz: must be ascending and finite")
        if not np.all((self.density >= 0) & np.isfinite(self.density)):
            raise ValueError("density: must be finite and not negative")

    def moment(self, order: int) -> float:
        """``m_n``, the integral of f^n S(f), by the trapezoidal rule, in m^2 Hz^n."""
        return float(np.trapezoid(self.frequency_hz**order * self.density, self.frequency_hz))

    @property
    def significant_height(self) -> float:
        """``H_m0 = 4 sqrt(m_0)``, in m."""
        return 4 * math.sqrt(self.moment(0))

    @property
    def peak_period(self) -> float:
        """``T_p = 1/f_p``, in s; f_p is the vertex of the parabola through the highest
        sample and its neighbours, or the sample itself at an end of the band.

        Raises
        ------
        ValueError
            If there are no waves.
        """
        if not self.density.any():
            raise ValueError("a spectrum without waves has no peak")
        top = int(np.argmax(self.density))
        if top in (0, len(self.density) - 1):
            return float(1 / self.frequency_hz[top])
        return 1 / _vertex(self.frequency_hz[top - 1 : top + 2], self.density[top - 1 : top + 2])

    def density_at(self, frequency_hz: ArrayLike) -> NDArray[np.float64]:
        """S at any frequencies, in m^2/Hz."""
        wanted = np.asarray(frequency_hz, dtype=float)
        return np.asarray(np.interp(wanted, self.frequency_hz, self.density, left=0.0, right=0.0))

    def scaled_to(self, significant_height: float) -> Spectrum:
        """The same shape with another significant height, in m.

        Raises
        ------
        ValueError
            If there are no waves to scale.
        """
        variance = self.moment(0)
        if variance == 0:
            raise ValueError("a spectrum without waves cannot be scaled")
        return Spectrum(self.frequency_hz, self.density * (significant_height**2 / 16 / variance))


def jonswap_density(
    frequency_hz: ArrayLike, significant_height: float, peak_period: float, peak_enhancement: float
) -> NDArray[np.float64]:
    """JONSWAP variance density, in m^2/Hz.

    ``S = H_s^2 T_p / (16 I) x^-5 exp(-5/4 x^-4) gamma^exp(-(x-1)^2 / (2 sigma^2))``
    with x = f T_p, and sigma = 0.07 up to the peak and 0.09 above it. ``I(gamma)``,
    the integral of the shape over all x, is computed and not fitted, so that
    m_0 = H_s^2/16 over 0 < f < inf to twelve digits.

    Frequencies f >= 0 in Hz, with S(0) = 0; ``significant_height`` H_s >= 0 in m;
    ``peak_period`` T_p > 0 in s; ``peak_enhancement`` gamma >= 1, where 1 is the
    Pierson-Moskowitz shape.

    References
    ----------
    Hasselmann et al., Measurements of wind-wave growth and swell decay during the
    Joint North Sea Wave Project (JONSWAP), Dt. Hydrogr. Z. A8-12 (1973).
    """
    ratio = np.maximum(np.asarray(frequency_hz, dtype=float) * peak_period, LOWEST_RATIO)
    scale = significant_height**2 * peak_period / (16 * _shape_integral(peak_enhancement))
    return np.asarray(
        scale * ratio**-5 * np.exp(-1.25 * ratio**-4) * _enhancement(ratio, peak_enhancement)
    )


def periodogram(elevation: ArrayLike, interval: float, padding: int = 8) -> Spectrum:
    """Spectrum of a record of the surface, without window or smoothing.

    The record's mean is taken off. Its m_0 is then the record's variance (Parseval); a
    window would spread m_0 over still fewer waves. Elevations in m, ``interval`` seconds
    apart; the record is lengthened ``padding``-fold with zeros, which refines the grid of
    frequencies and so the peak, and adds no information.
    """
    record = np.asarray(elevation, dtype=float)
    length = padding * len(record)
    transform = np.fft.rfft(record - record.mean(), length)
    density = 2 * interval / len(record) * np.abs(transform) ** 2
    return Spectrum(np.asarray(np.fft.rfftfreq(length, interval), dtype=float), density)


def _enhancement(ratio: NDArray[np.float64], gamma: float) -> NDArray[np.float64]:
    width = np.where(ratio <= 1, WIDTH_BELOW_PEAK, WIDTH_ABOVE_PEAK)
    return np.asarray(gamma ** np.exp(-((ratio - 1) ** 2) / (2 * width**2)))


@cache
def _shape_integral(gamma: float) -> float:
    """Integral of x^-5 exp(-5/4 x^-4) gamma^r(x) over x > 0.

    With v = exp(-5/4 x^-4), x^-5 exp(-5/4 x^-4) dx = dv/5: a bounded integrand on
    0 < v < 1, with a bend at the peak alone.
    """

    def integrand(v: float) -> float:
        return float(_enhancement(np.asarray((-0.8 * math.log(v)) ** -0.25), gamma))

    peak = math.exp(-1.25)
    below, _ = scipy.integrate.quad(integrand, 0.0, peak, epsabs=1e-13, epsrel=1e-13)
    above, _ = scipy.integrate.quad(integrand, peak, 1.0, epsabs=1e-13, epsrel=1e-13)
    return (below + above) / 5


def _vertex(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Abscissa of the vertex of the parabola through three points, the middle one highest."""
    left = (y[1] - y[0]) / (x[1] - x[0])
    right = (y[2] - y[1]) / (x[2] - x[1])
    if left == right:
        return float(x[1])
    return float((x[0] + x[1]) / 2 + left * (x[2] - x[0]) / (2 * (left - right)))
