"""Counts of the hardware decoder against the sum of the steps (section 36.6.14)."""

from __future__ import annotations

import random

import pytest

from tests.due.chip import Chip

pytestmark = pytest.mark.emulated

QDEN, POSEN, EDGPHA, INVA, SWAP, FILTER = 1 << 8, 1 << 9, 1 << 12, 1 << 13, 1 << 16, 1 << 19
X4 = QDEN | POSEN | EDGPHA
DIRCHG, QERR, DIR = 1 << 1, 1 << 2, 1 << 8


XC0, SLOW = 5 | 1 << 8 | 1 << 10, 4


def encoders(chip: Chip) -> Chip:
    """The chip with encoder 0 at the decoder of TC0 and encoder 1 at that of TC2."""
    chip.due.attach_encoder("PB25", "PB27")
    chip.due.attach_encoder("PC25", "PC26")
    return chip


def decoder(mode: int, *, block: str = "TC0", maxfilt: int = 0) -> Chip:
    """A decoder at 0 that counts from its first step on: an edge of the slow clock takes the trigger."""
    chip = encoders(Chip(block))
    chip[f"{block}.CMR0"] = SLOW
    chip[f"{block}.BMR"] = mode | maxfilt << 20
    chip[f"{block}.CCR0"] = 5
    chip.due.run_us(32)
    chip[f"{block}.CMR0"] = XC0
    assert chip[f"{block}.CV0"] == 0
    return chip


def walk(chip: Chip, encoder: int, steps: list[int], cycles: int = 200) -> None:
    for step in steps:
        chip.due.set_encoder(encoder, chip.due.encoder(encoder) + step)
        chip.run_cycles(cycles)


def signed(value: int) -> int:
    return value - (1 << 32) if value >> 31 else value


@pytest.mark.parametrize(("block", "encoder"), [("TC0", 0), ("TC2", 1)])
@pytest.mark.parametrize("mode", [X4, X4 | FILTER | 15 << 20])
def test_count_is_the_sum_of_all_steps(block: str, encoder: int, mode: int) -> None:
    chip = decoder(mode, block=block)
    rng = random.Random(3)
    steps = [direction for _ in range(60) for direction in [rng.choice([-1, 1])] * rng.randint(1, 30)]
    walk(chip, encoder, steps)
    assert signed(chip[f"{block}.CV0"]) == sum(steps)
    assert chip[f"{block}.QISR"] & QERR == 0


@pytest.mark.parametrize("direction", [1, -1])
def test_a_trigger_costs_the_first_step(direction: int) -> None:
    chip = encoders(Chip("TC0"))
    chip["TC0.CMR0"] = XC0
    chip["TC0.BMR"] = X4
    chip["TC0.CCR0"] = 5
    walk(chip, 0, [direction] * 10)
    assert signed(chip["TC0.CV0"]) == 9 * direction
    chip["TC0.CCR0"] = 4
    assert signed(chip["TC0.CV0"]) == 9 * direction
    walk(chip, 0, [direction])
    assert chip["TC0.CV0"] == 0


def test_edges_of_one_phase_alone_give_half() -> None:
    chip = decoder(QDEN | POSEN)
    walk(chip, 0, [1] * 400)
    assert chip["TC0.CV0"] == 200


@pytest.mark.parametrize("mode", [INVA, SWAP])
def test_inverting_or_swapping_turns_the_direction(mode: int) -> None:
    chip = decoder(X4 | mode)
    walk(chip, 0, [1] * 100)
    assert signed(chip["TC0.CV0"]) == -100


def test_vibration_on_one_edge_adds_up_to_nothing() -> None:
    chip = decoder(X4)
    walk(chip, 0, [1, -1] * 100)
    assert chip["TC0.CV0"] == 0


def test_direction_is_reported() -> None:
    chip = decoder(X4)
    walk(chip, 0, [1] * 8)
    assert chip["TC0.QISR"] & DIR == 0
    walk(chip, 0, [-1] * 8)
    assert chip["TC0.QISR"] & (DIR | DIRCHG) == DIR | DIRCHG
    assert chip["TC0.QISR"] & DIRCHG == 0


def test_both_phases_at_once_are_an_error() -> None:
    chip = decoder(X4)
    walk(chip, 0, [1] * 4)
    chip.due.glitch_encoder(0)
    assert chip["TC0.QISR"] & QERR
    assert chip["TC0.QISR"] & QERR == 0


@pytest.mark.parametrize(("cycles", "counted"), [(8, False), (30, True)])
def test_the_filter_drops_pulses_up_to_its_length(cycles: int, counted: bool) -> None:
    chip = decoder(X4 | FILTER, maxfilt=15)
    walk(chip, 0, [1], cycles)
    assert (chip["TC0.CV0"] == 1) is counted
    walk(chip, 0, [-1], 100)
    assert chip["TC0.CV0"] == 0


def test_edges_closer_than_the_filter_are_an_error() -> None:
    chip = decoder(X4 | FILTER, maxfilt=30)
    walk(chip, 0, [1, 1], 10)
    chip.run_cycles(100)
    assert chip["TC0.QISR"] & QERR


def test_edges_are_counted_at_200000_a_second() -> None:
    chip = decoder(X4 | FILTER, maxfilt=15)
    start_us = chip.due.now_us
    for i in range(20_000):
        chip.due.schedule_step(0, 1, start_us + 5.0 * (i + 1))
    chip.due.run_us(100_010)
    assert chip["TC0.CV0"] == 20_000


def test_nothing_counts_without_its_clock() -> None:
    chip = decoder(X4)
    chip["PMC.PCDR0"] = 1 << 27
    walk(chip, 0, [1] * 10)
    chip.clock("TC0")
    assert chip["TC0.CV0"] == 0
