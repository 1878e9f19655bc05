"""Oscillators, PLLA and the master clock (datasheet, section 28)."""

from __future__ import annotations

import pytest
from heli_sim.due._due import Stop

from tests.due.chip import FULL_HZ, Chip

MOR_KEY = 0x37 << 16


def test_the_chip_starts_on_its_4_MHz_oscillator() -> None:
    assert Chip(full_speed=False).due.mck_Hz == 4_000_000


def test_the_documented_sequence_reaches_84_MHz() -> None:
    assert Chip().due.mck_Hz == FULL_HZ


def test_84_MHz_needs_four_flash_wait_states() -> None:
    chip = Chip()
    chip["PMC.MCKR"] = 1 << 4 | 1
    chip.wait("PMC.SR", 1 << 3)
    chip["EFC0.FMR"] = 3 << 8
    chip.due.run_us(1)
    with pytest.raises(Stop, match="flash wait states than FWS = 3"):
        chip["PMC.MCKR"] = 1 << 4 | 2


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
