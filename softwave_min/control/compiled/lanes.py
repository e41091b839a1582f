"""C code that evaluates a CasADi function for several arguments at once.

CasADi's own generated code takes one argument at a time. Here the instructions of a function
are written out on vectors, see ``lanes.h``, which modern processors add and multiply as fast
as single numbers. They divide slowly: of each divisor the reciprocal is taken once.

A quadrature in the function is a loop in the code, which the processor fetches once and not
for each place; what does not depend on the place stands before the loop. The lanes of a
vector are several arguments, or several places, or both.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from softwave_min.control.summed import Summed

_TEMPLATES: Mapping[int, str] = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_INV: "1 / {0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2 * {0}",
    ca.OP_SQRT: "root({0})",
    ca.OP_SIN: "sine({0})",
    ca.OP_COS: "cosine({0})",
    ca.OP_FABS: "magnitude({0})",
    ca.OP_SIGN: "sign({0})",
    ca.OP_LT: "less({0}, {1})",
    ca.OP_LE: "less_equal({0}, {1})",
    ca.OP_NOT: "negation({0})",
    ca.OP_IF_ELSE_ZERO: "if_true({0}, {1})",
}


def lane_code(
    function: ca.Function | Summed, arguments: int, same: Collection[str], places: int = 1
) -> str:
    """C source of ``void name(const double *const *arg, double *const *res)``.

    Parameters
    ----------
    function
        Of scalar expressions (SX), with dense inputs; of a sparse output, the nonzeros.
    arguments
        How many at once.
    same
        Names of the inputs that are alike in all arguments. Element ``e`` of such an input is
        ``arg[i][e]``; that of argument ``l`` of another one, or of an output, is
        ``arg[i][arguments * e + l]``.
    places
        How many places of the quadrature at once. A rule whose length is no multiple of it is
        filled up with places of weight 0.

    Raises
    ------
    NotImplementedError
        If the function has an instruction that is not known here.
    """
    whole = function.whole if isinstance(function, Summed) else function
    alike = [name in same for name in whole.name_in()]

    def given(argument: int, element: int) -> str:
        if alike[argument]:
            return f"all(arg[{argument}][{element}])"
        return f"load(arg[{argument}] + {arguments * element})"

    if isinstance(function, Summed):
        body = _summed(function, places, given)
    else:
        body = _straight(function, given)
    lines = [
        f"#define ARGUMENTS {arguments}",
        f"#define PLACES {places}",
        Path(__file__).with_name("lanes.h").read_text(encoding="utf-8"),
        f"void {whole.name()}(const double *const *arg, double *const *res) {{",
        *body,
        "}\n",
    ]
    return "\n".join(lines)


@dataclass(frozen=True)
class _Statement:
    name: str
    """Variable that it sets."""
    value: str
    varies: bool = False
    """Whether it depends on the place."""

    def __str__(self) -> str:
        return f"const lanes {self.name} = {self.value};"


@dataclass(frozen=True)
class _Output:
    argument: int
    element: int
    of: _Statement


Given = Callable[[int, int], str]
"""Value of an input by the indices of argument and element."""


def _straight(function: ca.Function, given: Given) -> Iterator[str]:
    statements, outputs = _translated(function, given, "a")
    yield from map(str, statements)
    yield from _stored(outputs)


def _summed(function: Summed, places: int, given: Given) -> Iterator[str]:
    summand, last = function.summand, function.summand.n_in() - 1
    rounds = -(-len(function.rule) // places)
    missing = rounds * places - len(function.rule)
    rule = [*function.rule, *[(0.5, 0.0)] * missing]

    statements, terms = _translated(
        summand, lambda i, e: "load_places(place[round])" if i == last else given(i, e), "t", last
    )
    # Of a structural zero no sum is needed.
    terms = [term for term in terms if term.of.value != "all(0.0)"]
    yield _table("place", [s for s, _ in rule], places)
    yield _table("weight", [weight for _, weight in rule], places)
    yield from (str(one) for one in statements if not one.varies)
    yield from (f"lanes s{term.element} = all(0);" for term in terms)
    yield f"for (int round = 0; round < {rounds}; round++) {{"
    yield "const lanes w = load_places(weight[round]);"
    yield from (str(one) for one in statements if one.varies)
    yield from (f"s{term.element} += w * {term.of.name};" for term in terms)
    yield "}"
    yield from (f"s{term.element} = total(s{term.element});" for term in terms)

    known = {term.element for term in terms}
    statements, outputs = _translated(
        function.whole,
        lambda i, e: given(i, e) if i != last else f"s{e}" if e in known else "all(0)",
        "a",
    )
    yield from map(str, statements)
    yield from _stored(outputs)


def _table(name: str, numbers: Sequence[float], places: int) -> str:
    rows = [numbers[start : start + places] for start in range(0, len(numbers), places)]
    text = ", ".join("{" + ", ".join(map(repr, row)) + "}" for row in rows)
    return f"static const double {name}[{len(rows)}][{places}] = {{{text}}};"


def _stored(outputs: Iterable[_Output]) -> Iterator[str]:
    for one in outputs:
        yield f"store(res[{one.argument}] + ARGUMENTS * {one.element}, {one.of.name});"


def _translated(
    function: ca.Function, given: Given, letter: str, place: int = -1
) -> tuple[list[_Statement], list[_Output]]:
    """The instructions, each with a variable of its own; ``place`` is an input's index."""
    statements: list[_Statement] = []
    outputs: list[_Output] = []
    registers: dict[int, _Statement] = {}
    reciprocals: dict[str, _Statement] = {}  # by the divisor
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        to, of = function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            outputs.append(_Output(to[0], to[1], registers[of[0]]))
            continue
        name, operands = f"{letter}{k}", []
        if code == ca.OP_CONST:
            value = f"all({function.instruction_constant(k)!r})"
        elif code == ca.OP_INPUT:
            value = given(*of)
        elif code in _TEMPLATES:
            operands = [registers[index] for index in of]
            value = _TEMPLATES[code].format(*(operand.name for operand in operands))
        elif code == ca.OP_DIV:
            dividend, divisor = (registers[index] for index in of)
            if divisor.name not in reciprocals:
                inverse = _Statement(f"r{divisor.name}", f"1 / {divisor.name}", divisor.varies)
                reciprocals[divisor.name] = inverse
                statements.append(inverse)
            operands = [dividend, reciprocals[divisor.name]]
            value = f"{dividend.name} * {operands[1].name}"
        else:
            raise NotImplementedError(f"{function.name()}: instruction {code} of CasADi")
        varies = any(one.varies for one in operands)
        if code == ca.OP_INPUT:
            varies = of[0] == place
        registers[to[0]] = _Statement(name, value, varies)
        statements.append(registers[to[0]])
    return statements, outputs
