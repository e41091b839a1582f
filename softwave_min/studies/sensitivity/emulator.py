r"""Polynomial chaos: a polynomial in place of an expensive function, and its sensitivity indices.

A function of shares :math:`x \in [0, 1]^d`, all equally likely, is replaced by

.. math:: \hat y(x) = \sum_{a \in A} c_a \prod_j P_{a_j}(2 x_j - 1),

with Legendre's polynomials, fitted by least squares to a space-filling design [1]_. Each point
of the design is also predicted from all others, which for least squares takes no fit of its
own. Fits to resamples of the design show what its size leaves open [2]_.

References
----------
.. [1] B. Sudret, Global sensitivity analysis using polynomial chaos expansions, Reliability
   Engineering & System Safety 93 (2008) 964-979.
.. [2] S. Marelli, B. Sudret, An active-learning algorithm that combines sparse polynomial
   chaos expansions and bootstrap for structural reliability analysis, Structural Safety 75
   (2018) 67-74.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from SALib.analyze.sobol import first_order, total_order
from SALib.sample import sobol

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Emulator:
    """One polynomial, or several with the same terms."""

    powers: Integers
    """Degree of each term in each variable, (terms, d)."""
    coefficients: Floats
    """(terms,) or (terms, polynomials)."""
    left_out: Floats
    """Value at each point of the design less that predicted from all others."""

    @property
    def degree(self) -> int:
        """Total degree."""
        return int(self.powers.sum(axis=1).max())

    def __call__(self, shares: Floats) -> Floats:
        """Values at shares (n, d): (n,) or (n, polynomials)."""
        return np.asarray(_terms(shares, self.powers) @ self.coefficients)


def fitted(shares: Floats, values: Floats, degrees: Sequence[int]) -> Emulator:
    """The polynomial that predicts the points left out best, from values (n,) at shares (n, d).

    Of the total degrees to try, those with fewer terms than half the points count.
    """
    tried = (_least_squares(shares, values, _powers(shares.shape[1], one)) for one in degrees)
    return min(
        (one for one in tried if 2 * len(one.powers) <= len(values)),
        key=lambda one: float(np.mean(one.left_out**2)),
    )


def _least_squares(shares: Floats, values: Floats, powers: Integers) -> Emulator:
    basis = _terms(shares, powers)
    inverse = np.linalg.pinv(basis)
    coefficients = inverse @ values
    leverage = np.einsum("ij,ji->i", basis, inverse)
    # A point that only it itself determines is not predicted by the others.
    left_out = (values - basis @ coefficients) / np.maximum(1 - leverage, 1e-9)
    return Emulator(powers, coefficients, left_out)


def resampled(
    emulator: Emulator, shares: Floats, values: Floats, count: int, generator: np.random.Generator
) -> Emulator:
    """As many polynomials with the same terms, fitted to resamples of the design."""
    basis = _terms(shares, emulator.powers)
    columns = []
    for _ in range(count):
        rows = generator.integers(len(values), size=len(values))
        columns.append(np.linalg.lstsq(basis[rows], values[rows], rcond=None)[0])
    return replace(emulator, coefficients=np.stack(columns, axis=1))


def _powers(variables: int, degree: int) -> Integers:
    """All terms up to a total degree."""
    every = product(range(degree + 1), repeat=variables)
    return np.array([one for one in every if sum(one) <= degree])


def _terms(shares: Floats, powers: Integers) -> Floats:
    """Each term of the polynomial at each point, (n, terms)."""
    values = legvander(2 * np.asarray(shares, float) - 1, int(powers.max()))
    found = np.ones((len(shares), len(powers)))
    for variable, degrees in enumerate(powers.T):
        found *= values[:, variable, degrees]
    return found


def problem_in_shares(variables: int) -> dict[str, Any]:
    """The variables as SALib wants them."""
    names = [str(one) for one in range(variables)]
    return {"num_vars": variables, "names": names, "bounds": [[0.0, 1.0]] * variables}


def indices_sample(variables: int, size: int, seed: int) -> Floats:
    """Saltelli's sample in shares, (size (variables + 2), variables)."""
    return np.asarray(
        sobol.sample(problem_in_shares(variables), size, calc_second_order=False, seed=seed)
    )


def indices(values: Floats, variables: int) -> tuple[Floats, Floats]:
    """First- and total-order indices, (variables, functions) each.

    From the values on Saltelli's sample, (size (variables + 2), functions): the share of the
    variance that goes with a variable alone, and with all its interactions; NaN where there is
    none.
    """
    with np.errstate(invalid="ignore"):
        values = (values - values.mean(axis=0)) / values.std(axis=0)
    blocks = values.reshape(-1, variables + 2, *values.shape[1:])
    a, b = blocks[:, 0], blocks[:, -1]
    mixed = [blocks[:, one + 1] for one in range(variables)]
    first, total = ([order(a, one, b) for one in mixed] for order in (first_order, total_order))
    return np.array(first), np.array(total)
