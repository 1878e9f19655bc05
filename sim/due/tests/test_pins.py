"""PIO and PWM: pull-ups, edges, wires, duty and faults (sections 31 and 38)."""

import pytest
from due_chip import FULL_HZ, Chip
from due_emulator import Stop

pytestmark = pytest.mark.emulated

# Bits of pins in the registers of their controller.
PA29, PB12, PB13, PC21, PD2 = 1 << 29, 1 << 12, 1 << 13, 1 << 21, 1 << 2

D2 = 1 << 25


def test_pull_ups_are_on_after_reset() -> None:
    chip = Chip("PIOC", full_speed=False)
    assert chip["PIOC.PUSR"] == 0
    assert chip["PIOC.PSR"] == 0xFFFF_FFFF
    assert chip.due.pin("PC21")
    chip["PIOC.PUDR"] = PC21
    assert not chip.due.pin("PC21")


def test_external_pull_down_beats_the_chips_pull_up() -> None:
    chip = Chip(full_speed=False)
    for pin in ("PB26", "PA14", "PA15", "PD3"):
        assert chip.due.pin(pin)
        chip.due.set_pin(pin, "pull-down")
        assert not chip.due.pin(pin)


def test_output_register_pair_and_direct_writes() -> None:
    chip = Chip("PIOB")
    chip["PIOB.OER"] = PB12 | PB13
    chip["PIOB.SODR"] = PB12
    assert chip["PIOB.ODSR"] == PB12
    assert chip["PIOB.PDSR"] >> 12 & 3 == 1
    chip["PIOB.OWER"] = PB13
    chip["PIOB.ODSR"] = PB13
    assert chip["PIOB.ODSR"] == PB12 | PB13


def test_open_drain_only_pulls_low() -> None:
    chip = Chip("PIOB")
    chip["PIOB.MDER"] = chip["PIOB.OER"] = PB12
    chip["PIOB.SODR"] = PB12
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
        chip[f"PIOD.{register}"] = PD2
    assert chip["PIOD.ISR"] >= 0
    chip["PIOD.IER"] = PD2
    chip.due.set_pin("PD2", levels[1])
    assert (chip.due.read_word(0xE000E200) >> 14 & 1) == seen
    assert bool(chip["PIOD.ISR"] & PD2) is seen


def test_reading_pins_needs_the_clock_and_setting_them_does_not() -> None:
    chip = Chip()
    chip["PIOB.OER"] = 1
    with pytest.raises(Stop, match=r"unclocked: read of PIOB PIO_PDSR .* clock 12 is off"):
        assert chip["PIOB.PDSR"]


def test_two_drivers_on_one_pin_are_noticed() -> None:
    chip = Chip("PIOB")
    chip.due.set_pin("PB12", "high")
    with pytest.raises(Stop, match="contention: pin PB12"):
        chip["PIOB.OER"] = PB12


def test_D4_and_PA29_are_one_wire() -> None:
    chip = Chip("PIOA", "PIOC")
    chip.due.set_pin("PC26", "low")
    chip["PIOA.SODR"] = PA29
    with pytest.raises(Stop, match="contention"):
        chip["PIOA.OER"] = PA29


CENTER = 1 << 8
CPOL = 1 << 9
GROUP = 0xF1
"""Channels 0 and 4 to 7, as synchronous channels."""
FAULT_2 = 1 << 2
"""Fault input 2 of the PWM."""


def started(mode: int, period: int, duty: int, *, channel: int = 4, clock: int = 0) -> Chip:
    chip = Chip("PWM")
    chip["PWM.CLK"] = clock
    chip[f"PWM.CMR{channel}"] = mode
    chip[f"PWM.CPRD{channel}"] = period
    chip[f"PWM.CDTY{channel}"] = duty
    chip["PWM.ENA"] = 1 << channel
    return chip


def group() -> Chip:
    """Channels 0 and 4 to 7 synchronous, centre-aligned, 20 kHz, PWML low when idle."""
    chip = Chip("PWM", "PIOC", "PIOD")
    chip["PWM.SCM"] = GROUP
    for channel in (0, 4, 5, 6, 7):
        chip[f"PWM.CMR{channel}"] = CENTER | CPOL
        chip[f"PWM.CPRD{channel}"] = 2100
        chip[f"PWM.CDTY{channel}"] = 2100
    chip["PIOC.ABSR"] = 0xF << 21
    chip["PIOC.PDR"] = 0xF << 21
    chip["PWM.ENA"] = 1
    return chip


def high_cycles(chip: Chip, channel: int, *, low_side: bool, cycles: int) -> int:
    before = chip.due.pwm_high_cycles(channel, low_side)
    chip.run_cycles(cycles)
    return chip.due.pwm_high_cycles(channel, low_side) - before


@pytest.mark.parametrize("duty", [0, 1, 700, 1050, 2099, 2100])
@pytest.mark.parametrize("mode", [0, CENTER, CPOL, CENTER | CPOL])
def test_duty_is_what_the_datasheet_computes(mode: int, duty: int) -> None:
    period = 2100
    chip = started(mode, period, duty)
    cycles = period * (2 if mode & CENTER else 1)
    # CPOL = 0: duty of OC = (period - CDTY) / period; PWMH is OC, PWML its complement.
    oc = duty if mode & CPOL else period - duty
    assert high_cycles(chip, 4, low_side=False, cycles=10 * cycles) == 10 * cycles * oc // period
    assert high_cycles(chip, 4, low_side=True, cycles=10 * cycles) == 10 * cycles * (period - oc) // period


@pytest.mark.parametrize(("mode", "clock", "expected_Hz"), [
    (CENTER, 0, FULL_HZ / (2 * 2100)),
    (0, 0, FULL_HZ / 2100),
    (3, 0, FULL_HZ / 8 / 2100),
    (10, 0, FULL_HZ / 1024 / 2100),
    (11, 7, FULL_HZ / 7 / 2100),
    (11, 2 << 8 | 5, FULL_HZ / 4 / 5 / 2100),
    (12, (1 << 8 | 3) << 16, FULL_HZ / 2 / 3 / 2100),
])  # fmt: skip
def test_frequency_follows_from_clock_and_period(mode: int, clock: int, expected_Hz: float) -> None:
    chip = started(mode, 2100, 1000, clock=clock)
    assert FULL_HZ / chip.due.pwm_period_cycles(4) == pytest.approx(expected_Hz)


def test_pin_shows_the_wave_of_its_channel() -> None:
    chip = group()
    chip["PWM.CDTYUPD4"] = 1400
    chip["PWM.SCUC"] = 1
    chip.run_cycles(3 * 4200)
    while not chip.due.pin("PC21"):
        chip.run_cycles(1)
    length = 0
    while chip.due.pin("PC21"):
        chip.run_cycles(1)
        length += 1
    # CPOL = 1: PWML is high while the counter is above CDTY.
    assert length == pytest.approx(2 * (2100 - 1400), abs=2)


@pytest.mark.parametrize(("mode", "idle"), [(0, True), (CPOL, False)])
def test_low_side_of_a_disabled_channel_is_high_unless_CPOL_is_set(mode: int, idle: bool) -> None:
    chip = Chip("PWM", "PIOC")
    chip["PWM.CMR4"] = mode
    chip["PIOC.ABSR"] = PC21
    chip["PIOC.PDR"] = PC21
    assert chip.due.pin("PC21") is idle


def test_a_new_duty_waits_for_the_end_of_the_period() -> None:
    chip = started(CPOL, 2100, 2100)
    chip.run_cycles(100)
    chip["PWM.CDTYUPD4"] = 1000
    assert chip["PWM.CDTY4"] == 2100
    chip.run_cycles(1950)
    assert chip["PWM.CDTY4"] == 2100
    chip.run_cycles(100)
    assert chip["PWM.CDTY4"] == 1000


def test_synchronous_channels_change_together_once_unlocked() -> None:
    chip = group()
    for channel in (4, 5, 6, 7):
        chip[f"PWM.CDTYUPD{channel}"] = 100 * channel
    chip.run_cycles(3 * 4200)
    assert [chip[f"PWM.CDTY{c}"] for c in (4, 5, 6, 7)] == [2100] * 4
    chip["PWM.SCUC"] = 1
    observed = set()
    for _ in range(50):
        chip.run_cycles(100)
        observed.add(tuple(chip[f"PWM.CDTY{c}"] for c in (4, 5, 6, 7)))
    assert observed == {(2100,) * 4, (400, 500, 600, 700)}
    assert chip["PWM.SCUC"] == 0


def test_override_holds_an_output_whatever_the_channel_does() -> None:
    chip = started(CPOL, 2100, 0)
    chip["PWM.OOV"] = 0
    chip["PWM.OSS"] = 1 << 20  # PWML4 takes its level from OOV, 0.
    assert high_cycles(chip, 4, low_side=True, cycles=21000) == 0
    chip["PWM.OSC"] = 1 << 20  # The channel drives it again.
    assert high_cycles(chip, 4, low_side=True, cycles=21000) > 0


def armed_fault(latched: bool) -> Chip:
    """Duty 1/3 on all four; a low level on PD6 (fault input 2) forces everything low."""
    chip = group()
    for channel in (4, 5, 6, 7):
        chip[f"PWM.CDTYUPD{channel}"] = 1400
    chip["PWM.SCUC"] = 1
    chip["PWM.FPV"] = 0
    # FPOL: input 2 is active low, the others high; FMOD: input 2 is latched.
    chip["PWM.FMR"] = (1 << 10 if latched else 0) | 0x3B
    chip["PWM.FCR"] = 0xFF
    chip["PWM.FPE1"] = FAULT_2
    chip.run_cycles(2 * 4200)
    return chip


def test_a_fault_forces_the_outputs_with_the_processor_stopped() -> None:
    chip = armed_fault(latched=False)
    assert chip.due.pin_duty("PC21") == pytest.approx(1 / 3)
    chip.due.hold_processor(True)
    chip.due.set_pin("PD6", "low")
    for pin in ("PC21", "PC22", "PC23", "PC24"):
        assert chip.due.pin_duty(pin) == 0.0
    chip.due.set_pin("PD6", "open")
    assert chip.due.pin_duty("PC21") == pytest.approx(1 / 3)


def test_a_latched_fault_lasts_until_it_is_cleared() -> None:
    chip = armed_fault(latched=True)
    chip.due.set_pin("PD6", "low")
    chip.due.set_pin("PD6", "open")
    assert chip.due.pin_duty("PC21") == 0.0
    assert chip["PWM.FSR"] >> 8 & FAULT_2
    chip["PWM.FCR"] = FAULT_2
    assert chip.due.pin_duty("PC21") == pytest.approx(1 / 3)


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("cycles", [0, 2])
def test_a_filtered_fault_input_drops_what_is_shorter_than_a_clock(filtered: bool, cycles: int) -> None:
    chip = armed_fault(latched=True)
    chip["PWM.FMR"] = filtered << 18 | 1 << 10 | 0x3B  # FFIL, FMOD and FPOL of input 2
    chip.due.set_pin("PD6", "low")
    chip.run_cycles(cycles)
    chip.due.set_pin("PD6", "open")
    chip.run_cycles(10)
    dropped = filtered and cycles == 0
    assert chip.due.pin_duty("PC21") == (pytest.approx(1 / 3) if dropped else 0.0)
    assert bool(chip["PWM.FSR"] >> 8 & FAULT_2) is not dropped


def test_synchronous_channels_ignore_their_own_fault_enables() -> None:
    chip = armed_fault(latched=False)
    chip["PWM.FPE1"] = 0
    chip["PWM.FPE2"] = 0x04040404
    chip.due.set_pin("PD6", "low")
    assert chip.due.pin_duty("PC21") == pytest.approx(1 / 3)


@pytest.mark.parametrize(
    ("register", "value", "message"),
    [
        ("PWM.CDTY4", 5, "use the update register"),
        ("PWM.CDTYUPD4", 2101, "above CPRD"),
        ("PWM.SCM", 0, "while enabled"),
        ("PWM.SCM", 1 << 16 | GROUP, "UPDM above 0"),
        ("PWM.WPCR", 1, "PWM_WPCR .*: not modelled"),
        ("PWM.DT4", 1, "PWM_DT4 .*: not modelled"),
        ("PWM.IER1", 1, "PWM_IER1 .*: not modelled"),
        ("PWM.OSSUPD", 1, "PWM_OSSUPD .*: not modelled"),
    ],
)
def test_what_the_datasheet_forbids_is_refused(register: str, value: int, message: str) -> None:
    with pytest.raises(Stop, match=message):
        group()[register] = value
