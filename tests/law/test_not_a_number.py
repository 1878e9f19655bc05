"""What is no number passes every limit of a law, and the board takes over in the tick in which it appears."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host.board.law_flight import engage, set_parameter
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

from tests.law.flown import DUTY_FULL, law_of
from tests.law.hostile import HOSTILE
from tests.law.poisoned import POISON, POISONED, Poisoned, Reference, poisoned
from tests.law.test_places import Compiled
from tests.running.long import samples

LAWS = sorted((Path(__file__).resolve().parents[2] / "docs" / "laws").glob("*.py"))
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
    laws = {path.stem: law_of(path) for path in LAWS}
    good = {name: HOSTILE[name][0] for name in ("small_bang_bang", "wind_up", "spins")}
    return {**laws, **good, "helpers": helpers}


def angles_of(replay: Any) -> Any:
    for _ in range(200):
        replay.measure(COUNTS)
    return replay


def ends_after(poisoned_law: Poisoned) -> tuple[int | None, int]:
    """Fly a tape on the board's own code and poison it before a call.

    In which of the ticks from there on it was taken over, and why.
    """
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
    some = nodes if len(nodes) < 300 else nodes[:: samples(1, 7)]
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
@pytest.mark.parametrize("name", [path.stem for path in LAWS])
def test_after_no_number_the_board_holds_the_arm(name: str) -> None:
    nodes = list(poisoned(law_of(next(path for path in LAWS if path.stem == name)).program))
    for node in nodes[:: max(1, len(nodes) // samples(12, 2))]:
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
@pytest.mark.parametrize("name", [*(path.stem for path in LAWS[:: samples(1, 4)]), "helpers"])
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
    from tests.law.processor import SPECIAL, Processor

    processor = Processor(built_elf())
    pairs = np.array(np.meshgrid(SPECIAL, SPECIAL), np.float32).reshape(2, -1).T
    pairs = np.ascontiguousarray(pairs[np.isnan(pairs).any(axis=1)][:: samples(1, 5)])
    for operation in OPERATIONS:
        if operation.operands == 0:
            continue
        native = native_law.operate(operation.code, pairs)[:, 0]
        word = operation.code << 27 | 400 << 18 | (1 if operation.operands == 2 else 0)
        for pair, wanted in zip(pairs, native, strict=True):
            processor.cost(np.array([word], np.uint32), pair)
            on_due = processor.read_cells()[400]
            assert on_due.view(np.uint32) == wanted.view(np.uint32), (operation.name, pair)
