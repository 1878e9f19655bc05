"""Make a law's function return NaN wherever a limit or condition gets NaN, as the board does.

In C and in CasADi ``fmin(nan, 1)`` is 1, and a comparison with NaN is false: a limit hides that a law has
failed. The board's operations give NaN there, so that its guard takes over in the same tick.
"""

from __future__ import annotations

from typing import Final

import casadi as ca

# Operations that hide NaN in C, with how many of their operands count: of a selection the condition alone.
_HIDING: Final = {
    ca.OP_FMIN: 2, ca.OP_FMAX: 2, ca.OP_LT: 2, ca.OP_LE: 2, ca.OP_EQ: 2, ca.OP_NE: 2, ca.OP_AND: 2,
    ca.OP_OR: 2, ca.OP_NOT: 1, ca.OP_IF_ELSE_ZERO: 1,
}  # fmt: skip


def with_no_number(function: ca.Function) -> ca.Function:
    """Return the function with NaN as the result of each operation that would hide a NaN among its operands.

    Parameters
    ----------
    function : casadi.Function
        Function of a control law.
    """
    function = function.expand() if not function.is_a("SXFunction") else function
    inputs = [ca.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
    outputs = [ca.SX(function.size1_out(k), 1) for k in range(function.n_out())]
    work: dict[int, ca.SX] = {}
    for k in range(function.n_instructions()):
        code, into = function.instruction_id(k), function.instruction_output(k)
        read = function.instruction_input(k)
        if code == ca.OP_INPUT:
            work[into[0]] = inputs[read[0]][read[1]]
        elif code == ca.OP_CONST:
            work[into[0]] = ca.SX(function.instruction_constant(k))
        elif code == ca.OP_OUTPUT:
            outputs[into[0]][into[1]] = work[read[0]]
        else:
            work[into[0]] = _computed(code, [work[place] for place in read])
    dense = [ca.densify(output) for output in outputs]
    return ca.Function(function.name(), inputs, dense, function.name_in(), function.name_out())


def _computed(code: int, operands: list[ca.SX]) -> ca.SX:
    """Result of an operation that is NaN if an operand is, also where CasADi's hides it."""
    result = ca.SX.unary(code, *operands) if len(operands) == 1 else ca.SX.binary(code, *operands)
    for operand in operands[: _HIDING.get(code, 0)]:
        if not operand.is_constant():
            result = result + _no_number_of(operand)
    return result


def _no_number_of(value: ca.SX) -> ca.SX:
    """NaN if a value is NaN, otherwise 0: NaN is neither below 0 nor from there on."""
    is_number = ca.logic_or(value < 0.0, value >= 0.0)
    return ca.SX.binary(ca.OP_IF_ELSE_ZERO, ca.logic_not(is_number), value)
