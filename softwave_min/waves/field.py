"""The flow under a sea in linear wave theory.

Elevation, velocity and acceleration are sums over components that travel towards
+x; the bed is at z = -d and the mean surface at z = 0. Nothing is stretched above
the mean surface: the fields are the analytic ones of linear theory everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy  # whose parts are loaded when they are used
from numpy.typing import ArrayLike, NDArray

from softwave_min.parameters import SeaParameters
from softwave_min.waves.dispersion import wave_number
from softwave_min.waves.spectrum import Spectrum, jonswap_density

Floats = NDArray[np.float64]

_PER_COMPONENT = ("angular_frequency", "amplitude", "wave_number", "phase")


@dataclass(frozen=True, eq=False)
class Sea:
    """Wave components: elevation = sum a_i cos(k_i x - w_i t + phi_i).

    The vectors have one length N, or a ValueError says so, and are kept as read-only copies.
    Methods take x, z, t of any shapes that broadcast and return that shape.
    """

    angular_frequency: Floats
    """w, in rad/s."""
    amplitude: Floats
    """a = A/2, in m, where A is the paper's crest-to-trough 'amplitude'."""
    wave_number: Floats
    """k, in rad/m."""
    phase: Floats
    """phi, in rad."""
    depth: float
    """Water depth d, in m."""
    gravity: float
    """g, in m/s^2."""

    def __post_init__(self) -> None:
        for name in _PER_COMPONENT:
            array = np.array(getattr(self, name), dtype=float).reshape(-1)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if len({len(getattr(self, name)) for name in _PER_COMPONENT}) > 1:
            raise ValueError(f"{', '.join(_PER_COMPONENT)}: must have one length")

    @classmethod
    def still(cls, depth: float, gravity: float) -> Self:
        """Water at rest: no component."""
        nothing = np.empty(0)
        return cls(nothing, nothing, nothing, nothing, depth, gravity)

    @classmethod
    def regular(
        cls, height: float, period: float, depth: float, gravity: float, phase: float = 0.0
    ) -> Self:
        """One wave of crest-to-trough ``height`` in m and ``period`` > 0 in s."""
        frequency = np.array([2 * math.pi / period])
        number = wave_number(frequency, depth, gravity)
        return cls(frequency, np.array([height / 2]), number, np.array([phase]), depth, gravity)

    @classmethod
    def random(cls, parameters: SeaParameters, gravity: float) -> Self:
        """A JONSWAP sea.

        The band is cut into equal bins; the component in the middle of each has
        a = sqrt(2 S df), and all are scaled by one factor so that sum a^2/2 =
        H_s^2/16. The phases depend on seed and number of components alone: seas of
        one seed differ in height and period only.
        """
        frequency_hz, _ = _bins(parameters)
        density = jonswap_density(
            frequency_hz, 1.0, parameters.peak_period, parameters.peak_enhancement
        )
        return cls._of_density(density, parameters.significant_height**2 / 16, parameters, gravity)

    @classmethod
    def from_spectrum(cls, spectrum: Spectrum, parameters: SeaParameters, gravity: float) -> Self:
        """A sea with any spectrum, such as a measured one, in place of the JONSWAP curve.

        The spectrum gives the shape; height, depth, band, number of components and phases
        come from ``parameters``, as in `random`. ``peak_period`` and ``peak_enhancement``
        are not read.

        Raises
        ------
        ValueError
            If the spectrum has no waves, or none in the middle of any bin.
        """
        scaled = spectrum.scaled_to(parameters.significant_height)
        density = scaled.density_at(_bins(parameters)[0])
        return cls._of_density(density, scaled.moment(0), parameters, gravity)

    @classmethod
    def _of_density(
        cls, density: Floats, variance: float, parameters: SeaParameters, gravity: float
    ) -> Self:
        """Components of a density in the middle of each bin, so that sum a^2/2 = variance."""
        frequency_hz, width = _bins(parameters)
        frequency, depth = 2 * math.pi * frequency_hz, parameters.depth
        amplitude = _amplitudes(density, width, variance)
        phase = np.random.default_rng(parameters.seed).uniform(0, 2 * math.pi, len(frequency))
        number = wave_number(frequency, depth, gravity)
        return cls(frequency, amplitude, number, phase, depth, gravity)

    def elevation(self, x: ArrayLike, t: ArrayLike) -> Floats:
        """Surface elevation zeta(x, t), in m (paper, eq. WaveEquation)."""
        return np.asarray(np.cos(self._angle(x, t)) @ self.amplitude)

    def velocity(self, x: ArrayLike, z: ArrayLike, t: ArrayLike) -> tuple[Floats, Floats]:
        """Velocity (u, w) in m/s (paper, eqs. ParticleVelocityX and ParticleVelocityZ)."""
        angle = self._angle(x, t)
        horizontal, vertical = self._profiles(z)
        speed = self.amplitude * self.angular_frequency
        return (
            np.asarray((horizontal * np.cos(angle)) @ speed),
            np.asarray((vertical * np.sin(angle)) @ speed),
        )

    def acceleration(self, x: ArrayLike, z: ArrayLike, t: ArrayLike) -> tuple[Floats, Floats]:
        """Local acceleration (du/dt, dw/dt) at a fixed point, in m/s^2."""
        angle = self._angle(x, t)
        horizontal, vertical = self._profiles(z)
        strength = self.amplitude * self.angular_frequency**2
        return (
            np.asarray((horizontal * np.sin(angle)) @ strength),
            np.asarray((vertical * np.cos(angle)) @ -strength),
        )

    def taylor_velocity(
        self, centre: tuple[float, float], times: ArrayLike, space_order: int, time_order: int
    ) -> NDArray[np.complex128]:
        """Taylor coefficients of the complex velocity about a point and each time.

        u - i w = sum_i a_i w_i / sinh(k_i d) cos(k_i (Z + i d) - w_i t + phi_i) is
        analytic in Z = x + i z, so near (Z_0, t_j)

        ``u - i w = sum_nm C[j, n, m] (Z - Z_0)^n (t - t_j)^m``.

        The local acceleration is the derivative of this in t. ``centre`` is (x_0, z_0) in m,
        ``times`` are the t_j in s, the orders the highest powers kept.

        Returns
        -------
        ndarray of complex, shape (T, space_order + 1, time_order + 1)
            C, in m/s per m^n s^m.
        """
        n = np.arange(space_order + 1)
        m = np.arange(time_order + 1)
        in_space = (-1j * self.wave_number[:, None]) ** n / scipy.special.factorial(n)
        in_time = (1j * self.angular_frequency[:, None]) ** m / scipy.special.factorial(m)
        powers = (in_space[:, :, None] * in_time[:, None, :]).reshape(-1, len(n) * len(m))
        x, z = centre
        # cos = (exp + exp)/2; the half that grows with depth is written with exp(-2 k d) in it
        rotation = np.exp(-1j * self._angle(x, np.asarray(times, dtype=float)))
        towards_surface, reflected = self._exponentials(z)
        speed = self.amplitude * self.angular_frequency
        coefficients = (rotation * (speed * towards_surface)) @ powers
        coefficients += (rotation.conj() * (speed * reflected)) @ powers.conj()
        return np.asarray(coefficients.reshape(-1, len(n), len(m)))

    def taylor_error_bound(
        self,
        centre: tuple[float, float],
        radius: float,
        half_interval: float,
        *,
        space_order: int,
        time_order: int,
        time_derivative: int = 0,
    ) -> float:
        """Bound on |error of u - i w| of `taylor_velocity`, for all times and phases.

        A component of speed U = a w cosh(k (z_0 + d)) / sinh(k d) is a sum of two
        exp(alpha) exp(beta) with |alpha| <= k r and beta imaginary, |beta| <= w tau.
        Both are cut short, hence

        ``|error| <= sum_i U_i [ sum_(j>n) (k_i r)^j / j!
        + sum_(j<=n) (k_i r)^j / j! (w_i tau)^(m+1) / (m+1)! ]``

        ``centre`` is (x_0, z_0), ``radius`` the largest distance r from it, in m,
        ``half_interval`` the largest |t - t_j|, tau, in s; the orders n and m are the highest
        powers kept. ``time_derivative`` 0 bounds the velocity in m/s, 1 the acceleration in m/s^2.
        """
        reach = self.wave_number * radius
        kept_time = time_order - time_derivative
        cut_space = np.exp(reach) * scipy.special.gammainc(space_order + 1, reach)
        kept_space = np.exp(reach) * scipy.special.gammaincc(space_order + 1, reach)
        turn = self.angular_frequency * half_interval
        cut_time = turn ** (kept_time + 1) / scipy.special.factorial(kept_time + 1)
        speed = self.amplitude * self.angular_frequency ** (1 + time_derivative)
        strength = speed * self._profiles(centre[1])[0]
        return float(strength @ (cut_space + kept_space * cut_time))

    def _angle(self, x: ArrayLike, t: ArrayLike) -> Floats:
        """Phase angle k x - w t + phi, components along the last axis."""
        x, t = np.asarray(x, dtype=float), np.asarray(t, dtype=float)
        return np.asarray(
            self.wave_number * x[..., None] - self.angular_frequency * t[..., None] + self.phase
        )

    def _exponentials(self, z: ArrayLike) -> tuple[Floats, Floats]:
        """exp(+-k (z + d)) / (2 sinh k d), written so that nothing overflows."""
        z = np.asarray(z, dtype=float)[..., None]
        whole = -np.expm1(-2 * self.wave_number * self.depth)
        rising = np.exp(self.wave_number * z) / whole
        falling = np.exp(-self.wave_number * (z + 2 * self.depth)) / whole
        return np.asarray(rising), np.asarray(falling)

    def _profiles(self, z: ArrayLike) -> tuple[Floats, Floats]:
        """Depth profiles cosh k(z + d) / sinh k d and sinh k(z + d) / sinh k d."""
        rising, falling = self._exponentials(z)
        above_bed = self.wave_number * (np.asarray(z, dtype=float)[..., None] + self.depth)
        # expm1 keeps the digits close to the bed, where the two exponentials cancel
        return rising + falling, np.asarray(rising * -np.expm1(-2 * above_bed))


def _bins(parameters: SeaParameters) -> tuple[Floats, float]:
    """Middles and width of the equal bins of the band, in Hz."""
    lowest, count = parameters.lowest_frequency_hz, parameters.components
    width = (parameters.highest_frequency_hz - lowest) / count
    return np.asarray(lowest + width * (np.arange(count) + 0.5), dtype=float), width


def _amplitudes(density: Floats, width: float, variance: float) -> Floats:
    """sqrt(2 S df), scaled so that sum a^2/2 is ``variance``."""
    if variance == 0:
        return np.zeros(len(density))
    sampled = float(density.sum()) * width
    if sampled == 0:
        raise ValueError("the band holds none of the spectrum's waves")
    return np.asarray(np.sqrt(2 * density * width * (variance / sampled)))
