"""The board's parser: damage costs the damaged frame and no other, and everything is counted."""

from __future__ import annotations

import itertools
import random

import pytest
from heli_host.declaration import MAX_COMMAND_PAYLOAD, MessageId
from heli_host.link.frames import encode_frame
from heli_test_native import link as core_link
from hypothesis import given
from hypothesis import strategies as st

payloads = st.binary(max_size=MAX_COMMAND_PAYLOAD)
ids = st.integers(2, 127)  # 1 is hello, with which a host may restart its count
messages = st.lists(st.tuples(ids, payloads), max_size=12)


def stream_of(frames: list[tuple[int, bytes]], first: int = 0) -> bytes:
    return b"".join(encode_frame(mid, first + k, payload) for k, (mid, payload) in enumerate(frames))


def contents(frames: list[tuple[int, int, bytes]]) -> list[tuple[int, bytes]]:
    return [(message_id, payload) for message_id, _, payload in frames]


@pytest.mark.medium
@given(messages, st.lists(st.integers(0, 900), max_size=30))
def test_frames_survive_any_chopping_of_the_stream(sent: list[tuple[int, bytes]], cuts: list[int]) -> None:
    stream = stream_of(sent)
    edges = [0, *sorted(cut for cut in cuts if cut < len(stream)), len(stream)]
    parser = core_link.Parser()
    frames = [f for a, b in itertools.pairwise(edges) for f in parser.feed(stream[a:b])]
    assert contents(frames) == sent
    assert (parser.frames_ok, parser.frames_bad, parser.frames_lost) == (len(sent), 0, 0)


@pytest.mark.medium
@given(st.binary(max_size=400), messages)
def test_after_any_garbage_the_first_delimiter_brings_it_in_step(
    garbage: bytes, sent: list[tuple[int, bytes]]
) -> None:
    parser = core_link.Parser()
    parser.feed(garbage + b"\0")
    before = parser.frames_ok
    assert contents(parser.feed(stream_of(sent))) == sent
    assert parser.frames_ok == before + len(sent)


@pytest.mark.medium
@given(st.binary(min_size=1, max_size=400).map(lambda b: b.replace(b"\0", b"\x01")), messages)
def test_garbage_without_a_delimiter_costs_one_frame(garbage: bytes, sent: list[tuple[int, bytes]]) -> None:
    parser = core_link.Parser()
    assert contents(parser.feed(garbage + stream_of(sent))) == sent[1:]
    assert parser.frames_bad == (1 if sent else 0)


@pytest.mark.medium
@given(ids, payloads, st.data())
def test_no_frame_with_a_changed_byte_is_accepted(
    message_id: int, payload: bytes, data: st.DataObject
) -> None:
    wire = bytearray(encode_frame(message_id, 5, payload))
    at = data.draw(st.integers(0, len(wire) - 2))
    wire[at] ^= data.draw(st.integers(1, 255))
    parser = core_link.Parser()
    assert parser.feed(bytes(wire)) == []
    assert parser.frames_bad >= 1
    assert contents(parser.feed(encode_frame(message_id, 6, payload))) == [(message_id, payload)]


@pytest.mark.medium
@given(st.lists(payloads, min_size=2, max_size=20), st.data())
def test_every_lost_byte_costs_at_most_two_frames(sent: list[bytes], data: st.DataObject) -> None:
    stream = stream_of([(10, payload) for payload in sent])
    at = data.draw(st.integers(0, len(stream) - 1))
    parser = core_link.Parser()
    frames = parser.feed(stream[:at] + stream[at + 1 :])
    assert len(frames) >= len(sent) - 2
    assert all(payload == sent[sequence] for _, sequence, payload in frames)


def test_empty_frames_are_neither_good_nor_bad() -> None:
    parser = core_link.Parser()
    parser.feed(b"\0\0\0")
    assert contents(parser.feed(b"\0" + encode_frame(10, 0, b"x") + b"\0")) == [(10, b"x")]
    assert (parser.frames_ok, parser.frames_bad, parser.bytes_dropped) == (1, 0, 0)


def test_a_command_longer_than_any_is_refused_and_counted() -> None:
    parser = core_link.Parser()
    wire = encode_frame(128, 0, bytes(MAX_COMMAND_PAYLOAD + 1))
    assert parser.feed(wire) == []
    assert parser.frames_bad == 1
    assert parser.bytes_dropped == len(wire) - 1
    assert contents(parser.feed(encode_frame(10, 1, bytes(MAX_COMMAND_PAYLOAD)))) == [
        (10, bytes(MAX_COMMAND_PAYLOAD))
    ]


@pytest.mark.medium
@given(st.integers(0, 255), st.integers(0, 254))
def test_a_gap_in_the_sequence_is_counted_modulo_256(first: int, missing: int) -> None:
    parser = core_link.Parser()
    parser.feed(encode_frame(10, first, b"") + encode_frame(10, first + missing + 1, b""))
    assert parser.frames_lost == missing


def test_a_repeated_frame_is_not_a_gap_of_255() -> None:
    parser = core_link.Parser()
    parser.feed(encode_frame(10, 7, b"") * 2)
    assert (parser.frames_ok, parser.frames_lost) == (2, 0)


def test_a_host_that_starts_again_with_hello_loses_nothing() -> None:
    parser = core_link.Parser()
    parser.feed(
        encode_frame(10, 99, b"") + encode_frame(MessageId.HELLO, 0, bytes(9)) + encode_frame(10, 1, b"")
    )
    assert parser.frames_lost == 0


def test_what_a_noisy_line_delivers_is_always_what_was_sent() -> None:
    rng = random.Random(20240611)
    sent_values = [rng.randbytes(rng.randrange(MAX_COMMAND_PAYLOAD)) for _ in range(2000)]
    stream = bytearray(stream_of([(10, payload) for payload in sent_values]))
    for _ in range(300):
        stream[rng.randrange(len(stream))] ^= 1 << rng.randrange(8)
    parser = core_link.Parser()
    arrived = parser.feed(bytes(stream))
    index = -1
    for _, sequence, payload in arrived:
        index += (sequence - index) % 256
        assert payload == sent_values[index]
    assert len(arrived) >= 2000 - 600
    assert parser.frames_ok == len(arrived)
    assert parser.frames_ok + parser.frames_lost <= 2000
