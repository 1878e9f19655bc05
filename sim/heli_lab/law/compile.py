"""From a function of symbols to a program: values, then sums of products, then cells.

Every value gets a cell of memory, which is used again after the last operation that reads the value.
"""

from __future__ import annotations

from typing import Protocol

import casadi as ca
from heli_host.declaration import LAW_CELLS, LAW_INPUTS
from heli_host.errors import BadLaw
from heli_host.law_program import Instruction, LawProgram, Term, divisor_of

from heli_lab.law.program import CODE, FIXED_OUTPUTS, Program, Value
from heli_lab.law.sums import SUM, with_sums


class LawSource(Protocol):
    """Properties of a control law that the compiler reads. `heli_lab.law.Law` documents them."""

    @property
    def name(self) -> str:
        """Name of the law for readers."""
        ...

    @property
    def rate_Hz(self) -> float:
        """Calls per second [Hz]."""
        ...

    @property
    def function(self) -> ca.Function:
        """CasADi function of inputs, states and parameters."""
        ...

    @property
    def states(self) -> dict[str, float]:
        """Initial values of the states by name."""
        ...

    @property
    def parameters(self) -> dict[str, float]:
        """Values of the parameters by name."""
        ...

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals."""
        ...


def compile_program(law: LawSource) -> LawProgram:
    """Make the program of a law.

    Parameters
    ----------
    law : LawSource
        Control law that the board is to run.

    Raises
    ------
    BadLaw
        No board could run it.
    """
    function = law.function.expand() if not law.function.is_a("SXFunction") else law.function
    program, outputs = _read(law, function)
    program, outputs = with_sums(program, outputs)
    _with_copies(law, program, outputs)
    program, outputs = _without_dead_ends(program, outputs)
    instructions, cells = _allot(law, program, outputs)
    return LawProgram(
        law.name,
        divisor_of(law.rate_Hz),
        tuple(program.constants),
        tuple(law.parameters.items()),
        tuple(law.states.items()),
        tuple(cells),
        law.signals,
        tuple(instructions),
    )


def _read(law: LawSource, function: ca.Function) -> tuple[Program, list[int]]:
    program = Program(law.name)
    kinds = ("input", "state", "parameter")
    count = FIXED_OUTPUTS + len(law.signals)
    outputs = [program.constant(0.0)] * (count + len(law.states))
    work: dict[int, int] = {}
    for k in range(function.n_instructions()):
        code, into = function.instruction_id(k), function.instruction_output(k)
        read = function.instruction_input(k)
        if code == ca.OP_INPUT:
            work[into[0]] = program.put(Value(kinds[read[0]], read[1]))
        elif code == ca.OP_CONST:
            work[into[0]] = program.constant(function.instruction_constant(k))
        elif code == ca.OP_OUTPUT:
            outputs[into[1] + (count if into[0] == 1 else 0)] = work[read[0]]
        elif code == ca.OP_PARAMETER:
            raise BadLaw(
                f"the law {law.name} contains a symbol that is not an input, a state or a parameter",
                "use inputs, states and parameters only",
            )
        else:
            work[into[0]] = program.casadi(code, work[read[0]], work[read[1]] if len(read) > 1 else 0)
    return program, outputs


def _with_copies(law: LawSource, program: Program, outputs: list[int]) -> None:
    """Copy a state before it is written if a later operation still reads its old value."""
    for k in range(FIXED_OUTPUTS + len(law.signals), len(outputs)):
        if program.values[outputs[k]].kind == "state":
            outputs[k] = program.do("copy", outputs[k])


def _without_dead_ends(program: Program, outputs: list[int]) -> tuple[Program, list[int]]:
    """Remove values that no operation and no output reads."""
    needed = set(outputs)
    for place in range(len(program.values) - 1, -1, -1):
        if place in needed:
            needed.update(program.values[place].operands)
    kept = Program(program.name)
    moved: dict[int, int] = {}
    for place in sorted(needed):
        kept.take(program, place, moved)
    return kept, [moved[operand] for operand in outputs]


def _allot(law: LawSource, program: Program, outputs: list[int]) -> tuple[list[Instruction], list[int]]:
    """Assign a cell to every value. A cell is free again after the last operation that reads its value."""
    start = {"input": 0, "constant": len(LAW_INPUTS)}
    start["parameter"] = start["constant"] + len(program.constants)
    start["state"] = start["parameter"] + len(law.parameters)
    fresh = start["state"] + len(law.states)
    last: dict[int, int] = {}
    for place, value in enumerate(program.values):
        for operand in value.operands:
            last[operand] = place
    last.update(dict.fromkeys(outputs, len(program.values)))
    cell: dict[int, int] = {}
    free: list[int] = []
    instructions: list[Instruction] = []
    for place, value in enumerate(program.values):
        if value.kind in start:
            cell[place] = start[value.kind] + value.place
            continue
        for operand in set(value.operands):
            if last[operand] == place and program.values[operand].kind not in start:
                free.append(cell[operand])
        if free:
            cell[place] = free.pop()
        else:
            cell[place], fresh = fresh, fresh + 1
        if cell[place] >= LAW_CELLS:
            raise BadLaw(
                f"the law {law.name} needs more than the {LAW_CELLS} cells of the board "
                f"({len(law.states)} states, {len(program.constants)} constants)",
                "give it fewer states, or smaller matrices",
            )
        operands = [cell[operand] for operand in value.operands]
        if value.kind == SUM:
            pairs = zip(operands[::2], operands[1::2], strict=True)
            terms = tuple(
                Term(first, second, bool(value.place >> k & 1)) for k, (first, second) in enumerate(pairs)
            )
            instructions.append(Instruction(CODE[SUM], cell[place], terms=terms))
        else:
            first, second = (*operands, 0)[:2]
            instructions.append(Instruction(CODE[value.kind], cell[place], first, second))
    return instructions, [cell[output] for output in outputs]
