"""What is held is the present value, and nothing else of the problem is changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from softwave_min.control.problem import Problem
from softwave_min.control.preview import Forecast
from softwave_min.experiments.zero_order_hold import Told, held_flow, held_reference


class Asked:
    """A solver that keeps what it is asked, and answers with the guess."""

    def solve(self, problem, guess):
        self.problem = problem
        return guess


@pytest.fixture
def problem():
    generator = np.random.default_rng(1)
    forecast = Forecast(generator.normal(size=(4, 9)), generator.normal(size=(4, 3)))
    return Problem(np.zeros(6), np.zeros(3), generator.normal(size=(4, 2)), forecast)


def told(telling, problem):
    asked = Asked()
    assert Told(asked, telling).solve(problem, "guess") == "guess"
    return asked.problem


def test_held_reference_is_the_next_point(problem):
    found = told(held_reference, problem)
    np.testing.assert_array_equal(found.reference, np.tile(problem.reference[0], (4, 1)))
    assert replace(found, reference=problem.reference) == problem


def test_held_flow_is_that_of_the_present_period(problem):
    found = told(held_flow, problem)
    np.testing.assert_array_equal(found.forecast.flow, np.tile(problem.forecast.flow[0], (4, 1)))
    assert found.forecast.disturbance is problem.forecast.disturbance
    assert replace(found, forecast=problem.forecast) == problem
