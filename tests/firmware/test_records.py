"""What is known of a fault after the reset that it causes, and that the bridges went off before all else."""

from __future__ import annotations

import struct

import pytest
from heli_host.declaration import Fault, Reset

from tests.firmware.desk import TRAVEL_INTERRUPT, Board
from tests.firmware.hangs import HANGS, POLL
from tests.firmware.test_safety import MAX_MS, UNDEFINED, pend, store

pytestmark = pytest.mark.emulated

pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
pytest.importorskip("elftools", reason="pyelftools is missing: make setup")

# Backup registers, in the order of firmware/due/README.md.
GPBR = 0x400E1A90
MAGIC = 0x48460000
SCB_CCR = 0xE000ED14
GIVE_UP = "_ZN4heli3due6faults7give_upEv"
HARD_FAULT = 3
NOWHERE = 0x50000000

LOAD_FROM_NOWHERE = struct.pack("<3H", 0x2050, 0x0600, 0x6800)
DIVISION_BY_ZERO = struct.pack("<3H", 0x2000, 0xFBB0, 0xF0F0)
UNALIGNED_LOAD = struct.pack("<3H", 0x4668, 0x3001, 0x6800)
BFARVALID, UNDEFINSTR, UNALIGNED, DIVBYZERO = 1 << 15, 1 << 16, 1 << 24, 1 << 25


def recorded(board: Board) -> list[int]:
    """Record, PC, LR, CFSR, BFAR and number of boots."""
    return [board.register(GPBR + 4 * k) for k in range(6)]


def halt_at(board: Board, symbol: str) -> None:
    """Let time pass until the firmware comes to a function, within two ticks; then it goes by steps."""
    address = board.image.symbols[symbol] & ~1
    board.due.add_breakpoint(address)
    board.due.run_us(2500.0)
    assert board.due.halt == "breakpoint"
    board.due.remove_breakpoint(address)
    board.due.resume()


def assert_off_before(board: Board, symbol: str) -> None:
    """From the start of a function of the firmware on, the bridges go off before anything is recorded."""
    halt_at(board, symbol)
    assert board.on()
    before = recorded(board)
    while not (board.off() and board.pwm_low()):
        assert recorded(board) == before
        board.due.step()
    assert recorded(board) == before


@pytest.mark.parametrize(
    ("code", "place", "flag"),
    [
        (UNDEFINED, 0, UNDEFINSTR),
        (DIVISION_BY_ZERO, 2, DIVBYZERO),
        (UNALIGNED_LOAD, 4, UNALIGNED),
        (LOAD_FROM_NOWHERE, 4, BFARVALID),
    ],
)
def test_a_fault_is_recorded_with_its_place_its_caller_and_its_cause(
    board: Board, code: bytes, place: int, flag: int
) -> None:
    for check in ("unaligned", "unmapped"):
        board.due.set_check(check, False)
    board.connect().arm()
    resets = board.due.resets
    address = board.image.symbols[POLL] & ~1
    original_code = board.due.peek(address, len(code))
    board.due.poke(address, code)
    halt_at(board, "fault_handler")
    while board.due.resets == resets:
        record, pc, lr, cfsr, bfar, _ = recorded(board)
        board.due.step()
    board.due.poke(address, original_code)
    assert pc == address + place
    assert board.due.describe(lr).startswith("heli::due::run()")
    assert record == MAGIC | HARD_FAULT << 8 | Fault.HARD_FAULT
    assert cfsr & flag
    assert flag != BFARVALID or bfar == NOWHERE
    welcome = board.connect().session.welcome
    assert (welcome.reset, welcome.boot_fault) == (Reset.SOFTWARE, Fault.HARD_FAULT)


def test_an_unexpected_interrupt_is_recorded_with_its_number(board: Board) -> None:
    board.connect().arm()
    resets = board.due.resets
    pend(board, 8)
    while board.due.resets == resets:
        record = recorded(board)[0]
        board.due.step()
    assert record == MAGIC | (16 + 8) << 8 | Fault.UNEXPECTED_INTERRUPT


def test_the_bridges_go_off_before_a_fault_is_recorded(board: Board) -> None:
    board.connect().arm()
    pend(board, 8)
    assert_off_before(board, "fault_handler")


def test_the_bridges_go_off_before_giving_up_is_recorded(board: Board) -> None:
    board.connect().arm()
    store(board, board.image.symbols["__stack_bottom"], 0)
    assert_off_before(board, GIVE_UP)


def test_no_interrupt_gets_between_giving_up_and_the_reset(board: Board) -> None:
    board.connect().arm()
    store(board, board.image.symbols["__stack_bottom"], 0)
    halt_at(board, GIVE_UP)
    resets = board.due.resets
    served = board.due.exception_stats(TRAVEL_INTERRUPT)[0]
    for _ in range(10):
        board.due.step()
    board.due.schedule_step(2, 1, board.due.now_us)
    board.wait_for_reset(resets)
    assert board.due.exception_stats(TRAVEL_INTERRUPT)[0] == served


def hang(board: Board) -> Fault:
    """Let the idle loop of an armed board hang, and return the report of the next start."""
    board.connect().arm()
    resets = board.due.resets
    with HANGS[1].of(board):
        board.milliseconds_until_off(max_ms=MAX_MS)
        board.wait_for_reset(resets)
    welcome = board.connect().session.welcome
    assert welcome.reset == Reset.WATCHDOG
    return Fault(welcome.boot_fault)


def test_a_record_is_reported_after_the_next_reset_and_never_again(board: Board) -> None:
    board.advance(20)
    store(board, GPBR, MAGIC | Fault.HARD_FAULT)
    assert hang(board) is Fault.HARD_FAULT
    assert hang(board) is Fault.WATCHDOG


def test_a_record_from_before_a_reset_by_the_user_is_old(board: Board) -> None:
    board.advance(20)
    store(board, GPBR, MAGIC | Fault.HARD_FAULT)
    board.reset()
    welcome = board.connect().session.welcome
    assert (welcome.reset, welcome.boot_fault) == (Reset.USER, Fault.NONE)
    assert hang(board) is Fault.WATCHDOG


def test_a_register_without_a_record_reports_nothing(board: Board) -> None:
    board.advance(20)
    store(board, GPBR, Fault.HARD_FAULT)
    assert hang(board) is Fault.WATCHDOG


def test_zero_division_and_unaligned_access_trap_and_stacks_are_aligned(board: Board) -> None:
    board.advance(20)
    assert board.register(SCB_CCR) == 1 << 9 | 1 << 4 | 1 << 3
