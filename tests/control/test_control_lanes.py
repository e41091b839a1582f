"""Code for several arguments at once, against CasADi's own evaluation of one after another."""

import ctypes

import casadi as ca
import numpy as np
import pytest

from softwave_min.control.compiled.lanes import lane_code
from softwave_min.control.summed import Summed
from softwave_min.native import build, compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")

DOUBLES = ctypes.POINTER(ctypes.c_double)


def evaluated(function, lanes, inputs, same=(), places=1):
    """Outputs of the compiled function for inputs (lanes, size), or (size,) where alike."""
    code = lane_code(function, lanes, same, places)
    library = ctypes.CDLL(str(build("lanes", {"lanes.c": code})))
    function = function.plain() if isinstance(function, Summed) else function
    arrays = [np.ascontiguousarray(one.T, dtype=float) for one in inputs]
    outputs = [np.zeros((function.numel_out(i), lanes)) for i in range(function.n_out())]
    pointers = [
        (DOUBLES * len(group))(*(one.ctypes.data_as(DOUBLES) for one in group))
        for group in (arrays, outputs)
    ]
    library[function.name()](*pointers)
    return [output.T for output in outputs]


a, b = ca.SX.sym("a"), ca.SX.sym("b")
OPERATIONS = {
    "sum": a + b,
    "difference": a - b,
    "product": a * b,
    "quotient": a / b + b / (3 * b) + a / 7,
    "opposite": -a,
    "reciprocal": 1 / b,
    "square": a**2,
    "twice": 2 * a,
    "root": ca.sqrt(ca.fabs(a)),
    "sine": ca.sin(a),
    "cosine": ca.cos(a),
    "magnitude": ca.fabs(a),
    "sign": ca.sign(a),
    "less": a < b,
    "at most": a <= b,
    "not": ca.logic_not(a < b),
    "choice": ca.if_else(a < b, a, 2 * b),
    "constant": ca.SX(0.1) + 0 * a,
}


@pytest.mark.parametrize("lanes", [2, 4, 8])
@pytest.mark.parametrize("name", OPERATIONS)
def test_each_operation_is_that_of_casadi_in_every_lane(name, lanes):
    function = ca.Function("operation", [a, b], [OPERATIONS[name]])
    rng = np.random.default_rng(3)
    values = rng.normal(scale=3, size=(2, lanes, 1))
    values[1, 0] = values[0, 0]  # equal numbers, for the comparisons
    (found,) = evaluated(function, lanes, values)
    expected = [float(function(*pair)) for pair in zip(*values[..., 0], strict=True)]
    np.testing.assert_allclose(found[:, 0], expected, rtol=4e-16, atol=1e-16)


def test_sine_and_cosine_are_exact_to_the_last_digit_but_one_over_many_turns():
    function = ca.Function("turn", [a], [ca.vertcat(ca.sin(a), ca.cos(a))])
    angles = np.concatenate(
        [np.linspace(-8 * np.pi, 8 * np.pi, 4001), np.arange(-40, 41) * np.pi / 4, [1e-9, 1e4, 0.0]]
    )
    for group in np.resize(angles, (len(angles) // 8 + 1, 8)):
        (found,) = evaluated(function, 8, [group[:, None]])
        np.testing.assert_allclose(found[:, 0], np.sin(group), rtol=0, atol=2.5e-16)
        np.testing.assert_allclose(found[:, 1], np.cos(group), rtol=0, atol=2.5e-16)


def test_an_angle_too_large_to_be_reduced_exactly_has_no_sine():
    function = ca.Function("turn", [a], [ca.vertcat(ca.sin(a), ca.cos(a))])
    most = 2**20 * np.pi / 2
    angles = np.array([most, 1.001 * most, -1e9, 1e300])
    (found,) = evaluated(function, 4, [angles[:, None]])
    np.testing.assert_allclose(found[0], [np.sin(most), np.cos(most)], rtol=0, atol=1e-15)
    assert np.isnan(found[1:]).all()


def test_a_number_that_is_not_finite_stays_in_its_lane():
    function = ca.Function("mixed", [a, b], [ca.sin(a) / b + ca.if_else(a < b, a, b)])
    values = np.array([[0.3, np.nan, np.inf, -0.2], [1.0, 1.0, 2.0, 3.0]])[..., None]
    (found,) = evaluated(function, 4, values)
    np.testing.assert_array_equal(np.isfinite(found[:, 0]), [True, False, False, True])


def test_a_divisor_that_changes_is_inverted_anew():
    """The register of a divisor is used again for another one."""
    total = a
    for step in range(6):
        total = total / (b + step) + total / (a + step)
    function = ca.Function("chain", [a, b], [total])
    values = np.random.default_rng(4).uniform(1, 2, size=(2, 4, 1))
    (found,) = evaluated(function, 4, values)
    expected = [float(function(*pair)) for pair in zip(*values[..., 0], strict=True)]
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-14)


def test_an_input_that_is_alike_in_all_lanes_is_given_once():
    x = ca.SX.sym("x", 3)
    function = ca.Function("scaled", [x, b], [b * x], ["x", "b"], ["y"])
    x_values = np.arange(12.0).reshape(4, 3)
    (found,) = evaluated(function, 4, [x_values, np.array([2.0])], same={"b"})
    np.testing.assert_array_equal(found, 2 * x_values)


def integral(rule):
    """A root of the integral of sin(a s) b / (1 + s^2), beside one that does not vary."""
    place, sums = ca.SX.sym("place"), ca.SX.sym("sums", 3)
    terms = ca.vertcat(ca.sin(a * place) * b / (1 + place**2), 0, b * ca.cos(a))
    outputs = {"root": ca.sqrt(1 + sums[0] ** 2) + sums[1], "flat": sums[2] - a}
    return Summed.of("integral", {"a": a, "b": b}, place, terms, sums, outputs, rule)


@pytest.mark.parametrize(("arguments", "places"), [(8, 1), (2, 4), (4, 2), (2, 2), (1, 4)])
@pytest.mark.parametrize("count", [1, 3, 4, 6])
def test_a_quadrature_is_summed_whatever_the_places_at_once(arguments, places, count):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    rule = [(float(s + 1) / 2, float(w) / 2) for s, w in zip(nodes, weights, strict=True)]
    first, second = np.random.default_rng(5).normal(size=(2, arguments, 1))
    root, flat = evaluated(integral(rule), arguments, [first, second], places=places)
    sums = sum(w * np.sin(first * s) * second / (1 + s**2) for s, w in rule)
    np.testing.assert_allclose(root, np.sqrt(1 + sums**2), rtol=1e-14)
    np.testing.assert_allclose(flat, second * np.cos(first) - first, rtol=0, atol=1e-14)


def test_what_does_not_depend_on_the_place_stands_before_the_loop():
    before, _, after = lane_code(integral([(0.5, 1.0)]), 2, ()).partition("for (int round")
    assert "cosine(t" in before.split("void integral")[1]
    assert "sine(t" in after
    assert "cosine(" not in after


def test_what_is_not_known_is_refused():
    with pytest.raises(NotImplementedError, match="tangent"):
        lane_code(ca.Function("tangent", [a], [ca.tan(a)]), 4, ())
