"""Spectra: normalisation, moments, peak."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from softwave_min.waves import Spectrum, jonswap_density


def jonswap(height=3.0, period=8.0, gamma=3.3, step=1e-4):
    frequency = np.arange(0.0, 5.0, step)
    return Spectrum(frequency, jonswap_density(frequency, height, period, gamma))


@pytest.mark.parametrize("gamma", [1.0, 1.55, 3.3, 5.0, 10.0])
@pytest.mark.parametrize("period", [6.1, 8.0, 10.0])
def test_jonswap_holds_the_energy_of_its_height(period, gamma):
    def density(frequency):
        return float(jonswap_density(frequency, 3.0, period, gamma))

    edges = [0.0, 0.9 / period, 1 / period, 1.2 / period, 2 / period, 10 / period]
    pieces = (quad(density, a, b, epsabs=0, epsrel=1e-13)[0] for a, b in pairwise(edges))
    variance = sum(pieces) + quad(density, edges[-1], np.inf, epsabs=1e-14)[0]
    assert 4 * math.sqrt(variance) == pytest.approx(3.0, rel=1e-13)


def test_peak_agrees_with_two_other_codes():
    """Each code's peak, brought to its own H_m0: they differ in normalisation alone.

    wavespectra 3.8.1: 13.950 m^2/Hz at H_m0 2.9997 m; mhkit 1.1.2: 13.984 at 3.0033 m.
    """
    peak = jonswap_density(1 / 8.0, 3.0, 8.0, 3.3)
    for density, height in ((13.950, 2.9997), (13.984, 3.0033)):
        assert peak == pytest.approx(density * (3.0 / height) ** 2, rel=3e-4)


def test_gamma_one_is_pierson_moskowitz():
    frequency = np.linspace(0.05, 0.6, 200)
    peak = 1 / 8.0
    expected = 5 / 16 * 9.0 * peak**4 / frequency**5 * np.exp(-1.25 * (peak / frequency) ** 4)
    np.testing.assert_allclose(jonswap_density(frequency, 3.0, 8.0, 1.0), expected, rtol=1e-11)


@pytest.mark.parametrize("gamma", [1.55, 3.3, 7.0])
def test_enhancement_over_pierson_moskowitz(gamma):
    """At the peak gamma, sigma f_p beside it gamma^exp(-1/2), two sigma f_p gamma^exp(-2)."""
    period = 8.0
    ratio = np.array([0.86, 0.93, 1.0, 1.09, 1.18, 3.0])
    exponent = np.exp([-2.0, -0.5, 0.0, -0.5, -2.0, -np.inf])
    peaked = jonswap_density(ratio / period, 3.0, period, gamma)
    plain = jonswap_density(ratio / period, 3.0, period, 1.0)
    enhancement = peaked / plain
    np.testing.assert_allclose(enhancement / enhancement[-1], gamma**exponent, rtol=1e-12)


def test_jonswap_at_the_ends_of_the_frequency_axis():
    with np.errstate(all="raise", under="ignore"):
        density = jonswap_density([0.0, 1e-300, 1e-3, 1e6], 3.0, 8.0, 3.3)
    assert np.all(density[:3] == 0)
    assert 0 < density[3] < 1e-30


@given(
    height=st.floats(0.1, 20),
    period=st.floats(2, 20),
    gamma=st.floats(1, 10),
)
def test_curve_scales_with_the_square_of_height_and_with_period(height, period, gamma):
    ratio = np.linspace(0.3, 4, 40)
    unit = jonswap_density(ratio, 1.0, 1.0, gamma)
    curve = jonswap_density(ratio / period, height, period, gamma)
    np.testing.assert_allclose(curve, unit * height**2 * period, rtol=1e-9)


def test_height_and_period_are_recovered_from_a_curve():
    spectrum = jonswap()
    assert spectrum.significant_height == pytest.approx(3.0, rel=1e-4)
    assert spectrum.peak_period == pytest.approx(8.0, rel=2e-4)


def test_moments_of_a_triangle():
    triangle = Spectrum([0.1, 0.2, 0.3], [0.0, 2.0, 0.0])
    assert triangle.moment(0) == pytest.approx(0.2)
    assert triangle.moment(1) / triangle.moment(0) == pytest.approx(0.2)
    assert triangle.significant_height == pytest.approx(4 * math.sqrt(0.2))
    np.testing.assert_allclose(triangle.density_at([0.15, 0.25]), [1, 1])


def test_no_density_outside_the_band():
    level = Spectrum([0.1, 0.2], [2.0, 3.0])
    np.testing.assert_array_equal(level.density_at([0.05, 0.1, 0.2, 0.25]), [0, 2, 3, 0])


@given(top=st.floats(0.16, 0.24), spacing=st.floats(0.6, 1.6))
def test_peak_of_a_parabola_is_exact_on_an_uneven_grid(top, spacing):
    frequency = np.array([0.1, 0.2 - 0.04 * spacing, 0.2, 0.2 + 0.04 / spacing, 0.3])
    spectrum = Spectrum(frequency, 1 - 20 * (frequency - top) ** 2)
    if np.argmax(spectrum.density) in (1, 2, 3):
        assert spectrum.peak_period == pytest.approx(1 / top, rel=1e-9)


def test_peak_at_an_end_of_the_band_is_the_sample():
    assert Spectrum([0.1, 0.2, 0.3], [3.0, 2.0, 1.0]).peak_period == pytest.approx(10.0)
    assert Spectrum([0.1, 0.2, 0.3], [1.0, 2.0, 3.0]).peak_period == pytest.approx(1 / 0.3)
    assert Spectrum([0.1, 0.2, 0.3], [0.0, 2.0, 2.0]).peak_period == pytest.approx(1 / 0.25)


def test_peak_that_is_too_low_for_a_slope_is_the_sample():
    """The smallest number there is, over 4 Hz, is no slope any more."""
    assert Spectrum([4.0, 8.0, 12.0], [0.0, 5e-324, 0.0]).peak_period == 1 / 8


def test_scaling_keeps_the_shape():
    spectrum = jonswap()
    scaled = spectrum.scaled_to(1.5)
    assert scaled.significant_height == pytest.approx(1.5, rel=1e-12)
    assert scaled.peak_period == pytest.approx(spectrum.peak_period, rel=1e-12)


@pytest.mark.parametrize("variance", [1.0, 0.25])
def test_any_variance_is_scaled(variance):
    spectrum = Spectrum([0.0, 0.5, 1.0], [0.0, 2 * variance, 0.0])
    assert spectrum.moment(0) == variance
    np.testing.assert_allclose(spectrum.scaled_to(2.0).density, [0, 0.5, 0], rtol=1e-15)


def test_no_waves_no_peak_and_nothing_to_scale():
    calm = Spectrum([0.1, 0.2], [0.0, 0.0])
    with pytest.raises(ValueError, match="without waves has no peak"):
        _ = calm.peak_period
    with pytest.raises(ValueError, match="without waves cannot be scaled"):
        calm.scaled_to(1.0)


@pytest.mark.parametrize(
    ("frequency", "density", "fault"),
    [
        ([0.1, 0.2], [1.0], "one length"),
        ([0.1], [1.0], "two or more"),
        ([-0.1, 0.2], [1.0, 1.0], "none negative"),
        ([0.2, 0.1], [1.0, 1.0], "ascending"),
        ([0.1, np.nan], [1.0, 1.0], "ascending"),
        ([0.1, 0.2, np.inf], [1.0, 1.0, 1.0], "finite"),
        ([0.1, 0.1], [1.0, 1.0], "ascending"),
        ([[0.1, 0.2]], [[1.0, 1.0]], "two vectors"),
        ([0.1, 0.2], [1.0, -1.0], "not negative"),
        ([0.1, 0.2], [1.0, np.inf], "finite"),
    ],
)
def test_samples_are_checked(frequency, density, fault):
    with pytest.raises(ValueError, match=fault):
        Spectrum(np.array(frequency), np.array(density))


def test_the_callers_arrays_are_neither_shared_nor_changed():
    density = np.array([0.0, 2.0, 0.0])
    spectrum = Spectrum(np.array([0.1, 0.2, 0.3]), density)
    density[1] = 5.0
    assert spectrum.density[1] == 2.0
    with pytest.raises(ValueError, match="read-only"):
        spectrum.density[1] = 1.0
