"""The random number generator: a word every 84 cycles, by its key only, from the seed."""

from __future__ import annotations

import pytest
from due_emulator import Stop

from tests.due.chip import Chip

pytestmark = pytest.mark.emulated

KEY = 0x524E47 << 8
NVIC_ISPR1 = 0xE000E204
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
    chip["TRNG.IER"] = 1
    assert chip["TRNG.IMR"] == 1
    assert not chip.word(NVIC_ISPR1) >> 41 - 32 & 1
    chip.due.run_us(3.0)
    assert chip.word(NVIC_ISPR1) >> 41 - 32 & 1
    chip["TRNG.IDR"] = 1
    assert chip["TRNG.IMR"] == 0
