"""Tapes whose values can be made "no number" in flight, one by one, and what then has to follow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.board.law_program import Instruction, LawProgram, Term
from heli_host.declaration import LAW_INPUTS, OPERATIONS

NAME: Final = {operation.code: operation.name for operation in OPERATIONS}
CODE: Final = {operation.name: operation.code for operation in OPERATIONS}
POISON: Final = "poison"
HEALTHY, POISONED = 1.0, 0.0


@dataclass(frozen=True)
class Poisoned:
    """A program with a parameter that, once 0, makes the result of one instruction NaN.

    ``instruction`` is its place in the program that it was made of.
    """

    program: LawProgram
    instruction: int

    @property
    def index(self) -> int:
        """Which of its parameters."""
        return len(self.program.parameters) - 1


def poisoned(program: LawProgram) -> Iterator[Poisoned]:
    """Yield a program for each instruction: its result is multiplied by 1, and in the end by 0 / 0."""
    first_own_cell = len(LAW_INPUTS) + len(program.constants) + len(program.parameters)

    def cell(place: int) -> int:
        return place + 1 if place >= first_own_cell else place

    moved = [
        Instruction(
            instruction.code, cell(instruction.target),
            cell(instruction.first) if not instruction.terms else 0,
            cell(instruction.second) if OPERATIONS[instruction.code].operands == 2 else 0,
            tuple(Term(cell(term.first), cell(term.second), term.negative) for term in instruction.terms),
        )
        for instruction in program.instructions
    ]  # fmt: skip
    parameters = (*program.parameters, (POISON, HEALTHY))
    outputs = tuple(cell(place) for place in program.outputs)
    ratio = program.cells + 1
    for k, instruction in enumerate(moved):
        poison = (
            Instruction(CODE["divide"], ratio, first_own_cell, first_own_cell),
            Instruction(CODE["multiply"], instruction.target, instruction.target, ratio),
        )
        instructions = (*moved[: k + 1], *poison, *moved[k + 1 :])
        yield Poisoned(replace(program, parameters=parameters, outputs=outputs, instructions=instructions), k)


_MEANING: Final[dict[str, Callable[[float, float], float]]] = {
    "copy": lambda a, b: a, "add": lambda a, b: a + b, "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b, "negate": lambda a, b: -a, "absolute": lambda a, b: abs(a),
    "divide": lambda a, b: float(np.divide(a, b)), "minimum": lambda a, b: float(np.minimum(a, b)),
    "maximum": lambda a, b: float(np.maximum(a, b)), "less": lambda a, b: float(a < b),
    "less_equal": lambda a, b: float(a <= b), "equal": lambda a, b: float(a == b),
    "not_equal": lambda a, b: float(a != b), "both": lambda a, b: float(bool(a) and bool(b)),
    "either": lambda a, b: float(bool(a) or bool(b)), "negation": lambda a, b: float(not a),
    "floor": lambda a, b: float(np.floor(a)), "square_root": lambda a, b: float(np.sqrt(a)),
    "sine": lambda a, b: float(np.sin(a)), "cosine": lambda a, b: float(np.cos(a)),
    "tangent": lambda a, b: float(np.tan(a)), "arctangent": lambda a, b: float(np.arctan2(a, b)),
    "hyperbolic_tangent": lambda a, b: float(np.tanh(a)), "exponential": lambda a, b: float(np.exp(a)),
}  # fmt: skip


class Reference:
    """A program as it is meant, in double precision: a result is NaN if an operand is that counts.

    Parameters
    ----------
    program : LawProgram
        What is run.
    """

    def __init__(self, program: LawProgram) -> None:
        self.program = program
        numbers = [*program.constants, *(value for _, value in program.parameters)]
        self._first_state = len(LAW_INPUTS) + len(numbers)
        self.cells = np.zeros(program.cells + 1)
        self.cells[len(LAW_INPUTS) : self._first_state] = numbers
        states = [value for _, value in program.states]
        self.cells[self._first_state : self._first_state + len(states)] = states

    def poison(self) -> None:
        """Set the parameter that makes a result NaN."""
        self.cells[self._first_state - 1] = POISONED

    def __call__(self, inputs: Sequence[float]) -> list[float]:
        """Run it once; all outputs, new states included."""
        self.cells[: len(LAW_INPUTS)] = inputs
        with np.errstate(all="ignore"):
            for instruction in self.program.instructions:
                self.cells[instruction.target] = self._result(instruction)
        outputs = [float(self.cells[place]) for place in self.program.outputs]
        states = len(self.program.states)
        if states:
            self.cells[self._first_state : self._first_state + states] = outputs[-states:]
        return outputs

    def _result(self, instruction: Instruction) -> float:
        if instruction.terms:
            signs = (-1.0 if term.negative else 1.0 for term in instruction.terms)
            pairs = ((self.cells[term.first], self.cells[term.second]) for term in instruction.terms)
            return float(sum(sign * a * b for sign, (a, b) in zip(signs, pairs, strict=True)))
        a, b = float(self.cells[instruction.first]), float(self.cells[instruction.second])
        name = NAME[instruction.code]
        if name == "select":
            return np.nan if np.isnan(a) else b if a else 0.0
        counts = (a, b)[: OPERATIONS[instruction.code].operands]
        return np.nan if np.isnan(counts).any() else _MEANING[name](a, b)
