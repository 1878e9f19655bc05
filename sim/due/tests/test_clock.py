"""Oscillators, PLLA, watchdog, resets, timer counters, quadrature decoder (sections 14 to 17, 28, 36)."""

import random

import pytest
from due_chip import (
    CSS_MAIN,
    CSS_PLLA,
    FULL_HZ,
    LOCKA,
    MCKRDY,
    MOR_KEY,
    MOSCRCEN,
    MOSCSEL,
    MOSCXTEN,
    MOSCXTS,
    PLLAR_ONE,
    PRES_2,
    RAM,
    Chip,
)
from due_emulator import Due, Stop

pytestmark = pytest.mark.emulated


def test_the_chip_starts_on_its_4_MHz_oscillator() -> None:
    assert Chip(full_speed=False).due.mck_Hz == 4_000_000


def test_the_documented_sequence_reaches_84_MHz() -> None:
    assert Chip().due.mck_Hz == FULL_HZ


@pytest.mark.parametrize("bank", ["EFC0", "EFC1"])
def test_84_MHz_needs_four_flash_wait_states_of_both_banks(bank: str) -> None:
    chip = Chip()
    chip["PMC.MCKR"] = PRES_2 | CSS_MAIN
    chip.wait("PMC.SR", MCKRDY)
    chip[f"{bank}.FMR"] = 3 << 8
    chip.due.run_us(1)
    with pytest.raises(Stop, match=f"flash wait states than FWS = 3 of {bank}"):
        chip["PMC.MCKR"] = PRES_2 | CSS_PLLA


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
        chip["PMC.MOR"] = MOR_KEY | 8 << 8 | MOSCRCEN | MOSCXTEN
        chip.wait("PMC.SR", MOSCXTS)
        chip["PMC.MOR"] = MOR_KEY | MOSCSEL | 8 << 8 | MOSCRCEN | MOSCXTEN
        chip["PMC.PLLAR"] = PLLAR_ONE | mula << 16 | 0x3F << 8 | 1
        chip.wait("PMC.SR", LOCKA)
        chip["PMC.MCKR"] = PRES_2 | CSS_MAIN
        chip.wait("PMC.SR", MCKRDY)
        chip["EFC0.FMR"] = chip["EFC1.FMR"] = wait_states << 8
        if wait_states < least:
            with pytest.raises(Stop, match="needs more flash wait states"):
                chip["PMC.MCKR"] = PRES_2 | CSS_PLLA
        else:
            chip["PMC.MCKR"] = PRES_2 | CSS_PLLA
            assert chip.due.mck_Hz == mck_Hz


@pytest.mark.parametrize(
    ("register", "value", "message"),
    [
        ("PMC.MOR", 1 << 3, "key 0x37"),
        ("PMC.MOR", MOR_KEY | MOSCSEL | MOSCRCEN | MOSCXTEN, "before PMC_SR.MOSCXTS"),
        ("PMC.PLLAR", 13 << 16 | 1, "bit 29"),
        ("PMC.PLLAR", PLLAR_ONE | 60 << 16 | 0x3F << 8 | 1, "outside of 84 to 192 MHz"),
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
    chip["PMC.MOR"] = MOR_KEY | counts << 8 | MOSCRCEN | MOSCXTEN
    chip.wait("PMC.SR", MOSCXTS)
    with pytest.raises(Stop, match=r"MOSCXTST is too short: the crystal needs 1\.4 ms"):
        chip["PMC.MOR"] = MOR_KEY | MOSCSEL | counts << 8 | MOSCRCEN | MOSCXTEN


@pytest.mark.parametrize("counts", [0, 5])
def test_a_pll_that_is_said_to_be_locked_before_it_can_is_noticed(counts: int) -> None:
    chip = Chip()
    chip["PMC.MCKR"] = PRES_2 | CSS_MAIN
    chip.wait("PMC.SR", MCKRDY)
    chip["PMC.PLLAR"] = PLLAR_ONE | 13 << 16 | counts << 8 | 1
    chip.wait("PMC.SR", LOCKA)
    with pytest.raises(Stop, match=r"PLLACOUNT is too short: PLLA needs 0\.2 ms"):
        chip["PMC.MCKR"] = PRES_2 | CSS_PLLA


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
    chip[f"{block}.CCR0"] = CLKEN | SWTRG
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
@pytest.mark.parametrize(("mode", "maxfilt"), [(X4, 0), (X4 | FILTER, 15)])
def test_count_is_the_sum_of_all_steps(block: str, encoder: int, mode: int, maxfilt: int) -> None:
    chip = decoder(mode, block=block, maxfilt=maxfilt)
    rng = random.Random(3)
    steps: list[int] = []
    for _ in range(60):
        direction = rng.choice([-1, 1])
        steps += [direction] * rng.randint(1, 30)
    walk(chip, encoder, steps)
    assert signed(chip[f"{block}.CV0"]) == sum(steps)
    assert chip[f"{block}.QISR"] & QERR == 0


@pytest.mark.parametrize("direction", [1, -1])
def test_a_trigger_costs_the_first_step(direction: int) -> None:
    chip = encoders(Chip("TC0"))
    chip["TC0.CMR0"] = XC0
    chip["TC0.BMR"] = X4
    chip["TC0.CCR0"] = CLKEN | SWTRG
    walk(chip, 0, [direction] * 10)
    assert signed(chip["TC0.CV0"]) == 9 * direction
    chip["TC0.CCR0"] = SWTRG
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
