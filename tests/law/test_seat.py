"""Guarantees for a law that flies on the board, whatever the host demands meanwhile."""

import math
from typing import Any

import pytest
from heli_host import declaration as d
from heli_host.board.law_flight import PART_WORDS
from heli_host.board.law_program import Instruction, LawProgram
from heli_host.declaration import Channel, Event, LawError, LawState, Result, State, Takeover
from heli_host.link.channels import physical
from heli_lab.law import Command, control_law
from heli_test_native import law as native_law

from tests.flight.harness import Harness
from tests.law.flown import upload_messages

FOLLOWING_MAX_deg = {p.name: p.default for p in d.PARAMS}["pitch_following_max_deg"]
ENVELOPE = {p.name: p.default for p in d.PARAMS}["law_envelope"]


def program_of(name: str, volts: Any) -> LawProgram:
    """A law whose two voltages are a function of its inputs."""

    @control_law(name=name)
    def law(now: Any, state: Any, parameter: Any) -> Command:
        return Command(*volts(now))

    return law.program


def hovering() -> Harness:
    """A board that flies level by its own law; of arms that do not follow, only pitch is watched."""
    harness = Harness()
    harness.set("pitch_following_max_deg", FOLLOWING_MAX_deg)
    harness.fly()
    harness.glide(0, 0.0, 60.0)
    harness.keep_flying(1500)
    return harness


def upload(harness: Harness, program: LawProgram) -> d.AckMessage:
    """Upload a law; the first answer that is not OK, or the last."""
    answers = [harness.ask(message) for message in upload_messages(program)]
    answer: d.AckMessage = next((a for a in answers if a.result != Result.OK), answers[-1])
    return answer


def engage(harness: Harness, program: LawProgram) -> d.AckMessage:
    """Upload a law and let it fly."""
    assert upload(harness, program).result == Result.OK
    answer: d.AckMessage = harness.ask(d.LawFlyMessage(request=0, on=1))
    return answer


def taken_over(harness: Harness) -> list[Takeover]:
    """Why the board took over, each time."""
    return [Takeover(event.detail) for event in harness.events if event.kind == Event.LAW_TAKEN_OVER]


def law_on(harness: Harness) -> d.LawMessage:
    """The board's report of the law that it has."""
    before = len(harness.frames)
    harness.send(d.LawReadMessage(200))
    harness.tick(3)
    (frame,) = [f for f in harness.frames[before:] if f.id == d.MessageId.LAW]
    return d.LawMessage.unpack(frame.payload)


def test_a_law_that_flies_cannot_be_replaced_and_no_part_reaches_its_tape() -> None:
    flying, other = (
        program_of("flying", lambda now: (1.6, 1.5)),
        program_of("other", lambda now: (3.0, 0.0)),
    )
    harness = hovering()
    assert engage(harness, flying).result == Result.OK
    harness.keep_flying(2500)
    motors = harness.motors
    refused = harness.ask(d.LawBeginMessage(request=0, hash=other.hash, words=len(other.words)))
    assert (refused.result, refused.detail) == (Result.BAD_LAW, LawError.FLYING)
    for first in range(0, len(flying.words), PART_WORDS):
        answer = harness.ask(d.LawPartMessage(0, first, *([0] * PART_WORDS)))
        assert (answer.result, answer.detail) == (Result.BAD_LAW, LawError.WRONG_PART)
    harness.keep_flying(50)
    reported = law_on(harness)
    assert (reported.state, reported.hash) == (LawState.FLYING, flying.hash)
    assert harness.motors == motors
    assert not taken_over(harness)


@pytest.mark.parametrize("axes", [1, 2, 3, 6])
def test_a_law_flies_only_where_the_board_closes_all_three_loops(axes: int) -> None:
    harness = hovering()
    assert harness.close_loops(axes).result == Result.OK
    answer = engage(harness, program_of("any", lambda now: (1.5, 1.5)))
    assert (answer.result, answer.detail) == (Result.BAD_LAW, LawError.NOT_FLYING)


@pytest.mark.parametrize("axes", [1, 3, 6])
def test_a_loop_that_is_opened_ends_the_flight_of_a_law(axes: int) -> None:
    harness = hovering()
    assert engage(harness, program_of("any", lambda now: (1.5, 1.5))).result == Result.OK
    harness.keep_flying(100)
    assert harness.close_loops(axes).result == Result.OK
    harness.keep_flying(3)
    assert taken_over(harness) == [Takeover.STATE]


def test_a_law_has_its_whole_time_astray_each_time_it_flies() -> None:
    """Three times 0.6 of the time that the guard allows: none of them is over it."""

    @control_law(name="asks for a tilt that does not come")
    def law(now: Any, state: Any, parameter: Any) -> Command:
        return Command(1.5, 1.5, pitch_setpoint_rad=math.radians(0.9 * FOLLOWING_MAX_deg))

    harness = hovering()
    assert upload(harness, law.program).result == Result.OK
    for _ in range(3):
        assert harness.ask(d.LawFlyMessage(request=0, on=1)).result == Result.OK
        harness.keep_flying(round(600 * ENVELOPE))
        assert harness.ask(d.LawFlyMessage(request=0, on=0)).result == Result.OK
    assert taken_over(harness) == 3 * [Takeover.COMMAND]
    assert harness.ask(d.LawFlyMessage(request=0, on=1)).result == Result.OK
    harness.keep_flying(round(1100 * ENVELOPE))
    assert taken_over(harness)[3:] == [Takeover.PITCH_FOLLOWING]


def test_the_first_voltage_of_every_flight_of_a_law_is_no_jump() -> None:
    """The board fades from its own voltages to those of the law, however far away these are."""
    harness = hovering()
    program = program_of("far", lambda now: (3.5, 3.5))
    assert upload(harness, program).result == Result.OK
    for _ in range(2):
        harness.keep_flying(2000)
        assert harness.motors[0] < 1.0 * harness.motors[1] + 100
        assert harness.ask(d.LawFlyMessage(request=0, on=1)).result == Result.OK
        harness.keep_flying(50)
        assert not taken_over(harness)[1:], "the law was taken over"
        assert harness.state is State.CLOSED_LOOP
        harness.ask(d.LawFlyMessage(request=0, on=0))
    assert taken_over(harness) == [Takeover.COMMAND, Takeover.COMMAND]


@pytest.mark.parametrize("motor", ["front", "back"])
@pytest.mark.parametrize(("jump_V", "allowed"), [(-2.6, False), (-2.4, True), (2.4, True), (2.6, False)])
def test_a_jump_of_either_motor_is_taken_over_beyond_its_limit(
    motor: str, jump_V: float, allowed: bool
) -> None:
    """The voltage of one motor jumps when the encoder of travel turns by two counts within a tick."""
    turned_deg = 2.0 * 360.0 / 4096.0
    harness = hovering()

    def volts(now: Any) -> tuple[Any, Any]:
        stepped = 3.0 + jump_V / math.radians(turned_deg) * now.travel_rad
        return (stepped, 3.0) if motor == "front" else (3.0, stepped)

    assert engage(harness, program_of("jumps", volts)).result == Result.OK
    harness.keep_flying(100)
    assert not taken_over(harness)
    harness.move(travel_deg=turned_deg)
    harness.keep_flying(10)
    assert taken_over(harness) == ([] if allowed else [Takeover.VOLTAGE_JUMP])


def adding(count: int, states: int = 0, signals: int = 0, more: tuple[Instruction, ...] = ()) -> LawProgram:
    """A law of so many additions, after other operations."""
    inputs = len(d.LAW_INPUTS)
    first_state, target = inputs, inputs + states
    add = Instruction(code=1, target=target, first=0, second=1)
    numbered = tuple((f"x{k}", 0.0) for k in range(states))
    outputs = (target,) * (5 + signals) + (target,) * states
    names = tuple(f"s{k}" for k in range(signals))
    assert first_state == inputs
    return LawProgram("adding", 20, (), (), numbered, outputs, names, (*more, *[add] * count))


@pytest.mark.parametrize(("states", "signals"), [(0, 0), (1, 0), (30, 0), (0, 4), (9, 2)])
def test_board_and_host_agree_on_the_ticks_and_the_cost_of_a_law(states: int, signals: int) -> None:
    """One addition more at a time, past the ends of two ticks; each has room for what the last costs."""
    ticks = set()
    for count in (*range(1, 5), *range(280, 320), *range(560, 620)):
        program = adding(count, states, signals)
        error, cost, needed = native_law.Tape().load(list(program.words), program.hash)
        assert (error, cost, needed) == (0, program.cost, program.ticks), count
        ticks.add(needed)
    assert ticks == {1, 2, 3}


def test_a_law_logs_each_of_its_signals_in_its_own_channel_and_a_large_one_at_its_size() -> None:
    # On the line a signal counts steps of 1e-5: 200 is above 2^24, where a float has no fraction.
    signals = {"first": 1.0, "second": 2.0, "large": 200.0, "low": -1000.0}

    @control_law(name="signals")
    def law(now: Any, state: Any, parameter: Any) -> Command:
        return Command(1.5, 1.5, signals=signals)

    harness = hovering()
    assert engage(harness, law.program).result == Result.OK
    harness.keep_flying(200)
    channels = (Channel.SIGNAL_1, Channel.SIGNAL_2, Channel.SIGNAL_3, Channel.SIGNAL_4)
    logged = [float(physical(harness.telemetry().raw[-1], channel)) for channel in channels]
    assert logged == pytest.approx([*signals.values()], rel=1e-6)


def test_a_law_as_long_as_the_tape_is_received_and_a_word_more_is_refused() -> None:
    harness = Harness()
    longest = harness.ask(d.LawBeginMessage(request=0, hash=1, words=d.LAW_WORDS))
    assert longest.result == Result.OK
    longer = harness.ask(d.LawBeginMessage(request=0, hash=1, words=d.LAW_WORDS + 1))
    assert (longer.result, longer.detail, longer.value) == (Result.BAD_LAW, LawError.TOO_LONG, d.LAW_WORDS)


def test_a_law_with_a_setpoint_of_its_own_logs_the_boards_in_the_first_free_signal() -> None:
    @control_law(name="own setpoint")
    def law(now: Any, state: Any, parameter: Any) -> Command:
        own_rad = 0.5 * now.elevation_setpoint_rad
        return Command(1.5, 1.5, elevation_setpoint_rad=own_rad, signals={"first": 1.0})

    harness = hovering()
    assert engage(harness, law.program).result == Result.OK
    harness.keep_flying(1500, elevation_deg=4.0)
    last = harness.telemetry().raw[-1]
    board_raw, law_raw = last[Channel.SIGNAL_2], last[Channel.ELEVATION_SETPOINT]
    assert board_raw == pytest.approx(2 * law_raw, abs=2)
    assert math.degrees(float(physical(last, Channel.ELEVATION_SETPOINT))) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_angle_that_a_takeover_foresees_is_on_the_side_to_which_the_arm_turns(sign: int) -> None:
    """At 60 degrees per second travel cannot be braked before its limit, to whichever side."""
    harness = hovering()
    assert engage(harness, program_of("any", lambda now: (1.5, 1.5))).result == Result.OK
    harness.glide(2, sign * 27.0, 60.0)
    assert taken_over(harness) == [Takeover.TRAVEL_ENVELOPE]
    foreseen_deg = harness.last_event(Event.LAW_TAKEN_OVER).value
    assert 170.0 < sign * foreseen_deg < 200.0
