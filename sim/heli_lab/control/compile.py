"""Compile the function of a law into a program for the board.

1. CasADi's operations become values. Equal operations are computed once. An operation that the board does not
   have is composed of operations that it has.
2. A value made of additions and multiplications, such as a x + b y - c z, becomes one operation with a term
   per product, if the board computes it faster. A linear law consists mostly of such values.
3. Each value gets a cell of the board's memory, which is used again after the last operation that reads it.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
from heli_host.board.law_program import Instruction, LawProgram, Term, divisor_of
from heli_host.declaration import LAW_CELLS, LAW_INPUTS, LAW_MAX_TERMS, LAW_TERM_COST, OPERATIONS
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
SUM: Final = "sum_of_products"
_LINEAR: Final = frozenset(("add", "subtract", "negate", "multiply"))
"""Operations that a sum of products replaces."""


def compile_program(
    function: ca.Function,
    *,
    name: str,
    rate_Hz: float,
    states: Mapping[str, float],
    parameters: Mapping[str, float],
    signals: tuple[str, ...],
) -> LawProgram:
    """Compile the function of a control law; the arguments are the fields of a `Law`."""
    if not function.is_a("SXFunction"):
        function = function.expand()
    output_count = FIXED_OUTPUTS + len(signals)
    program, outputs = _translate_to_values(name, function, output_count)
    program, outputs = _with_sums(program, outputs)
    # The outputs from `output_count` on are the new states. If a new state is an old one, it is copied:
    # without the copy, the board may have overwritten the old value before it is read.
    for k in range(output_count, len(outputs)):
        if program.values[outputs[k]].kind == "state":
            outputs[k] = program.append("copy", outputs[k])
    program, outputs = _without_unused_values(program, outputs)
    instructions, output_cells = _assign_cells(program, outputs, len(parameters), len(states))
    return LawProgram(
        name=name,
        divisor=divisor_of(rate_Hz),
        constants=tuple(program.constants),
        parameters=tuple(parameters.items()),
        states=tuple(states.items()),
        outputs=tuple(output_cells),
        signals=signals,
        instructions=tuple(instructions),
    )


def _translate_to_values(name: str, function: ca.Function, output_count: int) -> tuple[_Program, list[int]]:
    """Translate CasADi's instructions into values. Returns `program`, `outputs`."""
    program = _Program(name)
    argument_kinds = ("input", "state", "parameter")
    # Result 0 has the outputs, result 1 the new states. CasADi has no instruction for an output that is 0.
    new_states = 1
    outputs = [program.constant(0.0)] * (output_count + function.size1_out(new_states))
    first_output_of_result = (0, output_count)
    # Index of the value in each of CasADi's work registers.
    register: dict[int, int] = {}
    for k in range(function.n_instructions()):
        code, target = function.instruction_id(k), function.instruction_output(k)
        operands = function.instruction_input(k)
        if code == ca.OP_INPUT:
            argument, element = operands
            register[target[0]] = program.put(Value(argument_kinds[argument], element))
        elif code == ca.OP_CONST:
            register[target[0]] = program.constant(function.instruction_constant(k))
        elif code == ca.OP_OUTPUT:
            result, element = target
            outputs[first_output_of_result[result] + element] = register[operands[0]]
        elif code == ca.OP_PARAMETER:
            raise BadLaw(
                f"the law {name} contains a symbol that is not an input, a state or a parameter",
                "use inputs, states and parameters only",
            )
        else:
            # An operation on one operand ignores the second one.
            second = register[operands[1]] if len(operands) > 1 else 0
            register[target[0]] = program.append_casadi(code, register[operands[0]], second)
    return program, outputs


def _without_unused_values(program: _Program, outputs: list[int]) -> tuple[_Program, list[int]]:
    """Remove the values that no operation and no output reads; return the program and its `outputs`."""
    read_values = set(outputs)
    for index in range(len(program.values) - 1, -1, -1):
        if index in read_values:
            read_values.update(program.values[index].operands)
    smaller = _Program(program.name)
    new_index: dict[int, int] = {}
    for index in sorted(read_values):
        smaller.copy_value(program, index, new_index)
    return smaller, [new_index[output] for output in outputs]


def _assign_cells(
    program: _Program, outputs: list[int], parameter_count: int, state_count: int
) -> tuple[list[Instruction], list[int]]:
    """Assign a cell of the board's memory to every value; return the instructions, and the cell of each
    output.
    """
    # Values of these kinds have fixed cells, in this order; the other cells follow.
    first_cell = {"input": 0, "constant": len(LAW_INPUTS)}
    first_cell["parameter"] = first_cell["constant"] + len(program.constants)
    first_cell["state"] = first_cell["parameter"] + parameter_count
    next_cell = first_cell["state"] + state_count
    # Index of the last operation that reads each value; the outputs are read after all operations.
    last_reader: dict[int, int] = {}
    for index, value in enumerate(program.values):
        for operand in value.operands:
            last_reader[operand] = index
    last_reader.update(dict.fromkeys(outputs, len(program.values)))
    # Cell of each value, by the index of the value.
    cell: dict[int, int] = {}
    free_cells: list[int] = []
    instructions: list[Instruction] = []
    for index, value in enumerate(program.values):
        if value.kind in first_cell:
            cell[index] = first_cell[value.kind] + value.detail
            continue
        # The result may take the cell of an operand that no later operation reads.
        for operand in set(value.operands):
            if last_reader[operand] == index and program.values[operand].kind not in first_cell:
                free_cells.append(cell[operand])
        if free_cells:
            cell[index] = free_cells.pop()
        else:
            cell[index], next_cell = next_cell, next_cell + 1
        if cell[index] >= LAW_CELLS:
            raise BadLaw(
                f"the law {program.name} needs more than the {LAW_CELLS} cells of the board "
                f"({state_count} states, {len(program.constants)} constants)",
                "give it fewer states, or smaller matrices",
            )
        instructions.append(
            _write_instruction(value, cell[index], [cell[operand] for operand in value.operands])
        )
    return instructions, [cell[output] for output in outputs]


def _write_instruction(value: Value, target: int, operands: list[int]) -> Instruction:
    """Write the instruction that computes a `value` from the cells `operands` into the cell `target`."""
    if value.kind != SUM:
        # The virtual machine ignores the second operand of a unary operation.
        first, second = operands[0], operands[1] if len(operands) > 1 else 0
        return Instruction(CODE[value.kind], target, first, second)
    # The operands of a sum of products are the two factors of each product in turn.
    factors = zip(operands[::2], operands[1::2], strict=True)
    terms = []
    for product, (first, second) in enumerate(factors):
        is_subtracted = bool(value.detail & (1 << product))
        terms.append(Term(first, second, is_subtracted))
    return Instruction(CODE[SUM], target, terms=tuple(terms))


@dataclass(frozen=True)
class Value:
    """A value of the program: the result of an operation, or an input, constant, parameter or state."""

    kind: str  # ``input``, ``constant``, ``parameter``, ``state``, or the operation's name
    detail: int = 0
    """For an input, constant, parameter or state, its index among those of its kind. For a sum of products,
    bit k is set if product k is subtracted. For any other operation, 0."""
    operands: tuple[int, ...] = ()  # Indices of the values from which this value is computed


class _Program:
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

    def copy_value(self, other: _Program, index: int, new_index: dict[int, int]) -> None:
        """Copy a value of another program, and add its new index to `new_index`."""
        # `new_index`: For each value copied so far, its index in this program by its index in `other`. The
        # operands of the value must be among them.
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


def _simpler_sum(program: _Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify x + 0 to x."""
    if 0.0 in numbers:
        return operands[1 - numbers.index(0.0)]
    return None


def _simpler_difference(program: _Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify x - x to 0, x - 0 to x, and 0 - x to -x."""
    if operands[0] == operands[1]:
        return program.constant(0.0)
    if numbers[1] == 0.0:
        return operands[0]
    return program.append("negate", operands[1]) if numbers[0] == 0.0 else None


def _simpler_product(program: _Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify products with 1, -1 and 0."""
    for number, other in zip(numbers, reversed(operands), strict=True):
        if number == 1.0:
            return other
        if number == -1.0:
            return program.append("negate", other)
        if number == 0.0:
            return program.constant(0.0)
    return None


def _simpler_quotient(program: _Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Replace a division by a constant by a product with its reciprocal, which is cheaper."""
    divisor = numbers[1]
    # Beyond these limits, the reciprocal is not a normal number of single precision.
    if divisor is None or not 1e-37 < abs(divisor) < 1e37:
        return None
    return program.append("multiply", operands[0], program.constant(1.0 / divisor))


def _simpler_negation(program: _Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify -(-x) to x, and -(x - y) to y - x."""
    inner = program.values[operands[0]]
    if inner.kind == "negate":
        return inner.operands[0]
    return program.append("subtract", *reversed(inner.operands)) if inner.kind == "subtract" else None


def _simpler_extremum(program: _Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify the minimum and the maximum of x and x to x."""
    return operands[0] if operands[0] == operands[1] else None


def _simpler_selection(program: _Program, operands: tuple[int, ...], numbers: _Numbers) -> int | None:
    """Simplify a selection, x if a condition holds and otherwise 0, of 0 or by a constant condition."""
    if numbers[1] == 0.0 or numbers[0] == 0.0:
        return program.constant(0.0)
    return operands[1] if numbers[0] is not None else None


_SIMPLIFICATION: Final[dict[str, Callable[[_Program, tuple[int, ...], _Numbers], int | None]]] = {
    "add": _simpler_sum, "subtract": _simpler_difference, "multiply": _simpler_product,
    "divide": _simpler_quotient, "negate": _simpler_negation, "minimum": _simpler_extremum,
    "maximum": _simpler_extremum, "select": _simpler_selection,
}  # fmt: skip
"""Functions that simplify an operation, by its name."""

_COMPOSED: Final[dict[int, Callable[[_Program, int, int], int]]] = {
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


@dataclass(frozen=True)
class _Product:
    """A term of a sum."""

    factor: float  # Constant factor
    first: int  # Index of the value that the factor multiplies
    second: int | None = None  # Index of a second value that is multiplied; None if there is none


def _with_sums(program: _Program, outputs: list[int]) -> tuple[_Program, list[int]]:
    """Replace additions and multiplications by sums of products where these cost less. Returns `program`,
    `outputs`.
    """
    # Number of readers of each value.
    readers = Counter(operand for value in program.values for operand in value.operands)
    readers.update(outputs)
    # Products of each sum, by the index of its value.
    sums: dict[int, list[_Product]] = {}
    # From the last value to the first, so that each value is known to be read, or not, when its turn comes.
    read_values = set(outputs)
    for index in range(len(program.values) - 1, -1, -1):
        if index not in read_values:
            continue
        value = program.values[index]
        if value.kind in _LINEAR:
            sums[index] = _merge_equal_products(
                program, _expand_to_products(program, readers, index, factor=1.0, is_root=True)
            )
            for product in sums[index]:
                read_values.add(product.first)
                if product.second is not None:
                    read_values.add(product.second)
        else:
            read_values.update(value.operands)
    result = _Program(program.name)
    new_index: dict[int, int] = {}
    for index in sorted(read_values):
        if index in sums:
            products = [_reindexed(product, new_index) for product in sums[index]]
            new_index[index] = _append_cheapest_sum(result, products)
        else:
            result.copy_value(program, index, new_index)
    return result, [new_index[output] for output in outputs]


def _reindexed(product: _Product, new_index: dict[int, int]) -> _Product:
    """Return the same product for another program, whose indices `new_index` gives."""
    second = None if product.second is None else new_index[product.second]
    return _Product(product.factor, new_index[product.first], second)


def _expand_to_products(
    program: _Program, readers: Counter[int], index: int, factor: float, is_root: bool = False
) -> list[_Product]:
    """Expand a value of the program, times a factor, into products."""
    # `is_root`: The value is the whole sum, not a term of one.
    value = program.values[index]
    # Several operations read a shared value, so it is computed anyway.
    is_shared = readers[index] > 1
    if value.kind not in _LINEAR or (is_shared and not is_root):
        return [_Product(factor, index)]
    if value.kind == "negate":
        return _expand_to_products(program, readers, value.operands[0], -factor)
    first, second = value.operands
    if value.kind != "multiply":
        second_factor = factor if value.kind == "add" else -factor
        return [
            *_expand_to_products(program, readers, first, factor),
            *_expand_to_products(program, readers, second, second_factor),
        ]
    for constant, other in ((first, second), (second, first)):
        number = program.constant_number(constant)
        if number is not None:
            return _expand_to_products(program, readers, other, factor * number)
    # A term on the board has two operands and a sign, so no room for a factor of two values.
    if abs(factor) == 1.0:
        return [_Product(factor, first, second)]
    return [_Product(factor, index)]


def _merge_equal_products(program: _Program, products: list[_Product]) -> list[_Product]:
    """Combine products of the same values into one, and all constant terms into one."""
    factors: dict[tuple[int, int | None], float] = {}
    offset, constant = 0.0, -1
    for product in products:
        number = program.constant_number(product.first)
        if number is not None and product.second is None:
            offset, constant = offset + product.factor * number, product.first
            continue
        key = (product.first, product.second)
        factors[key] = factors.get(key, 0.0) + product.factor
    merged = [_Product(factor, *key) for key, factor in factors.items() if factor != 0.0]
    number = program.constant_number(constant) if offset != 0.0 else None
    return [*merged, _Product(offset / number, constant)] if number else merged


def _cost_on_board(name: str) -> int:
    """Cost of an operation on the board, in the unit of the declaration."""
    return OPERATIONS[CODE[name]].cost


def _append_cheapest_sum(program: _Program, products: list[_Product]) -> int:
    """Append the sum of some products to a program; return the index of the result."""
    if not products:
        return program.constant(0.0)
    products = [_with_two_operands(program, product) for product in products]
    multiplications = sum(product.second is not None or abs(product.factor) != 1.0 for product in products)
    separate_cost = multiplications * _cost_on_board("multiply") + (len(products) - 1) * _cost_on_board("add")
    if all(product.factor == -1.0 for product in products):
        separate_cost += _cost_on_board("negate")
    if len(products) == 1 or separate_cost <= _cost_on_board(SUM) + LAW_TERM_COST * len(products):
        return _append_single_operations(program, products)
    while len(products) > LAW_MAX_TERMS:
        first_terms = _Product(1.0, _append_sum(program, products[:LAW_MAX_TERMS]))
        products = [first_terms, *products[LAW_MAX_TERMS:]]
    return _append_sum(program, products)


def _with_two_operands(program: _Program, product: _Product) -> _Product:
    """Simplify a product so that a sum of products can hold it, which has two operands and a sign per
    term.
    """
    # A constant with a factor becomes another constant. The product of two values with a factor becomes one
    # value with that factor.
    number = program.constant_number(product.first)
    if number is not None and product.second is None:
        return _Product(1.0, program.constant(product.factor * number))
    if product.second is not None and abs(product.factor) != 1.0:
        return _Product(product.factor, program.append("multiply", product.first, product.second))
    return product


def _append_sum(program: _Program, products: list[_Product]) -> int:
    """Append one sum of products to a program; return its index."""
    operands: list[int] = []
    subtracted_bits = 0
    for k, product in enumerate(products):
        subtracted_bits |= (product.factor < 0.0) << k
        second = program.constant(abs(product.factor)) if product.second is None else product.second
        operands += [product.first, second]
    return program.put(Value(SUM, subtracted_bits, tuple(operands)))


def _append_single_operations(program: _Program, products: list[_Product]) -> int:
    """Append a multiplication per product and additions between them; return the index of the result."""
    total: int | None = None
    # Added products first, so that the others can be subtracted from them.
    for product in sorted(products, key=lambda each: each.factor == -1.0):
        is_subtracted = product.factor == -1.0
        if product.second is not None:
            value = program.append("multiply", product.first, product.second)
        elif is_subtracted:
            value = product.first
        else:
            value = program.append("multiply", product.first, program.constant(product.factor))
        if total is None:
            total = program.append("negate", value) if is_subtracted else value
        else:
            total = program.append("subtract" if is_subtracted else "add", total, value)
    assert total is not None
    return total
