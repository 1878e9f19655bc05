"""Oscillators, PLLA and the master clock (datasheet, section 28)."""

from __future__ import annotations

import pytest
from due_emulator import Stop

from tests.due.chip import FULL_HZ, Chip

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
