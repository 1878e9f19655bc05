"""The declared costs of its operations bound the cost of a program, and the bound is tight."""

import subprocess
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest

pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")

from heli_host import declaration as d
from heli_host.board.law_program import LawProgram
from heli_lab.law import Command, Law, control_law, motor_volts, sqrt

from firmware.due.report import read_image
from tests.firmware.built import built_elf
from tests.firmware.cost import LAW_UPDATE, Flight, fly_the_worst
from tests.law.flown import LAWS, fly_and_steer, law_of
from tests.law.processor import (
    Processor,
    adversarial_sums,
    operation_cost,
    operation_word,
    pairs,
    sum_cost,
    sum_words,
)
from tests.running.long import LONG, samples

pytestmark = pytest.mark.emulated

TAPES = samples(10_000, 300)
ROOT = Path(__file__).resolve().parents[2]
# Setting up and leaving the interpreter's loop.
AROUND = 20
ALL = tuple(sorted(path.stem for path in LAWS.glob("*.py")))
EXECUTE = "_ZN4heli3law4Tape7execute"
SUM = next(operation for operation in d.OPERATIONS if operation.name == "sum_of_products")
MAX_TICK = 30_000
# Square roots that fill a tick.
ROOTS = 48
# The core with the code for laws, and without it.
SEAT = (
    ("law/simplex.hpp", "if (!uploaded_.busy()) {", "if (true) {"),
    ("core.cpp", "if (uploaded_.busy() && uploaded_.flying() &&", "if (false && uploaded_.flying() &&"),
    ("core.cpp", "  if (uploaded_.busy()) {\n    log_law(sample);", "  if (false) {\n    log_law(sample);"),
)
LQI_MAX = 4_000


@pytest.fixture(scope="module")
def processor() -> Processor:
    """The firmware's own code."""
    return Processor(built_elf())


def test_no_operation_takes_longer_than_declared_nor_much_less(processor: Processor) -> None:
    operands = pairs(1, 100)
    for operation in d.OPERATIONS:
        if operation.operands == 0:
            continue
        most = operation_cost(processor, operation.code, operands, operation.operands == 2)
        assert most <= operation.cost, operation.name
        assert most >= 0.9 * operation.cost - 2, operation.name


def test_a_sum_takes_no_longer_than_declared_whatever_its_terms_are(processor: Processor) -> None:
    chance = np.random.default_rng(7)
    nearest = 0.0
    for cells, terms in adversarial_sums(chance, samples(20_000, 400)):
        instructions = sum_cost(processor, cells, terms)
        declared = SUM.cost + d.LAW_TERM_COST * len(terms)
        assert instructions <= declared, (cells, terms)
        nearest = max(nearest, instructions / declared)
    # There are terms that take as long as is declared of any.
    assert nearest > 0.98


def random_program(chance: np.random.Generator, inputs: int, written: int) -> tuple[list[int], int]:
    """Words of a program whose cells are written before they are read, and the bound on its cost."""
    words: list[int] = []
    declared = AROUND
    for k in range(int(chance.integers(1, 40))):
        operation = d.OPERATIONS[int(chance.integers(0, len(d.OPERATIONS)))]
        target, readable = inputs + k % (written - inputs), inputs + min(k, written - inputs)
        declared += operation.cost
        if operation.operands == 0:
            count = int(chance.integers(1, 12))
            cells = chance.integers(0, readable, (count, 2)).tolist()
            signs = chance.integers(0, 2, count).tolist()
            words += sum_words(
                target, [(a, b, bool(sign)) for (a, b), sign in zip(cells, signs, strict=True)]
            )
            declared += d.LAW_TERM_COST * count
            continue
        first, second = chance.integers(0, readable, 2).tolist()
        words.append(operation_word(operation.code, target, first, second if operation.operands == 2 else 0))
    return words, declared


def test_random_tapes_never_take_longer_than_predicted(processor: Processor) -> None:
    chance = np.random.default_rng(2)
    inputs, written = len(d.LAW_INPUTS), 60
    for _ in range(TAPES):
        words, declared = random_program(chance, inputs, written)
        cells = chance.integers(0, 1 << 32, written, np.uint64).astype(np.uint32).view(np.float32)
        cells = np.where(np.abs(cells) < 1.2e-38, np.float32(0.0), cells)
        assert processor.cost(np.array(words, np.uint32), cells) <= declared


@pytest.mark.parametrize("name", ALL if LONG else ("lqi", "mpc"))
def test_a_flight_costs_no_more_than_predicted_and_nearly_as_much(name: str) -> None:
    program = law_of(LAWS / f"{name}.py").program
    flight = flown(program)
    update = flight.function_cost(LAW_UPDATE).max_instructions
    assert update <= max(program.tick_costs) <= 1.15 * update
    assert name != "lqi" or program.cost <= LQI_MAX
    assert flight.tick_cost().max_instructions <= MAX_TICK


def test_states_and_signals_cost_no_more_than_declared() -> None:
    few, many = (
        flown(remembering(count).program).function_cost(LAW_UPDATE).max_instructions for count in (1, 201)
    )
    each = (many - few) / 200
    assert d.LAW_STATE_COST - 1 < each <= d.LAW_STATE_COST
    ticks = flown(remembering(1, signals=4).program).function_cost(LAW_UPDATE).max_instructions
    assert (ticks - few) / 4 <= d.LAW_SIGNAL_COST


def test_a_tick_with_the_most_expensive_accepted_tape_is_within_its_bound() -> None:
    program = most_expensive().program
    assert d.LAW_TICK_COST - 400 < program.cost <= d.LAW_TICK_COST
    flight = flown(program)
    update = flight.function_cost(LAW_UPDATE).max_instructions
    tick_cycles = flight.tick_cost().max_instructions
    assert update <= program.cost <= 1.15 * update
    assert tick_cycles <= MAX_TICK
    # What is around the law has room too, so that no program of the same cost does more.
    assert d.LAW_TICK_COST + (tick_cycles - update) <= MAX_TICK


@pytest.mark.skipif(not LONG, reason="builds the firmware without the seat for laws: make long")
def test_a_board_on_which_no_law_flies_pays_at_most_20_instructions_a_tick_for_the_seat(
    tmp_path: Path,
) -> None:
    copytree(ROOT / "firmware", tmp_path / "firmware")
    for file, seat, without in SEAT:
        source = tmp_path / "firmware" / "core" / file
        text = source.read_text()
        assert text.count(seat) == 1, seat
        source.write_text(text.replace(seat, without))
    elf_without_seat = tmp_path / "heli.elf"
    subprocess.run(
        ["make", "-s", "-C", tmp_path / "firmware" / "due", f"BUILD={tmp_path}", elf_without_seat], check=True
    )
    with_seat, bare = (
        max(flight.tick_cost().max_instructions for flight in fly_the_worst(elf))
        for elf in (built_elf(), elf_without_seat)
    )
    assert 0 < with_seat - bare <= 20


def flown(program: LawProgram) -> Flight:
    """A flight of four seconds, counted."""
    elf = built_elf()
    flight = Flight(elf, read_image(elf), (LAW_UPDATE, EXECUTE))
    fly_and_steer(flight, program, 4.0)
    return flight


def hover_volts(now: Any) -> tuple[Any, Any]:
    """Voltages of a law that flies."""
    collective_V = 1.4 - 16.0 * now.elevation_rad - 12.0 * now.elevation_rad_s
    tilt_rad = -0.5 * now.travel_rad - 2.5 * now.travel_rad_s
    return motor_volts(collective_V, 5.0 * (tilt_rad - now.pitch_rad) - 1.6 * now.pitch_rad_s)


def remembering(states: int, signals: int = 0) -> Law:
    """A law that flies, and has nothing to do with its states."""

    @control_law(states={f"x{k}": 0.5 for k in range(states)})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        inputs = (now.pitch_rad, now.travel_rad, now.elevation_rad, now.pitch_rad_s)
        return Command(
            *hover_volts(now),
            states={f"x{k}": 0.25 for k in range(states)},
            signals={f"s{k}": inputs[k] for k in range(signals)},
        )

    return law


def most_expensive() -> Law:
    """A law of 1 kHz that flies, and takes all the time that there is."""

    @control_law(states={"x": 0.0})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        x = state.x
        for _ in range(ROOTS):
            x = sqrt(1.0 + x)
        return Command(*hover_volts(now), states={"x": x})

    return law
