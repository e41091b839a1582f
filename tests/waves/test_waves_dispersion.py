"""The wave number solves the dispersion relation, from deep water to a film."""

import numpy as np
import pytest

from softwave_min.waves import dispersion, wave_number


@pytest.mark.parametrize("depth", [1e4, 200.0, 54.0, 20.0, 0.5, 1e-3])
def test_relation_holds_to_machine_precision(depth):
    frequency = np.logspace(-4, 2, 400)
    number = wave_number(frequency, depth, 9.81)
    residual = 9.81 * number * np.tanh(number * depth) / frequency**2 - 1
    assert np.max(np.abs(residual)) < 2e-15


@pytest.mark.parametrize("depth", [1e4, 20.0, 0.5])
def test_newton_starts_from_guos_formula_and_squares_its_error(monkeypatch, depth):
    frequency = np.logspace(-4, 2, 400)
    exact = wave_number(frequency, depth, 9.81)
    errors = []
    for steps in (0, 1, 2):
        monkeypatch.setattr(dispersion, "NEWTON_STEPS", steps)
        errors.append(np.max(np.abs(wave_number(frequency, depth, 9.81) / exact - 1)))
    assert errors[0] == pytest.approx(0.0075, abs=5e-5)
    assert errors[1] < errors[0] ** 2
    assert errors[2] < errors[1] ** 2


def test_agrees_with_another_code():
    """mhkit 1.1.2 at 54 m; it takes g = 9.80665 and the values have five digits."""
    frequency = 2 * np.pi / np.array([6.1, 8.0, 10.0])
    number = wave_number(frequency, 54.0, 9.80665)
    np.testing.assert_allclose(number, [0.10819, 0.06304, 0.04121], atol=0.5e-5)


def test_limits_of_deep_and_shallow_water():
    assert wave_number(1.0, 1e4, 9.81) == pytest.approx(1 / 9.81, rel=1e-15)
    assert wave_number(1e-3, 0.5, 9.81) == pytest.approx(1e-3 / np.sqrt(9.81 * 0.5), rel=1e-7)


def test_keeps_the_shape_of_its_argument():
    frequency = np.array([[0.5, 1.0, 2.0], [3.0, 4.0, 5.0]])
    number = wave_number(frequency, 20.0, 9.81)
    assert number.shape == (2, 3)
    assert np.all(np.diff(number.ravel()) > 0)


@pytest.mark.parametrize(
    ("frequency", "depth", "gravity", "named"),
    [
        (0.0, 20.0, 9.81, "angular_frequency"),
        ([1.0, np.nan], 20.0, 9.81, "angular_frequency"),
        (1.0, -20.0, 9.81, "depth"),
        (1.0, np.inf, 9.81, "depth"),
        (1.0, 20.0, 0.0, "gravity"),
    ],
)
def test_rejects_what_has_no_wave(frequency, depth, gravity, named):
    with pytest.raises(ValueError, match=f"^{named}: must be positive and finite$"):
        wave_number(frequency, depth, gravity)
