"""A control law in the form that a board accepts: instructions over cells, with names of its signals.

The laboratory compiles such programs (tapes) from Python. This module stores them, computes their cost and
packs them for the link. docs/reference/link.md defines every word of a program.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Protocol

from heli_host.declaration import (
    AXES,
    LAW_CELLS,
    LAW_FIXED_COST,
    LAW_FORMAT,
    LAW_INPUT_COST,
    LAW_INPUTS,
    LAW_MAX_TICKS,
    LAW_MOVING_COST,
    LAW_OUTPUT_COST,
    LAW_SIGNAL_COST,
    LAW_SIGNALS,
    LAW_STATE_COST,
    LAW_TERM_COST,
    LAW_TICK_COST,
    LAW_WORDS,
    OPERATIONS,
    TICK_US,
)
from heli_host.errors import BadLaw
from heli_host.link.installation import plugins

TICK_Hz: Final = 1_000_000 // TICK_US
DIVISORS: Final = tuple(d for d in range(1, 256) if TICK_Hz % d == 0)


@dataclass(frozen=True)
class Term:
    """One product of a sum."""

    first: int  # first, second: Cells of its factors
    second: int
    negative: bool = False  # Whether the product is subtracted

    @property
    def word(self) -> int:
        """The 32 bits that cross the link."""
        return self.negative << 31 | self.first << 9 | self.second


@dataclass(frozen=True)
class Instruction:
    """One operation of a program."""

    code: int  # Number of the operation, see ``OPERATIONS``
    target: int  # Cell that the operation writes
    first: int = 0
    """first, second: Cells that the operation reads. `second` is 0 for one operand; both are 0 for a sum of
    products."""
    second: int = 0
    terms: tuple[Term, ...] = ()  # Terms of a sum of products

    @property
    def words(self) -> tuple[int, ...]:
        """Words that are sent over the link, 32 bits each."""
        second = len(self.terms) if self.terms else self.second
        header = self.code << 27 | self.target << 18 | self.first << 9 | second
        return (header, *(term.word for term in self.terms))

    @property
    def cost(self) -> int:
        """Worst-case number of processor instructions that the operation takes on the Due."""
        return OPERATIONS[self.code].cost + LAW_TERM_COST * len(self.terms)

    @property
    def read(self) -> tuple[int, ...]:
        """Cells that it reads."""
        if self.terms:
            return tuple(cell for term in self.terms for cell in (term.first, term.second))
        return (self.first, self.second)[: OPERATIONS[self.code].operands]


@dataclass(frozen=True)
class LawProgram:
    """A law that a board can run.

    Parameters
    ----------
    name : str
        Name of the law, for people.
    divisor : int
        Ticks from one call to the next.
    constants : tuple of float
        Numbers that never change.
    parameters : tuple of (str, float)
        Names and initial values of the parameters that can be changed in flight.
    states : tuple of (str, float)
        Names and first values.
    outputs : tuple of int
        Cells of both voltages, the three setpoints, the signals and the new states.
    signals : tuple of str
        Names of the signals.
    instructions : tuple of Instruction
        The program, in order.
    """

    name: str
    divisor: int
    constants: tuple[float, ...]
    parameters: tuple[tuple[str, float], ...]
    states: tuple[tuple[str, float], ...]
    outputs: tuple[int, ...]
    signals: tuple[str, ...]
    instructions: tuple[Instruction, ...]

    def __post_init__(self) -> None:
        if self.divisor not in DIVISORS:
            raise BadLaw(*rate_problem(TICK_Hz / self.divisor if self.divisor else 0.0))
        if len(self.signals) > LAW_SIGNALS:
            raise BadLaw(f"{len(self.signals)} signals are too many", f"give at most {LAW_SIGNALS}")
        if self.cells > LAW_CELLS:
            count = f"{len(self.states)} states, {len(self.constants)} constants"
            raise BadLaw(
                f"the law needs {self.cells} cells ({count}), the board has {LAW_CELLS}",
                "give it fewer states, or smaller matrices",
            )
        if len(self.words) > LAW_WORDS:
            raise BadLaw(
                f"the law has {len(self.words)} words ({len(self.instructions)} operations), but the board "
                f"holds {LAW_WORDS}",
                "simplify it: fewer states, fewer unrolled iterations",
            )
        # A call must end before the next one begins, `divisor` ticks later.
        ticks_needed = self.ticks
        if ticks_needed > min(self.divisor, LAW_MAX_TICKS):
            remedy = "simplify it: it fits no rate"
            fitting_divisor = next((divisor for divisor in DIVISORS if divisor >= ticks_needed), None)
            if fitting_divisor is not None and ticks_needed <= LAW_MAX_TICKS:
                fitting_Hz = TICK_Hz / fitting_divisor
                remedy = f"at {fitting_Hz:g} Hz it fits: a call is spread over {ticks_needed} ticks"
            raise BadLaw(
                f"a call costs up to {self.cost} instructions, a tick has {LAW_TICK_COST} for it", remedy
            )

    @property
    def rate_Hz(self) -> float:
        """Calls per second [Hz]."""
        return TICK_Hz / self.divisor

    @property
    def cells(self) -> int:
        """Number of cells that the program needs."""
        fixed = len(LAW_INPUTS) + len(self.constants) + len(self.parameters) + len(self.states)
        return max([fixed, *(instruction.target + 1 for instruction in self.instructions)])

    @property
    def words(self) -> tuple[int, ...]:
        """Words that are sent over the link, 32 bits each."""
        header = (
            LAW_FORMAT | self.divisor << 8 | len(self.signals) << 16 | len(self.parameters) << 24,
            len(self.constants) | len(self.states) << 16,
            sum(len(instruction.words) for instruction in self.instructions),
        )
        numbers = [*self.constants, *(v for _, v in self.parameters), *(v for _, v in self.states)]
        return (
            *header,
            *(_bits_of_single(value) for value in numbers),
            *self.outputs,
            *(word for instruction in self.instructions for word in instruction.words),
        )

    @property
    def hash(self) -> int:
        """CRC-32 of the words."""
        return hash_of(self.words)

    @cached_property
    def inputs_read(self) -> frozenset[str]:
        """Names of the inputs that the program reads or copies to an output."""
        cells = {cell for instruction in self.instructions for cell in instruction.read} | set(self.outputs)
        return frozenset(name for cell, name in enumerate(LAW_INPUTS) if cell in cells)

    @cached_property
    def own_setpoints(self) -> tuple[str, ...]:
        """Axes whose setpoint the law computes itself, although it also reads the board's setpoint."""
        return tuple(
            axis
            for k, axis in enumerate(AXES)
            if self.outputs[2 + k] != LAW_INPUTS.index(f"{axis}_setpoint_rad")
            and any(f"{axis}_setpoint_{unit}" in self.inputs_read for unit in ("rad", "rad_s", "rad_s2"))
        )

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Names of the logged signals: those of the law, then the board's setpoints of `own_setpoints`."""
        board_setpoints = (f"board_{axis}_setpoint_rad" for axis in self.own_setpoints)
        return (*self.signals, *board_setpoints)[:LAW_SIGNALS]

    @property
    def cost(self) -> int:
        """Instructions of the Due's processor that a call takes in the worst case."""
        return sum(self.tick_costs)

    @property
    def ticks(self) -> int:
        """Number of ticks over which a call is spread."""
        return len(self.tick_costs)

    @cached_property
    def tick_costs(self) -> tuple[int, ...]:
        """Worst-case instructions in each tick of a call, computed as the board does."""
        moving_axes = sum(
            any(f"{axis}_setpoint_{unit}" in self.inputs_read for unit in ("rad_s", "rad_s2"))
            for axis in AXES
        )
        each_tick = LAW_FIXED_COST + LAW_MOVING_COST * moving_axes
        end = LAW_OUTPUT_COST + LAW_STATE_COST * len(self.states) + LAW_SIGNAL_COST * len(self.signals)
        ticks = [LAW_INPUT_COST * len(self.inputs_read) + each_tick]
        for instruction in self.instructions:
            # Each tick keeps room for the end of the call, because it may be the last one.
            if ticks[-1] + instruction.cost + end > LAW_TICK_COST:
                ticks.append(each_tick)
            ticks[-1] += instruction.cost
        ticks[-1] += end
        return tuple(ticks)


class LawLike(Protocol):
    """An object with a program, such as a control law of the laboratory."""

    @property
    def program(self) -> LawProgram:
        """The law as the board takes it."""
        ...


def program_of(law: LawProgram | LawLike) -> LawProgram:
    """Return the program of a law, or the program itself."""
    program = law if isinstance(law, LawProgram) else getattr(law, "program", None)
    if not isinstance(program, LawProgram):
        raise BadLaw(
            f"a {type(law).__name__} is not a control law",
            "give the result of @control_law or from_gain, or its program",
        )
    return program


def hash_of(words: Sequence[int]) -> int:
    """Return the CRC-32 of words in the byte order of the link."""
    return zlib.crc32(struct.pack(f"<{len(words)}I", *words))


def check_number(quantity: str, value: float) -> None:
    """Refuse a number that a board cannot store."""
    try:
        single = struct.unpack("<f", struct.pack("<f", value))[0]
    except (struct.error, TypeError):
        raise BadLaw(f"the {quantity} is {value!r}, not a number", "give a number") from None
    except OverflowError:
        single = math.inf
    if not math.isfinite(single):
        raise BadLaw(
            f"the {quantity} is {value:g}", "give a finite number below 3.4e38, the limit of single precision"
        )


def rate_problem(rate_Hz: float) -> tuple[str, str]:
    """Explain why a board cannot call a law at this rate, and give the nearest possible rates."""
    rates = [TICK_Hz / d for d in DIVISORS]
    if math.isnan(rate_Hz):
        return "rate_Hz is nan", f"give {min(rates):g} to {max(rates):g} Hz"
    above = [rate for rate in rates if rate >= rate_Hz]
    below = [rate for rate in rates if rate <= rate_Hz]
    nearest_rates = sorted({*above[-1:], *below[:1]})
    return (
        f"a law cannot be called at {rate_Hz:g} Hz: a call every so many ticks of {TICK_Hz} Hz",
        f"give {' or '.join(f'{rate:g}' for rate in nearest_rates)} Hz",
    )


def divisor_of(rate_Hz: float) -> int:
    """Return the number of ticks from one call to the next."""
    if rate_Hz > 0.0:
        divisor = round(TICK_Hz / rate_Hz)
        if divisor in DIVISORS and abs(TICK_Hz / divisor - rate_Hz) < 1e-6 * rate_Hz:
            return divisor
    raise BadLaw(*rate_problem(rate_Hz))


def _bits_of_single(value: float) -> int:
    """Return the 32 bits of a number in single precision."""
    bits: int = struct.unpack("<I", struct.pack("<f", value))[0]
    return bits


ENTRY_POINT_GROUP: Final = "heli_host.laws"
FILE_LIMIT_s: Final = 30.0
"""How long the file of a law may run [s]. The laws of the documents take under 2 s. A shorter limit refuses
files that solve a large problem first; with a longer limit people wait longer for a loop without an end."""

LawReader = Callable[[Path, str | None], LawProgram]


def read_law(path: Path, rig: str | None = None) -> LawProgram:
    """Compile the law in a file to a program; the code of the file is run."""
    for entry in plugins(ENTRY_POINT_GROUP):
        reader: LawReader = entry.load()
        return reader(path, rig)
    raise BadLaw("no installed package can read control laws", "reinstall heli-host")
