"""Ways in which the firmware can hang in flight, and how long the motors stay on then."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware.due.report import Image
from tests.firmware.desk import Board

TICK: Final = "_ZN4heli4Core4tickENS_10TickTimingE"
POLL: Final = "_ZN4heli4Core4pollEv"
BRANCH_TO_SELF: Final = b"\xfe\xe7"
MASKED_BRANCH_TO_SELF: Final = b"\x72\xb6\xfe\xe7"
RETURN: Final = b"\x70\x47"
TICK_TIMER_CONTROL: Final = 0x40084000
CLOCK_DISABLE: Final = 1 << 1
TRAVEL: Final = 2
SLOWEST_Hz, FASTEST_Hz = 20_000, 44_000
"""Range of the slow clock, over parts and temperature."""
KICK_INTERVAL_MS: Final = 16


@dataclass(frozen=True)
class Hang:
    """One way to hang."""

    name: str
    # Linker symbol of the function whose first instructions are overwritten; empty for none
    function: str = ""
    code: bytes = b""  # With what
    edge: bool = False  # Whether an edge of the travel encoder sets it off
    stopped_timer: bool = False  # Whether the tick's timer is stopped

    @contextmanager
    def of(self, board: Board) -> Iterator[None]:
        """Hang now; on the way out the program is whole again."""
        address = board.image.symbols[self.function] & ~1 if self.function else 0
        original_code = board.due.peek(address, len(self.code)) if self.code else b""
        if self.code:
            board.due.poke(address, self.code)
        if self.edge:
            board.due.schedule_step(TRAVEL, 1, board.due.now_us + 1.0)
        if self.stopped_timer:
            board.due.poke(TICK_TIMER_CONTROL, struct.pack("<I", CLOCK_DISABLE))
        try:
            yield
        finally:
            if original_code:
                board.due.poke(address, original_code)

    def __str__(self) -> str:
        return self.name


HANGS: Final = (
    Hang("tick hangs", TICK, BRANCH_TO_SELF),
    Hang("idle loop hangs", POLL, BRANCH_TO_SELF),
    Hang("idle loop hangs with interrupts masked", POLL, MASKED_BRANCH_TO_SELF),
    Hang("encoder interrupt is stuck", "encoder_interrupt", RETURN, edge=True),
    Hang("tick interrupt is stuck", "tick_interrupt", RETURN),
    Hang("tick never comes again", stopped_timer=True),
)


def armed_board(elf: Path, image: Image, slow_Hz: int) -> Board:
    """A board with both bridges on and nothing on its motors."""
    board = Board(elf, image)
    board.due.set_slow_clock(slow_Hz)
    board.connect().arm()
    assert board.on()
    return board


def off_after_ms(elf: Path, image: Image, hang: Hang, slow_Hz: int, phase_ms: int) -> float:
    """How long after a hang the bridges are off [ms]."""
    board = armed_board(elf, image, slow_Hz)
    board.advance(phase_ms)
    with hang.of(board):
        return board.milliseconds_until_off(step_us=100.0)
