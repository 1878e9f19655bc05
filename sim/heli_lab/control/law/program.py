"""Build a program for the board from CasADi's operations, and simplify it on the way.

Equal operations are computed once, and operations without effect are left out. An operation of CasADi that
the board does not have is composed of operations that it has.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
from heli_host.declaration import OPERATIONS
from heli_host.errors import BadLaw

CODE: Final = {operation.name: operation.code for operation in OPERATIONS}
FIXED_OUTPUTS: Final = 5
"""Outputs of every law: two voltages and three setpoints. Its signals follow, then its new states."""
BINARY: Final = frozenset(operation.code for operation in OPERATIONS if operation.operands == 2)
"""Codes of the operations with two operands."""
_MAX_POWER: Final = 16
"""Largest exponent of a power that is composed of products."""

_ON_BOARD: Final = {
    ca.OP_ADD: "add", ca.OP_SUB: "subtract", ca.OP_MUL: "multiply", ca.OP_DIV: "divide", ca.OP_NEG: "negate",
    ca.OP_FABS: "absolute", ca.OP_FMIN: "minimum", ca.OP_FMAX: "maximum", ca.OP_LT: "less",
    ca.OP_LE: "less_equal", ca.OP_EQ: "equal", ca.OP_NE: "not_equal", ca.OP_AND: "both", ca.OP_OR: "either",
    ca.OP_NOT: "negation", ca.OP_IF_ELSE_ZERO: "select", ca.OP_FLOOR: "floor", ca.OP_SQRT: "square_root",
    ca.OP_SIN: "sine", ca.OP_COS: "cosine", ca.OP_TAN: "tangent", ca.OP_ATAN2: "arctangent",
    ca.OP_TANH: "hyperbolic_tangent", ca.OP_EXP: "exponential",
}  # fmt: skip
"""Operations of CasADi that the board has, by CasADi's code."""
_NAMES: Final = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}


@dataclass(frozen=True)
class Value:
    """A value of the program: the result of an operation, or an input, constant, parameter or state."""

    kind: str  # ``input``, ``constant``, ``parameter``, ``state``, or the operation's name
    detail: int = 0
    """For an input, constant, parameter or state, its index among those of its kind. For a sum of products,
    bit k is set if product k is subtracted. For any other operation, 0."""
    operands: tuple[int, ...] = ()  # Indices of the values from which this value is computed


class Program:
    """Values in the order of their computation; the same operation on the same values occurs once."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.values: list[Value] = []
        self.constants: list[float] = []
        # Index of each value.
        self._index: dict[Value, int] = {}

    def put(self, value: Value) -> int:
        """Add a value, unless the program has it already; return its index."""
        index = self._index.get(value)
        if index is None:
            index = self._index[value] = len(self.values)
            self.values.append(value)
        return index

    def copy_value(self, other: Program, index: int, new_index: dict[int, int]) -> None:
        """Copy a value of another program, and add its new index to `new_index`.

        `new_index`: For each value copied so far, its index in this program by its index in `other`. The
        operands of the value must be among them.
        """
        value = other.values[index]
        if value.kind == "constant":
            new_index[index] = self.constant(other.constants[value.detail])
        else:
            operands = tuple(new_index[operand] for operand in value.operands)
            new_index[index] = self.put(replace(value, operands=operands))

    def constant(self, number: float) -> int:
        """Add a constant; return the index of its value."""
        if not math.isfinite(number):
            raise BadLaw(
                f"the law {self.name} contains the constant {number}",
                "give finite numbers, and sin, cos, sqrt, ... of heli_lab.law: "
                "those of math do not accept symbols",
            )
        try:
            single: float = struct.unpack("<f", struct.pack("<f", number))[0]
        except OverflowError:
            raise BadLaw(
                f"the law {self.name} holds {number:g}",
                "give numbers below 3.4e38, the limit of single precision",
            ) from None
        if single not in self.constants:
            self.constants.append(single)
        return self.put(Value("constant", self.constants.index(single)))

    def constant_number(self, index: int) -> float | None:
        """Return the number of a value that is a constant; None for any other value."""
        value = self.values[index]
        return self.constants[value.detail] if value.kind == "constant" else None

    def append(self, name: str, *operands: int) -> int:
        """Append an operation, or a cheaper one with the same result; return the index of its value."""
        numbers = [self.constant_number(operand) for operand in operands]
        compute = _CONSTANT_FOLDING.get(name)
        if compute is not None and None not in numbers:
            result = compute(*numbers)
            if math.isfinite(result):
                return self.constant(result)
        simplify = _SIMPLIFICATION.get(name)
        simpler_index = simplify(self, operands, numbers) if simplify is not None else None
        if simpler_index is not None:
            return simpler_index
        if name in _COMMUTATIVE:
            operands = tuple(sorted(operands))
        return self.put(Value(name, 0, operands))

    def append_casadi(self, code: int, a: int, b: int) -> int:
        """Append an operation of CasADi, composed of those of the board; return the index of its value."""
        if code in _ON_BOARD:
            name = _ON_BOARD[code]
            return self.append(name, a, b) if CODE[name] in BINARY else self.append(name, a)
        composed = _COMPOSED.get(code)
        if composed is not None:
            return composed(self, a, b)
        if code in (ca.OP_POW, ca.OP_CONSTPOW):
            return self._power_by_products(a, b)
        known = ", ".join(sorted(set(_ON_BOARD.values())))
        raise BadLaw(
            f"the law {self.name} uses {_NAMES.get(code, code)}, which the board cannot compute",
            f"use only {known}",
        )

    def _power_by_products(self, a: int, b: int) -> int:
        """Compose a power of the value `a` from products; the exponent `b` must be a whole number or 1/2."""
        constant = self.constant_number(b)
        # The test below refuses nan, and thus an exponent that is not a constant.
        exponent = math.nan if constant is None else constant
        if exponent == 0.5:
            return self.append("square_root", a)
        if exponent != round(exponent) or not 0 < abs(exponent) <= _MAX_POWER:
            raise BadLaw(
                f"the law {self.name} has a power that is not a whole number up to {_MAX_POWER}",
                "use sqrt, exp or products",
            )
        power = a
        for _ in range(int(abs(exponent)) - 1):
            power = self.append("multiply", power, a)
        return power if exponent > 0 else self.append("divide", self.constant(1.0), power)


_COMMUTATIVE: Final = frozenset(("add", "multiply", "equal", "not_equal", "both", "either"))
_CONSTANT_FOLDING: Final[dict[str, Callable[..., float]]] = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b if b else math.nan,
    "negate": lambda a: -a,
    "absolute": abs,
    "minimum": min,
    "maximum": max,
    "square_root": lambda a: math.sqrt(a) if a >= 0.0 else math.nan,
    "sine": math.sin,
    "cosine": math.cos,
    "hyperbolic_tangent": math.tanh,
    "less": lambda a, b: float(a < b),
    "less_equal": lambda a, b: float(a <= b),
    "floor": lambda a: float(math.floor(a)),
}
"""Operations whose result is computed here if all operands are constants."""

_Numbers = list[float | None]
"""Value of each operand that is a constant, otherwise None."""

# Each of the following functions simplifies one operation of a program. It returns the index of a value that
# is cheaper to compute and has the same result; None if there is none.


def _simpler_sum(program: Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify x + 0 to x."""
    if 0.0 in numbers:
        return operands[1 - numbers.index(0.0)]
    return None


def _simpler_difference(program: Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify x - x to 0, x - 0 to x, and 0 - x to -x."""
    if operands[0] == operands[1]:
        return program.constant(0.0)
    if numbers[1] == 0.0:
        return operands[0]
    return program.append("negate", operands[1]) if numbers[0] == 0.0 else None


def _simpler_product(program: Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify products with 1, -1 and 0."""
    for number, other in zip(numbers, reversed(operands), strict=True):
        if number == 1.0:
            return other
        if number == -1.0:
            return program.append("negate", other)
        if number == 0.0:
            return program.constant(0.0)
    return None


def _simpler_quotient(program: Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Replace a division by a constant by a product with its reciprocal, which is cheaper."""
    divisor = numbers[1]
    # Beyond these limits, the reciprocal is not a normal number of single precision.
    if divisor is None or not 1e-37 < abs(divisor) < 1e37:
        return None
    return program.append("multiply", operands[0], program.constant(1.0 / divisor))


def _simpler_negation(program: Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify -(-x) to x, and -(x - y) to y - x."""
    inner = program.values[operands[0]]
    if inner.kind == "negate":
        return inner.operands[0]
    return program.append("subtract", *reversed(inner.operands)) if inner.kind == "subtract" else None


def _simpler_extremum(program: Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify the minimum and the maximum of x and x to x."""
    return operands[0] if operands[0] == operands[1] else None


def _simpler_selection(program: Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify a selection, x if a condition holds and otherwise 0, of 0 or by a constant condition."""
    if numbers[1] == 0.0 or numbers[0] == 0.0:
        return program.constant(0.0)
    return operands[1] if numbers[0] is not None else None


_SIMPLIFICATION: Final[dict[str, Callable[[Program, tuple[int, ...], _Numbers], int | None]]] = {
    "add": _simpler_sum, "subtract": _simpler_difference, "multiply": _simpler_product,
    "divide": _simpler_quotient, "negate": _simpler_negation, "minimum": _simpler_extremum,
    "maximum": _simpler_extremum, "select": _simpler_selection,
}  # fmt: skip
"""Functions that simplify an operation, by its name."""

_COMPOSED: Final[dict[int, Callable[[Program, int, int], int]]] = {
    ca.OP_ASSIGN: lambda _, a, b: a,
    ca.OP_SQ: lambda p, a, b: p.append("multiply", a, a),
    ca.OP_TWICE: lambda p, a, b: p.append("add", a, a),
    ca.OP_INV: lambda p, a, b: p.append("divide", p.constant(1.0), a),
    ca.OP_CEIL: lambda p, a, b: p.append("negate", p.append("floor", p.append("negate", a))),
    ca.OP_SIGN: lambda p, a, b: p.append(
        "subtract", p.append("less", p.constant(0.0), a), p.append("less", a, p.constant(0.0))
    ),
    ca.OP_ATAN: lambda p, a, b: p.append("arctangent", a, p.constant(1.0)),
    ca.OP_HYPOT: lambda p, a, b: p.append(
        "square_root", p.append("add", p.append("multiply", a, a), p.append("multiply", b, b))
    ),
}
"""Operations of CasADi that are composed of those of the board, by CasADi's code."""
