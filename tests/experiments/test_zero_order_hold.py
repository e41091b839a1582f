"""What is held is the present value, and nothing else of the problem is changed."""

from __future__ import annotations

from operator import attrgetter

import numpy as np
import pytest

from softwave_min.control.preview import Forecast
from softwave_min.control.problem import Problem
from softwave_min.experiments.zero_order_hold import ZeroOrderHold, hold_flow, hold_reference


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


@pytest.mark.parametrize(
    ("hold", "field"), [(hold_reference, "reference"), (hold_flow, "forecast.flow")]
)
def test_what_is_held_is_the_present_value_and_nothing_else_is_changed(problem, hold, field):
    asked = Asked()
    assert ZeroOrderHold(asked, hold).solve(problem, "guess") == "guess"
    held, own = attrgetter(field)(asked.problem), attrgetter(field)(problem)
    np.testing.assert_array_equal(held, np.tile(own[0], (4, 1)))
    for name in ("state", "previous", "reference", "forecast.flow", "forecast.disturbance"):
        if name != field:
            assert attrgetter(name)(asked.problem) is attrgetter(name)(problem)
