"""Timer counters and the quadrature decoder, by the datasheet's formulas (section 36)."""

from __future__ import annotations

import random

import pytest
from due_chip import Chip
from due_emulator import Stop

pytestmark = pytest.mark.emulated

CLKEN, CLKDIS, SWTRG = 1, 2, 4
WAVE, UP_RC, UPDOWN_RC = 1 << 15, 2 << 13, 3 << 13
CPAS, CPBS, CPCS, COVFS = 1 << 2, 1 << 3, 1 << 4, 1


def running(mode: int, rc: int, *, ra: int = 0, rb: int = 0) -> Chip:
    chip = Chip("TC1", "TC2", "PIOC")
    chip["TC2.CMR0"] = mode
    if mode & WAVE:
        chip["TC2.RA0"], chip["TC2.RB0"] = ra, rb
    chip["TC2.RC0"] = rc
    chip["TC2.CCR0"] = CLKEN | SWTRG
    return chip


@pytest.mark.parametrize(("clock", "divider"), [(0, 2), (1, 8), (2, 32), (3, 128), (4, 84_000_000 // 32_000)])
def test_the_counter_moves_with_its_clock(clock: int, divider: int) -> None:
    chip = running(clock, 0)
    chip.run_cycles(1000 * divider)
    assert chip["TC2.CV0"] == pytest.approx(1000, abs=3)


@pytest.mark.parametrize("rc", [42, 42_000, 65_536])
def test_rc_compare_repeats_every_rc_steps(rc: int) -> None:
    chip = running(WAVE | UP_RC, rc)
    chip.run_cycles(2 * rc - 20)
    assert chip["TC2.SR0"] & CPCS == 0
    chip.run_cycles(20)
    assert chip["TC2.SR0"] & CPCS
    assert chip["TC2.CV0"] < 10
    chip.run_cycles(4 * rc)
    assert chip["TC2.CV0"] < 20


def test_a_thousand_ticks_a_second_are_a_thousand() -> None:
    chip = running(WAVE | UP_RC, 42_000)
    chip["TC2.IER0"] = CPCS
    count = 0
    for _ in range(2000):
        chip.due.run_us(500)
        count += bool(chip["TC2.SR0"] & CPCS)
    assert count == 1000


def test_outputs_follow_the_compares() -> None:
    # TIOA on PC25: set at RC, cleared at RA; TIOB on PC26 (EEVT = XC0): set at RC, cleared at RB.
    mode = WAVE | UP_RC | 2 << 16 | 1 << 18 | 1 << 10 | 2 << 24 | 1 << 26
    chip = running(mode, 1000, ra=300, rb=700)
    chip["PIOC.ABSR"] = chip["PIOC.PDR"] = 3 << 25
    chip.run_cycles(2000 * 3)
    high = [0, 0]
    for _ in range(2000):
        chip.run_cycles(1)
        high[0] += chip.due.pin("PC25")
        high[1] += chip.due.pin("PC26")
    assert high == [pytest.approx(600, abs=2), pytest.approx(1400, abs=2)]


def test_up_down_counts_a_triangle() -> None:
    chip = running(WAVE | UPDOWN_RC, 1000)
    chip.run_cycles(2 * 1000)
    assert chip["TC2.CV0"] == pytest.approx(1000, abs=5)
    chip.run_cycles(2 * 400)
    assert chip["TC2.CV0"] == pytest.approx(600, abs=10)
    chip.run_cycles(2 * 600)
    assert chip["TC2.CV0"] < 15


@pytest.mark.parametrize(("bit", "clock_on"), [(1 << 6, 1), (1 << 7, 0)])
def test_the_clock_can_stop_at_rc(bit: int, clock_on: int) -> None:
    chip = running(WAVE | UP_RC | bit, 500)
    chip.run_cycles(3000)
    assert chip["TC2.CV0"] == 0
    assert chip["TC2.SR0"] >> 16 & 1 == clock_on


def test_stopping_keeps_the_value_and_a_trigger_clears_it() -> None:
    chip = running(0, 0)
    chip.run_cycles(1000)
    chip["TC2.CCR0"] = CLKDIS
    held = chip["TC2.CV0"]
    chip.run_cycles(1000)
    assert chip["TC2.CV0"] == held > 400
    chip["TC2.CCR0"] = CLKEN | SWTRG
    assert chip["TC2.CV0"] < 10


@pytest.mark.parametrize(("clock", "divider"), [(2, 32), (3, 128)])
def test_a_trigger_clears_the_counter_at_the_next_edge_of_its_clock(clock: int, divider: int) -> None:
    chip = running(clock, 0)
    while chip["TC2.CV0"] < 40:
        chip.run_cycles(1)
    chip["TC2.CCR0"] = SWTRG
    chip.run_cycles(divider // 2)
    assert chip["TC2.CV0"] == 40
    chip.run_cycles(divider // 2)
    assert chip["TC2.CV0"] == 0
    chip.run_cycles(3 * divider)
    assert chip["TC2.CV0"] == 3


def test_the_counter_has_32_bits() -> None:
    chip = running(WAVE | UP_RC, 0xFFFF_FFFF)
    chip.due.run_us(2_000_000)
    assert chip["TC2.CV0"] == pytest.approx(84_000_000, abs=50)


@pytest.mark.parametrize(
    ("register", "value", "message"),
    [
        ("TC2.CMR0", 6, "external clocks"),
        ("TC2.RA0", 1, "read-only in capture mode"),
        ("TC2.BMR", 1 << 8 | 1 << 10, "speed measurement"),
        ("TC2.CMR0", 1 << 16, "captures and triggers by TIOA"),
        ("TC2.CMR0", 1 << 8, "captures and triggers by TIOA"),
        ("TC2.WPMR", 1, r"TC2 TC_WPMR \(0x400880e4\): not modelled"),
    ],
)
def test_what_is_not_modelled_or_wrong_is_refused(register: str, value: int, message: str) -> None:
    with pytest.raises(Stop, match=message):
        running(0, 0)[register] = value


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
