"""What is no number passes every limit of a law, and the board takes over in the tick in which it appears."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import heli_host
import numpy as np
import numpy.typing as npt
import pytest
from heli_host.board.law_flight import engage, set_parameter
from heli_host.board.law_program import Instruction, LawProgram, Term
from heli_host.declaration import AXES, LAW_INPUTS, OPERATIONS, PARAMS, Takeover
from heli_lab.law import (
    Command,
    Law,
    atan2,
    control_law,
    fabs,
    floor,
    fmax,
    fmin,
    if_else,
    logic_and,
    logic_not,
    logic_or,
    saturated,
    sqrt,
)
from heli_test_native import law as native_law

from tests.law.flown import DUTY_FULL, LAWS, law_of
from tests.law.hostile import HOSTILE
from tests.law.test_places import Compiled
from tests.running.long import samples

FILES = sorted(LAWS.glob("*.py"))
# Inputs of a law: near level, with a small error on each axis.
COUNTS, SETPOINTS = [10, 12, -9], [500, 0, 1500]
FRONT_V, BACK_V = 1.7, 1.7
CALLS_BEFORE = 3


@control_law(states={"max_rad": 0.0})
def helpers(now: Any, state: Any, parameter: Any) -> Command:
    """Every limit and condition that there is."""
    a, b = now.pitch_rad, now.travel_rad
    either = if_else(logic_or(a < b, a >= 0.3), 1.7, 1.6)
    front_base_V = if_else(logic_and(a != b, logic_not(b <= -0.2)), either, 1.5)
    return Command(
        saturated(front_base_V + a, 1.0, 2.0),
        1.7 + fmin(a, b) + fmax(now.elevation_rad, 0.0) + 0.0 * if_else(a == b, 1.0, 2.0),
        states={"max_rad": fmax(state.max_rad, fabs(b))},
        signals={"floor": floor(a), "guarded": if_else(b > 0.0, sqrt(b), 0.0)},
        elevation_setpoint_rad=atan2(a, 1.0),
    )


def shipped() -> dict[str, Law]:
    """Laws of the documents, and those that tests have."""
    laws = {path.stem: law_of(path) for path in FILES}
    good = {name: HOSTILE[name].law for name in ("small_bang_bang", "wind_up", "spins")}
    return {**laws, **good, "helpers": helpers}


def angles_of(replay: Any) -> Any:
    for _ in range(200):
        replay.measure(COUNTS)
    return replay


def ends_after(poisoned_law: Poisoned) -> tuple[int | None, int]:
    """Fly a tape on the board's own code and poison it before a call."""
    # In which of the ticks from there on it was taken over, and why.
    tape = poisoned_law.program
    replay = angles_of(native_law.LawReplay([spec.default for spec in PARAMS], DUTY_FULL["native"]))
    assert replay.load(tape.words, tape.hash) == 0
    assert replay.engage(round(1000 * FRONT_V), round(1000 * BACK_V))
    replay.news()
    for _ in range(CALLS_BEFORE * tape.divisor):
        replay.measure(COUNTS)
        assert replay.update(SETPOINTS) is not None, f"taken over before it was poisoned: {replay.news()}"
    assert replay.set_parameter(poisoned_law.index, POISONED)
    for tick in range(tape.divisor):
        replay.measure(COUNTS)
        if replay.update(SETPOINTS) is None:
            return tick, int(replay.news()[0])
    return None, -1


def reaches(poisoned_law: Poisoned) -> bool:
    """Whether its NaN gets to an output, a signal or a state, by the reference."""
    reference = Reference(poisoned_law.program)
    per_count = 2.0 * np.pi / np.array([one_axis_counts() for _ in AXES])
    inputs = dict.fromkeys(LAW_INPUTS, 0.0)
    for k, axis in enumerate(AXES):
        inputs[f"{axis}_rad"] = COUNTS[k] * per_count[k]
        inputs[f"{axis}_setpoint_rad"] = SETPOINTS[k] * 1e-5
    inputs["front_V"], inputs["back_V"] = FRONT_V, BACK_V
    values = list(inputs.values())
    for _ in range(CALLS_BEFORE):
        assert np.isfinite(reference(values)).all()
    reference.poison()
    return bool(np.isnan(reference(values)).any())


def one_axis_counts() -> float:
    return 4096.0


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(shipped()))
def test_no_number_at_any_node_is_taken_over_in_that_very_tick(name: str) -> None:
    tape = shipped()[name].program
    nodes = list(poisoned(tape))
    some = nodes[:: samples(1, 7 if len(nodes) > 300 else 2)]
    unseen = []
    for node in some:
        tick, reason = ends_after(node)
        if not reaches(node):
            assert tick is None, f"{name}, instruction {node.instruction}: taken over for what does not count"
            unseen.append(node.instruction)
            continue
        assert reason == Takeover.NOT_FINITE, f"{name}, instruction {node.instruction}: {reason}"
        assert tick == node.program.ticks - 1, f"{name}, instruction {node.instruction}: in tick {tick}"
    # Branches that are not taken; a hostile law consists of two.
    assert len(unseen) <= (0.6 if name in HOSTILE else 0.3) * len(some), unseen


@pytest.mark.slow
@pytest.mark.parametrize("name", [path.stem for path in FILES])
def test_after_no_number_the_board_holds_the_arm(name: str) -> None:
    nodes = list(poisoned(law_of(next(path for path in FILES if path.stem == name)).program))
    for node in nodes[:: max(1, len(nodes) // samples(12, 1))]:
        with heli_host.connect("sil://") as heli:
            heli.take_off()
            heli.setpoint(elevation_deg=15.0, travel_deg=5.0)
            heli.wait(4.0)
            first = engage(heli, node.program)
            heli.wait(1.0)
            set_parameter(heli.session, node.program, POISON, POISONED)
            heli.wait(4.0)
            since = heli.samples(last_s=6.0)
            assert heli.state is heli_host.State.CLOSED_LOOP
            flying = (np.asarray(since.flags) & heli_host.declaration.Flags.LAW) != 0
            if not reaches(node):
                continue
            after = ~flying & (since.tick >= first)
            assert after[-1], f"instruction {node.instruction}"
            away_deg = np.abs(np.degrees(since.elevation_rad) - 15.0)
            assert away_deg[after].max() < away_deg[flying].max() + 1.5
            assert away_deg[-1] < 1.0
            assert min(since.front_V[after].min(), since.back_V[after].min()) > 1.0


def tape_outputs(law: Law, inputs: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    tape = native_law.Tape()
    assert tape.load(law.program.words, law.program.hash)[0] == 0
    outputs: np.ndarray[Any, Any] = tape.run(np.ascontiguousarray(inputs[None].astype(np.float32)))[0]
    return outputs


@pytest.mark.slow
@pytest.mark.parametrize("name", [*(path.stem for path in FILES[:: samples(1, 4)]), "helpers"])
def test_no_number_passes_in_numpy_and_c_where_it_does_on_the_board(name: str, tmp_path: Path) -> None:
    law = shipped()[name]
    inputs = np.random.default_rng(3).normal(scale=0.05, size=len(LAW_INPUTS))
    compiled = Compiled(law, tmp_path)
    for place in range(len(LAW_INPUTS)):
        given = inputs.copy()
        given[place] = np.nan
        on_board = np.isnan(tape_outputs(law, given))
        assert np.array_equal(np.isnan(law.runner()(given)), on_board), LAW_INPUTS[place]
        compiled.state = np.array([*law.states.values()], np.float32)
        assert np.array_equal(np.isnan(compiled(given)), on_board), LAW_INPUTS[place]


@pytest.mark.emulated
def test_operations_on_no_number_are_the_same_on_the_due() -> None:
    pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
    from tests.firmware.built import built_elf
    from tests.law.processor import RESULT_CELL, SPECIAL, Processor, operation_word

    processor = Processor(built_elf())
    pairs = np.array(np.meshgrid(SPECIAL, SPECIAL), np.float32).reshape(2, -1).T
    pairs = np.ascontiguousarray(pairs[np.isnan(pairs).any(axis=1)][:: samples(1, 5)])
    for operation in OPERATIONS:
        if operation.operands == 0:
            continue
        native = native_law.operate(operation.code, pairs)[:, 0]
        word = operation_word(operation.code, RESULT_CELL, second=1 if operation.operands == 2 else 0)
        for pair, wanted in zip(pairs, native, strict=True):
            processor.cost(np.array([word], np.uint32), pair)
            on_due = processor.read_cells()[RESULT_CELL]
            assert on_due.view(np.uint32) == wanted.view(np.uint32), (operation.name, pair)


NAME: Final = {operation.code: operation.name for operation in OPERATIONS}
CODE: Final = {operation.name: operation.code for operation in OPERATIONS}
POISON: Final = "poison"
HEALTHY, POISONED = 1.0, 0.0


@dataclass(frozen=True)
class Poisoned:
    """A program with a parameter that, once 0, makes the result of one instruction NaN."""

    # ``instruction`` is its place in the program that it was made of.

    program: LawProgram
    instruction: int

    @property
    def index(self) -> int:
        """Which of its parameters."""
        return len(self.program.parameters) - 1


def poisoned(program: LawProgram) -> Iterator[Poisoned]:
    """Yield a program for each instruction: its result is multiplied by 1, and in the end by 0 / 0."""
    first_own_cell = len(LAW_INPUTS) + len(program.constants) + len(program.parameters)

    def cell(place: int) -> int:
        return place + 1 if place >= first_own_cell else place

    moved = [
        Instruction(
            instruction.code, cell(instruction.target),
            cell(instruction.first) if not instruction.terms else 0,
            cell(instruction.second) if OPERATIONS[instruction.code].operands == 2 else 0,
            tuple(Term(cell(term.first), cell(term.second), term.negative) for term in instruction.terms),
        )
        for instruction in program.instructions
    ]  # fmt: skip
    parameters = (*program.parameters, (POISON, HEALTHY))
    outputs = tuple(cell(place) for place in program.outputs)
    ratio = program.cells + 1
    for k, instruction in enumerate(moved):
        poison = (
            Instruction(CODE["divide"], ratio, first_own_cell, first_own_cell),
            Instruction(CODE["multiply"], instruction.target, instruction.target, ratio),
        )
        instructions = (*moved[: k + 1], *poison, *moved[k + 1 :])
        yield Poisoned(replace(program, parameters=parameters, outputs=outputs, instructions=instructions), k)


_MEANING: Final[dict[str, Callable[[float, float], float]]] = {
    "copy": lambda a, b: a, "add": lambda a, b: a + b, "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b, "negate": lambda a, b: -a, "absolute": lambda a, b: abs(a),
    "divide": lambda a, b: float(np.divide(a, b)), "minimum": lambda a, b: float(np.minimum(a, b)),
    "maximum": lambda a, b: float(np.maximum(a, b)), "less": lambda a, b: float(a < b),
    "less_equal": lambda a, b: float(a <= b), "equal": lambda a, b: float(a == b),
    "not_equal": lambda a, b: float(a != b), "both": lambda a, b: float(bool(a) and bool(b)),
    "either": lambda a, b: float(bool(a) or bool(b)), "negation": lambda a, b: float(not a),
    "floor": lambda a, b: float(np.floor(a)), "square_root": lambda a, b: float(np.sqrt(a)),
    "sine": lambda a, b: float(np.sin(a)), "cosine": lambda a, b: float(np.cos(a)),
    "tangent": lambda a, b: float(np.tan(a)), "arctangent": lambda a, b: float(np.arctan2(a, b)),
    "hyperbolic_tangent": lambda a, b: float(np.tanh(a)), "exponential": lambda a, b: float(np.exp(a)),
}  # fmt: skip


class Reference:
    """A program as it is meant, in double precision: a result is NaN if an operand is that counts."""

    def __init__(self, program: LawProgram) -> None:
        self.program = program
        numbers = [*program.constants, *(value for _, value in program.parameters)]
        self._first_state = len(LAW_INPUTS) + len(numbers)
        self.cells = np.zeros(program.cells + 1)
        self.cells[len(LAW_INPUTS) : self._first_state] = numbers
        states = [value for _, value in program.states]
        self.cells[self._first_state : self._first_state + len(states)] = states

    def poison(self) -> None:
        """Set the parameter that makes a result NaN."""
        self.cells[self._first_state - 1] = POISONED

    def __call__(self, inputs: Sequence[float]) -> list[float]:
        """Run it once; all outputs, new states included."""
        self.cells[: len(LAW_INPUTS)] = inputs
        with np.errstate(all="ignore"):
            for instruction in self.program.instructions:
                self.cells[instruction.target] = self._result(instruction)
        outputs = [float(self.cells[place]) for place in self.program.outputs]
        states = len(self.program.states)
        if states:
            self.cells[self._first_state : self._first_state + states] = outputs[-states:]
        return outputs

    def _result(self, instruction: Instruction) -> float:
        if instruction.terms:
            signs = (-1.0 if term.negative else 1.0 for term in instruction.terms)
            pairs = ((self.cells[term.first], self.cells[term.second]) for term in instruction.terms)
            return float(sum(sign * a * b for sign, (a, b) in zip(signs, pairs, strict=True)))
        a, b = float(self.cells[instruction.first]), float(self.cells[instruction.second])
        name = NAME[instruction.code]
        if name == "select":
            return np.nan if np.isnan(a) else b if a else 0.0
        counts = (a, b)[: OPERATIONS[instruction.code].operands]
        return np.nan if np.isnan(counts).any() else _MEANING[name](a, b)


Floats = npt.NDArray[np.float32]
TINY = np.finfo(np.float32).tiny
SPECIAL = np.array(
    [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, TINY, -TINY, 3.4028235e38, 0.5, 1.5, 2.5, 8388608.0,
     16777216.0, 1.0000001, 0.99999994, 1e-45, 8191.999, 8192.0, 88.7, 89.0, -87.4],
    np.float32,
)  # fmt: skip


def operands(seed: int) -> Floats:
    """Special numbers against each other, any bits, and pairs of like size."""
    print(f"seed {seed}")
    chance = np.random.default_rng(seed)
    pairs = np.array(np.meshgrid(SPECIAL, SPECIAL)).reshape(2, -1).T
    bits = chance.integers(0, 1 << 32, (200_000, 2), np.uint64).astype(np.uint32).view(np.float32)
    near = (bits.view(np.uint32) & 0x803FFFFF | 0x3F000000 + (bits.view(np.uint32) & 0x01C00000)).view(
        np.float32
    )
    return np.ascontiguousarray(np.vstack([pairs, bits, near]).astype(np.float32))


def flushed(values: Floats) -> Floats:
    """Numbers below the normal ones as zeros of their sign."""
    return np.where(np.abs(values) < TINY, np.copysign(np.float32(0.0), values), values)


def same(results: Floats, wanted: Floats) -> npt.NDArray[np.bool_]:
    """Bit for bit, any "no number" like any other."""
    alike: npt.NDArray[np.bool_] = results.view(np.uint32) == wanted.view(np.uint32)
    return alike | (np.isnan(results) & np.isnan(wanted))


def computed(name: str, pairs: Floats) -> Floats:
    return native_law.operate(CODE[name], pairs)[:, 0]


@pytest.mark.parametrize("name", ["add", "subtract", "multiply", "divide", "square_root"])
def test_arithmetic_is_that_of_ieee_754_but_for_numbers_below_the_normal_ones(name: str) -> None:
    pairs = operands(1)
    a, b = flushed(pairs[:, 0]), flushed(pairs[:, 1])
    functions = {"add": np.add, "subtract": np.subtract, "multiply": np.multiply, "divide": np.divide}
    with np.errstate(all="ignore"):
        wanted = flushed(np.sqrt(a) if name == "square_root" else functions[name](a, b))
    # A product that is rounded up to the least normal number is that number in one way of counting.
    edge = np.abs(wanted) <= TINY
    results = computed(name, pairs)
    agree = same(results, wanted) | (edge & (np.abs(results) <= TINY))
    worst = np.flatnonzero(~agree)[:5]
    assert agree.all(), [(a[k], b[k], results[k], wanted[k]) for k in worst]


def test_comparison_and_selection_are_those_of_ieee_754_but_for_no_number() -> None:
    pairs = operands(2)
    a, b = flushed(pairs[:, 0]), flushed(pairs[:, 1])
    zero = np.float32(0.0)
    with np.errstate(all="ignore"):
        wanted = {
            "copy": a, "negate": -a, "absolute": np.abs(a), "less": a < b, "less_equal": a <= b,
            "equal": a == b, "not_equal": a != b, "both": (a != 0) & (b != 0),
            "either": (a != 0) | (b != 0), "negation": a == 0,
            "select": np.where(a != 0, b, zero), "floor": np.floor(a),
        }  # fmt: skip
    # Unlike IEEE 754, a condition of what is no number is no number either; what is not selected is nothing.
    no_number = np.isnan(a) | np.isnan(b)
    of_first = ("copy", "negate", "absolute", "negation", "select", "floor")
    for name, values in wanted.items():
        expected = np.where(np.isnan(a) if name in of_first else no_number, np.nan, values)
        assert same(computed(name, pairs), expected.astype(np.float32)).all(), name
    # Which of two zeros is the lesser, nothing says.
    for name, values in (("minimum", np.minimum(a, b)), ("maximum", np.maximum(a, b))):
        results = computed(name, pairs)
        assert (same(results, values) | (results == values)).all(), name


@pytest.mark.parametrize(
    ("name", "reference", "reach", "most_error"),
    [
        ("sine", np.sin, 20.0, 1.2e-7), ("cosine", np.cos, 20.0, 1.2e-7), ("sine", np.sin, 1e-3, 4e-9),
        ("hyperbolic_tangent", np.tanh, 12.0, 2.4e-7), ("exponential", np.exp, 0.7, 2.4e-7),
    ],
)  # fmt: skip
def test_functions_are_right_to_the_last_bit_or_two(
    name: str, reference: np.ufunc, reach: float, most_error: float
) -> None:
    values = np.linspace(-reach, reach, 400_001).astype(np.float32)
    pairs = np.ascontiguousarray(np.column_stack([values, values]))
    error = np.abs(computed(name, pairs) - reference(values.astype(float)))
    assert error.max() < most_error, values[error.argmax()]


def test_tangent_exponential_and_arctangent_are_right_relative_to_their_size() -> None:
    chance = np.random.default_rng(3)
    values = chance.uniform(-1.5, 1.5, (200_000, 2)).astype(np.float32)
    exact = values.astype(float)
    error = np.abs(computed("tangent", values) - np.tan(exact[:, 0]))
    assert (error * np.cos(exact[:, 0]) ** 2).max() < 3e-7
    assert (
        np.abs(computed("exponential", 50.0 * values) / np.exp(50.0 * values[:, 0].astype(float)) - 1).max()
        < 1e-5
    )
    angle = np.arctan2(exact[:, 0], exact[:, 1])
    assert np.abs(computed("arctangent", values) - angle).max() < 3e-7


def test_arctangent_knows_all_quadrants_and_zeros_and_infinities() -> None:
    numbers = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, 1e-30, np.nan]
    pairs = np.array([(y, x) for y in numbers for x in numbers], np.float32)
    wanted = np.arctan2(pairs[:, 0], pairs[:, 1])
    results = computed("arctangent", pairs)
    assert np.array_equal(np.isnan(results), np.isnan(wanted))
    assert np.nanmax(np.abs(results - wanted)) < 3e-7


def test_functions_beyond_their_reach_say_so() -> None:
    pairs = np.array([[8192.0, 0], [-9000.0, 0], [np.inf, 0], [np.nan, 0]], np.float32)
    for name in ("sine", "cosine", "tangent"):
        assert np.isnan(computed(name, pairs)).all(), name
    ends = np.array([[90.0, 0], [-110.0, 0], [np.inf, 0], [-np.inf, 0]], np.float32)
    assert computed("exponential", ends).tolist() == [np.inf, 0.0, np.inf, 0.0]
    assert computed("hyperbolic_tangent", ends).tolist() == [1.0, -1.0, 1.0, -1.0]
