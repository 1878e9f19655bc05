"""The headers say what the vendor's description of the chip says, and the started firmware has set it up.

The tables of the set-up are the wiring and the datasheet's meaning of each bit; they are not read from the
firmware's sources. Flights show most of these settings, but not all: an input is heard whichever peripheral
its pin is given to, and an interrupt priority shows only if two interrupts meet.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import fetch_svd
import pytest
from fetch_svd import Description, Register

from firmware.due.report import Image
from tests.firmware import built
from tests.firmware.desk import ENABLE_PINS, GIVE_UP, GPBR, PWM_PINS, STOP_PIN, Board, call, halt_at

pytestmark = pytest.mark.emulated


@pytest.fixture(scope="session")
def description() -> Description:
    """The vendor's description of the chip."""
    vendors = fetch_svd.description()
    if vendors is None:
        pytest.skip(fetch_svd.MISSING)
    return vendors


HEADER = built.DRIVERS / "registers.hpp"

# Structures of the header: their peripheral in the description.
BLOCKS = {
    "Pmc": "PMC",
    "Uart": "UART",
    "Efc": "EFC0",
    "Pio": "PIOA",
    "Rstc": "RSTC",
    "Wdt": "WDT",
    "Gpbr": "GPBR",
    "Tc": "TC0",
    "Pwm": "PWM",
    "Trng": "TRNG",
}
# Structures that stand in others: who holds them, in which array, of how many.
NESTED = {"TcChannel": ("Tc", "TC_CHANNEL", 3), "PwmChannel": ("Pwm", "PWM_CH_NUM", 8)}

PREFIXES = ("PMC_", "UART_", "EEFC_", "PIO_", "RSTC_", "WDT_", "SYS_", "TC_", "PWM_", "TRNG_")

ACCESS = {"ReadOnly": "read-only", "WriteOnly": "write-only", "ReadWrite": "read-write"}


@dataclass(frozen=True)
class Member:
    """A register of the header."""

    block: str  # Its structure
    access: str  # Its type
    name: str  # As in the datasheet


def text() -> str:
    return HEADER.read_text()


def members() -> list[Member]:
    matches = []
    for block in re.finditer(r"^struct (\w+) \{\n(.*?)^\};", text(), re.MULTILINE | re.DOTALL):
        for line in re.finditer(
            r"^  (ReadOnly|WriteOnly|ReadWrite) (\w+)(?:\[\d+\])?;", block[2], re.MULTILINE
        ):
            matches.append(Member(block[1], line[1], line[2]))
    return matches


def short(name: str) -> str:
    for prefix in PREFIXES:
        if name.startswith(prefix):
            return name.removeprefix(prefix)
    return name


def described(description: Description, member: Member) -> list[tuple[int, Register]]:
    """The same register in the description: index in an array of channels, and what it says."""
    block, _, count = NESTED.get(member.block, (member.block, "", 0))
    peripheral = description.peripherals[BLOCKS[block]]
    name = short(member.name)
    if not count:
        return [(0, peripheral.registers[name])]
    return [(index, peripheral.registers[f"{name}{index}"]) for index in range(count)]


def compile_claims(claims: list[str], folder: Path) -> None:
    source = folder / "claims.cpp"
    lines = ["#include <cstddef>", f'#include "{HEADER}"', "using namespace heli::due;", *claims]
    source.write_text("\n".join(lines) + "\n")
    flags = ["-std=c++17", "-fsyntax-only", "-Wno-int-to-pointer-cast", "-Wno-invalid-offsetof"]
    process = built.compile_here(*flags, source)
    failed = re.findall(r"static assertion failed[^\n]*|error:[^\n]*", process.stderr)
    assert process.returncode == 0, "\n".join(failed)


def test_every_register_of_the_header_is_in_the_description(description: Description) -> None:
    assert len(members()) > 60
    for member in members():
        assert described(description, member)


def test_registers_stand_where_the_description_has_them(description: Description, tmp_path: Path) -> None:
    claims = []
    for member in members():
        for index, register in described(description, member):
            place = f"{member.block}, {member.name}"
            if member.block in NESTED:
                outer, array, _ = NESTED[member.block]
                place = f"{outer}, {array}[{index}].{member.name}"
            claims.append(f'static_assert(offsetof({place}) == {register.offset:#x}, "{place}");')
    compile_claims(claims, tmp_path)


def test_registers_can_be_read_and_written_as_on_the_chip(description: Description) -> None:
    mistakes = [
        f"{member.name} is {register.access}, the header says {ACCESS[member.access]}"
        for member in members()
        for _, register in described(description, member)
        if ACCESS[member.access] != register.access
    ]
    assert not mistakes, "\n".join(mistakes)


def test_peripherals_stand_where_the_description_has_them(description: Description) -> None:
    definitions = re.findall(r"^inline constexpr At<(\w+)> (\w+)\{(0x[0-9A-Fa-f]+)\};", text(), re.MULTILINE)
    assert len(definitions) >= len(BLOCKS)
    for _, name, address in definitions:
        assert int(address, 16) == description.peripherals[name].address, name


def test_identifiers_are_those_of_the_description(description: Description) -> None:
    definitions = re.findall(r"^inline constexpr unsigned ID_(\w+) = (\d+);", text(), re.MULTILINE)
    assert definitions
    for name, number in definitions:
        assert description.interrupts[name] == int(number), name


def split(constant: str, description: Description) -> tuple[list[Register], str]:
    """A constant's registers, and what follows their name in it: PMC_SR_LOCKA is LOCKA of SR."""
    prefix = constant.partition("_")[0]
    peripheral = {"CKGR": "PMC", "EEFC": "EFC0", "TC": "TC0"}.get(prefix, prefix)
    registers = description.peripherals[peripheral].registers
    for key in (constant, constant.removeprefix(f"{prefix}_")):
        for length in range(key.count("_"), 0, -1):
            words = key.split("_")
            name, rest = "_".join(words[:length]), "_".join(words[length:])
            hits = [registers[also] for also in (name, f"{name}0", f"{name}0_WAVE_EQ_1") if also in registers]
            if hits:
                return hits, rest
    raise AssertionError(f"{constant} belongs to no register")


def test_bits_and_fields_are_those_of_the_description(description: Description) -> None:
    bits = re.findall(r"^inline constexpr std::uint32_t (\w+) = bit\((\d+)\);", text(), re.MULTILINE)
    fields = re.findall(r"^inline constexpr Field (\w+)\{(\d+), (\d+)\};", text(), re.MULTILINE)
    assert len(bits) + len(fields) > 60
    mistakes = []
    for name, offset, width in [*((name, offset, "1") for name, offset in bits), *fields]:
        registers, field = split(name, description)
        says = {register.fields[field] for register in registers if field in register.fields}
        if says != {(int(offset), int(width))}:
            mistakes.append(f"{name}: {offset}, {width} instead of {says}")
    assert not mistakes, "\n".join(mistakes)


def test_named_values_are_those_of_the_description(description: Description) -> None:
    values = re.findall(r"^inline constexpr std::uint32_t (\w+) =\s*(\w+)\((\d+)\);", text(), re.MULTILINE)
    values = [value for value in values if value[1] != "bit"]
    assert len(values) >= 8
    mistakes = []
    for name, field_name, value in values:
        registers, field = split(field_name, description)
        meaning = name.removeprefix(field_name + "_")
        says = {register.values.get((field, meaning)) for register in registers} - {None}
        if says != {int(value)}:
            mistakes.append(f"{name}: {value} instead of {says}")
    assert not mistakes, "\n".join(mistakes)


def test_no_constant_of_the_header_escapes_these_tests() -> None:
    kinds = (r"At<\w+> \w+\{0x\w+\};", r"unsigned ID_\w+ = \d+;", r"Field \w+\{\d+, \d+\};")
    known = [*kinds, r"std::uint32_t \w+ =\s*\w+\(\d+\);"]
    constants = re.findall(r"^inline constexpr ([^;]+;)", text(), re.MULTILINE)
    assert not [line for line in constants if not any(re.fullmatch(kind, line) for kind in known)]


CLOCK_START = "_ZN4heli3due5clock5startEv"
PWM_START = "_ZN4heli3due6motors5startEv"
CUT = "_ZN4heli3due6motors3cutEv"
PORTS = {"A": 0x400E_0E00, "B": 0x400E_1000, "C": 0x400E_1200, "D": 0x400E_1400}
PIO_PSR, PIO_OSR, PIO_ODSR, PIO_IMR, PIO_PUSR, PIO_ABSR = 0x08, 0x18, 0x38, 0x48, 0x68, 0x70
UART_PINS = ("PA8", "PA9")
DECODER_PINS = ("PB25", "PB27", "PC25", "PC26")
EDGE_PINS = ("PD0", "PD1")

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
