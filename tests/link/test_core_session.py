"""The board's session: who may speak, and that a command takes effect exactly once."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from heli_host.declaration import (
    LINK_HASH,
    ArmMessage,
    HelloMessage,
    LandMessage,
    MessageId,
    ParamSetMessage,
    PingMessage,
    Result,
    SetpointMessage,
    StatusReadMessage,
    StopMessage,
)
from hypothesis import given
from hypothesis import strategies as st

from tests.link.core_harness import (
    STREAMS,
    TO_BOARD,
    Harness,
    acks_in,
    named,
    open_harness,
    payloads_of,
    slowly_changing_samples,
)

NEVER = 0xFFFFFFFF


@pytest.mark.parametrize("cls", TO_BOARD, ids=named)
def test_before_the_handshake_nothing_but_hello_is_heard(cls: Any) -> None:
    harness = Harness()
    frames = harness.turn(harness.raw_frame(cls.ID, b"\x05" + bytes(cls.STRUCT.size - 1)), ticks=3)
    assert harness.executed == []
    assert harness.streamed == []
    if cls.ID == MessageId.HELLO:
        (welcome,) = payloads_of(frames, MessageId.WELCOME)
        assert welcome[1] == Result.HASH_MISMATCH
    elif cls in STREAMS:
        assert frames == []
    else:
        (ack,) = acks_in(frames)
        assert (ack.request, ack.command, ack.result) == (5, cls.ID, Result.NO_HANDSHAKE)


def test_before_the_handshake_the_board_says_nothing_by_itself() -> None:
    harness = Harness()
    harness.native.push_event(0, 0)
    harness.native.push_samples(0, slowly_changing_samples(60))
    assert harness.turn(ticks=3000) == []


def test_events_before_the_handshake_are_reported_after_it() -> None:
    harness = Harness()
    for tick in range(5):
        harness.native.push_event(tick, 1)
    harness.turn(ticks=100)
    frames = harness.turn(harness.frame(HelloMessage(1, LINK_HASH, 1)))
    assert [frame.id for frame in frames] == [MessageId.WELCOME] + [MessageId.EVENT] * 5
    assert [event[0] for event in payloads_of(frames, MessageId.EVENT)] == [0, 1, 2, 3, 4]


def test_another_declaration_gets_welcome_with_the_mismatch_and_no_session() -> None:
    harness = Harness()
    welcome = harness.hello(link_hash=LINK_HASH ^ 1)
    assert (welcome.result, welcome.link_hash) == (Result.HASH_MISMATCH, LINK_HASH)
    (ack,) = acks_in(harness.ask(ArmMessage(3)))
    assert ack.result == Result.NO_HANDSHAKE


def test_a_host_of_another_declaration_ends_the_session_of_the_one_before() -> None:
    harness = open_harness()
    harness.hello(link_hash=LINK_HASH ^ 1)
    assert harness.native.ticks_since_host_frame() == NEVER
    (ack,) = acks_in(harness.ask(ArmMessage(3)))
    assert ack.result == Result.NO_HANDSHAKE


def test_welcome_carries_the_device_time() -> None:
    harness = Harness()
    harness.turn(ticks=1234)
    assert harness.hello().tick == 1234


def test_the_age_of_the_link_counts_from_the_last_valid_frame() -> None:
    harness = Harness()
    assert harness.native.ticks_since_host_frame() == NEVER
    harness.hello()
    harness.turn(ticks=250)
    assert harness.native.ticks_since_host_frame() == 250
    harness.turn(b"noise\0more noise\0", ticks=10)
    assert harness.native.ticks_since_host_frame() == 260
    harness.turn(harness.frame(PingMessage(1, 0)))
    assert harness.native.ticks_since_host_frame() == 0


def test_a_retry_is_answered_from_memory_and_not_executed_again() -> None:
    harness = open_harness(lambda _id, _payload: (Result.CHECK_FAILED, 21, 1.5))
    first = acks_in(harness.ask(ArmMessage(7)))
    again = acks_in(harness.ask(ArmMessage(7)))
    assert first == again
    assert (first[0].result, first[0].detail, first[0].value) == (Result.CHECK_FAILED, 21, 1.5)
    assert len(harness.executed) == 1
    assert harness.status().duplicates == 1


def test_retries_that_overtake_the_answer_are_answered_once() -> None:
    harness = open_harness()
    frames = harness.turn(harness.frame(ArmMessage(7)) * 3, ticks=3)
    assert len(harness.executed) == 1
    assert len(acks_in(frames)) == 1


def test_a_new_session_forgets_the_commands_of_the_old_one() -> None:
    harness = open_harness()
    harness.ask(ArmMessage(7))
    harness.hello(session=2)
    harness.ask(ArmMessage(7))
    assert len(harness.executed) == 2


def test_the_same_session_that_reconnects_does_not_repeat_its_command() -> None:
    harness = open_harness()
    harness.ask(ArmMessage(7))
    harness.hello(session=1)
    harness.ask(ArmMessage(7))
    assert len(harness.executed) == 1


def test_a_stop_is_executed_though_256_pings_brought_its_number_round_again() -> None:
    harness = open_harness()
    harness.ask(StopMessage(9))
    for request in range(10, 10 + 255):
        harness.turn(harness.frame(PingMessage(request % 256, 0)))
    harness.ask(StopMessage(9))
    assert len(harness.executed) == 2


def test_a_stop_is_executed_though_commands_of_one_byte_brought_its_number_round_again() -> None:
    harness = open_harness()
    harness.ask(StopMessage(9))
    for request in range(10, 10 + 255):
        harness.turn(harness.frame(StatusReadMessage(request % 256)))
    harness.ask(StopMessage(9))
    assert len(harness.executed) == 2


def test_the_same_number_on_another_command_is_another_command() -> None:
    harness = open_harness()
    harness.ask(ParamSetMessage(9, 10, 1.0))
    harness.ask(ParamSetMessage(9, 10, 2.0))
    harness.ask(StopMessage(9))
    assert len(harness.executed) == 3


def test_one_command_at_a_time_the_second_waits_for_its_retry() -> None:
    harness = open_harness()
    frames = harness.turn(harness.frame(ArmMessage(1)) + harness.frame(LandMessage(2)), ticks=3)
    assert [ack.request for ack in acks_in(frames)] == [1]
    (ack,) = acks_in(harness.ask(LandMessage(2)))
    assert ack.request == 2
    assert [message_id for message_id, _ in harness.executed] == [MessageId.ARM, MessageId.LAND]


def test_a_stop_on_the_heels_of_another_command_is_executed_without_a_retry() -> None:
    harness = open_harness()
    frames = harness.turn(harness.frame(ArmMessage(1)) + harness.frame(StopMessage(2)) * 3, ticks=4)
    assert [message_id for message_id, _ in harness.executed] == [MessageId.ARM, MessageId.STOP]
    assert [ack.request for ack in acks_in(frames)] == [1, 2]
    assert acks_in(harness.ask(StopMessage(2)))[0].request == 2
    assert len(harness.executed) == 2


@st.composite
def line_faults(draw: st.DrawFn) -> tuple[list[int], list[int]]:
    """How many copies of each frame arrive, towards the board and from it; 0 is a loss."""
    copies = st.lists(st.sampled_from([0, 0, 1, 1, 1, 2, 3]), min_size=60, max_size=60)
    return draw(copies), draw(copies)


@pytest.mark.medium
@given(line_faults(), st.integers(0, 255))
def test_every_acknowledged_command_took_effect_once_whatever_the_line_lost(
    faults: tuple[list[int], list[int]], first_request: int
) -> None:
    to_board, from_board = (iter(copies) for copies in faults)
    done: list[float] = []

    def execute(_message_id: int, payload: bytes) -> tuple[int, int, float]:
        (value,) = struct.unpack_from("<f", payload, 2)
        done.append(value)
        return Result.OK, 0, value

    harness = open_harness(execute)
    for number in range(12):
        message = ParamSetMessage((first_request + number) % 256, 10, float(number))
        acknowledged = False
        for _attempt in range(5):
            wire = harness.frame(message) * next(to_board, 1)
            acks = acks_in(harness.turn(wire, ticks=4))
            arrived = acks * next(from_board, 1)
            if arrived:
                assert {(ack.request, ack.value) for ack in arrived} == {(message.request, float(number))}
                acknowledged = True
                break
        assert done.count(float(number)) <= 1
        if acknowledged:
            assert done.count(float(number)) == 1
    assert done == sorted(done)


def test_a_setpoint_before_the_handshake_is_not_remembered() -> None:
    harness = Harness()
    harness.turn(harness.frame(SetpointMessage(0, 0.1, 0.0, 0.0)))
    harness.hello()
    harness.turn(ticks=5)
    assert harness.streamed == []
