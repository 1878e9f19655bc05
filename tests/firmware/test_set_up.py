"""Once the firmware has started, the chip is set up: clocks, pins, interrupts, peripherals in use.

The tables here are the wiring and the datasheet's meaning of each bit; nothing is read from the firmware's
sources. Flights show most of these settings, but not all: an input is heard whichever peripheral its pin is
given to, and an interrupt priority shows only if two interrupts meet.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from firmware.due.report import Image
from tests.firmware.calling import call, halt_at
from tests.firmware.desk import ENABLE_PINS, PWM_PINS, Board
from tests.firmware.test_records import GPBR

pytestmark = pytest.mark.emulated

pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
pytest.importorskip("elftools", reason="pyelftools is missing: make setup")

CLOCK_START = "_ZN4heli3due5clock5startEv"
PWM_START = "_ZN4heli3due6motors5startEv"
CUT = "_ZN4heli3due6motors3cutEv"
GIVE_UP = "_ZN4heli3due6faults7give_upEv"

PORTS = {"A": 0x400E_0E00, "B": 0x400E_1000, "C": 0x400E_1200, "D": 0x400E_1400}
PIO_PSR, PIO_OSR, PIO_ODSR, PIO_IMR, PIO_PUSR, PIO_ABSR = 0x08, 0x18, 0x38, 0x48, 0x68, 0x70
UART_PINS = ("PA8", "PA9")
DECODER_PINS = ("PB25", "PB27", "PC25", "PC26")
EDGE_PINS = ("PD0", "PD1")
STOP_PIN = "PD6"

# Numbers of peripherals, which are their bits in PMC_PCSR and their interrupts (datasheet, 9.1).
UART, PIOA, PIOB, PIOC, PIOD, TC0, TC3, TC4, TC6, PWM, TRNG = 8, 11, 12, 13, 14, 27, 30, 31, 33, 36, 41
PMC_PCSR0, PMC_PCSR1, CKGR_MOR, CKGR_PLLAR, PMC_MCKR = (
    0x400E_0600 + offset for offset in (0x18, 0x108, 0x20, 0x28, 0x30)
)
UART_BASE, RSTC_MR, WDT_MR = 0x400E_0800, 0x400E_1A08, 0x400E_1A54
TC_BASES = {"TC0": 0x4008_0000, "TC1": 0x4008_4000, "TC2": 0x4008_8000}
TC_CMR, TC_RC, TC_SR, TC_IMR, TC_BMR, TC_QIMR = 0x04, 0x1C, 0x20, 0x2C, 0xC4, 0xD0
CLKSTA = 1 << 16
PWM_BASE = 0x4009_4000
NVIC_ISER, NVIC_IPR, SCB_VTOR = 0xE000_E100, 0xE000_E400, 0xE000_ED08
FLASH = 0x0008_0000

OFF_BITS = 0xF0 << 16
"""The low-side outputs of channels 4 to 7 in the override registers."""
GROUP = 0xF1
"""The four channels of the bridges, and channel 0, which gives them its clock."""
STOP_INPUT = 1 << 2


@pytest.fixture
def started(board: Board) -> Board:
    """A board that has started and flies nothing."""
    board.advance(20)
    return board


def before(elf: Path, image: Image, symbol: str) -> Board:
    """A board just after power-up, as it comes to a function of its start."""
    board = Board(elf, image)
    board.cut_power()
    board.restore_power()
    halt_at(board, symbol, max_us=20_000.0)
    return board


def register_mask(port: str, *pins: str) -> int:
    return sum(1 << int(pin[2:]) for pin in pins if pin[1] == port)


def ports(board: Board, register: int) -> dict[str, int]:
    return {port: board.register(base + register) for port, base in PORTS.items()}


def in_ports(*pins: str) -> dict[str, int]:
    return {port: register_mask(port, *pins) for port in PORTS}


def inverted(values: dict[str, int]) -> dict[str, int]:
    return {port: value ^ 0xFFFF_FFFF for port, value in values.items()}


def channel(number: int, register: int) -> int:
    return PWM_BASE + 0x200 + 0x20 * number + register


# -- clocks --------------------------------------------------------------------------------------------


def test_the_crystal_is_multiplied_by_14_and_halved(started: Board) -> None:
    # Crystal and RC oscillator on, the crystal chosen, started over 8 times 8 slow clocks.
    assert started.register(CKGR_MOR) == 1 << 24 | 8 << 8 | 1 << 3 | 1
    assert started.register(CKGR_PLLAR) & ~(1 << 29) == 13 << 16 | 0x3F << 8 | 1
    # Half of PLLA.
    assert started.register(PMC_MCKR) == 1 << 4 | 2


def test_the_peripherals_in_use_have_their_clock_and_no_other(started: Board) -> None:
    clocked = {k for k in range(32) if started.register(PMC_PCSR0) >> k & 1}
    clocked |= {32 + k for k in range(32) if started.register(PMC_PCSR1) >> k & 1}
    assert clocked == {UART, PIOA, PIOB, PIOC, PIOD, TC0, TC3, TC4, TC6, PWM, TRNG}


# -- pins ----------------------------------------------------------------------------------------------


def test_each_pin_is_given_to_what_the_wiring_table_has_there(started: Board) -> None:
    given = (*UART_PINS, *DECODER_PINS, *PWM_PINS, STOP_PIN)
    assert ports(started, PIO_PSR) == inverted(in_ports(*given))
    # All of these are peripheral B of their pin, except for the serial line.
    assert ports(started, PIO_ABSR) == in_ports(*DECODER_PINS, *PWM_PINS, STOP_PIN)


def test_only_what_the_bridges_need_is_driven(started: Board) -> None:
    driven = (*ENABLE_PINS, *PWM_PINS)
    assert ports(started, PIO_OSR) == in_ports(*driven)
    assert ports(started, PIO_ODSR) == in_ports()
    # A set bit is a pull-up that is off: inputs keep theirs, so that a broken wire has a level.
    assert ports(started, PIO_PUSR) == in_ports(*driven)


def test_the_bridges_pins_are_low_before_the_clock_is_fast(elf: Path, image: Image) -> None:
    board = before(elf, image, CLOCK_START)
    assert ports(board, PIO_OSR) == in_ports(*ENABLE_PINS, *PWM_PINS)
    assert ports(board, PIO_PSR) == inverted(in_ports())
    assert not any(board.due.pin(pin) for pin in (*ENABLE_PINS, *PWM_PINS))
    assert board.register(PMC_PCSR0) == sum(1 << port for port in (PIOA, PIOB, PIOC, PIOD))


def test_pwm_pins_stay_low_while_they_are_handed_over(elf: Path, image: Image) -> None:
    board = before(elf, image, PWM_START)
    for _ in range(400):
        assert not any(board.due.pin(pin) for pin in (*ENABLE_PINS, *PWM_PINS))
        board.due.step()
    assert ports(board, PIO_ABSR)["C"] & register_mask("C", *PWM_PINS) == register_mask("C", *PWM_PINS)


# -- interrupts ----------------------------------------------------------------------------------------


def test_edges_interrupt_ticks_and_nothing_else_interrupts(started: Board) -> None:
    enabled = [started.register(NVIC_ISER + 4 * k) for k in range(2)]
    assert enabled == [1 << PIOD | 1 << TC3, 0]
    registers = (started.register(NVIC_IPR + 4 * k) for k in range(12))
    priorities = [byte for word in registers for byte in word.to_bytes(4, "little")]
    # Four bits each, in the upper half; smaller is more urgent.
    assert {k: value >> 4 for k, value in enumerate(priorities) if value} == {TC3: 8}
    assert ports(started, PIO_IMR) == in_ports(*EDGE_PINS)
    assert started.register(SCB_VTOR) == FLASH


# -- timers --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("block", ["TC0", "TC2"])
def test_a_decoder_counts_all_edges_of_both_lines_through_the_longest_filter(
    started: Board, block: str
) -> None:
    base = TC_BASES[block]
    # QDEN, POSEN, EDGPHA, FILTER, MAXFILT (datasheet, 36.7.17).
    assert started.register(base + TC_BMR) == 1 << 8 | 1 << 9 | 1 << 12 | 1 << 19 | 63 << 20
    # Clocked by XC0, with the external trigger that the datasheet asks for: rising edge of TIOA.
    assert started.register(base + TC_CMR) == 5 | 1 << 8 | 1 << 10
    assert started.register(base + TC_SR) & CLKSTA
    assert [started.register(base + 0x40 * k + TC_IMR) for k in range(3)] == [0, 0, 0]
    assert started.register(base + TC_QIMR) == 0


def test_one_counter_restarts_each_millisecond_and_one_never(started: Board) -> None:
    base = TC_BASES["TC1"]
    # Waveform mode, on half the master clock; the ticker up to RC, which interrupts.
    assert started.register(base + TC_CMR) == 1 << 15 | 2 << 13
    assert started.register(base + TC_RC) == 42_000
    assert started.register(base + TC_IMR) == 1 << 4
    assert started.register(base + 0x40 + TC_CMR) == 1 << 15
    assert started.register(base + 0x40 + TC_IMR) == 0
    assert started.register(base + 0x40 + TC_SR) & CLKSTA
    assert not started.register(base + 0x80 + TC_SR) & CLKSTA


# -- motors --------------------------------------------------------------------------------------------


def test_all_pwm_channels_run_alike_in_one_group_and_begin_with_duty_zero(started: Board) -> None:
    assert started.register(PWM_BASE) == 0  # PWM_CLK: the master clock
    assert started.register(PWM_BASE + 0x0C) == GROUP
    # Synchronous, update by software.
    assert started.register(PWM_BASE + 0x20) == GROUP
    for number in (0, 4, 5, 6, 7):
        # Centre-aligned, first level high: 84 MHz / (2 * 2100) is 20 kHz.
        assert started.register(channel(number, 0x00)) == 1 << 8 | 1 << 9
        assert started.register(channel(number, 0x04)) == 2100
        assert started.register(channel(number, 0x0C)) == 2100


def test_pwm_outputs_are_overridden_low_until_the_motors_are_armed(started: Board) -> None:
    assert started.register(PWM_BASE + 0x44) == 0
    assert started.register(PWM_BASE + 0x48) == OFF_BITS
    heli = started.connect()
    heli.arm()
    assert started.register(PWM_BASE + 0x48) == 0
    heli.stop()
    assert started.register(PWM_BASE + 0x48) == OFF_BITS


def test_the_stop_input_is_active_high_latched_and_filtered(started: Board) -> None:
    assert started.register(PWM_BASE + 0x5C) == STOP_INPUT | STOP_INPUT << 8 | STOP_INPUT << 16
    assert started.register(PWM_BASE + 0x68) == 0
    # The input is released, and nothing of it is latched.
    assert not started.register(PWM_BASE + 0x60) & (STOP_INPUT | STOP_INPUT << 8)


def test_bridges_can_be_cut_before_anything_is_set_up(elf: Path, image: Image) -> None:
    board = before(elf, image, CLOCK_START)
    call(board, CUT)
    assert board.register(PMC_PCSR1) >> PWM - 32 & 1
    assert board.register(PWM_BASE + 0x48) == OFF_BITS
    assert board.off() and board.pwm_low()


# -- serial line, flash, watchdog, reset ---------------------------------------------------------------


def test_the_serial_line_moves_bytes_by_itself_and_interrupts_never(started: Board) -> None:
    # Normal mode, no parity.
    assert started.register(UART_BASE + 0x04) == 4 << 9
    assert started.register(UART_BASE + 0x20) == 21
    assert started.register(UART_BASE + 0x10) == 0
    # The peripheral's DMA controller reads and writes.
    assert started.register(UART_BASE + 0x124) == 1 << 8 | 1
    first, count, following, next_count = (
        started.register(UART_BASE + offset) for offset in (0x100, 0x104, 0x110, 0x114)
    )
    assert (count, next_count, following - first) == (512, 512, 512)


def test_the_watchdog_resets_after_27_periods_and_stops_only_for_a_debugger(started: Board) -> None:
    assert started.register(WDT_MR) == 26 | 26 << 16 | 1 << 13 | 1 << 28


def test_the_reset_button_stays_a_reset_button(started: Board) -> None:
    assert started.register(RSTC_MR) & 1


def test_a_start_uses_up_the_record_of_a_fault(started: Board) -> None:
    assert started.register(GPBR) == 0


def test_a_clock_that_does_not_come_up_is_given_up(elf: Path, image: Image) -> None:
    board = before(elf, image, CLOCK_START)
    # As from a crystal that never starts: the function returns false.
    board.due.set_reg(15, board.due.reg(14) & ~1)
    board.due.set_reg(0, 0)
    halt_at(board, GIVE_UP)
    resets = board.due.resets
    board.due.run_us(1000.0)
    assert board.due.resets > resets
