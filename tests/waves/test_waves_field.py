"""The flow of linear wave theory: equations, conventions, limits, Taylor expansion."""

import math
from dataclasses import replace

import numpy as np
import pytest

from softwave_min.arm.mechanics import Structure
from softwave_min.paper.cases import wave_cases
from softwave_min.waves import Sea, Spectrum, jonswap_density

GRAVITY = 9.81
BASE = (0.0, -4.0)
FIELDS = ("velocity", "acceleration")


@pytest.fixture(scope="module")
def sea(parameters):
    return Sea.random(parameters, GRAVITY)


@pytest.fixture(scope="module", params=[20.0, 1e4, 0.5], ids="depth {:g} m".format)
def at_depth(request, parameters):
    """A sea, and 50 places and times in its water, no deeper than 19 m."""
    sea = Sea.random(replace(parameters, depth=request.param), GRAVITY)
    rng = np.random.default_rng(7)
    z = rng.uniform(-min(request.param, 19.0), 0, 50)
    return sea, rng.uniform(-40, 40, 50), z, rng.uniform(0, 60, 50)


def derivative(function, step=0.02):
    """By central differences of eighth order."""
    weights = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    pairs = (function(i * step) - function(-i * step) for i in range(1, 5))
    return sum(c * pair for c, pair in zip(weights, pairs, strict=True)) / step


def test_continuity_and_no_rotation(at_depth):
    """Both together are Laplace's equation of the potential."""
    sea, x, z, t = at_depth
    u_x, w_x = derivative(lambda s: np.array(sea.velocity(x + s, z, t)))
    u_z, w_z = derivative(lambda s: np.array(sea.velocity(x, z + s, t)))
    assert np.max(np.abs(u_x + w_z)) < 1e-10
    assert np.max(np.abs(w_x - u_z)) < 1e-10
    assert np.max(np.abs(u_x)) > 0.01


def test_no_flow_through_the_bed(at_depth):
    sea, x, _, t = at_depth
    _, w = sea.velocity(x, -sea.depth, t)
    assert np.all(w == 0)


def test_surface_moves_with_the_water(at_depth):
    sea, x, _, t = at_depth
    rise = derivative(lambda s: sea.elevation(x, t + s))
    np.testing.assert_allclose(sea.velocity(x, 0.0, t)[1], rise, rtol=0, atol=1e-10)
    assert np.max(np.abs(rise)) > 0.1


def test_pressure_at_the_surface_is_constant(at_depth):
    """Linear Bernoulli: du/dt + g d(zeta)/dx = 0 at z = 0, hence the dispersion relation."""
    sea, x, _, t = at_depth
    slope = derivative(lambda s: sea.elevation(x + s, t))
    np.testing.assert_allclose(sea.acceleration(x, 0.0, t)[0], -GRAVITY * slope, rtol=0, atol=1e-10)
    assert np.max(np.abs(slope)) > 0.01


def test_acceleration_is_the_local_derivative_of_velocity(at_depth):
    sea, x, z, t = at_depth
    exact = derivative(lambda s: np.array(sea.velocity(x, z, t + s)))
    np.testing.assert_allclose(np.array(sea.acceleration(x, z, t)), exact, rtol=0, atol=1e-10)
    assert np.max(np.abs(exact)) > 0.1


def test_agrees_with_another_code():
    """raschii 2.0.0 'Airy': H = 3 m, wavelength 99.7 m, depth 54 m, at z = -4 m.

    The water moves forward under a crest and rises ahead of it.
    """
    number = 2 * math.pi / 99.7
    frequency = math.sqrt(GRAVITY * number * math.tanh(number * 54.0))
    wave = Sea.regular(3.0, 2 * math.pi / frequency, 54.0, GRAVITY)
    assert wave.wave_number[0] == pytest.approx(number, rel=1e-13)
    under_crest, ahead = wave.velocity(0.0, -4.0, 0.0), wave.velocity(99.7 / 4, -4.0, 0.0)
    np.testing.assert_allclose(under_crest, [0.91830076, 0.0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(ahead, [0.0, 0.91494140], rtol=0, atol=1e-8)


def test_the_wave_travels_towards_positive_x():
    wave = Sea.regular(2.0, 8.0, 20.0, GRAVITY)
    speed = wave.angular_frequency[0] / wave.wave_number[0]
    t = np.linspace(0, 8, 9)
    np.testing.assert_allclose(wave.elevation(speed * t, t), 1.0, atol=1e-12)


def test_height_is_crest_to_trough():
    wave = Sea.regular(2.0, 8.0, 20.0, GRAVITY, phase=0.7)
    elevation = wave.elevation(0.0, np.linspace(0, 8, 4001))
    assert elevation.max() - elevation.min() == pytest.approx(2.0, rel=1e-6)
    assert wave.elevation(0.0, 0.0) == pytest.approx(math.cos(0.7))


def test_parseval(parameters):
    """Components at odd multiples of 5 mHz repeat after 200 s: the series' Fourier
    amplitudes over that time are the components', each where it belongs.
    """
    sea = Sea.random(
        replace(parameters, lowest_frequency_hz=0.05, highest_frequency_hz=0.55, components=50),
        GRAVITY,
    )
    elevation = sea.elevation(0.0, np.arange(0, 200, 0.5))
    fourier = np.fft.rfft(elevation) / 200
    expected = np.zeros(201)
    expected[11:110:2] = sea.amplitude
    np.testing.assert_allclose(np.abs(fourier), expected, atol=1e-12)
    np.testing.assert_allclose(np.var(elevation), np.sum(sea.amplitude**2) / 2, rtol=1e-12)


def test_components_follow_the_curve(sea, parameters):
    width = (parameters.highest_frequency_hz - parameters.lowest_frequency_hz) / 60
    frequency = sea.angular_frequency / (2 * np.pi)
    density = jonswap_density(frequency, 3.0, 10.0, 3.3)
    ratio = sea.amplitude**2 / (2 * width) / density
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    assert ratio[0] == pytest.approx(1, abs=0.02)
    np.testing.assert_allclose(np.diff(frequency), width)
    assert frequency[0] == pytest.approx(parameters.lowest_frequency_hz + width / 2)


def test_one_seed_one_set_of_phases(parameters):
    phases = [
        Sea.random(replace(parameters, significant_height=h, peak_period=p), GRAVITY).phase
        for h in (0.5, 3.0)
        for p in (6.1, 8.0, 10.0)
    ]
    for phase in phases:
        np.testing.assert_array_equal(phase, phases[0])
    other = Sea.random(replace(parameters, seed=parameters.seed + 1), GRAVITY).phase
    assert not np.any(other == phases[0])


def test_phases_fill_the_circle_evenly(parameters):
    phase = Sea.random(replace(parameters, components=20000), GRAVITY).phase
    counts, _ = np.histogram(phase, bins=20, range=(0, 2 * math.pi))
    assert counts.sum() == 20000
    assert np.all(np.abs(counts - 1000) < 5 * math.sqrt(1000))


def test_a_phase_delays_the_wave():
    """elevation = a cos(k x - w t + phi): the wave comes later by phi/w."""
    plain, delayed = (Sea.regular(2.0, 8.0, 20.0, GRAVITY, phase=phase) for phase in (0.0, 0.7))
    t = np.linspace(0, 8, 9)
    later = t + 0.7 / plain.angular_frequency[0]
    for field, place in (("elevation", (3.0,)), *((f, (3.0, -4.0)) for f in FIELDS)):
        late, early = getattr(delayed, field)(*place, later), getattr(plain, field)(*place, t)
        np.testing.assert_allclose(late, early, rtol=0, atol=1e-14)


def test_seas_of_one_seed_are_proportional_to_height(parameters):
    t = np.linspace(0, 60, 601)
    low = Sea.random(replace(parameters, significant_height=0.5), GRAVITY).elevation(0.0, t)
    high = Sea.random(replace(parameters, significant_height=3.0), GRAVITY).elevation(0.0, t)
    np.testing.assert_allclose(high, 6 * low, atol=1e-12)


def test_a_spectrum_and_the_formula_make_the_same_sea(parameters, sea):
    frequency = np.arange(0.0, 5.0, 1e-4)
    spectrum = Spectrum(frequency, jonswap_density(frequency, 3.0, 10.0, 3.3))
    same = Sea.from_spectrum(spectrum, parameters, GRAVITY)
    np.testing.assert_allclose(same.amplitude, sea.amplitude, rtol=1e-4, atol=1e-8)
    np.testing.assert_array_equal(same.phase, sea.phase)


def test_a_band_without_waves_is_refused(parameters):
    spectrum = Spectrum([0.1, 0.15, 0.2], [0.0, 1.0, 0.0])
    band = replace(parameters, lowest_frequency_hz=0.3, highest_frequency_hz=0.5)
    with pytest.raises(ValueError, match="holds none of the spectrum's waves"):
        Sea.from_spectrum(spectrum, band, GRAVITY)


def test_any_height_has_its_waves(parameters):
    for height in (1e-3, 1.0, 4.0, 8.0):
        sea = Sea.random(replace(parameters, significant_height=height), GRAVITY)
        assert 4 * math.sqrt(np.sum(sea.amplitude**2) / 2) == pytest.approx(height, rel=1e-12)


def test_a_measured_spectrum_of_no_height_is_a_flat_sea(parameters):
    flat = replace(parameters, significant_height=0.0)
    sea = Sea.from_spectrum(Spectrum([0.1, 0.2], [1.0, 1.0]), flat, GRAVITY)
    assert np.all(sea.amplitude == 0)
    assert len(sea.amplitude) == parameters.components


def test_no_height_no_motion(parameters):
    flat = Sea.random(replace(parameters, significant_height=0.0), GRAVITY)
    still = Sea.still(20.0, GRAVITY)
    assert len(still.amplitude) == 0
    t = np.arange(5.0)
    for sea in (flat, still):
        assert np.all(sea.elevation(0.0, t) == 0)
        assert np.all(np.array(sea.velocity(0.0, -4.0, t)) == 0)
        assert np.all(np.array(sea.acceleration(0.0, -4.0, t)) == 0)
        assert np.all(sea.taylor_velocity(BASE, t, 3, 2) == 0)
        assert sea.taylor_velocity(BASE, t, 3, 2).shape == (5, 4, 3)


def test_deep_water_limit_without_overflow():
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        wave = Sea.regular(2.0, 0.5, 1e4, GRAVITY)
        u, w = wave.velocity(0.3, np.array([0.0, -0.1, -4.0, -1e4]), 0.2)
        coefficients = wave.taylor_velocity((0.3, -0.1), [0.2], 2, 2)
    frequency, number = wave.angular_frequency[0], wave.wave_number[0]
    angle = number * 0.3 - frequency * 0.2
    decay = frequency * np.exp(number * np.array([0.0, -0.1, -4.0, -1e4]))
    np.testing.assert_allclose(u, decay * math.cos(angle), rtol=1e-12)
    np.testing.assert_allclose(w, decay * math.sin(angle), rtol=1e-12)
    assert coefficients[0, 0, 0] == pytest.approx(complex(u[1], -w[1]), rel=1e-12)


def test_shallow_water_limit():
    """Long waves: u = zeta sqrt(g/d) at every depth, w linear from bed to surface."""
    depth, z, t = 0.5, np.array([0.0, -0.1, -0.25, -0.5]), -30.0
    wave = Sea.regular(0.02, 600.0, depth, GRAVITY)
    u, w = wave.velocity(0.0, z, t)
    np.testing.assert_allclose(u, wave.elevation(0.0, t) * math.sqrt(GRAVITY / depth), rtol=1e-5)
    np.testing.assert_allclose(w, w[0] * (z + depth) / depth, rtol=1e-5, atol=0)
    assert w[0] > 0


def test_arguments_broadcast(sea):
    x, z, t = np.zeros((4, 1)), np.linspace(-5, -3, 3), 2.0
    u, w = sea.velocity(x, z, t)
    assert u.shape == w.shape == (4, 3)
    assert sea.elevation(x, np.arange(6.0)).shape == (4, 6)
    assert sea.acceleration(0.0, -4.0, 1.0)[0].shape == ()


def test_components_cannot_be_changed(sea):
    with pytest.raises(ValueError, match="read-only"):
        sea.amplitude[0] = 1.0


def error_bound(sea, reach, half, order, differentiated=0):
    orders = {"space_order": order[0], "time_order": order[1], "time_derivative": differentiated}
    return sea.taylor_error_bound(BASE, reach, half, **orders)


def evaluated(coefficients, offset, delay, differentiated=0):
    """The expansion at Z_0 + offset, t_j + delay; or its derivative in time."""
    powers = np.polynomial.polynomial.polyder(coefficients, differentiated, axis=2)
    in_time = powers @ delay ** np.arange(powers.shape[2])
    return in_time @ offset ** np.arange(powers.shape[1])


@pytest.mark.parametrize("period", [6.1, 10.0])
@pytest.mark.parametrize("order", [(2, 2), (8, 2), (6, 4), (8, 5)])
@pytest.mark.parametrize("in_time", [0, 1])
def test_expansion_agrees_with_the_sum_within_its_bound(parameters, period, order, in_time):
    sea = Sea.random(replace(parameters, peak_period=period), GRAVITY)
    times = np.arange(0.05, 60, 0.1)
    coefficients = sea.taylor_velocity(BASE, times, *order)
    errors = []
    for direction in np.exp(2j * np.pi * np.arange(8) / 8):
        for delay in (-0.05, 0.05):
            offset = 0.9 * direction
            where = (offset.real, BASE[1] + offset.imag, times + delay)
            field = sea.acceleration if in_time else sea.velocity
            u, w = field(*where)
            errors.append(np.abs(evaluated(coefficients, offset, delay, in_time) - u + 1j * w))
    bound = error_bound(sea, 0.9, 0.05, order, in_time)
    assert np.max(errors) <= bound + 1e-14
    assert np.max(errors) > bound / 50


@pytest.mark.parametrize("case", ["W1", "W2", "W3"])
@pytest.mark.parametrize("height", [0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
def test_expansion_replaces_the_sum_within_the_arms_reach(nominal, case, height):
    """As a run expands it: relative to the rms of the flow at the same point below 1e-6,
    for velocity and acceleration. The error is analytic in Z, so it is largest on the
    circle of the arm's reach. The bound, which holds for all phases and times, is below
    1e-6 as well.
    """
    period = wave_cases()[case].peak_period
    chosen = replace(nominal.sea, significant_height=height, peak_period=period)
    sea = Sea.random(chosen, nominal.fluid.gravity)
    assert nominal.arm.base_position == BASE
    reach, half = sum(nominal.arm.length), nominal.nmpc.control_period / 2
    order = Structure.space_order, Structure.time_order
    times = np.arange(half, nominal.simulation.duration, 12 * half)
    coefficients = sea.taylor_velocity(BASE, times, *order)
    slowest = [math.inf, math.inf]
    for offset in reach * np.exp(2j * np.pi * np.arange(16) / 16):
        for delay in (-half, half):
            where = (offset.real, BASE[1] + offset.imag, times + delay)
            for in_time, field in enumerate((sea.velocity, sea.acceleration)):
                u, w = field(*where)
                rms = math.sqrt(np.mean(u**2 + w**2))
                error = evaluated(coefficients, offset, delay, in_time) - u + 1j * w
                assert np.max(np.abs(error)) < 1e-6 * rms
                slowest[in_time] = min(slowest[in_time], rms)
    for in_time, rms in enumerate(slowest):
        assert error_bound(sea, reach, half, order, in_time) < 1e-6 * rms


def test_the_bound_is_attained_by_the_worst_wave():
    """Deep water, straight above the centre: all terms left out add up."""
    wave = Sea.regular(2.0, 3.0, 500.0, GRAVITY)
    u, w = wave.velocity(0.0, -3.1, 0.0)
    error = abs(evaluated(wave.taylor_velocity(BASE, [0.0], 3, 0), 0.9j, 0.0)[0] - u + 1j * w)
    assert error == pytest.approx(error_bound(wave, 0.9, 0.0, (3, 0)), rel=1e-9)


@pytest.mark.parametrize("order", [(2, 2), (8, 5)])
@pytest.mark.parametrize("in_time", [0, 1])
def test_the_bound_is_the_sum_that_it_says(sea, order, in_time):
    radius, half, (n, m) = 0.9, 0.05, order
    kept_time = m - in_time
    expected = 0.0
    for a, w, k in zip(sea.amplitude, sea.angular_frequency, sea.wave_number, strict=True):
        above_bed = k * (BASE[1] + sea.depth)
        strength = a * w ** (1 + in_time) * math.cosh(above_bed) / math.sinh(k * sea.depth)
        powers = [(k * radius) ** j / math.factorial(j) for j in range(40)]
        in_delay = (w * half) ** (kept_time + 1) / math.factorial(kept_time + 1)
        expected += strength * (sum(powers[n + 1 :]) + sum(powers[: n + 1]) * in_delay)
    assert error_bound(sea, radius, half, order, in_time) == pytest.approx(expected, rel=1e-9)


def test_components_must_be_complete():
    with pytest.raises(ValueError, match="wave_number, phase: must have one length"):
        Sea(np.ones(3), np.ones(3), np.ones(3), np.ones(2), 20.0, GRAVITY)
