"""The converters and the random number generator (sections 43, 44 and 42)."""

import pytest
from due_chip import RAM, Chip
from due_emulator import Stop

pytestmark = pytest.mark.emulated

SWRST, START = 1, 2
LOWRES, SLEEP, FREERUN = 1 << 4, 1 << 5, 1 << 7
DRDY, GOVRE, ENDRX, RXBUFF = 1 << 24, 1 << 25, 1 << 27, 1 << 28
TAG = 1 << 24
NVIC_ISPR1 = 0xE000E204
ADC_CLOCK = 1 << (37 - 32)
"""In PMC_PCER1 and PMC_PCDR1."""
RXTEN = 1 << 0
DATRDY = 1 << 0
TXRDY, DACC_TAG, CHANNEL_1_TAG = 1 << 0, 1 << 20, 1 << 12
# PRESCAL = 1: MCK / 4. A conversion takes TRACKTIM + 1 and 20 periods.
MODE, CONVERSION = 1 << 8, 21 * 4


def converter(*channels: int, mode: int = MODE) -> Chip:
    chip = Chip("ADC")
    for channel in range(16):
        chip.due.set_analog(channel, 0.2 * channel)
    chip["ADC.MR"] = mode
    chip["ADC.CHER"] = sum(1 << channel for channel in channels)
    return chip


def pending(chip: Chip, pid: int) -> bool:
    return bool(chip.word(NVIC_ISPR1) >> (pid - 32) & 1)


@pytest.mark.parametrize(
    ("volts", "code"),
    [(-1.0, 0), (0.0, 0), (0.001, 1), (1.65, 2048), (3.299, 4094), (3.3, 4095), (9.0, 4095)],
)
def test_a_voltage_is_its_share_of_3V3_in_4096_steps(volts: float, code: int) -> None:
    chip = converter(7)
    chip.due.set_analog(7, volts)
    chip["ADC.CR"] = START
    chip.wait("ADC.ISR", DRDY, 100)
    assert chip["ADC.CDR7"] == chip["ADC.LCDR"] == code


def test_ten_bits_are_the_upper_ones() -> None:
    chip = converter(7, mode=MODE | LOWRES)
    chip.due.set_analog(7, 1.65)
    chip["ADC.CR"] = START
    chip.wait("ADC.ISR", DRDY, 100)
    assert chip["ADC.LCDR"] == 512


@pytest.mark.parametrize(("prescal", "tracktim"), [(1, 0), (1, 15), (9, 3)])
def test_a_conversion_takes_its_tracking_and_20_periods(prescal: int, tracktim: int) -> None:
    chip = converter(0, mode=prescal << 8 | tracktim << 24)
    cycles = (tracktim + 1 + 20) * 2 * (prescal + 1)
    chip["ADC.CR"] = START
    chip.run_cycles(cycles - 8)
    assert chip["ADC.ISR"] & DRDY == 0
    chip.run_cycles(16)
    assert chip["ADC.ISR"] & DRDY


@pytest.mark.parametrize(("sleep", "second_waits"), [(0, False), (SLEEP, True)])
def test_the_start_up_time_comes_first_and_after_each_sleep(sleep: int, second_waits: bool) -> None:
    chip = converter(0, mode=MODE | sleep | 8 << 16)
    for waits in (True, second_waits):
        chip["ADC.CR"] = START
        chip.run_cycles(CONVERSION + 20)
        assert bool(chip["ADC.ISR"] & DRDY) is not waits
        chip.run_cycles(512 * 4)
        assert chip["ADC.LCDR"] == 0
        assert chip["ADC.CDR0"] == 0


def test_a_start_converts_every_enabled_channel_in_its_order() -> None:
    chip = converter(3, 4, 12)
    chip["ADC.EMR"] = TAG
    chip["ADC.CR"] = START
    chip.run_cycles(8)
    for channel, before in ((3, 0), (4, 1 << 3), (12, 1 << 3 | 1 << 4)):
        assert chip["ADC.ISR"] & 0xFFFF == before
        chip.run_cycles(CONVERSION)
        assert chip["ADC.LCDR"] == channel << 12 | int(0.2 * channel / 3.3 * 4096)
    chip.run_cycles(10 * CONVERSION)
    assert chip["ADC.ISR"] & DRDY == 0


def test_reading_clears_what_was_read() -> None:
    chip = converter(3, 5)
    chip["ADC.CR"] = START
    chip.run_cycles(3 * CONVERSION)
    assert chip["ADC.ISR"] & (0xFFFF | DRDY | GOVRE) == 1 << 3 | 1 << 5 | DRDY | GOVRE
    assert chip["ADC.ISR"] & (0xFFFF | DRDY | GOVRE) == 1 << 3 | 1 << 5 | DRDY
    assert chip["ADC.CDR3"]
    assert chip["ADC.ISR"] & (0xFFFF | DRDY) == 1 << 5 | DRDY
    assert chip["ADC.LCDR"]
    assert chip["ADC.ISR"] & (0xFFFF | DRDY) == 1 << 5


def test_a_value_that_nobody_read_is_an_overrun() -> None:
    chip = converter(3)
    for _ in range(2):
        assert chip["ADC.OVER"] == 0
        chip["ADC.CR"] = START
        chip.run_cycles(2 * CONVERSION)
    assert chip["ADC.OVER"] == 1 << 3
    assert chip["ADC.OVER"] == 0


def test_a_disabled_channel_is_left_out() -> None:
    chip = converter(3, 5)
    chip["ADC.CHDR"] = 1 << 3
    assert chip["ADC.CHSR"] == 1 << 5
    chip["ADC.CR"] = START
    chip.run_cycles(3 * CONVERSION)
    assert chip["ADC.ISR"] & 0xFFFF == 1 << 5


def test_a_conversion_waits_while_the_clock_is_off() -> None:
    chip = converter(7)
    chip["ADC.CR"] = START
    chip["PMC.PCDR1"] = ADC_CLOCK
    chip.run_cycles(10 * CONVERSION)
    chip["PMC.PCER1"] = ADC_CLOCK
    assert chip["ADC.ISR"] & DRDY == 0
    chip.run_cycles(CONVERSION)
    assert chip["ADC.ISR"] & DRDY


def test_running_freely_needs_no_start() -> None:
    chip = converter(7, mode=MODE | FREERUN)
    for volts in (1.0, 2.0):
        chip.due.set_analog(7, volts)
        chip.run_cycles(3 * CONVERSION)
        assert chip["ADC.CDR7"] == int(volts / 3.3 * 4096)


@pytest.mark.parametrize("source", [1 << 7, DRDY])
def test_an_end_of_conversion_interrupts_if_it_may(source: int) -> None:
    chip = converter(7)
    chip["ADC.CR"] = START
    chip.run_cycles(2 * CONVERSION)
    assert not pending(chip, 37)
    chip["ADC.IER"] = source
    assert chip["ADC.IMR"] == source
    assert pending(chip, 37)


def test_the_pdc_carries_halfwords_to_memory_and_says_when_its_buffers_are_full() -> None:
    chip = converter(3, 5, mode=MODE | FREERUN)
    chip["ADC.CR"] = SWRST
    chip["ADC.RPR"], chip["ADC.RCR"] = RAM + 0x100, 3
    chip["ADC.RNPR"], chip["ADC.RNCR"] = RAM + 0x200, 2
    chip["ADC.PTCR"] = RXTEN
    chip["ADC.CHER"] = 1 << 3 | 1 << 5
    chip["ADC.MR"] = MODE | FREERUN
    chip.run_cycles(7 * CONVERSION // 2)
    assert chip["ADC.ISR"] & (ENDRX | RXBUFF) == ENDRX
    chip.run_cycles(3 * CONVERSION)
    assert chip["ADC.ISR"] & (ENDRX | RXBUFF) == ENDRX | RXBUFF
    low, high = (int(0.2 * channel / 3.3 * 4096) for channel in (3, 5))
    first, second = chip.due.peek(RAM + 0x100, 8), chip.due.peek(RAM + 0x200, 6)
    assert [int.from_bytes(first[i : i + 2], "little") for i in (0, 2, 4)] == [low, high, low]
    assert [int.from_bytes(second[i : i + 2], "little") for i in (0, 2)] == [high, low]
    assert first[6:] == second[4:] == b"\x5b\x5b"


@pytest.mark.parametrize(
    ("register", "value", "message"),
    [
        ("ADC.MR", 1, "triggers from timers"),
        ("ADC.MR", 1 << 31, "user sequences"),
        ("ADC.IER", 1 << 26, "comparison"),
        ("ADC.CGR", 1, "gain and offset"),
        ("ADC.WPMR", 1, "ADC_WPMR .*: not modelled"),
        ("DACC.MR", 1, "triggers are not modelled"),
        ("DACC.CDR", 0, "channel 0, which is off"),
        ("DACC.WPMR", 1, "DACC_WPMR .*: not modelled"),
    ],
)
def test_what_is_not_modelled_or_wrong_is_refused(register: str, value: int, message: str) -> None:
    with pytest.raises(Stop, match=message):
        Chip("ADC", "DACC")[register] = value


@pytest.mark.parametrize(("code", "volts"), [(0, 0.55), (4095, 2.75), (1365, 0.55 + 2.2 / 3)])
def test_an_output_lies_between_one_and_five_sixths_of_3V3(code: int, volts: float) -> None:
    chip = Chip("DACC")
    assert chip.due.analog_out(1) == 0.0
    chip["DACC.MR"] = 1 << 16  # USER_SEL: channel 1
    chip["DACC.CHER"] = 1 << 1
    chip["DACC.CDR"] = code
    chip.run_cycles(60)
    assert chip.due.analog_out(1) == pytest.approx(volts)
    end_of_conversion = 1 << 1
    assert chip["DACC.ISR"] & end_of_conversion
    # Reading has cleared it.
    assert chip["DACC.ISR"] & end_of_conversion == 0


def test_the_queue_of_the_outputs_takes_four_values_and_says_so() -> None:
    chip = Chip("DACC")
    chip["DACC.MR"] = DACC_TAG
    assert chip["DACC.ISR"] & TXRDY == 0
    chip["DACC.CHER"] = 3
    for code in range(4):
        assert chip["DACC.ISR"] & TXRDY
        chip["DACC.CDR"] = CHANNEL_1_TAG | code
    assert chip["DACC.ISR"] & TXRDY == 0
    with pytest.raises(Stop, match=r"write while DACC_ISR\.TXRDY is 0"):
        chip["DACC.CDR"] = 0
    chip.run_cycles(4 * 50 + 4)
    assert chip.due.analog_out(1) == pytest.approx(3.3 * (1 + 4 * 3 / 4095) / 6)


KEY = 0x524E47 << 8
CYCLES_US = 84 / 84.0


def generating(seed: int = 1) -> Chip:
    chip = Chip("TRNG")
    chip.due.seed_random(seed)
    chip["TRNG.CR"] = KEY | 1
    return chip


def words(chip: Chip, count: int) -> list[int]:
    matches = []
    for _ in range(count):
        chip.due.run_us(CYCLES_US)
        matches.append(chip["TRNG.ODATA"])
    return matches


def test_a_word_is_ready_after_84_cycles_and_reading_the_status_takes_it_back() -> None:
    chip = generating()
    chip.due.run_us(0.9 * CYCLES_US)
    assert (chip["TRNG.ISR"], chip["TRNG.ODATA"]) == (0, 0)
    chip.due.run_us(0.2 * CYCLES_US)
    assert chip["TRNG.ISR"] == 1
    assert chip["TRNG.ISR"] == 0
    word = chip["TRNG.ODATA"]
    chip.due.run_us(CYCLES_US)
    assert chip["TRNG.ISR"] == 1
    assert chip["TRNG.ODATA"] != word


def test_words_follow_from_the_seed_and_are_spread_over_all_bits() -> None:
    drawn = words(generating(), 256)
    assert drawn == words(generating(), 256)
    assert drawn[:8] != words(generating(2), 8)
    assert len(set(drawn)) == 256
    for bit in range(32):
        assert 80 < sum(word >> bit & 1 for word in drawn) < 176


def test_a_start_goes_on_in_the_sequence() -> None:
    chip = generating()
    drawn = words(chip, 4)
    chip.due.power_off()
    chip.power_on("TRNG")
    assert (chip["TRNG.ISR"], chip["TRNG.ODATA"]) == (0, 0)
    chip["TRNG.CR"] = KEY | 1
    assert not set(drawn) & set(words(chip, 4))


def test_it_stops_when_it_is_disabled_and_needs_its_key() -> None:
    chip = generating()
    [word] = words(chip, 1)
    chip["TRNG.CR"] = KEY
    chip.due.run_us(10.0)
    assert (chip["TRNG.ISR"], chip["TRNG.ODATA"]) == (0, word)
    with pytest.raises(Stop, match=r"TRNG_CR .*key"):
        chip["TRNG.CR"] = 1


def test_a_ready_word_interrupts_where_that_is_enabled() -> None:
    chip = generating()
    assert chip["TRNG.IMR"] == 0
    chip["TRNG.IER"] = DATRDY
    assert chip["TRNG.IMR"] == 1
    assert not chip.word(NVIC_ISPR1) >> 41 - 32 & 1
    chip.due.run_us(3.0)
    assert chip.word(NVIC_ISPR1) >> 41 - 32 & 1
    chip["TRNG.IDR"] = DATRDY
    assert chip["TRNG.IMR"] == 0
