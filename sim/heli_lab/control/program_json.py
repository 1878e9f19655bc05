"""Convert a program of the board to JSON and back, and back to a law.

The JSON may come from an untrusted process, so that every entry is checked.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, Final

import casadi as ca
from heli_host.board.law_program import Instruction, LawProgram, Term, check_number
from heli_host.declaration import LAW_CELLS, LAW_INPUTS, LAW_MAX_TERMS, OPERATIONS
from heli_host.errors import BadLaw

from heli_lab.control.compile import CODE, FIXED_OUTPUTS, SUM
from heli_lab.control.law import LONGEST_NAME, Law, casadi_function

_MAX_ITEMS: Final = 8192
"""Longest list [entries]: more than the 1,536 words that a board stores."""

_FUNCTION_OF_OPERATION: Final[dict[str, Callable[..., Any]]] = {
    "copy": lambda a: a, "add": lambda a, b: a + b, "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b, "divide": lambda a, b: a / b, "negate": lambda a: -a,
    "absolute": ca.fabs, "minimum": ca.fmin, "maximum": ca.fmax, "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b, "equal": ca.eq, "not_equal": ca.ne, "both": ca.logic_and,
    "either": ca.logic_or, "negation": ca.logic_not, "select": lambda a, b: ca.if_else(a, b, 0),
    "floor": ca.floor, "square_root": ca.sqrt, "sine": ca.sin, "cosine": ca.cos, "tangent": ca.tan,
    "arctangent": ca.atan2, "hyperbolic_tangent": ca.tanh, "exponential": ca.exp,
}  # fmt: skip


def program_json(program: LawProgram) -> str:
    """Return the program as JSON that `program_of_json` reads."""
    content = {
        "name": program.name,
        "divisor": program.divisor,
        "constants": program.constants,
        "parameters": program.parameters,
        "states": program.states,
        "outputs": program.outputs,
        "signals": program.signals,
        "instructions": [
            (
                instruction.code,
                instruction.target,
                instruction.first,
                instruction.second,
                [(term.first, term.second, int(term.negative)) for term in instruction.terms],
            )
            for instruction in program.instructions
        ],
    }
    return json.dumps(content)


def program_of_json(text: str) -> LawProgram:
    """Read a program that an untrusted process wrote; every entry is checked."""
    try:
        content = json.loads(text)
        return _check_and_convert(content)
    except (ValueError, TypeError, KeyError, IndexError, RecursionError, OverflowError) as error:
        raise BadLaw(
            "the file's process did not return a program", "remove the code that replaces it"
        ) from error


def _check_and_convert(content: Mapping[str, Any]) -> LawProgram:
    """Convert the `content` of a JSON text to a program; invalid content raises one of Python's errors."""
    constants = tuple(
        _check_single_precision("constant", value) for value in _check_list(content["constants"])
    )
    parameters = tuple(_check_named_value("parameter", *pair) for pair in _check_list(content["parameters"]))
    states = tuple(_check_named_value("state", *pair) for pair in _check_list(content["states"]))
    signals = tuple(_printable_name(signal) for signal in _check_list(content["signals"]))
    outputs = tuple(_check_cell(cell) for cell in _check_list(content["outputs"]))
    if len(outputs) != FIXED_OUTPUTS + len(signals) + len(states):
        raise ValueError("another number of outputs")
    program = LawProgram(
        _printable_name(content["name"]),
        _check_whole_number(content["divisor"], stop=256),  # A byte of the program
        constants,
        parameters,
        states,
        outputs,
        signals,
        tuple(_check_instruction(*fields) for fields in _check_list(content["instructions"])),
    )
    # This checks names, and that every cell is written before it is read.
    law_of_program(program)
    return program


def law_of_program(program: LawProgram) -> Law:
    """Return the law that a program computes, to linearise it or run it with numpy."""
    inputs = ca.SX.sym("inputs", len(LAW_INPUTS))
    states = ca.SX.sym("states", len(program.states))
    parameters = ca.SX.sym("parameters", len(program.parameters))
    # The board's memory before the first instruction, in the order in which a compiler assigns the cells.
    first_cells = [
        *ca.vertsplit(inputs),
        *(ca.SX(value) for value in program.constants),
        *(parameters[k] for k in range(len(program.parameters))),
        *(states[k] for k in range(len(program.states))),
    ]
    cells: dict[int, ca.SX] = dict(enumerate(first_cells))
    try:
        for instruction in program.instructions:
            cells[instruction.target] = _result_of(instruction, cells)
        results = [cells[cell] for cell in program.outputs]
    except KeyError as error:
        raise BadLaw(
            f"the law {program.name} reads cell {error} before it is written", "compile the law again"
        ) from error
    output_count = FIXED_OUTPUTS + len(program.signals)
    outputs, new_states = results[:output_count], results[output_count:]
    function = casadi_function(inputs, states, parameters, outputs, new_states)
    start_states, parameter_values = dict(program.states), dict(program.parameters)
    return Law(program.name, program.rate_Hz, function, start_states, parameter_values, program.signals)


def _result_of(instruction: Instruction, cells: Mapping[int, ca.SX]) -> ca.SX:
    """Return the value that an instruction computes from the cells that it reads."""
    if instruction.code != CODE[SUM]:
        function = _FUNCTION_OF_OPERATION[OPERATIONS[instruction.code].name]
        result: ca.SX = function(*(cells[cell] for cell in instruction.read))
        return result
    products = (
        (-1.0 if term.negative else 1.0) * cells[term.first] * cells[term.second]
        for term in instruction.terms
    )
    return sum(products, ca.SX(0.0))


def _check_list(value: Any) -> list[Any]:
    """Check that a value is a list, and not too long."""
    if not isinstance(value, list) or len(value) > _MAX_ITEMS:
        raise TypeError("not a list of a program")
    return value


def _check_whole_number(value: Any, stop: int) -> int:
    """Check that a value is a whole number from 0 to `stop` - 1."""
    if type(value) is not int or not 0 <= value < stop:
        raise ValueError("not a number of a program")
    return value


def _check_cell(value: Any) -> int:
    """Check that a value is the number of a cell."""
    return _check_whole_number(value, LAW_CELLS)


def _check_single_precision(what: str, value: Any) -> float:
    """Check that a value is a number that the board can store; messages call it `what`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("not a number")
    check_number(what, float(value))
    return float(value)


def _printable_name(value: Any) -> str:
    """Check that a value is a text, and make it safe to print: short, and without control characters."""
    if not isinstance(value, str):
        raise TypeError("not a name")
    return "".join(letter if letter.isprintable() else "?" for letter in value[:LONGEST_NAME])


def _check_named_value(kind: str, name: Any, value: Any) -> tuple[str, float]:
    """Check name and value of a parameter or state, its `kind`."""
    return _printable_name(name), _check_single_precision(f"{kind} {_printable_name(name)}", value)


def _check_instruction(code: Any, target: Any, first: Any, second: Any, terms: Any) -> Instruction:
    """Check the entries of an instruction; only a sum of products has terms."""
    code = _check_whole_number(code, len(OPERATIONS))
    checked_terms = [
        Term(_check_cell(a), _check_cell(b), bool(_check_whole_number(negative, 2)))
        for a, b, negative in _check_list(terms)
    ]
    if bool(checked_terms) != (code == CODE[SUM]) or len(checked_terms) > LAW_MAX_TERMS:
        raise ValueError("terms of another operation")
    return Instruction(
        code, _check_cell(target), _check_cell(first), _check_cell(second), tuple(checked_terms)
    )
