"""Strict mode says what, where and who; lenient mode warns once, and ends a program that waits in vain."""

import struct
import subprocess
import sys
from pathlib import Path

import pytest
from due_chip import FLASH, Build, Chip
from due_emulator import Due, Stop, new_due, read_image

pytestmark = pytest.mark.emulated

CODE = FLASH + 0x100


def program(*halfwords: int, literals: tuple[int, ...] = ()) -> bytes:
    """Vectors, then code, then literals at CODE + 32."""
    vectors = struct.pack("<II", 0x2008_8000, CODE | 1).ljust(0x100, b"\0")
    code = b"".join(struct.pack("<H", word) for word in halfwords).ljust(32, b"\0")
    return vectors + code + b"".join(struct.pack("<I", word) for word in literals)


def loading(address: int) -> bytes:
    """Ldr r0, =address; ldr r1, [r0]; nop; b ."""
    return program(0x4807, 0x6801, 0xBF00, 0xE7FE, literals=(address,))


def storing(address: int, store: int = 0x6001) -> bytes:
    """Ldr r0, =address; str r1, [r0]; nop; b ."""
    return program(0x4807, store, 0xBF00, 0xE7FE, literals=(address,))


def booted(data: bytes, *, strict: bool = True) -> Due:
    due = Due()
    due.set_strict(strict)
    due.load(FLASH, data)
    due.add_symbol(CODE, 32, "_ZN5motor4pushEv")
    due.power_on()
    return due


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (loading(0x400E_0640), r"unmodelled: read of PMC PMC_PCK0 \(0x400e0640\): not modelled"),
        (loading(0x4000_8010), r"unmodelled: read of 0x40008010 SPI0\+0x10: this peripheral is not modelled"),
        (loading(0x400E_1A38), r"unmodelled: read of 0x400e1a38 RTT\+0x8: this peripheral is not modelled"),
        (storing(0x400E_1A10), r"unmodelled: write of 0x400e1a10 SUPC\+0x0: this peripheral is not modelled"),
        (loading(0x400E_070C), r"unmodelled: read of PMC PMC_PCR \(0x400e070c\): not modelled"),
        (
            loading(0x4009_400C),
            r"unclocked: read of PWM PWM_SR \(0x4009400c\) while peripheral clock 36 is off",
        ),
        (loading(0x400E_1A00), r"direction: read of RSTC RSTC_CR \(0x400e1a00\), which is write-only"),
        (storing(0x400E_1A04), r"direction: write of RSTC RSTC_SR \(0x400e1a04\), which is read-only"),
        (loading(0x400E_060C), r"unmodelled: read of PMC 0x400e060c: there is no register"),
        (loading(0x6000_0000), "unmapped: read of 0x60000000, where there is nothing"),
        (loading(0x2007_0001), "unaligned: read of 4 bytes from 0x20070001"),
        (storing(0x400E_0E30, 0x7001), "narrow: write of 1 bytes to 0x400e0e30"),
        (loading(0xE000_ED94), "unmodelled: read of 0xe000ed94 in the private peripheral bus"),
        (program(0x4807, 0x4700, literals=(0x3000_0001,)), "unmapped: instruction fetch from 0x30000000"),
    ],
)
def test_a_mistake_stops_with_its_name_and_place(data: bytes, message: str) -> None:
    due = booted(data)
    with pytest.raises(Stop, match=message) as stopped:
        due.run_us(1000)
    if "fetch" not in message:
        assert str(stopped.value).endswith("at pc 0x00080102 in motor::push()+0x2")


def test_lenient_mode_warns_once_for_each_place() -> None:
    # ldr r0, =address; ldr r1, [r0]; b back to the load
    due = booted(program(0x4807, 0x6801, 0xE7FD, literals=(0x4000_8010,)), strict=False)
    due.run_us(1000)
    warnings = due.take_warnings()
    assert len(warnings) == 1
    assert "SPI0+0x10" in warnings[0]
    assert due.take_warnings() == []


def test_lenient_mode_delivers_the_bus_fault() -> None:
    due = booted(loading(0x6000_0000), strict=False)
    due.stop_at_hardfault(True)
    due.run_us(1000)
    assert due.halt == "hardfault"
    assert due.bfar == 0x6000_0000
    assert due.reg(15) == CODE + 2


def test_one_check_can_be_switched_off_alone() -> None:
    due = booted(loading(0x2007_0001))
    due.set_check("unaligned", False)
    due.run_us(1000)
    assert due.reg(15) == CODE + 6


def test_sram0_repeats_below_itself_and_strict_mode_wants_nobody_there() -> None:
    address = 0x2006_FFFC
    with pytest.raises(Stop, match="access to 0x2006fffc, where SRAM0 only repeats"):
        booted(storing(address, 0x6000)).run_us(1000)
    due = booted(storing(address, 0x6000), strict=False)
    due.run_us(1000)
    assert due.peek(address + 0x1_0000, 4) == struct.pack("<I", address)


def test_a_locked_up_processor_waits_for_the_watchdog_once_the_check_is_off() -> None:
    # An undefined instruction, and a vector of HardFault that leads nowhere.
    due = booted(program(0xDE00))
    due.set_strict(False)
    with pytest.raises(Stop, match="lockup"):
        due.run_us(1000)
    due = booted(program(0xDE00))
    due.set_strict(False)
    due.set_check("lockup", False)
    due.run_us(17_000_000)
    assert (due.resets, due.last_reset) == (2, "watchdog")


def test_a_clock_switched_off_makes_a_register_an_error_again() -> None:
    chip = Chip("UART")
    assert chip["UART.MR"] == 0
    chip["PMC.PCDR0"] = 1 << 8
    with pytest.raises(Stop, match="unclocked: read of UART UART_MR"):
        assert chip["UART.MR"]


SPI0_SR, PMC_SR, UART_SR, PIOA_PDSR, TC2_CV0 = 0x4000_8010, 0x400E_0668, 0x400E_0814, 0x400E_0E3C, 0x4008_8010
WDT_CR = 0x400E_1A50
# ldr r0, =register, before a loop that begins at its load
LOAD_ADDRESS = 0x4807
TST_BEQ = (0x6801, 0x4A07, 0x4211, 0xD0FB)  # ldr r1, [r0]; ldr r2, =mask; tst r1, r2; beq
ENDLESS = 0xE7FE


def waiting(register: int, mask: int, *, strict: bool = False) -> Due:
    code = program(LOAD_ADDRESS, *TST_BEQ, ENDLESS, literals=(register, mask))
    return booted(code, strict=strict)


def test_register_bit_and_place_are_reported_after_half_a_second() -> None:
    due = waiting(SPI0_SR, 1 << 9)
    due.run_us(499_000)
    with pytest.raises(Stop) as stopped:
        due.run_us(50_000)
    assert str(stopped.value) == (
        "wait: for 0.5 s a loop has read 0x40008010 SPI0+0x10, which stays 0x00000000: the program waits for "
        "its bit 9; at pc 0x00080102 in motor::push()+0x2"
    )
    assert due.now_us == pytest.approx(510_000, abs=11_000)


def test_a_modelled_register_that_nothing_changes_is_named() -> None:
    with pytest.raises(Stop, match=r"read PMC PMC_SR \(0x400e0668\), .*waits for one of its bits 1, 6;"):
        waiting(PMC_SR, 1 << 6 | 1 << 1).run_us(600_000)


def test_a_register_that_must_be_two_things_is_reported_without_a_bit() -> None:
    # bics r2, r1 leaves what is missing; back unless that is nothing
    code = program(LOAD_ADDRESS, 0x6801, 0x4A07, 0x438A, 0xD1FB, ENDLESS, literals=(PMC_SR, 1 << 6 | 1 << 1))
    with pytest.raises(Stop, match="the program waits for no single bit of it"):
        booted(code, strict=False).run_us(600_000)


@pytest.mark.parametrize(
    ("register", "mask"),
    [
        (UART_SR, 1),  # a byte may come
        (PIOA_PDSR, 1 << 3),  # a pin may change
    ],
)
def test_waiting_for_the_world_outside_is_no_hang(register: int, mask: int) -> None:
    due = waiting(register, mask)
    due.set_pin("PA3", "low")
    due.write_word(0x400E_0610, 1 << 8 | 1 << 11)
    due.run_us(1_200_000)


def test_waiting_for_the_uarts_own_flags_is_a_hang() -> None:
    # The transmitter was never switched on.
    due = waiting(UART_SR, 1 << 1)
    due.write_word(0x400E_0610, 1 << 8)
    with pytest.raises(Stop, match=r"UART_SR .*its bit 1;"):
        due.run_us(600_000)


def test_a_register_that_changes_is_no_hang() -> None:
    # Channel 0 of TC2 counts the slow clock.
    due = waiting(TC2_CV0, 1 << 31)
    due.write_word(0x400E_0700, 1 << 1)
    due.write_word(0x4008_8004, 4)
    due.write_word(0x4008_8000, 5)
    due.run_us(1_200_000)


@pytest.mark.parametrize("rest", [(ENDLESS,), (0xBF30, 0xE7FD)])
def test_a_program_that_is_past_its_loop_is_left_alone(rest: tuple[int, ...]) -> None:
    # ldr r1, [r0], then nothing but a branch to itself, or sleep without an alarm
    due = booted(program(LOAD_ADDRESS, 0x6801, *rest, literals=(SPI0_SR,)), strict=False)
    for _ in range(12):
        due.run_us(100_000)
    assert due.now_us == pytest.approx(1_200_000, abs=10)


def test_a_loop_that_does_something_is_no_hang() -> None:
    # ldr r1, [r0]; str r1, [r0]; b: a register is read and written
    code = program(LOAD_ADDRESS, 0x6801, 0x6001, 0xE7FC, literals=(SPI0_SR,))
    booted(code, strict=False).run_us(1_200_000)


def test_keeping_the_watchdog_quiet_is_not_doing_something() -> None:
    # ldr r3, =WDT_CR; ldr r4, =key; then ldr r1, [r0]; str r4, [r3]; tst r1, r2; beq
    instructions = (0x4A08, 0x4B08, 0x4C09, 0x6801, 0x601C, 0x4211, 0xD0FB, ENDLESS)
    code = program(LOAD_ADDRESS, *instructions, literals=(SPI0_SR, 4, WDT_CR, 0xA500_0001))
    with pytest.raises(Stop, match="its bit 2;"):
        booted(code, strict=False).run_us(600_000)


def test_strict_mode_waits_as_long_as_it_is_run() -> None:
    waiting(PMC_SR, 1 << 6, strict=True).run_us(1_200_000)


@pytest.fixture(scope="module")
def stuck(build: Build) -> dict[str, Path]:
    return {option: build("stuck.c", option) for option in ("-O0", "-Os", "-O2")}


def test_looking_ahead_leaves_everything_as_it_was(stuck: dict[str, Path]) -> None:
    image = read_image(stuck["-Os"])
    stopped, other = new_due(image, strict=False), new_due(image, strict=False)
    other.set_check("wait", False)
    for due in (stopped, other):
        due.power_on()
    with pytest.raises(Stop):
        stopped.run_us(700_000)
    while other.cycles < stopped.cycles:
        other.run_us(100) if other.cycles + 1000 < stopped.cycles else other.step()
    for due in (stopped, other):
        assert due.read_word(image.address("tries")) > 10_000
    for step in range(200):
        state = [
            (due.cycles, *(due.reg(i) for i in range(16)), due.xpsr, due.peek(0x2007_0000, 0x18000))
            for due in (stopped, other)
        ]
        assert state[0] == state[1], f"after {step} steps"
        for due in (stopped, other):
            due.step()


@pytest.mark.parametrize("option", ["-O0", "-Os", "-O2"])
def test_a_compiled_wait_is_found_under_a_running_systick(stuck: dict[str, Path], option: str) -> None:
    due = new_due(read_image(stuck[option]), strict=False)
    due.power_on()
    with pytest.raises(Stop, match=r"read 0x40008010 SPI0\+0x10, .*its bit 1; at pc .* in "):
        due.run_us(700_000)


def test_the_command_line_says_it_and_ends_with_4(stuck: dict[str, Path]) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "due_emulator", str(stuck["-Os"]), "--lenient", "--seconds", "2"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert result.returncode == 4, result.stderr
    assert "SPI0+0x10, which stays 0x00000000: the program waits for its bit 1" in result.stderr
