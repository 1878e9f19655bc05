"""An emulated Due with a program in it, and what to say of it when it stops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from due_emulator.image import Image

if TYPE_CHECKING:
    from due_emulator._due import Due

_FAULT_BITS = {
    0: "IACCVIOL", 3: "MUNSTKERR", 4: "MSTKERR", 7: "MMARVALID", 8: "IBUSERR", 9: "PRECISERR",
    11: "UNSTKERR", 12: "STKERR", 15: "BFARVALID", 16: "UNDEFINSTR", 17: "INVSTATE", 18: "INVPC",
    19: "NOCP", 24: "UNALIGNED", 25: "DIVBYZERO",
}  # fmt: skip


def new_due(image: Image | None = None, *, strict: bool = True) -> Due:
    """An emulated board, powered off, with the program `image` in its flash, which None leaves erased. Unless
    `strict`, what the chip does not promise to take is a warning instead of a stop.
    """
    from due_emulator._due import Due

    due = Due()
    due.set_strict(strict)
    if image is not None:
        load_image(due, image)
    return due


def load_image(due: Due, image: Image) -> None:
    """Load a program into the flash of a board, `due`, with the names of its functions."""
    for address, data in image.segments:
        due.load(address, data)
    for symbol in image.symbols:
        if symbol.is_function:
            due.add_symbol(symbol.address, symbol.size, symbol.name)


@dataclass(frozen=True)
class Report:
    """The processor at one moment."""

    registers: tuple[int, ...]  # r0 to r12, SP, LR, PC
    xpsr: int  # Flags, IT state and number of the running exception
    cfsr: int  # cfsr, hfsr, bfar: Fault status and address
    hfsr: int
    bfar: int
    function: str  # Function and offset of PC, empty when unknown
    time_us: float  # Board time

    def __str__(self) -> str:
        names = [*(f"r{i}" for i in range(13)), "sp", "lr", "pc"]
        cells = [f"{name:>3} {value:08x}" for name, value in zip(names, self.registers, strict=True)]
        rows = ["  ".join(cells[i : i + 4]) for i in range(0, 16, 4)]
        bits = " ".join(name for bit, name in _FAULT_BITS.items() if self.cfsr >> bit & 1)
        rows.append(f"xpsr {self.xpsr:08x}  cfsr {self.cfsr:08x}  hfsr {self.hfsr:08x}  bfar {self.bfar:08x}")
        if bits:
            rows.append(f"fault: {bits}")
        if self.function:
            rows.append(f"in {self.function}")
        return "\n".join(rows)


def report_of(due: Due) -> Report:
    """Report of the present state of the processor of a board, `due`."""
    return Report(
        registers=tuple(due.reg(i) for i in range(16)),
        xpsr=due.xpsr,
        cfsr=due.cfsr,
        hfsr=due.hfsr,
        bfar=due.bfar,
        function=due.describe(due.reg(15)),
        time_us=due.now_us,
    )
