"""PIO: pull-ups, drivers, edges, and wires with two masters (section 31)."""

from __future__ import annotations

import pytest
from due_chip import Chip
from due_emulator import Stop

pytestmark = pytest.mark.emulated

D2 = 1 << 25


def test_pull_ups_are_on_after_reset() -> None:
    chip = Chip("PIOC", full_speed=False)
    assert chip["PIOC.PUSR"] == 0
    assert chip["PIOC.PSR"] == 0xFFFF_FFFF
    assert chip.due.pin("PC21")
    chip["PIOC.PUDR"] = 1 << 21
    assert not chip.due.pin("PC21")


def test_external_pull_down_beats_the_chips_pull_up() -> None:
    chip = Chip(full_speed=False)
    for pin in ("PB26", "PA14", "PA15", "PD3"):
        assert chip.due.pin(pin)
        chip.due.set_pin(pin, "pull-down")
        assert not chip.due.pin(pin)


def test_output_register_pair_and_direct_writes() -> None:
    chip = Chip("PIOB")
    chip["PIOB.OER"] = 3 << 12
    chip["PIOB.SODR"] = 1 << 12
    assert chip["PIOB.ODSR"] == 1 << 12
    assert chip["PIOB.PDSR"] >> 12 & 3 == 1
    chip["PIOB.OWER"] = 1 << 13
    chip["PIOB.ODSR"] = 1 << 13
    assert chip["PIOB.ODSR"] == 3 << 12


def test_open_drain_only_pulls_low() -> None:
    chip = Chip("PIOB")
    chip["PIOB.MDER"] = chip["PIOB.OER"] = 1 << 12
    chip["PIOB.SODR"] = 1 << 12
    chip.due.set_pin("PB12", "low")
    assert not chip.due.pin("PB12")


@pytest.mark.parametrize(
    ("setup", "levels", "seen"),
    [
        ((), ("low", "high"), True),
        ((), ("high", "low"), True),
        (("AIMER", "ESR", "REHLSR"), ("low", "high"), True),
        (("AIMER", "ESR", "REHLSR"), ("high", "low"), False),
        (("AIMER", "ESR", "FELLSR"), ("high", "low"), True),
        (("AIMER", "LSR", "FELLSR"), ("high", "low"), True),
        (("AIMER", "LSR", "REHLSR"), ("low", "high"), True),
        (("AIMER", "LSR", "FELLSR"), ("high", "high"), False),
    ],
)
def test_interrupts_on_edges_and_levels(setup: tuple[str, ...], levels: tuple[str, str], seen: bool) -> None:
    chip = Chip("PIOD")
    chip.due.set_pin("PD2", levels[0])
    for register in setup:
        chip[f"PIOD.{register}"] = 1 << 2
    assert chip["PIOD.ISR"] >= 0
    chip["PIOD.IER"] = 1 << 2
    chip.due.set_pin("PD2", levels[1])
    assert (chip.due.read_word(0xE000E200) >> 14 & 1) == seen
    assert bool(chip["PIOD.ISR"] & 1 << 2) is seen


def test_reading_pins_needs_the_clock_and_setting_them_does_not() -> None:
    chip = Chip()
    chip["PIOB.OER"] = 1
    with pytest.raises(Stop, match=r"unclocked: read of PIOB PIO_PDSR .* clock 12 is off"):
        assert chip["PIOB.PDSR"]


def test_two_drivers_on_one_pin_are_noticed() -> None:
    chip = Chip("PIOB")
    chip.due.set_pin("PB12", "high")
    with pytest.raises(Stop, match="contention: pin PB12"):
        chip["PIOB.OER"] = 1 << 12


def test_D4_and_PA29_are_one_wire() -> None:
    chip = Chip("PIOA", "PIOC")
    chip.due.set_pin("PC26", "low")
    chip["PIOA.SODR"] = 1 << 29
    with pytest.raises(Stop, match="contention"):
        chip["PIOA.OER"] = 1 << 29
