"""The board sends every tick once, counts gaps, and sends replies before events before telemetry."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.declaration import PARAMS, Channel, MessageId, ParamSetMessage, PingMessage, Result
from heli_host.link.frames import Frame
from hypothesis import given
from hypothesis import strategies as st

from tests.channels.groups import UNSIGNED
from tests.link import host_reference as reference
from tests.link.core_harness import Harness, open_harness, payloads_of, slowly_changing_samples

BATCH = next(spec for spec in PARAMS if spec.name == "telemetry_batch_ticks")
RING_TICKS = 64


def turn_with_sample(harness: Harness, row: np.ndarray, received: bytes = b"") -> list[Frame]:
    """One millisecond in which the tick logs one sample."""
    harness.native.push_samples(harness.tick, row.reshape(1, -1))
    return harness.turn(received)


def batches(frames: list[Frame]) -> list[tuple[int, list[list[int]]]]:
    return [reference.telemetry_samples(payload) for payload in payloads_of(frames, MessageId.TELEMETRY)]


def ticks_of(frames: list[Frame]) -> list[int]:
    return [first + k for first, rows in batches(frames) for k in range(len(rows))]


def test_every_tick_of_a_session_arrives_once_and_in_order() -> None:
    harness = open_harness()
    start = harness.tick
    raw = np.random.default_rng(1).integers(-100, 100, (400, len(Channel))).astype(np.int32)
    raw[:, UNSIGNED] &= 7
    frames: list[Frame] = []
    for row in raw:
        frames += turn_with_sample(harness, row)
    got = [row for _, rows in batches(frames) for row in rows]
    assert ticks_of(frames) == list(range(start, start + 400))
    assert got == raw.tolist()
    assert harness.status().ticks_dropped == 0


def test_a_batch_has_as_many_ticks_as_the_parameter_says() -> None:
    harness = Harness(lambda _id, _payload: (Result.OK, 0, 0.0))
    harness.hello()
    for count in (20, 4, 32):
        harness.native.params.set(BATCH.index, float(count), True)
        harness.ask(ParamSetMessage(count, BATCH.index, float(count)))
        frames = [frame for row in slowly_changing_samples(200) for frame in turn_with_sample(harness, row)]
        sizes = [len(rows) for _, rows in batches(frames)]
        assert sizes[2:]
        assert set(sizes[2:]) == {count}


def test_a_gap_in_the_ticks_ends_a_batch() -> None:
    harness = open_harness()
    harness.native.push_samples(100, slowly_changing_samples(7))
    harness.native.push_samples(200, slowly_changing_samples(20))
    assert [(first, len(rows)) for first, rows in batches(harness.turn())] == [(100, 7), (200, 20)]


def test_tick_numbers_may_wrap() -> None:
    harness = open_harness()
    harness.native.push_samples(2**32 - 10, slowly_changing_samples(20))
    assert [(first, len(rows)) for first, rows in batches(harness.turn())] == [(2**32 - 10, 20)]


def test_an_idle_loop_that_is_late_loses_nothing_within_the_ring() -> None:
    harness = open_harness()
    harness.native.push_samples(0, slowly_changing_samples(RING_TICKS))
    frames = harness.turn()
    harness.native.push_samples(RING_TICKS, slowly_changing_samples(16))
    assert ticks_of(frames + harness.turn()) == list(range(80))


def test_ticks_beyond_the_ring_are_lost_and_counted() -> None:
    harness = open_harness()
    harness.native.push_samples(0, slowly_changing_samples(RING_TICKS + 9))
    harness.turn()
    assert harness.status().ticks_dropped == 9


def test_a_full_line_costs_whole_batches_which_are_counted() -> None:
    harness = open_harness()
    harness.room = 0
    start = harness.tick
    frames: list[Frame] = []
    for row in slowly_changing_samples(500):
        frames += turn_with_sample(harness, row)
    assert frames == []
    harness.room = 100000
    for row in slowly_changing_samples(100):
        frames += turn_with_sample(harness, row)
    seen = ticks_of(frames)
    missing = set(range(start, seen[-1])) - set(seen)
    assert sorted(set(seen)) == seen
    assert harness.status().ticks_dropped == len(missing) > 400
    # What does arrive is fresh: nothing older than what batch and ring can hold.
    assert seen[0] >= start + 500 - RING_TICKS


def test_replies_leave_before_events_and_events_before_telemetry() -> None:
    harness = open_harness()
    harness.room = 0
    harness.native.push_event(0, 1)
    harness.native.push_samples(0, slowly_changing_samples(20))
    harness.turn(harness.frame(PingMessage(1, 0)), ticks=2)
    harness.room = 10000
    assert [frame.id for frame in harness.turn()] == [MessageId.PONG, MessageId.EVENT, MessageId.TELEMETRY]


@pytest.mark.slow
@given(st.lists(st.integers(0, 120), min_size=200, max_size=200))
def test_the_board_never_sends_more_than_there_is_room_for(rooms: list[int]) -> None:
    harness = open_harness()
    for number, room in enumerate(rooms):
        harness.room = room  # the bench raises when more is sent
        harness.native.push_event(harness.tick, 1)
        turn_with_sample(harness, slowly_changing_samples(1)[0], harness.frame(PingMessage(number % 256, 0)))


def test_status_comes_once_a_second_by_itself() -> None:
    harness = open_harness()
    frames = harness.turn(ticks=5000)
    assert [payload[0] for payload in payloads_of(frames, MessageId.STATUS)] == [0] * 5


def test_of_too_many_events_the_first_sixteen_are_kept() -> None:
    harness = open_harness()
    for tick in range(30):
        harness.native.push_event(tick, 1)
    events = payloads_of(harness.turn(), MessageId.EVENT)
    assert [event[0] for event in events] == list(range(16))
