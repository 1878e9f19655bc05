"""Make limits and conditions of a law return NaN if an operand is NaN, as on the board.

In C and in CasADi, ``fmin(nan, 1)`` is 1, and a comparison with NaN is false. A limit would thus hide that a
law has failed. The board's operations return NaN instead, so that its guard takes over in the same tick.
"""

from __future__ import annotations

from typing import Final

import casadi as ca

# Operations that hide NaN in C, with the number of their leading operands that are checked: for a selection,
# only the condition.
_CHECKED_OPERANDS: Final = {
    ca.OP_FMIN: 2, ca.OP_FMAX: 2, ca.OP_LT: 2, ca.OP_LE: 2, ca.OP_EQ: 2, ca.OP_NE: 2, ca.OP_AND: 2,
    ca.OP_OR: 2, ca.OP_NOT: 1, ca.OP_IF_ELSE_ZERO: 1,
}  # fmt: skip


def with_nan_propagation(function: ca.Function) -> ca.Function:
    """Return the function of a law in which each operation returns NaN if an operand is NaN."""
    function = function.expand() if not function.is_a("SXFunction") else function
    inputs = [ca.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
    outputs = [ca.SX(function.size1_out(k), 1) for k in range(function.n_out())]
    # Expression in each of CasADi's work registers.
    register: dict[int, ca.SX] = {}
    for k in range(function.n_instructions()):
        code, target = function.instruction_id(k), function.instruction_output(k)
        operands = function.instruction_input(k)
        if code == ca.OP_INPUT:
            number, element = operands
            register[target[0]] = inputs[number][element]
        elif code == ca.OP_CONST:
            register[target[0]] = ca.SX(function.instruction_constant(k))
        elif code == ca.OP_OUTPUT:
            number, element = target
            outputs[number][element] = register[operands[0]]
        else:
            register[target[0]] = _operation_with_nan(code, [register[operand] for operand in operands])
    dense = [ca.densify(output) for output in outputs]
    return ca.Function(function.name(), inputs, dense, function.name_in(), function.name_out())


def _operation_with_nan(code: int, operands: list[ca.SX]) -> ca.SX:
    """Apply CasADi's operation `code`, and make the result NaN if a checked operand is NaN."""
    result = ca.SX.unary(code, *operands) if len(operands) == 1 else ca.SX.binary(code, *operands)
    for operand in operands[: _CHECKED_OPERANDS.get(code, 0)]:
        if not operand.is_constant():
            result = result + _nan_or_zero(operand)
    return result


def _nan_or_zero(value: ca.SX) -> ca.SX:
    """Return an expression that is NaN if a value is NaN, and otherwise 0."""
    # Both comparisons are false for NaN only.
    is_number = ca.logic_or(value < 0.0, value >= 0.0)
    return ca.SX.binary(ca.OP_IF_ELSE_ZERO, ca.logic_not(is_number), value)
