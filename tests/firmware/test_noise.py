"""Bounce and noise on the inputs are no movement, no stop, and no lost count."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from heli_host.declaration import Fault, State

from firmware.due.report import Image
from tests.firmware.desk import STOP_PIN, TRAVEL_INTERRUPT, Board
from tests.firmware.test_board import counted, open_loop

pytestmark = pytest.mark.emulated

pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
pytest.importorskip("elftools", reason="pyelftools is missing: make setup")

DECODER_PINS = (("PB25", "PB27"), ("PC25", "PC26"))
CYCLES_PER_US = 84.0
WRITE_MOTORS = "_ZN4heli3due6motors5writeERKNS_12MotorCommandE"
PWM_FSR = 0x4009_4060
STOP_INPUT = 1 << 2
TRAVEL_COUNT = "_ZN4heli3due8encoders12_GLOBAL__N_110edge_countE"
TRAVEL_ILLEGAL = "_ZN4heli3due8encoders12_GLOBAL__N_113illegal_edgesE"


def word(board: Board, symbol: str) -> int:
    """A signed variable of the firmware, as it is now."""
    [value] = struct.unpack("<i", board.due.peek(board.image.symbols[symbol], 4))
    return int(value)


@pytest.mark.parametrize("axis", [0, 1])
def test_pulses_shorter_than_the_filter_are_nothing_to_a_decoder(board: Board, axis: int) -> None:
    heli = board.connect()
    before = list(counted(heli))
    for _ in range(5):
        # The switching of a motor couples a pulse into both lines of a cable at once. A running processor
        # would end its instruction first, and so stretch a pulse past the 0.76 us of the filter.
        board.due.hold_processor(True)
        for level in ("high", "low"):
            for pin in DECODER_PINS[axis]:
                board.due.set_pin(pin, level)
            board.due.run_us(0.7)
        board.due.hold_processor(False)
        heli.wait(0.003)
    assert list(counted(heli)) == before
    status = heli.session.status()
    assert (status.illegal_elevation, status.illegal_pitch) == (0, 0)


def test_an_edge_that_bounces_back_at_any_moment_leaves_the_count_where_it_was(board: Board) -> None:
    board.advance(20)
    for cycles in range(1, 90):
        start_us = board.due.now_us + 1.0
        board.due.schedule_step(2, 1, start_us)
        board.due.schedule_step(2, -1, start_us + cycles / CYCLES_PER_US)
        board.due.run_us(20.0)
        assert (word(board, TRAVEL_COUNT), word(board, TRAVEL_ILLEGAL)) == (0, 0), f"after {cycles} cycles"


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_where_the_travel_encoder_stands_at_the_start_is_its_zero(
    elf: Path, image: Image, steps: int
) -> None:
    board = Board(elf, image)
    board.cut_power()
    board.due.set_encoder(2, steps)
    board.restore_power()
    board.advance(20)
    board.due.schedule_step(2, 1, board.due.now_us + 10.0)
    board.due.schedule_step(2, 1, board.due.now_us + 30.0)
    board.advance(1)
    assert (word(board, TRAVEL_COUNT), word(board, TRAVEL_ILLEGAL)) == (2, 0)


def test_travel_counts_every_step_in_both_directions(board: Board) -> None:
    board.advance(20)
    place = 0
    for direction in (1, 1, 1, 1, 1, -1, 1, 1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 1):
        board.due.schedule_step(2, direction, board.due.now_us + 5.0)
        board.due.run_us(20.0)
        place += direction
        assert (word(board, TRAVEL_COUNT), word(board, TRAVEL_ILLEGAL)) == (place, 0)
    assert board.due.exception_stats(TRAVEL_INTERRUPT)[0] == 18


def test_a_spike_shorter_than_a_clock_is_no_stop_and_a_longer_one_is(board: Board) -> None:
    heli = board.connect()
    open_loop(heli, 6.0, 3.0)
    board.due.set_pin(STOP_PIN, "high")
    board.due.set_pin(STOP_PIN, "low")
    heli.wait(0.02)
    assert board.on()
    assert not board.pwm_low()
    board.due.set_pin(STOP_PIN, "high")
    board.due.run_us(0.1)
    board.due.set_pin(STOP_PIN, "low")
    heli.wait(0.02)
    assert board.off()
    assert heli.fault is Fault.HARDWARE_STOP


def test_a_stop_that_bounces_keeps_the_outputs_low_until_the_enables_are(board: Board) -> None:
    heli = board.connect()
    open_loop(heli, 6.0, 3.0)
    # Between two ticks, so that the next one finds the switch open again.
    board.due.run_us(500.0)
    for open_us, closed_us in ((2.0, 5.0), (1.0, 20.0), (5.0, 1.0)):
        board.press_stop()
        board.due.run_us(open_us)
        board.release_stop()
        board.due.run_us(closed_us)
    # Outputs come back at the end of a PWM period, which a tick may lie within: the latch itself is asked
    # too, where the tick is about to switch the enables off.
    write = board.image.symbols[WRITE_MOTORS] & ~1
    board.due.add_breakpoint(write)
    while board.due.halt != "breakpoint":
        assert board.pwm_low()
        board.due.run_us(1.0)
    assert board.register(PWM_FSR) >> 8 & STOP_INPUT
    board.due.remove_breakpoint(write)
    board.due.resume()
    heli.wait(0.02)
    assert board.off() and board.pwm_low()
    assert heli.state is State.FAULT


def test_stopping_takes_the_outputs_low_at_once_and_not_at_the_end_of_their_period(board: Board) -> None:
    heli = board.connect()
    open_loop(heli, 9.5, 9.5)
    for _ in range(6):
        board.due.glitch_encoder(2)
        board.due.run_us(5.0)
    board.milliseconds_until_off(step_us=1.0, max_ms=2.0)
    board.due.run_us(2.0)
    assert board.pwm_low()
    heli.wait(0.02)
    assert heli.fault is Fault.ENCODER_TRAVEL
