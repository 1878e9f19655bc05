"""What a tape costs is bounded by the sum of its operations' declared costs, and the bound is near."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("heli_sim.due._due", reason="the emulated Due is not built: make setup")

from heli_host.declaration import LAW_INPUTS, LAW_MOST_TERMS, LAW_TERM_COST, LAW_TICK_COST, OPERATIONS

from firmware.due.report import read_image
from tests.firmware.built import built_elf
from tests.firmware.cost import LAW_UPDATE, Flight
from tests.law.flown import fly_and_steer, law_of
from tests.law.processor import Processor, operation_cost, pairs, sum_cost, sum_words
from tests.running.long import LONG, samples

pytestmark = pytest.mark.emulated

TAPES = samples(10_000, 300)
LAWS = Path(__file__).resolve().parents[2] / "docs" / "laws"
# Setting up and leaving the interpreter's loop.
AROUND = 20
ALL = tuple(sorted(one.stem for one in LAWS.glob("*.py")))
EXECUTE = "_ZN4heli3law4Tape7execute"
SUM = next(one for one in OPERATIONS if one.name == "sum_of_products")
MOST_TICK = 30_000
LQI_MOST = 4_000


@pytest.fixture(scope="module")
def processor() -> Processor:
    """The firmware's own code."""
    return Processor(built_elf())


def test_no_operation_takes_longer_than_declared_nor_much_less(processor: Processor) -> None:
    operands = pairs(1, 100)
    for one in OPERATIONS:
        if one.operands == 0:
            continue
        most = operation_cost(processor, one.code, operands, one.operands == 2)
        assert most <= one.cost, one.name
        assert most >= 0.9 * one.cost - 2, one.name


@pytest.mark.parametrize("growing", [True, False])
def test_a_sum_takes_no_longer_than_declared(processor: Processor, growing: bool) -> None:
    for terms in (1, 2, 7, LAW_MOST_TERMS):
        taken = sum_cost(processor, terms, growing)
        assert taken <= SUM.cost + LAW_TERM_COST * terms
        assert not growing or taken >= 0.9 * (SUM.cost + LAW_TERM_COST * terms)


def random_program(chance: np.random.Generator, inputs: int, written: int) -> tuple[list[int], int]:
    """Words of a program whose cells are written before they are read, and the bound on its cost."""
    words: list[int] = []
    foretold = AROUND
    for k in range(int(chance.integers(1, 40))):
        one = OPERATIONS[int(chance.integers(0, len(OPERATIONS)))]
        target, readable = inputs + k % (written - inputs), inputs + min(k, written - inputs)
        foretold += one.cost
        if one.operands == 0:
            count = int(chance.integers(1, 12))
            cells = chance.integers(0, readable, (count, 2)).tolist()
            signs = chance.integers(0, 2, count).tolist()
            words += sum_words(
                target, [(a, b, bool(sign)) for (a, b), sign in zip(cells, signs, strict=True)]
            )
            foretold += LAW_TERM_COST * count
            continue
        first, second = chance.integers(0, readable, 2).tolist()
        words.append(one.code << 27 | target << 18 | first << 9 | (second if one.operands == 2 else 0))
    return words, foretold


def test_random_tapes_never_take_longer_than_foretold(processor: Processor) -> None:
    chance = np.random.default_rng(2)
    inputs, written = len(LAW_INPUTS), 60
    for _ in range(TAPES):
        words, foretold = random_program(chance, inputs, written)
        cells = chance.integers(0, 1 << 32, written, np.uint64).astype(np.uint32).view(np.float32)
        cells = np.where(np.abs(cells) < 1.2e-38, np.float32(0.0), cells)
        assert processor.cost(np.array(words, np.uint32), cells) <= foretold


@pytest.mark.parametrize("name", ALL if LONG else ("lqi", "mpc"))
def test_a_flight_costs_no_more_than_foretold_and_nearly_as_much(name: str) -> None:
    elf = built_elf()
    tape = law_of(LAWS / f"{name}.py").tape
    flight = Flight(elf, read_image(elf), (LAW_UPDATE, EXECUTE))
    fly_and_steer(flight, tape, 4.0)
    _, _, execute = flight.function(EXECUTE)
    _, _, update = flight.function(LAW_UPDATE)
    if tape.ticks == 1:
        assert update <= tape.cost <= 1.15 * update
        assert name != "lqi" or tape.cost <= LQI_MOST
    else:
        assert 0.7 * LAW_TICK_COST < execute <= LAW_TICK_COST
    assert flight.tick()[2] <= MOST_TICK
