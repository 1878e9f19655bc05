"""Write a plant's millisecond as a WebAssembly module, instruction by instruction, without a compiler.

CasADi lists a function as instructions on a work vector; each becomes the same operation on doubles here, so
that the numbers are those of the C that CasADi writes. Functions of mathematics come from the board's module.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final

import casadi as ca
from heli_sim.errors import PlantError

# Bytes of WebAssembly: types, sections and instructions. All arithmetic is on doubles, f64.
_F64, _POINTER, _SIGNATURE = 0x7C, 0x7F, 0x60
_TYPES, _IMPORTS, _FUNCTION_TYPES, _EXPORTS, _BODIES = 1, 2, 3, 7, 10
_OF_FUNCTION, _OF_MEMORY = b"\x00", b"\x02"
"""Kinds of an import or export."""
_GET, _SET, _LOAD, _STORE, _CONST = 0x20, 0x21, 0x2B, 0x39, 0x44
_ALIGNED_8: Final = 3
"""Alignment of a load or a store, as an exponent of 2."""
_CONVERT_I32: Final = 0xB7
_MUL, _DIV, _EQUAL, _UNEQUAL, _LESS, _GREATER = b"\xa2", b"\xa3", b"\x61", b"\x62", b"\x63", b"\x64"
_AND, _OR, _CALL, _END = b"\x71", b"\x72", b"\x10", b"\x0b"
_SELECT: Final = b"\x1b"
"""Of two values, the first where the condition above them on the stack is not 0."""
_ZERO: Final = bytes([_CONST]) + struct.pack("<d", 0.0)
_UNARY: Final = {ca.OP_NEG: 0x9A, ca.OP_SQRT: 0x9F, ca.OP_FABS: 0x99, ca.OP_FLOOR: 0x9C, ca.OP_CEIL: 0x9B}
_BINARY: Final = {ca.OP_ADD: 0xA0, ca.OP_SUB: 0xA1, ca.OP_MUL: 0xA2, ca.OP_DIV: 0xA3, ca.OP_COPYSIGN: 0xA6}
_COMPARE: Final = {ca.OP_LT: 0x63, ca.OP_LE: 0x65, ca.OP_EQ: 0x61, ca.OP_NE: 0x62}
_CALL_1: Final = {
    getattr(ca, f"OP_{name.upper()}"): name
    for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log")
} | {ca.OP_LOG1P: "log1p", ca.OP_EXPM1: "expm1"}
_CALL_2: Final = {
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_FMOD: "fmod",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_ATAN2: "atan2",
    ca.OP_HYPOT: "hypot",
}
_FUNCTIONS: Final = (*sorted(_CALL_1.values()), *sorted({*_CALL_2.values()}))
"""Imported functions in the order of their indices; the plant's own function follows them."""


def plant_module(function: ca.Function) -> bytes:
    """Return a module that exports `step` with the pointers state, volts, locked, parameters, next state and
    angles, for a function of these four inputs and two outputs.
    """
    inputs, outputs = function.n_in(), function.n_out()
    unary, binary, step = range(3)
    types = [
        _signature([_F64], [_F64]),
        _signature([_F64, _F64], [_F64]),
        _signature([_POINTER] * (inputs + outputs), []),
    ]
    # Memory of one page at least, without a limit, then the functions of mathematics, each with the index of
    # its type.
    imports = [_name("env") + _name("memory") + _OF_MEMORY + b"\x00\x01"]
    for name in _FUNCTIONS:
        kind = unary if name in _CALL_1.values() else binary
        imports.append(_name("env") + _name(f"math_{name}") + _OF_FUNCTION + _number(kind))
    body = _vector([_number(function.sz_w()) + bytes([_F64])]) + _code(function, inputs, outputs) + _END
    exported = _name("step") + _OF_FUNCTION + _number(len(_FUNCTIONS))
    return b"\0asm\x01\0\0\0" + b"".join(
        bytes([section]) + _number(len(content)) + content
        for section, content in (
            (_TYPES, _vector(types)),
            (_IMPORTS, _vector(imports)),
            (_FUNCTION_TYPES, _vector([_number(step)])),
            (_EXPORTS, _vector([exported])),
            (_BODIES, _vector([_number(len(body)) + body])),
        )
    )


def _code(function: ca.Function, inputs: int, outputs: int) -> bytes:
    """Return the instructions of a function; arguments and results are the first locals."""
    first_work = inputs + outputs
    code = bytearray()

    def get(work: int) -> bytes:
        return bytes([_GET]) + _number(first_work + work)

    for k in range(function.n_instructions()):
        operation, source, target = (
            function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
        )
        if operation == ca.OP_OUTPUT:
            output, element = target
            code += bytes([_GET]) + _number(inputs + output) + get(source[0])
            code += bytes([_STORE, _ALIGNED_8]) + _number(8 * element)  # a double has 8 bytes
            continue
        if operation == ca.OP_INPUT:
            pointer, element = source
            code += bytes([_GET]) + _number(pointer) + bytes([_LOAD, _ALIGNED_8]) + _number(8 * element)
        elif operation == ca.OP_CONST:
            code += bytes([_CONST]) + struct.pack("<d", function.instruction_constant(k))
        else:
            code += _operation(operation, [get(work) for work in source])
        code += bytes([_SET]) + _number(first_work + target[0])
    return bytes(code)


def _operation(operation: int, get: list[bytes]) -> bytes:
    """Return the code that leaves the result of an operation on the stack; `get` gets each operand there."""
    operands = b"".join(get)
    if operation == ca.OP_ASSIGN:
        return operands
    if operation in _UNARY:
        return operands + bytes([_UNARY[operation]])
    if operation in _BINARY:
        return operands + bytes([_BINARY[operation]])
    if operation in _COMPARE:
        return operands + bytes([_COMPARE[operation], _CONVERT_I32])
    if operation in _CALL_1 or operation in _CALL_2:
        name = _CALL_1.get(operation) or _CALL_2[operation]
        return operands + _CALL + _number(_FUNCTIONS.index(name))
    if operation == ca.OP_SQ:
        return get[0] + get[0] + _MUL
    if operation == ca.OP_TWICE:
        return bytes([_CONST]) + struct.pack("<d", 2.0) + get[0] + _MUL
    if operation == ca.OP_INV:
        return bytes([_CONST]) + struct.pack("<d", 1.0) + get[0] + _DIV
    if operation == ca.OP_NOT:
        return get[0] + _ZERO + _EQUAL + bytes([_CONVERT_I32])
    if operation in (ca.OP_AND, ca.OP_OR):
        flags = b"".join(part + _ZERO + _UNEQUAL for part in get)
        return flags + (_AND if operation == ca.OP_AND else _OR) + bytes([_CONVERT_I32])
    if operation == ca.OP_IF_ELSE_ZERO:
        condition, value = get
        return value + _ZERO + condition + _ZERO + _UNEQUAL + _SELECT
    if operation == ca.OP_SIGN:
        # As in CasADi's C: -1, 0 or 1, and NaN stays.
        minus_1, plus_1 = (bytes([_CONST]) + struct.pack("<d", sign) for sign in (-1.0, 1.0))
        not_negative = plus_1 + get[0] + get[0] + _ZERO + _GREATER + _SELECT
        return minus_1 + not_negative + get[0] + _ZERO + _LESS + _SELECT
    name = next((name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == operation), "")
    raise PlantError(f"the page has no operation {name}", "leave out the effect that contains it")


def _number(value: int) -> bytes:
    """Return an unsigned number in LEB128."""
    out = bytearray()
    while True:
        value, low = value >> 7, value & 0x7F
        out.append(low | (0x80 if value else 0))
        if not value:
            return bytes(out)


def _signature(arguments: list[int], results: list[int]) -> bytes:
    return (
        bytes([_SIGNATURE])
        + _number(len(arguments))
        + bytes(arguments)
        + _number(len(results))
        + bytes(results)
    )


def _name(text: str) -> bytes:
    return _number(len(text)) + text.encode()


def _vector(items: Iterable[bytes]) -> bytes:
    parts = list(items)
    return _number(len(parts)) + b"".join(parts)
