"""Frames of the host: against a slow witness, and with the damage that a line does."""

from __future__ import annotations

import random

import pytest
from heli_host.declaration import MAX_COMMAND_PAYLOAD, MAX_TELEMETRY_PAYLOAD, PROTOCOL
from heli_host.link.frames import Frame, FrameParser, encode_frame
from hypothesis import given
from hypothesis import strategies as st

from tests.link import host_reference as reference

payloads = st.binary(max_size=MAX_TELEMETRY_PAYLOAD)
ids = st.integers(128, 255)


@pytest.mark.medium
@given(ids, st.integers(0, 1000), payloads)
def test_a_frame_is_what_the_slow_witness_makes(message_id: int, seq: int, payload: bytes) -> None:
    assert encode_frame(message_id, seq, payload) == reference.frame(message_id, seq, payload)


@pytest.mark.medium
@given(st.lists(st.tuples(ids, payloads), max_size=20), st.data())
def test_frames_survive_any_chopping_of_the_stream(
    messages: list[tuple[int, bytes]], data: st.DataObject
) -> None:
    stream = b"".join(
        encode_frame(message_id, seq, payload) for seq, (message_id, payload) in enumerate(messages)
    )
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=30)))
    parser = FrameParser()
    frames = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        frames += parser.feed(stream[start:end])
    assert frames == [Frame(message_id, seq, payload) for seq, (message_id, payload) in enumerate(messages)]
    assert (parser.frames_ok, parser.frames_bad, parser.frames_lost) == (len(messages), 0, 0)
    assert parser.bytes_dropped == 0
    assert parser.bytes_received == len(stream)


@pytest.mark.medium
@given(st.binary(max_size=2000), st.binary(max_size=40))
def test_after_any_garbage_the_parser_is_in_step_at_the_next_delimiter(
    garbage: bytes, payload: bytes
) -> None:
    parser = FrameParser()
    parser.feed(garbage)
    parser.feed(b"\0")
    assert parser.feed(encode_frame(200, 3, payload))[-1:] == [Frame(200, 3, payload)]


@pytest.mark.medium
@given(st.binary(min_size=1, max_size=3000))
def test_every_byte_of_a_stream_is_in_a_frame_or_counted_as_dropped(garbage: bytes) -> None:
    parser = FrameParser()
    kept = sum(len(frame.payload) + 8 for frame in parser.feed(garbage + b"\0"))
    assert kept + parser.bytes_dropped + (garbage + b"\0").count(0) == len(garbage) + 1
    assert parser.excerpt == b"" or garbage.replace(b"\0", b"").endswith(parser.excerpt)


def test_a_missing_frame_is_counted_as_lost_and_a_repeated_one_is_not() -> None:
    parser = FrameParser()
    frames = [encode_frame(134, seq, b"") for seq in range(250, 270)]
    parser.feed(frames[0] + frames[1] + frames[1] + frames[5] + frames[6])
    assert (parser.frames_ok, parser.frames_lost, parser.frames_repeated) == (5, 3, 1)


def test_a_restart_of_the_other_end_is_not_a_loss() -> None:
    parser = FrameParser()
    parser.feed(encode_frame(134, 77, b""))
    parser.restart_sequence()
    parser.feed(encode_frame(134, 0, b""))
    assert parser.frames_lost == 0


def test_joining_in_the_middle_of_a_frame_is_no_bad_frame() -> None:
    parser = FrameParser()
    frames = parser.feed(encode_frame(133, 1, b"tail of this")[5:] + encode_frame(133, 2, b"whole"))
    assert [frame.payload for frame in frames] == [b"whole"]
    assert parser.frames_bad == 0
    assert parser.bytes_dropped > 0


def test_a_stream_without_delimiters_takes_bounded_memory_and_is_dropped() -> None:
    parser = FrameParser()
    for _ in range(100):
        assert parser.feed(b"\x55" * 1000) == []
        assert len(parser.pending) <= 1000
    parser.feed(b"\0")
    assert parser.bytes_dropped == 100_000
    assert [f.seq for f in parser.feed(encode_frame(134, 9, b""))] == [9]


def test_another_protocol_version_is_refused() -> None:
    plain = bytes([PROTOCOL + 1, 130, 0])
    frame = reference.cobs_encode(plain + reference.crc32(plain).to_bytes(4, "little")) + b"\0"
    parser = FrameParser()
    assert parser.feed(b"\0" + frame) == []
    assert parser.frames_bad == 1


def test_a_payload_longer_than_the_board_takes_is_refused_before_it_is_sent() -> None:
    with pytest.raises(ValueError, match=str(MAX_COMMAND_PAYLOAD)):
        encode_frame(1, 0, bytes(MAX_COMMAND_PAYLOAD + 1))
    with pytest.raises(ValueError, match=str(MAX_TELEMETRY_PAYLOAD)):
        encode_frame(133, 0, bytes(MAX_TELEMETRY_PAYLOAD + 1))


@pytest.mark.parametrize(("message_id", "size"), [(1, MAX_COMMAND_PAYLOAD), (133, MAX_TELEMETRY_PAYLOAD)])
def test_the_longest_payload_passes(message_id: int, size: int) -> None:
    payload = bytes(k % 251 for k in range(size))
    assert [frame.payload for frame in FrameParser().feed(encode_frame(message_id, 0, payload))] == [payload]


@pytest.mark.medium
@pytest.mark.parametrize("damage", ["flip", "drop", "double"])
def test_no_damaged_frame_passes_and_every_loss_is_counted(damage: str) -> None:
    chance = random.Random(7)
    sent_values = [
        bytes(chance.randrange(256) for _ in range(chance.randrange(10, 200))) for _ in range(3000)
    ]
    # 3 in 10^3 bytes: some thirty times worse than what the link must stand, so that much is tried.
    stream = bytearray()
    for byte in b"".join(encode_frame(133, seq, payload) for seq, payload in enumerate(sent_values)):
        hit = chance.random() < 3e-3
        if hit and damage == "flip":
            stream.append(byte ^ (1 << chance.randrange(8)))
        elif hit and damage == "double":
            stream += bytes([byte, byte])
        elif not hit:
            stream.append(byte)
    parser = FrameParser()
    frames = parser.feed(b"\0" + bytes(stream) + encode_frame(133, len(sent_values), b"last"))
    remaining = iter(enumerate(sent_values))
    for frame in frames[:-1]:
        assert any(seq % 256 == frame.seq and payload == frame.payload for seq, payload in remaining)
    assert frames[-1].payload == b"last"
    assert parser.frames_bad > 0
    assert parser.frames_ok + parser.frames_lost == len(sent_values) + 1
