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

_F64: Final = 0x7C
_GET, _SET, _LOAD, _STORE, _CONST = 0x20, 0x21, 0x2B, 0x39, 0x44
_CONVERT_I32: Final = 0xB7
_ZERO: Final = bytes([_CONST]) + struct.pack("<d", 0.0)
_UNARY: Final = {ca.OP_NEG: 0x9A, ca.OP_SQRT: 0x9F, ca.OP_FABS: 0x99, ca.OP_FLOOR: 0x9C, ca.OP_CEIL: 0x9B}
_BINARY: Final = {
    ca.OP_ADD: 0xA0,
    ca.OP_SUB: 0xA1,
    ca.OP_MUL: 0xA2,
    ca.OP_DIV: 0xA3,
    ca.OP_COPYSIGN: 0xA6,
}
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
        b"\x60\x01\x7c\x01\x7c",
        b"\x60\x02\x7c\x7c\x01\x7c",
        b"\x60" + _vector([b"\x7f"] * (inputs + outputs)) + b"\x00",
    ]
    imports = [_name("env") + _name("memory") + b"\x02\x00\x01"]
    for name in _FUNCTIONS:
        kind = unary if name in _CALL_1.values() else binary
        imports.append(_name("env") + _name(f"math_{name}") + b"\x00" + _number(kind))
    body = _vector([_number(function.sz_w()) + bytes([_F64])]) + _code(function, inputs, outputs) + b"\x0b"
    exported = _name("step") + b"\x00" + _number(len(_FUNCTIONS))
    return b"\0asm\x01\0\0\0" + b"".join(
        bytes([kind]) + _number(len(content)) + content
        for kind, content in (
            (1, _vector(types)),
            (2, _vector(imports)),
            (3, _vector([_number(step)])),
            (7, _vector([exported])),
            (10, _vector([_number(len(body)) + body])),
        )
    )


def _code(function: ca.Function, inputs: int, outputs: int) -> bytes:
    """Return the instructions of a function; arguments and results are the first locals."""
    first = inputs + outputs
    code = bytearray()

    def get(work: int) -> bytes:
        return bytes([_GET]) + _number(first + work)

    for k in range(function.n_instructions()):
        operation, source, target = (
            function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
        )
        if operation == ca.OP_OUTPUT:
            code += bytes([_GET]) + _number(inputs + target[0]) + get(source[0])
            code += bytes([_STORE, 3]) + _number(8 * target[1])
            continue
        if operation == ca.OP_INPUT:
            code += bytes([_GET]) + _number(source[0]) + bytes([_LOAD, 3]) + _number(8 * source[1])
        elif operation == ca.OP_CONST:
            code += bytes([_CONST]) + struct.pack("<d", function.instruction_constant(k))
        else:
            code += _operation(operation, [get(work) for work in source])
        code += bytes([_SET]) + _number(first + target[0])
    return bytes(code)


def _operation(operation: int, get: list[bytes]) -> bytes:
    """Return the code that leaves the result of an operation on the stack."""
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
        return operands + b"\x10" + _number(_FUNCTIONS.index(name))
    if operation == ca.OP_SQ:
        return get[0] + get[0] + b"\xa2"
    if operation == ca.OP_TWICE:
        return bytes([_CONST]) + struct.pack("<d", 2.0) + get[0] + b"\xa2"
    if operation == ca.OP_INV:
        return bytes([_CONST]) + struct.pack("<d", 1.0) + get[0] + b"\xa3"
    if operation == ca.OP_NOT:
        return get[0] + _ZERO + b"\x61" + bytes([_CONVERT_I32])
    if operation in (ca.OP_AND, ca.OP_OR):
        flags = b"".join(part + _ZERO + b"\x62" for part in get)
        return flags + (b"\x71" if operation == ca.OP_AND else b"\x72") + bytes([_CONVERT_I32])
    if operation == ca.OP_IF_ELSE_ZERO:
        return get[1] + _ZERO + get[0] + _ZERO + b"\x62\x1b"
    if operation == ca.OP_SIGN:
        # As in CasADi's C: -1, 0 or 1, and NaN stays.
        signs = [bytes([_CONST]) + struct.pack("<d", sign) for sign in (-1.0, 1.0)]
        above = signs[1] + get[0] + get[0] + _ZERO + b"\x64\x1b"
        return signs[0] + above + get[0] + _ZERO + b"\x63\x1b"
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


def _name(text: str) -> bytes:
    return _number(len(text)) + text.encode()


def _vector(items: Iterable[bytes]) -> bytes:
    parts = list(items)
    return _number(len(parts)) + b"".join(parts)
