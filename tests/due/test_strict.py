"""Strict mode says what, where and who; lenient mode warns once and goes on."""

from __future__ import annotations

import struct

import pytest
from due_emulator import Due, Stop

from tests.due.chip import FLASH, Chip

pytestmark = pytest.mark.emulated

CODE = FLASH + 0x100


def program(*halfwords: int, literals: tuple[int, ...] = ()) -> bytes:
    """Vectors, then code, then literals at CODE + 32."""
    vectors = struct.pack("<II", 0x2008_8000, CODE | 1).ljust(0x100, b"\0")
    code = b"".join(struct.pack("<H", word) for word in halfwords).ljust(32, b"\0")
    return vectors + code + b"".join(struct.pack("<I", word) for word in literals)


def loading(address: int) -> bytes:
    """ldr r0, =address; ldr r1, [r0]; nop; b ."""
    return program(0x4807, 0x6801, 0xBF00, 0xE7FE, literals=(address,))


def storing(address: int, store: int = 0x6001) -> bytes:
    """ldr r0, =address; str r1, [r0]; nop; b ."""
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
