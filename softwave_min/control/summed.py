"""CasADi functions with a quadrature in them, in a form that can be looped over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import casadi as ca


@dataclass(frozen=True)
class Summed:
    r"""A function of a sum, :math:`f(x) = F(x, \sum_p w_p\, g(x, s_p))`."""

    whole: ca.Function
    """F; its last input are the sums."""
    summand: ca.Function
    """g; its last input is the place s, and its one output has a term for each sum."""
    rule: tuple[tuple[float, float], ...]
    """Places s_p and weights w_p."""

    @classmethod
    def of(
        cls,
        name: str,
        inputs: Mapping[str, ca.SX],
        place: ca.SX,
        terms: ca.SX,
        sums: ca.SX,
        outputs: Mapping[str, ca.SX],
        rule: Sequence[tuple[float, float]],
    ) -> Self:
        """Of expressions: ``terms`` in the inputs and the place, ``outputs`` in the sums."""
        return cls(
            dense_function(name, {**inputs, "sums": sums}, outputs),
            dense_function(f"{name}_term", {**inputs, "place": place}, {"terms": terms}),
            tuple(rule),
        )

    def plain(self) -> ca.Function:
        """f, with the sum written out."""
        names = self.whole.name_in()[:-1]
        inputs = self.whole.sx_in()[:-1]
        sums = sum(
            (weight * self.summand(*inputs, place) for place, weight in self.rule), start=ca.SX(0)
        )
        outputs = self.whole.call([*inputs, sums])
        return dense_function(
            self.whole.name(),
            dict(zip(names, inputs, strict=True)),
            dict(zip(self.whole.name_out(), outputs, strict=True)),
        )


def dense_function(
    name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, ca.SX]
) -> ca.Function:
    """Function of expressions by name, with dense outputs and nothing computed twice."""
    dense = [ca.densify(output) for output in outputs.values()]
    return ca.Function(name, list(inputs.values()), ca.cse(dense), list(inputs), list(outputs))
