"""C code that evaluates a CasADi function for several arguments at once.

CasADi's own generated code takes one argument at a time. Here the instructions of a function
are written out on vectors of ``lanes`` numbers, see ``lanes.h``, which modern processors add
and multiply as fast as single ones. They divide slowly: of each divisor the reciprocal is
taken once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import casadi as ca

__all__ = ["lane_code"]

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


def lane_code(function: ca.Function, lanes: int, same: Collection[str]) -> str:
    """C source of ``void name(const double *const *arg, double *const *res)``.

    Parameters
    ----------
    function
        Of scalar expressions (SX), with dense inputs and outputs.
    lanes
        How many arguments at once.
    same
        Names of the inputs that are alike in all lanes. Element ``e`` of such an input is
        ``arg[i][e]``; lane ``l`` of element ``e`` of another one, or of an output, is
        ``arg[i][lanes * e + l]``.

    Raises
    ------
    NotImplementedError
        If the function has an instruction that is not known here.
    """
    alike = [name in same for name in function.name_in()]
    registers = ", ".join(f"a{index}" for index in range(function.sz_w()))
    return "\n".join(
        [
            f"#define LANES {lanes}",
            Path(__file__).with_name("lanes.h").read_text(encoding="utf-8"),
            f"void {function.name()}(const double *const *arg, double *const *res) {{",
            f"lanes {registers};",
            *_statements(function, lanes, alike),
            "}\n",
        ]
    )


def _statements(function: ca.Function, lanes: int, alike: list[bool]) -> Iterator[str]:
    reciprocals: dict[int, str] = {}  # by the register that holds the divisor
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        to, of = function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            yield f"store(res[{to[0]}] + {lanes * to[1]}, a{of[0]});"
            continue
        if code == ca.OP_DIV and of[1] not in reciprocals:
            reciprocals[of[1]] = f"r{k}"
            yield f"const lanes r{k} = 1 / a{of[1]};"
        if code == ca.OP_CONST:
            value = f"all({function.instruction_constant(k)!r})"
        elif code == ca.OP_INPUT:
            argument, element = of
            value = f"load(arg[{argument}] + {lanes * element})"
            if alike[argument]:
                value = f"all(arg[{argument}][{element}])"
        elif code == ca.OP_DIV:
            value = f"a{of[0]} * {reciprocals[of[1]]}"
        elif code in _TEMPLATES:
            value = _TEMPLATES[code].format(*(f"a{index}" for index in of))
        else:
            raise NotImplementedError(f"{function.name()}: instruction {code} of CasADi")
        yield f"a{to[0]} = {value};"
        reciprocals.pop(to[0], None)
