"""Oscillators, PLLA, master clock, watchdog and resets (datasheet, sections 14 to 17 and 28)."""

from __future__ import annotations

import pytest
from due_chip import FULL_HZ, RAM, Chip
from due_emulator import Due, Stop

pytestmark = pytest.mark.emulated

MOR_KEY = 0x37 << 16


def test_the_chip_starts_on_its_4_MHz_oscillator() -> None:
    assert Chip(full_speed=False).due.mck_Hz == 4_000_000


def test_the_documented_sequence_reaches_84_MHz() -> None:
    assert Chip().due.mck_Hz == FULL_HZ


@pytest.mark.parametrize("bank", ["EFC0", "EFC1"])
def test_84_MHz_needs_four_flash_wait_states_of_both_banks(bank: str) -> None:
    chip = Chip()
    chip["PMC.MCKR"] = 1 << 4 | 1
    chip.wait("PMC.SR", 1 << 3)
    chip[f"{bank}.FMR"] = 3 << 8
    chip.due.run_us(1)
    with pytest.raises(Stop, match=f"flash wait states than FWS = 3 of {bank}"):
        chip["PMC.MCKR"] = 1 << 4 | 2


@pytest.mark.parametrize("bank", ["EFC0", "EFC1"])
@pytest.mark.parametrize("wait_states", [0, 3])
def test_wait_states_cannot_be_taken_away_at_84_MHz(bank: str, wait_states: int) -> None:
    chip = Chip()
    chip[f"{bank}.FMR"] = 6 << 8
    with pytest.raises(Stop, match=f"{wait_states} is too few wait states for 84000000 Hz"):
        chip[f"{bank}.FMR"] = wait_states << 8


# PLLA x (mula + 1) of 12 MHz, divided by two; the vendor's limits are 19, 50, 64, 80 and 90 MHz.
@pytest.mark.parametrize(
    ("mula", "mck_Hz", "least"), [(7, 48e6, 1), (9, 60e6, 2), (12, 78e6, 3), (13, 84e6, 4)]
)
def test_least_wait_states_are_those_of_the_vendors_table(mula: int, mck_Hz: float, least: int) -> None:
    for wait_states in (least - 1, least):
        chip = Chip(full_speed=False)
        chip["PMC.MOR"] = MOR_KEY | 8 << 8 | 1 << 3 | 1
        chip.wait("PMC.SR", 1 << 0)
        chip["PMC.MOR"] = MOR_KEY | 1 << 24 | 8 << 8 | 1 << 3 | 1
        chip["PMC.PLLAR"] = 1 << 29 | mula << 16 | 0x3F << 8 | 1
        chip.wait("PMC.SR", 1 << 1)
        chip["PMC.MCKR"] = 1 << 4 | 1
        chip.wait("PMC.SR", 1 << 3)
        chip["EFC0.FMR"] = chip["EFC1.FMR"] = wait_states << 8
        if wait_states < least:
            with pytest.raises(Stop, match="needs more flash wait states"):
                chip["PMC.MCKR"] = 1 << 4 | 2
        else:
            chip["PMC.MCKR"] = 1 << 4 | 2
            assert chip.due.mck_Hz == mck_Hz


@pytest.mark.parametrize(
    ("register", "value", "message"),
    [
        ("PMC.MOR", 1 << 3, "key 0x37"),
        ("PMC.MOR", MOR_KEY | 1 << 24 | 1 << 3 | 1, "before PMC_SR.MOSCXTS"),
        ("PMC.PLLAR", 13 << 16 | 1, "bit 29"),
        ("PMC.PLLAR", 1 << 29 | 60 << 16 | 0x3F << 8 | 1, "outside of 84 to 192 MHz"),
        ("PMC.MCKR", 2, "before PMC_SR.LOCKA"),
    ],
)
def test_a_forbidden_clock_setting_is_refused(register: str, value: int, message: str) -> None:
    with pytest.raises(Stop, match=message):
        Chip(full_speed=False)[register] = value


def test_board_time_keeps_its_pace_when_the_clock_changes() -> None:
    chip = Chip(full_speed=False)
    before_us = chip.due.now_us
    chip.to_full_speed()
    cycles, now_us = chip.due.cycles, chip.due.now_us
    chip.due.run_us(1000)
    assert chip.due.cycles - cycles == pytest.approx(84_000, abs=2)
    assert chip.due.now_us - now_us == pytest.approx(1000, abs=0.1)
    # The crystal starts in 8 * 8 + 1 periods of the slow clock, PLLA locks in 63 + 1.
    assert now_us - before_us == pytest.approx((65 + 64) / 32000 * 1e6, abs=100)


@pytest.mark.parametrize("counts", [0, 20, 30])
def test_a_crystal_that_is_said_to_run_before_it_can_is_noticed(counts: int) -> None:
    chip = Chip(full_speed=False)
    chip.due.set_slow_clock(8 * counts * 1000 + 16_000)
    chip["PMC.MOR"] = MOR_KEY | counts << 8 | 1 << 3 | 1
    chip.wait("PMC.SR", 1 << 0)
    with pytest.raises(Stop, match=r"MOSCXTST is too short: the crystal needs 1\.4 ms"):
        chip["PMC.MOR"] = MOR_KEY | 1 << 24 | counts << 8 | 1 << 3 | 1


@pytest.mark.parametrize("counts", [0, 5])
def test_a_pll_that_is_said_to_be_locked_before_it_can_is_noticed(counts: int) -> None:
    chip = Chip()
    chip["PMC.MCKR"] = 1 << 4 | 1
    chip.wait("PMC.SR", 1 << 3)
    chip["PMC.PLLAR"] = 1 << 29 | 13 << 16 | counts << 8 | 1
    chip.wait("PMC.SR", 1 << 1)
    with pytest.raises(Stop, match=r"PLLACOUNT is too short: PLLA needs 0\.2 ms"):
        chip["PMC.MCKR"] = 1 << 4 | 2


def test_prescaler_and_source_of_the_master_clock_do_not_change_in_one_write() -> None:
    chip = Chip()
    with pytest.raises(Stop, match="in one write"):
        chip["PMC.MCKR"] = 1


def test_write_protection_is_kept() -> None:
    chip = Chip()
    chip["PMC.WPMR"] = 0x504D43 << 8 | 1
    with pytest.raises(Stop, match="write while write protection is on"):
        chip["PMC.PCER0"] = 1 << 8
    chip["PMC.WPMR"] = 0x504D43 << 8
    chip["PMC.PCER0"] = 1 << 8


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
