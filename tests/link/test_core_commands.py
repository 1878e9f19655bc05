"""The board's answer to each command and stream, and its session: a command takes effect exactly once."""

import math
import struct
from typing import Any

import pytest
from heli_host import declaration as d
from heli_host.link.frames import encode_frame
from hypothesis import given
from hypothesis import strategies as st

from tests.link.core_harness import (
    COMMANDS,
    STREAMS,
    TO_BOARD,
    Harness,
    acks_in,
    named,
    open_harness,
    payloads_of,
    slowly_changing_samples,
)

BY_BOARD_ALONE = (
    d.MessageId.HELLO, d.MessageId.PING, d.MessageId.PARAMS_READ, d.MessageId.STATUS_READ,
    d.MessageId.LAW_BEGIN, d.MessageId.LAW_PART, d.MessageId.LAW_END, d.MessageId.LAW_READ,
    d.MessageId.CONTROLLER_READ, d.MessageId.PARAMS_ORIGIN_READ,
)  # fmt: skip
BY_TICK = [cls for cls in COMMANDS if cls.ID not in BY_BOARD_ALONE]
NO_NUMBERS = [math.nan, math.inf, -math.inf]


def float_fields(cls: Any) -> list[tuple[int, int]]:
    """(position among the fields, byte offset) of the floats of a message."""
    matches = []
    offset = 0
    for field, code in enumerate(cls.STRUCT.format.lstrip("<")):
        if code == "f":
            matches.append((field, offset))
        offset += struct.calcsize("<" + code)
    return matches


FLOATS = [(cls, field, offset) for cls in TO_BOARD for field, offset in float_fields(cls)]


@pytest.mark.parametrize("cls", BY_TICK, ids=named)
def test_a_command_reaches_the_tick_as_it_was_sent_and_its_answer_the_host(cls: Any) -> None:
    harness = open_harness(lambda _id, _payload: (d.Result.BAD_STATE, 7, 2.5))
    payload = b"\x05" + bytes(cls.STRUCT.size - 1)
    frames = harness.turn(harness.raw_frame(cls.ID, payload), ticks=2)
    assert harness.executed == [(cls.ID, payload)]
    assert acks_in(frames) == [
        d.AckMessage(request=5, command=cls.ID, result=d.Result.BAD_STATE, detail=7, value=2.5)
    ]


@pytest.mark.parametrize("cls", COMMANDS, ids=named)
@pytest.mark.parametrize("change", [-1, 1, 30])
def test_a_command_of_wrong_length_is_refused(harness: Harness, cls: Any, change: int) -> None:
    payload = bytes(min(cls.STRUCT.size + change, d.MAX_COMMAND_PAYLOAD))
    (ack,) = acks_in(harness.turn(harness.raw_frame(cls.ID, payload), ticks=3))
    assert (ack.command, ack.result) == (cls.ID, d.Result.BAD_LENGTH)
    assert harness.executed == []


@pytest.mark.parametrize(("cls", "field", "offset"), FLOATS, ids=named)
def test_no_field_takes_what_is_no_number(harness: Harness, cls: Any, field: int, offset: int) -> None:
    for value in NO_NUMBERS:
        payload = bytearray(cls.STRUCT.size)
        struct.pack_into("<f", payload, offset, value)
        frames = harness.turn(harness.raw_frame(cls.ID, bytes(payload)), ticks=3)
        if cls in STREAMS:
            (event,) = (d.EventMessage.unpack(payload) for payload in payloads_of(frames, d.MessageId.EVENT))
            assert (event.kind, event.detail) == (d.Event.SETPOINT_REJECTED, d.Result.BAD_VALUE)
        else:
            (ack,) = acks_in(frames)
            assert (ack.result, ack.detail) == (d.Result.BAD_VALUE, field)
    assert harness.executed == []
    assert harness.streamed == []
    assert harness.status().stale_streams == (len(NO_NUMBERS) if cls in STREAMS else 0)


@pytest.mark.parametrize("message_id", [0, 30, 31, 35, 127])
def test_an_unknown_command_is_answered_as_such(harness: Harness, message_id: int) -> None:
    (ack,) = acks_in(harness.turn(harness.raw_frame(message_id, b"\x09rest")))
    assert (ack.request, ack.command, ack.result) == (9, message_id, d.Result.UNKNOWN_COMMAND)


def test_a_board_that_hears_itself_does_not_answer_itself(harness: Harness) -> None:
    for message_id in range(128, 256):
        assert harness.turn(harness.raw_frame(message_id, bytes(8)), ticks=2) == []


def test_a_board_that_hears_itself_does_not_take_itself_for_a_host(harness: Harness) -> None:
    harness.turn(ticks=400)
    harness.turn(harness.raw_frame(d.MessageId.EVENT, bytes(11)))
    assert harness.native.ticks_since_host_frame() == 401


def test_a_stop_is_executed_even_when_no_answer_can_leave(harness: Harness) -> None:
    harness.room = 0
    harness.ask(d.ArmMessage(1))
    harness.ask(d.ArmMessage(2))
    harness.ask(d.StopMessage(3))
    assert [message_id for message_id, _ in harness.executed] == [d.MessageId.ARM, d.MessageId.STOP]
    harness.room = 100
    assert [ack.request for ack in acks_in(harness.turn())] == [3]


def test_ping_returns_the_host_clock_and_the_tick_of_the_answer(harness: Harness) -> None:
    harness.turn(ticks=100)
    (pong,) = payloads_of(harness.turn(harness.frame(d.PingMessage(3, 2**60 + 5))), d.MessageId.PONG)
    assert d.PongMessage.unpack(pong) == d.PongMessage(3, 2**60 + 5, 101)


def test_a_pong_that_had_to_wait_carries_the_tick_at_which_it_left(harness: Harness) -> None:
    harness.room = 0
    sent = harness.turn(harness.frame(d.PingMessage(3, 5)), ticks=20)
    assert sent == []
    harness.room = 100
    (pong,) = payloads_of(harness.turn(), d.MessageId.PONG)
    assert d.PongMessage.unpack(pong).tick == harness.tick - 1


@pytest.mark.parametrize("first", [0, 1, 20, 31, 32, len(d.PARAMS) - 1])
def test_params_are_read_in_table_order_at_most_32_at_a_time(harness: Harness, first: int) -> None:
    (payload,) = payloads_of(harness.ask(d.ParamsReadMessage(4, first)), d.MessageId.PARAMS)
    head = d.ParamsMessage.unpack(payload)
    expected = [spec.default for spec in d.PARAMS[first : first + 32]]
    assert (head.request, head.first, head.count) == (4, first, len(expected))
    values = struct.unpack(f"<{head.count}f", payload[d.ParamsMessage.STRUCT.size :])
    assert values == pytest.approx(expected, rel=1e-7)


def test_there_is_nothing_to_read_beyond_the_table(harness: Harness) -> None:
    for first in (len(d.PARAMS), 255):
        (ack,) = acks_in(harness.ask(d.ParamsReadMessage(4, first)))
        assert (ack.result, ack.detail) == (d.Result.NO_SUCH_PARAMETER, first)


def test_saving_writes_the_flash_only_after_the_tick_agreed() -> None:
    harness = open_harness(lambda _id, _payload: (d.Result.BAD_STATE, 2, 0.0))
    erased = harness.native.board.flash
    (ack,) = acks_in(harness.ask(d.ParamsSaveMessage(1)))
    assert ack.result == d.Result.BAD_STATE
    assert harness.native.board.flash == erased


def test_a_save_is_reported_with_its_generation_and_not_repeated(harness: Harness) -> None:
    for generation in (1, 2):
        frames = harness.ask(d.ParamsSaveMessage(generation))
        (ack,) = acks_in(frames)
        (event,) = (d.EventMessage.unpack(payload) for payload in payloads_of(frames, d.MessageId.EVENT))
        assert (ack.result, ack.value) == (d.Result.OK, generation)
        assert (event.kind, event.value) == (d.Event.PARAMS_SAVED, generation)
        assert acks_in(harness.ask(d.ParamsSaveMessage(generation))) == [ack]
    assert harness.native.store.generation == 2
    assert harness.native.store.source == d.ParamsSource.STORED


def test_a_flash_that_does_not_hold_what_was_written_is_reported(harness: Harness) -> None:
    harness.native.board.steps_left = 300
    frames = harness.ask(d.ParamsSaveMessage(1))
    (ack,) = acks_in(frames)
    assert ack.result == d.Result.FLASH_FAILED
    assert payloads_of(frames, d.MessageId.EVENT) == []


def test_streams_reach_the_tick_unanswered_and_in_order(harness: Harness) -> None:
    setpoint = d.SetpointMessage(apply_tick=1000, elevation_rad=0.25, pitch_rad=-0.5, travel_rad=1.0)
    voltages = d.VoltagesMessage(front_V=3.0, back_V=4.0, valid_ms=50)
    frames = harness.turn(harness.frame(setpoint) + harness.frame(voltages), ticks=3)
    assert frames == []
    assert harness.streamed == [(setpoint.ID, setpoint.pack()), (voltages.ID, voltages.pack())]


def test_of_more_streamed_values_than_the_tick_takes_the_latest_wins(harness: Harness) -> None:
    values = [d.VoltagesMessage(front_V=float(k), back_V=0.0, valid_ms=50) for k in range(20)]
    harness.turn(b"".join(harness.frame(value) for value in values), ticks=4)
    assert harness.streamed[-1] == (d.MessageId.VOLTAGES, values[-1].pack())
    assert len(harness.streamed) < 20


def test_a_stream_of_wrong_length_is_refused_and_counted(harness: Harness) -> None:
    frames = harness.turn(harness.raw_frame(d.MessageId.SETPOINT, bytes(15)))
    (event,) = (d.EventMessage.unpack(payload) for payload in payloads_of(frames, d.MessageId.EVENT))
    assert (event.kind, event.detail) == (d.Event.SETPOINT_REJECTED, d.Result.BAD_LENGTH)
    assert harness.status().stale_streams == 1


def test_streams_pass_while_a_command_is_with_the_tick(harness: Harness) -> None:
    setpoint = d.SetpointMessage(apply_tick=0, elevation_rad=0.1, pitch_rad=0.0, travel_rad=0.0)
    harness.turn(harness.frame(d.ArmMessage(1)) + harness.frame(setpoint), ticks=2)
    assert harness.streamed == [(setpoint.ID, setpoint.pack())]


def test_the_status_counts_what_the_parser_saw(harness: Harness) -> None:
    harness.native.publish(17)
    harness.turn(b"garbage\0")
    harness.frame(d.ArmMessage(1))  # lost on the way
    counters = harness.status()
    assert (counters.frames_ok, counters.frames_bad, counters.frames_lost) == (2, 1, 1)
    assert (counters.overruns, counters.tick) == (17, harness.tick - 3)


frames_to_board = st.tuples(
    st.one_of(st.sampled_from([int(cls.ID) for cls in TO_BOARD]), st.integers(0, 255)),
    st.binary(max_size=d.MAX_COMMAND_PAYLOAD),
)


@pytest.mark.medium
@given(st.lists(frames_to_board, max_size=40), st.booleans())
def test_no_sequence_of_frames_keeps_the_board_from_answering_a_ping(
    frames: list[tuple[int, bytes]], handshake: bool
) -> None:
    harness = open_harness() if handshake else Harness()
    for message_id, payload in frames:
        harness.turn(harness.raw_frame(message_id, payload))
    harness.turn(ticks=5)
    harness.hello(session=99)
    (pong,) = payloads_of(harness.ask(d.PingMessage(77, 1)), d.MessageId.PONG)
    assert pong[0] == 77


@pytest.mark.medium
@given(st.lists(st.binary(max_size=100), max_size=20))
def test_no_bytes_keep_the_board_from_answering_a_ping(chunks: list[bytes]) -> None:
    harness = Harness()
    for chunk in chunks:
        harness.turn(chunk)
    harness.turn(b"\0", ticks=3)
    harness.hello()
    assert payloads_of(harness.ask(d.PingMessage(1, 1)), d.MessageId.PONG)


def test_the_sequence_numbers_of_the_board_have_no_gap(harness: Harness) -> None:
    frames = [
        frame
        for k in range(600)
        for frame in harness.turn(encode_frame(message_id=2, seq=k, payload=bytes(9)))
    ]
    assert [b.seq for b in frames] == [(frames[0].seq + k) % 256 for k in range(len(frames))]
    assert len(frames) == 600


def test_the_board_gives_the_names_of_its_controllers_and_how_many_it_has(harness: Harness) -> None:
    for index, name in ((0, b"cascade"), (1, b"sixteen_letters_"), (2, b""), (255, b"")):
        frames = harness.turn(harness.frame(d.ControllerReadMessage(9, index)), ticks=2)
        (payload,) = payloads_of(frames, d.MessageId.CONTROLLER)
        answer = d.ControllerMessage.unpack(payload)
        name_words = (answer.name_0, answer.name_1, answer.name_2, answer.name_3)
        assert (answer.request, answer.index, answer.count) == (9, index, 2)
        assert b"".join(word.to_bytes(4, "little") for word in name_words).rstrip(b"\0") == name


NEVER = 0xFFFFFFFF


@pytest.mark.parametrize("cls", TO_BOARD, ids=named)
def test_before_the_handshake_nothing_but_hello_is_heard(cls: Any) -> None:
    harness = Harness()
    frames = harness.turn(harness.raw_frame(cls.ID, b"\x05" + bytes(cls.STRUCT.size - 1)), ticks=3)
    assert harness.executed == []
    assert harness.streamed == []
    if cls.ID == d.MessageId.HELLO:
        (welcome,) = payloads_of(frames, d.MessageId.WELCOME)
        assert welcome[1] == d.Result.HASH_MISMATCH
    elif cls in STREAMS:
        assert frames == []
    else:
        (ack,) = acks_in(frames)
        assert (ack.request, ack.command, ack.result) == (5, cls.ID, d.Result.NO_HANDSHAKE)


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
    frames = harness.turn(harness.frame(d.HelloMessage(request=1, link_hash=d.LINK_HASH, session=1)))
    assert [frame.id for frame in frames] == [d.MessageId.WELCOME] + [d.MessageId.EVENT] * 5
    events = [d.EventMessage.unpack(payload) for payload in payloads_of(frames, d.MessageId.EVENT)]
    assert [event.tick for event in events] == [0, 1, 2, 3, 4]


def test_another_declaration_gets_welcome_with_the_mismatch_and_no_session() -> None:
    harness = Harness()
    welcome = harness.hello(link_hash=d.LINK_HASH ^ 1)
    assert (welcome.result, welcome.link_hash) == (d.Result.HASH_MISMATCH, d.LINK_HASH)
    (ack,) = acks_in(harness.ask(d.ArmMessage(3)))
    assert ack.result == d.Result.NO_HANDSHAKE


def test_a_host_of_another_declaration_ends_the_session_of_the_one_before(harness: Harness) -> None:
    harness.hello(link_hash=d.LINK_HASH ^ 1)
    assert harness.native.ticks_since_host_frame() == NEVER
    (ack,) = acks_in(harness.ask(d.ArmMessage(3)))
    assert ack.result == d.Result.NO_HANDSHAKE


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
    harness.turn(harness.frame(d.PingMessage(1, 0)))
    assert harness.native.ticks_since_host_frame() == 0


def test_a_retry_is_answered_from_memory_and_not_executed_again() -> None:
    harness = open_harness(lambda _id, _payload: (d.Result.CHECK_FAILED, 21, 1.5))
    first = acks_in(harness.ask(d.ArmMessage(7)))
    again = acks_in(harness.ask(d.ArmMessage(7)))
    assert first == again
    assert (first[0].result, first[0].detail, first[0].value) == (d.Result.CHECK_FAILED, 21, 1.5)
    assert len(harness.executed) == 1
    assert harness.status().duplicates == 1


def test_retries_that_overtake_the_answer_are_answered_once(harness: Harness) -> None:
    frames = harness.turn(harness.frame(d.ArmMessage(7)) * 3, ticks=3)
    assert len(harness.executed) == 1
    assert len(acks_in(frames)) == 1


def test_a_new_session_forgets_the_commands_of_the_old_one(harness: Harness) -> None:
    harness.ask(d.ArmMessage(7))
    harness.hello(session=2)
    harness.ask(d.ArmMessage(7))
    assert len(harness.executed) == 2


def test_the_same_session_that_reconnects_does_not_repeat_its_command(harness: Harness) -> None:
    harness.ask(d.ArmMessage(7))
    harness.hello(session=1)
    harness.ask(d.ArmMessage(7))
    assert len(harness.executed) == 1


def test_a_stop_is_executed_though_256_pings_brought_its_number_round_again(harness: Harness) -> None:
    harness.ask(d.StopMessage(9))
    for request in range(10, 10 + 255):
        harness.turn(harness.frame(d.PingMessage(request % 256, 0)))
    harness.ask(d.StopMessage(9))
    assert len(harness.executed) == 2


def test_a_stop_is_executed_though_commands_of_one_byte_brought_its_number_round_again(
    harness: Harness,
) -> None:
    harness.ask(d.StopMessage(9))
    for request in range(10, 10 + 255):
        harness.turn(harness.frame(d.StatusReadMessage(request % 256)))
    harness.ask(d.StopMessage(9))
    assert len(harness.executed) == 2


def test_the_same_number_on_another_command_is_another_command(harness: Harness) -> None:
    harness.ask(d.ParamSetMessage(9, 10, 1.0))
    harness.ask(d.ParamSetMessage(9, 10, 2.0))
    harness.ask(d.StopMessage(9))
    assert len(harness.executed) == 3


def test_one_command_at_a_time_the_second_waits_for_its_retry(harness: Harness) -> None:
    frames = harness.turn(harness.frame(d.ArmMessage(1)) + harness.frame(d.LandMessage(2)), ticks=3)
    assert [ack.request for ack in acks_in(frames)] == [1]
    (ack,) = acks_in(harness.ask(d.LandMessage(2)))
    assert ack.request == 2
    assert [message_id for message_id, _ in harness.executed] == [d.MessageId.ARM, d.MessageId.LAND]


def test_a_stop_on_the_heels_of_another_command_is_executed_without_a_retry(harness: Harness) -> None:
    frames = harness.turn(harness.frame(d.ArmMessage(1)) + harness.frame(d.StopMessage(2)) * 3, ticks=4)
    assert [message_id for message_id, _ in harness.executed] == [d.MessageId.ARM, d.MessageId.STOP]
    assert [ack.request for ack in acks_in(frames)] == [1, 2]
    assert acks_in(harness.ask(d.StopMessage(2)))[0].request == 2
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
        return d.Result.OK, 0, value

    harness = open_harness(execute)
    for number in range(12):
        message = d.ParamSetMessage((first_request + number) % 256, 10, float(number))
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
    harness.turn(
        harness.frame(d.SetpointMessage(apply_tick=0, elevation_rad=0.1, pitch_rad=0.0, travel_rad=0.0))
    )
    harness.hello()
    harness.turn(ticks=5)
    assert harness.streamed == []
