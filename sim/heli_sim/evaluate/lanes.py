"""CasADi functions written as C that evaluates several windows together, one in each lane of a vector.

CasADi's own C evaluates one window. Its operations depend on each other, and a compiler cannot vectorise
them. Windows are independent: the same operation in four windows is one operation on a vector, with each
window in a lane. Each lane gives the same bits as CasADi's C. Values that depend on parameters alone are the
same in all windows and stay scalars.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from typing import Final

import casadi as ca

from heli_sim.errors import PlantError

_SHARED_INPUT: Final = 3
"""Index of the one input, among those of the function, that all windows share: the parameters."""
_VECTOR_OPERATIONS: Final = {
    "ASSIGN": "{x}",
    "ADD": "{x} + {y}",
    "SUB": "{x} - {y}",
    "MUL": "{x} * {y}",
    "DIV": "{x} / {y}",
    "NEG": "-{x}",
    "SQ": "{x} * {x}",
    "TWICE": "2.0 * {x}",
    "INV": "1.0 / {x}",
}
"""Operations that C has for vectors, by their name in CasADi."""
_SELECT: Final = "(Lanes)(((Mask)({condition}) & (Mask){yes}) | (~(Mask)({condition}) & (Mask){no}))"
"""In each lane `yes` if the condition holds, else `no`."""
_TRUTH: Final = "(Lanes)((Mask)({condition}) & (Mask)all(1.0))"
"""In each lane 1 if the condition holds, else 0."""
_MASK_OPERATIONS: Final = {
    # As the mathematical library computes them: a number next to a NaN, and y of equal operands.
    "FMAX": _SELECT.format(condition="({x} > {y}) | ({y} != {y})", yes="{x}", no="{y}"),
    "FMIN": _SELECT.format(condition="({x} < {y}) | ({y} != {y})", yes="{x}", no="{y}"),
    "FABS": "(Lanes)((Mask){x} & 0x7fffffffffffffffLL)",
    "LT": _TRUTH.format(condition="{x} < {y}"),
    "LE": _TRUTH.format(condition="{x} <= {y}"),
    "EQ": _TRUTH.format(condition="{x} == {y}"),
    "NE": _TRUTH.format(condition="{x} != {y}"),
    "NOT": _TRUTH.format(condition="{x} == all(0.0)"),
    "AND": _TRUTH.format(condition="({x} != all(0.0)) & ({y} != all(0.0))"),
    "OR": _TRUTH.format(condition="({x} != all(0.0)) | ({y} != all(0.0))"),
    "IF_ELSE_ZERO": "(Lanes)((Mask)({x} != all(0.0)) & (Mask){y})",
}
"""Operations on vectors by comparisons. Calls of the library took a fifth of the time of a fit."""
_LANE_OPERATIONS: Final = {
    "LT": "{x} < {y}",
    "LE": "{x} <= {y}",
    "EQ": "{x} == {y}",
    "NE": "{x} != {y}",
    "NOT": "!{x}",
    "AND": "{x} && {y}",
    "OR": "{x} || {y}",
    "IF_ELSE_ZERO": "{x} ? {y} : 0.0",
    "SIGN": "{x} < 0.0 ? -1.0 : ({x} > 0.0 ? 1.0 : {x})",
    "POW": "pow({x}, {y})",
    "CONSTPOW": "pow({x}, {y})",
    **{
        name: f"{name.lower()}({{x}})"
        for name in (
            *("EXP", "LOG", "SQRT", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "FLOOR", "CEIL", "FABS"),
            *("ERF", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH", "LOG1P", "EXPM1"),
        )
    },
    **{
        name: f"{name.lower()}({{x}}, {{y}})"
        for name in ("FMIN", "FMAX", "FMOD", "COPYSIGN", "ATAN2", "HYPOT", "REMAINDER")
    },
}
"""Operations on numbers, which vectors carry out lane by lane unless they have a better way."""
_EXPRESSIONS: Final = {
    getattr(ca, f"OP_{name}"): (text, (_VECTOR_OPERATIONS | _MASK_OPERATIONS).get(name, ""))
    for name, text in (_VECTOR_OPERATIONS | _LANE_OPERATIONS).items()
}
"""For each operation of CasADi its expression in C for numbers, and that for vectors; empty if C has none."""


def c_function(function: ca.Function) -> str:
    """Write a CasADi function in C."""
    lines: list[str] = []
    in_register: dict[int, str] = {}
    """C expression of the value that is now in each of CasADi's work registers."""
    vectors: set[str] = set()
    """C expressions that are vectors; all others are numbers."""
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        # Both are work registers, except at the borders: an output is (result, element), and an input is
        # (argument, element).
        target, operands = function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            # Results are vectors, so a number is copied to all lanes.
            value = in_register[operands[0]]
            lines.append(f"r{target[0]}[{target[1]}] = {value if value in vectors else f'all({value})'};")
            continue
        if code == ca.OP_INPUT:
            argument, element = operands
            value = f"a{argument}[{element}]"
            if argument != _SHARED_INPUT:
                vectors.add(value)
        elif code == ca.OP_CONST:
            value = f"({_c_literal(function.instruction_constant(k))})"
        else:
            value = f"v{k}"
            # The second operand of a unary operation is ignored.
            x, y = in_register[operands[0]], in_register[operands[-1]]
            lines.append(_c_operation(value, code, x, y, vectors))
            if {x, y} & vectors:
                vectors.add(value)
        in_register[target[0]] = value
    arguments = ", ".join(
        [f"const {'double' if i == _SHARED_INPUT else 'Lanes'}* a{i}" for i in range(function.n_in())]
        + [f"Lanes* r{i}" for i in range(function.n_out())]
    )
    body = "\n  ".join(lines)
    return f"{_target_attribute()}static void {function.name()}({arguments}) {{\n  {body}\n}}\n"


def _target_attribute() -> str:
    """Return the attribute in C of a function for the vectors of this processor."""
    # A function for any processor, which the loader would choose from, takes three times as long to compile.
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
            flags = next((line for line in lines if line.startswith("flags")), "")
    except OSError:
        return ""
    return '__attribute__((target("avx2"))) ' if "avx2" in flags.split() else ""


def _c_operation(result: str, code: int, x: str, y: str, vectors: Collection[str]) -> str:
    """Write one operation as a C statement; its result is a vector if an operand is in `vectors`."""
    if code not in _EXPRESSIONS:
        raise PlantError(
            f"a model uses CasADi's operation {code}, which is not compiled here",
            "write it with arithmetic, comparisons and elementary functions",
        )
    # Without an expression of vectors, the operation is done in a loop over their elements.
    of_numbers, of_vectors = _EXPRESSIONS[code]
    if x not in vectors and y not in vectors:
        return f"const double {result} = {of_numbers.format(x=x, y=y)};"
    if of_vectors:
        x, y = (operand if operand in vectors else f"all({operand})" for operand in (x, y))
        return f"const Lanes {result} = {of_vectors.format(x=x, y=y)};"
    x, y = (f"{operand}[z]" if operand in vectors else operand for operand in (x, y))
    return f"Lanes {result}; for (int z = 0; z < LANES; ++z) {result}[z] = {of_numbers.format(x=x, y=y)};"


def _c_literal(value: float) -> str:
    """Write a number in C."""
    if math.isnan(value):
        return "NAN"
    return repr(value).replace("inf", "INFINITY")
