"""The firmware's own code for tapes, called on the emulated processor, instruction by instruction counted.

Command line: ``python -m tests.law.processor ELF`` prints what each operation costs at most.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from due_emulator import BareCore, read_image
from heli_host.declaration import LAW_CELLS, LAW_MAX_TERMS, LAW_TERM_COST, OPERATIONS

EXECUTE: Final = "_ZN4heli3law4Tape7executeEPKmS3_"
# In RAM: the tape's object, then the program; a stack at the end; in flash behind all code: a loop to itself.
TAPE: Final = 0x20070000
PROGRAM: Final = 0x20074000
STACK: Final = 0x20087000
STOP: Final = 0x000FE000
MAX_INSTRUCTIONS: Final = 500
HALT: Final = b"\xfe\xe7"
Terms = tuple[int, int, bool]
SP, LR, PC = 13, 14, 15
CODE: Final = {operation.name: operation.code for operation in OPERATIONS}

SPECIAL: Final = np.array(
    [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1.1754944e-38, 3.4028235e38, -3.4028235e38, 0.5, 1.5,
     -2.5, 16777216.0, 1.0000001, 0.99999994, 8191.9, 8192.0, 88.7, -87.3, 0.24, 0.26, 9.9, 1e-5, 3e-8, -0.7,
     1e30, 1e-30, 2.0, 8388609.0],
    np.float32,
)  # fmt: skip


class Processor:
    """The firmware in flash, ready to run tapes."""

    def __init__(self, elf: Path) -> None:
        image = read_image(elf)
        self.core = BareCore()
        for address, data in image.segments:
            self.core.write(address, data)
        self.core.write(STOP, HALT)
        self.execute = image.address(EXECUTE)
        self.cells = TAPE + self._cells_offset(image.address(EXECUTE))

    def _cells_offset(self, _: int) -> int:
        """Where in the object the cells are: the last of it, found by writing a number and copying it."""
        # At each place in turn, a number is written there, and the program copies cell 0 to cell 1. Cell 0 is
        # there if the number is then in the word behind it.
        word = operation_word(code=0, target=1)
        self.core.write(PROGRAM, word.to_bytes(4, "little"))
        for offset in range(0, 0x2000, 4):
            self.core.write(TAPE, bytes(0x2800))
            self.core.write(TAPE + offset, (0x12345678).to_bytes(4, "little"))
            self.call(PROGRAM, PROGRAM + 4)
            copied = self.core.read(TAPE + offset + 4, 4)
            if int.from_bytes(copied, "little") == 0x12345678:
                return offset
        raise AssertionError("the cells are not where they are looked for")

    def call(self, start: int, end: int) -> int:
        """Run a program; how many instructions that took."""
        most = 50 + MAX_INSTRUCTIONS * (end - start) // 4
        core = self.core
        for register, value in (
            (0, TAPE),
            (1, start),
            (2, end),
            (SP, STACK),
            (LR, STOP | 1),
            (PC, self.execute),
        ):
            core.set_reg(register, value)
        before = core.instructions
        core.trace(STOP, most)
        return core.instructions - before

    def cost(self, words: npt.NDArray[np.uint32], cells: npt.NDArray[np.float32]) -> int:
        """Instructions of a program over cells."""
        self.core.write(PROGRAM, words.astype("<u4").tobytes())
        self.core.write(self.cells, cells.astype("<f4").tobytes())
        return self.call(PROGRAM, PROGRAM + 4 * len(words))

    def read_cells(self) -> npt.NDArray[np.float32]:
        """All cells as they are now."""
        return np.frombuffer(self.core.read(self.cells, 4 * LAW_CELLS), "<f4")


def pairs(seed: int, count: int) -> npt.NDArray[np.float32]:
    """Operands that take long: special ones against each other, any bits, and sizes that are near."""
    chance = np.random.default_rng(seed)
    special = np.array(np.meshgrid(SPECIAL, SPECIAL)).reshape(2, -1).T
    bits = chance.integers(0, 1 << 32, (count, 2), np.uint64).astype(np.uint32)
    near = bits & 0x807FFFFF | 0x3D000000 + (bits & 0x03800000)
    return np.vstack([special, bits.view(np.float32), near.view(np.float32)]).astype(np.float32)


RESULT_CELL: Final = 400


def operation_word(code: int, target: int, first: int = 0, second: int = 0) -> int:
    """Word of an operation: its code, the cell of its result, and those of its operands."""
    return code << 27 | target << 18 | first << 9 | second


def operation_cost(processor: Processor, code: int, operands: npt.NDArray[np.float32], binary: bool) -> int:
    """Most instructions of one operation, the step to the next included."""
    word = operation_word(code, RESULT_CELL, first=0, second=1 if binary else 0)
    most = 0
    once, twice = np.array([word], np.uint32), np.array([word, word], np.uint32)
    for pair in operands:
        cells = np.zeros(2, np.float32)
        cells[:] = pair
        exponent = pair.view(np.uint32) >> 23 & 0xFF
        cells[exponent == 0] = 0.0
        most = max(most, processor.cost(twice, cells) - processor.cost(once, cells))
    return most


def sum_words(target: int, terms: Sequence[Terms]) -> list[int]:
    """Words of a sum of products over pairs of cells."""
    head = CODE["sum_of_products"] << 27 | target << 18 | len(terms)
    return [head, *(negative << 31 | first << 9 | second for first, second, negative in terms)]


def sum_cost(processor: Processor, cells: npt.NDArray[np.float32], terms: Sequence[Terms]) -> int:
    """Instructions of a sum over cells, the step to the next operation included."""
    once = np.array(sum_words(400, terms), np.uint32)
    twice = np.concatenate([once, once])
    return processor.cost(twice, cells) - processor.cost(once, cells)


def adversarial_sums(
    chance: np.random.Generator, count: int
) -> Iterator[tuple[npt.NDArray[np.float32], list[Terms]]]:
    """Sums that take long: cells, and terms over them."""
    # Any bits; terms that grow, so that what was summed is shifted each time; terms that nearly cancel, so
    # that hardly anything is left to be rounded; and numbers near the least normal ones.
    for k in range(count):
        terms = int(chance.integers(1, 10)) if k % 50 else LAW_MAX_TERMS
        size = 2 * terms
        sizes = (chance.uniform(1.0, 2.0, size) * chance.choice((-1.0, 1.0), size)).astype(np.float32)
        if k % 4 == 0:
            cells = chance.integers(0, 1 << 32, size, np.uint64).astype(np.uint32).view(np.float32)
        elif k % 4 == 1:
            cells = np.ldexp(sizes, np.sort(chance.integers(-60, 60, size))).astype(np.float32)
        elif k % 4 == 2:
            cells = np.ldexp(np.full(size, abs(sizes[0])), int(chance.integers(-50, 50))).astype(np.float32)
            cells.view(np.uint32)[:] += chance.integers(0, 3, size).astype(np.uint32)
        else:
            cells = np.ldexp(sizes, chance.integers(-126, -60, size)).astype(np.float32)
        cells[np.abs(cells) < np.finfo(np.float32).tiny] = 0.0
        yield cells, [(2 * n, 2 * n + 1, bool(chance.integers(0, 2))) for n in range(terms)]


def main() -> None:
    """Print what each operation costs."""
    parser = argparse.ArgumentParser(description="instructions of each operation of a tape")
    parser.add_argument("elf", type=Path)
    parser.add_argument("--count", type=int, default=1500, help="random pairs of operands")
    arguments = parser.parse_args()
    processor = Processor(arguments.elf)
    operands = pairs(1, arguments.count)
    for operation in OPERATIONS:
        if operation.operands == 0:
            continue
        most = operation_cost(processor, operation.code, operands, operation.operands == 2)
        print(f"{operation.name:20} {most:5} declared {operation.cost:5}")
    most = max(
        sum_cost(processor, cells, terms) - LAW_TERM_COST * len(terms)
        for cells, terms in adversarial_sums(np.random.default_rng(7), arguments.count)
    )
    print(f"{'sum_of_products':20} {most:5} declared {OPERATIONS[-1].cost:5}, and {LAW_TERM_COST} a term")


if __name__ == "__main__":
    main()
