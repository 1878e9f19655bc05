"""Compile the function of a law into a program for the board.

First, CasADi's operations become values. Then additions and multiplications become sums of products. Last,
each value gets a cell of the board's memory, which is used again after the last operation that reads it.
"""

from __future__ import annotations

import casadi as ca
from heli_host.board.law_program import Instruction, LawProgram, Term, divisor_of
from heli_host.declaration import LAW_CELLS, LAW_INPUTS
from heli_host.errors import BadLaw

from heli_lab.control.law.law_function import LawFunction
from heli_lab.control.law.program import CODE, FIXED_OUTPUTS, Program, Value
from heli_lab.control.law.sums import SUM, with_sums


def compile_program(law: LawFunction) -> LawProgram:
    """Compile a control law into a program for the board."""
    function = law.function.expand() if not law.function.is_a("SXFunction") else law.function
    program, outputs = _translate_to_values(law, function)
    program, outputs = with_sums(program, outputs)
    _copy_read_states(law, program, outputs)
    program, outputs = _without_unused_values(program, outputs)
    instructions, output_cells = _assign_cells(law, program, outputs)
    return LawProgram(
        name=law.name,
        divisor=divisor_of(law.rate_Hz),
        constants=tuple(program.constants),
        parameters=tuple(law.parameters.items()),
        states=tuple(law.states.items()),
        outputs=tuple(output_cells),
        signals=law.signals,
        instructions=tuple(instructions),
    )


def _translate_to_values(law: LawFunction, function: ca.Function) -> tuple[Program, list[int]]:
    """Translate CasADi's instructions into values. Returns `program`, `outputs`."""
    program = Program(law.name)
    argument_kinds = ("input", "state", "parameter")
    output_count = FIXED_OUTPUTS + len(law.signals)
    outputs = [program.constant(0.0)] * (output_count + len(law.states))
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
            # Result 0 has the outputs, result 1 the new states.
            outputs[element + (output_count if result == 1 else 0)] = register[operands[0]]
        elif code == ca.OP_PARAMETER:
            raise BadLaw(
                f"the law {law.name} contains a symbol that is not an input, a state or a parameter",
                "use inputs, states and parameters only",
            )
        else:
            second = register[operands[1]] if len(operands) > 1 else 0
            register[target[0]] = program.append_casadi(code, register[operands[0]], second)
    return program, outputs


def _copy_read_states(law: LawFunction, program: Program, outputs: list[int]) -> None:
    """Copy each state whose old value becomes the new value of a state; change `outputs` in place.

    Without the copy, the board may have overwritten the old value before it is read.
    """
    for k in range(FIXED_OUTPUTS + len(law.signals), len(outputs)):
        if program.values[outputs[k]].kind == "state":
            outputs[k] = program.append("copy", outputs[k])


def _without_unused_values(program: Program, outputs: list[int]) -> tuple[Program, list[int]]:
    """Remove the values that no operation and no output reads; return the program and its `outputs`."""
    read_values = set(outputs)
    for index in range(len(program.values) - 1, -1, -1):
        if index in read_values:
            read_values.update(program.values[index].operands)
    smaller = Program(program.name)
    new_index: dict[int, int] = {}
    for index in sorted(read_values):
        smaller.copy_value(program, index, new_index)
    return smaller, [new_index[output] for output in outputs]


def _assign_cells(
    law: LawFunction, program: Program, outputs: list[int]
) -> tuple[list[Instruction], list[int]]:
    """Assign a cell of the board's memory to every value, and write the instructions. Returns
    `instructions`, `output_cells`.

    A cell is free again after the last operation that reads its value.
    """
    first_cell = {"input": 0, "constant": len(LAW_INPUTS)}
    first_cell["parameter"] = first_cell["constant"] + len(program.constants)
    first_cell["state"] = first_cell["parameter"] + len(law.parameters)
    next_cell = first_cell["state"] + len(law.states)
    # Index of the last operation that reads each value.
    last_reader: dict[int, int] = {}
    for index, value in enumerate(program.values):
        for operand in value.operands:
            last_reader[operand] = index
    last_reader.update(dict.fromkeys(outputs, len(program.values)))
    cell: dict[int, int] = {}
    free_cells: list[int] = []
    instructions: list[Instruction] = []
    for index, value in enumerate(program.values):
        if value.kind in first_cell:
            cell[index] = first_cell[value.kind] + value.detail
            continue
        for operand in set(value.operands):
            if last_reader[operand] == index and program.values[operand].kind not in first_cell:
                free_cells.append(cell[operand])
        if free_cells:
            cell[index] = free_cells.pop()
        else:
            cell[index], next_cell = next_cell, next_cell + 1
        if cell[index] >= LAW_CELLS:
            raise BadLaw(
                f"the law {law.name} needs more than the {LAW_CELLS} cells of the board "
                f"({len(law.states)} states, {len(program.constants)} constants)",
                "give it fewer states, or smaller matrices",
            )
        instructions.append(
            _write_instruction(value, cell[index], [cell[operand] for operand in value.operands])
        )
    return instructions, [cell[output] for output in outputs]


def _write_instruction(value: Value, target: int, operands: list[int]) -> Instruction:
    """Write the instruction that computes a `value` from the cells `operands` into the cell `target`."""
    if value.kind != SUM:
        first, second = (*operands, 0)[:2]
        return Instruction(CODE[value.kind], target, first, second)
    terms = []
    for k, (first, second) in enumerate(zip(operands[::2], operands[1::2], strict=True)):
        is_subtracted = bool(value.detail >> k & 1)
        terms.append(Term(first, second, is_subtracted))
    return Instruction(CODE[SUM], target, terms=tuple(terms))
