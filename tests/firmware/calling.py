"""Calls one function of the firmware on an emulated board, with arguments of the test's choice."""

from __future__ import annotations

from typing import Final

from tests.firmware.desk import Board

SCRATCH: Final = 0x2007_F000
"""Memory that no variable and no stack of the firmware uses; the linker fills SRAM0 from below."""
_STACK_POINTER, _LINK, _PC = 13, 14, 15
_MAX_MS: Final = 100


def halt_at(board: Board, symbol: str, max_us: float = 2500.0) -> None:
    """Let time pass until the firmware comes to a function; then it goes by steps."""
    address = board.image.symbols[symbol] & ~1
    board.due.add_breakpoint(address)
    board.due.run_us(max_us)
    assert board.due.halt == "breakpoint", f"the firmware does not come to {symbol}"
    board.due.remove_breakpoint(address)
    board.due.resume()


def enter(board: Board, symbol: str, *arguments: int) -> int:
    """Set the processor to the first instruction of a function; the address that it returns to."""
    due = board.due
    back = due.reg(_PC)
    for index, argument in enumerate(arguments):
        due.set_reg(index, argument & 0xFFFF_FFFF)
    due.set_reg(_LINK, back | 1)
    due.set_reg(_PC, board.image.symbols[symbol] & ~1)
    return back


def call(board: Board, symbol: str, *arguments: int) -> int:
    """The result of a function, called at the processor's present instruction, to which it returns."""
    due = board.due
    saved = [due.reg(index) for index in range(16)]
    back = enter(board, symbol, *arguments)
    due.add_breakpoint(back)
    # Interrupts go on meanwhile, and come back to where they were.
    for _ in range(_MAX_MS):
        due.run_us(1000.0)
        if due.halt == "breakpoint":
            break
    assert due.halt == "breakpoint", f"{symbol} does not return"
    due.remove_breakpoint(back)
    due.resume()
    assert due.reg(_STACK_POINTER) == saved[_STACK_POINTER]
    result = due.reg(0)
    for index, value in enumerate(saved):
        due.set_reg(index, value)
    return result
