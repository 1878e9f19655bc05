"""UPLL and the USB port with no cable in it: what a program needs that opens it and talks elsewhere."""

from __future__ import annotations

import pytest
from due_emulator import Stop

from tests.due.chip import Chip

pytestmark = pytest.mark.emulated

UPLLEN, LOCKU, UOTGCLK = 1 << 16, 1 << 6, 1 << 5
USBE, CLKUSABLE = 1 << 15, 1 << 14


@pytest.mark.parametrize("count", [1, 3, 15])
def test_UPLL_locks_after_eight_slow_periods_for_each_count(count: int) -> None:
    chip = Chip()
    chip["PMC.UCKR"] = count << 20 | UPLLEN
    assert chip["PMC.UCKR"] == count << 20 | UPLLEN
    lock_us = 8 * count / 32_000 * 1e6
    chip.due.run_us(lock_us - 5)
    assert chip["PMC.SR"] & LOCKU == 0
    chip.due.run_us(50)
    assert chip["PMC.SR"] & LOCKU
    chip["PMC.UCKR"] = count << 20
    assert chip["PMC.SR"] & LOCKU == 0


def test_the_usb_clock_is_shown_once_it_runs() -> None:
    chip = Chip()
    chip["PMC.UCKR"] = 3 << 20 | UPLLEN
    chip.wait("PMC.SR", LOCKU)
    chip["PMC.USB"] = 1
    assert chip["PMC.SCSR"] == 1
    chip["PMC.SCER"] = UOTGCLK
    assert chip["PMC.SCSR"] == UOTGCLK | 1
    with pytest.raises(Stop, match="UPLL is switched off while the USB clock runs from it"):
        chip["PMC.UCKR"] = 0
    chip["PMC.SCDR"] = UOTGCLK
    assert chip["PMC.SCSR"] == 1
    chip["PMC.UCKR"] = 0


def test_UPLL_needs_the_crystal() -> None:
    with pytest.raises(Stop, match="before the 12 MHz crystal runs"):
        Chip(full_speed=False)["PMC.UCKR"] = 3 << 20 | UPLLEN


def test_the_usb_clock_waits_for_the_lock_of_its_source() -> None:
    chip = Chip()
    chip["PMC.USB"] = 1
    chip["PMC.UCKR"] = 3 << 20 | UPLLEN
    with pytest.raises(Stop, match=r"before PMC_SR\.LOCKU says that UPLL"):
        chip["PMC.SCER"] = UOTGCLK


def test_a_lock_of_UPLL_that_is_said_too_early_is_noticed() -> None:
    chip = Chip()
    chip["PMC.USB"] = 1
    chip["PMC.UCKR"] = UPLLEN
    chip.wait("PMC.SR", LOCKU)
    with pytest.raises(Stop, match=r"UPLLCOUNT is too short: UPLL needs 0\.1 ms"):
        chip["PMC.SCER"] = UOTGCLK


def test_the_ports_clock_is_usable_with_UPLL_and_the_port_on() -> None:
    chip = Chip()
    chip["PMC.PCER1"] = 1 << 8
    for upll in (False, True):
        if upll:
            chip["PMC.UCKR"] = 3 << 20 | UPLLEN
            chip.wait("PMC.SR", LOCKU)
        for enabled in (0, USBE):
            chip["UOTGHS.CTRL"] = enabled
            assert bool(chip["UOTGHS.SR"] & CLKUSABLE) is (upll and enabled == USBE)


def test_masks_and_switches_of_the_port_are_kept() -> None:
    chip = Chip()
    chip["PMC.PCER1"] = 1 << 8
    chip["UOTGHS.DEVIER"] = 0x1C
    chip["UOTGHS.DEVIDR"] = 0x04
    assert chip["UOTGHS.DEVIMR"] == 0x18
    chip["UOTGHS.DEVCTRL"] = 0
    assert chip["UOTGHS.DEVCTRL"] == 0
    with pytest.raises(Stop, match=r"UOTGHS_DEVEPTCFG0 .*not modelled"):
        chip["UOTGHS.DEVEPTCFG0"] = 1
