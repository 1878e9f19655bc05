"""Watchdog, reset line, software reset, and what survives them (sections 14, 15, 17)."""

from __future__ import annotations

import pytest
from due_emulator import Due, Stop

from tests.due.chip import RAM, Chip

pytestmark = pytest.mark.emulated

RSTEN, PROCESSOR_ONLY, DISABLE, IDLE_HALT = 1 << 13, 1 << 14, 1 << 15, 1 << 29
RESTART = 0xA500_0001


def chip_with_watchdog(value: int, *, window: int = 0xFFF, slow_Hz: int = 32_000, more: int = 0) -> Chip:
    """A chip whose watchdog fires after `value` + 1 periods of 128 cycles of the slow clock."""
    chip = Chip()
    chip.due.set_slow_clock(slow_Hz)
    chip["WDT.MR"] = value | window << 16 | RSTEN | more
    return chip


@pytest.mark.parametrize("slow_Hz", [20_000, 32_000, 44_000])
def test_the_watchdog_fires_after_its_periods_whatever_its_clock(slow_Hz: int) -> None:
    chip = chip_with_watchdog(26, slow_Hz=slow_Hz)
    expected_us = 27 * 128 / slow_Hz * 1e6
    chip.due.run_us(expected_us - 20)
    assert chip.due.resets == 1
    chip.due.run_us(40)
    assert (chip.due.resets, chip.due.last_reset) == (2, "watchdog")
    assert 78e3 < expected_us < 173e3


def test_restarts_hold_it_off() -> None:
    chip = chip_with_watchdog(26)
    for _ in range(20):
        chip.due.run_us(50_000)
        chip["WDT.CR"] = RESTART
    assert chip.due.resets == 1


def test_a_restart_before_the_window_is_an_error() -> None:
    chip = chip_with_watchdog(100, window=50)
    chip.due.run_us(50_000)
    chip["WDT.CR"] = RESTART
    chip.due.run_us(1)
    assert chip.due.last_reset == "watchdog"


def test_without_reset_enable_it_only_reports() -> None:
    chip = Chip()
    chip["WDT.MR"] = 26 | 0xFFF << 16
    chip.due.run_us(110_000)
    assert chip.due.resets == 1
    assert chip["WDT.SR"] == 1
    assert chip["WDT.SR"] == 0


def test_it_can_stand_still_while_the_processor_sleeps() -> None:
    chip = chip_with_watchdog(26, more=IDLE_HALT)
    chip.due.run_us(1_000_000)
    assert chip.due.resets == 1


def test_it_runs_from_reset_on() -> None:
    chip = Chip(full_speed=False)
    assert chip["WDT.MR"] == 0x3FFF_2FFF


def test_its_mode_is_written_once() -> None:
    with pytest.raises(Stop, match="second write"):
        chip_with_watchdog(26)["WDT.MR"] = DISABLE


def test_its_key_is_needed() -> None:
    with pytest.raises(Stop, match="key 0xA5"):
        chip_with_watchdog(26)["WDT.CR"] = 1


def test_the_reset_line_resets_everything_but_memory_and_backup_registers() -> None:
    chip = Chip("PWM")
    chip["GPBR.GPBR3"] = 0x1234_5678
    chip.due.poke(RAM, b"kept")
    chip.due.set_nrst(True)
    chip.due.run_us(1000)
    assert chip.due.held_in_reset
    chip.due.set_nrst(False)
    chip.due.run_us(200)
    assert not chip.due.held_in_reset
    assert chip.due.last_reset == "user"
    assert chip["RSTC.SR"] >> 8 & 7 == 4
    assert chip["PMC.PCSR1"] == 0
    assert chip["GPBR.GPBR3"] == 0x1234_5678
    assert chip.due.peek(RAM, 4) == b"kept"


def test_power_loss_forgets_memory_and_backup_registers() -> None:
    chip = Chip()
    chip["GPBR.GPBR3"] = 1
    chip.due.poke(RAM, b"kept")
    chip.due.power_off()
    chip.power_on()
    assert chip["GPBR.GPBR3"] == 0
    assert chip.due.peek(RAM, 4) != b"kept"
    assert chip["RSTC.SR"] >> 8 & 7 == 0


def test_software_can_reset_the_chip() -> None:
    chip = Chip()
    chip["RSTC.CR"] = 0xA500_0005
    chip.due.run_us(200)
    assert chip["RSTC.SR"] >> 8 & 7 == 3
    assert chip.due.mck_Hz == 4_000_000


def test_an_erased_chip_stays_in_its_rom_with_inputs_only() -> None:
    due = Due()
    due.set_pin("PB26", "pull-down")
    due.power_on()
    due.run_us(10_000)
    assert due.in_rom
    assert not due.pin("PB26")
