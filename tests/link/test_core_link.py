"""The board's codec against zlib, cobs and a slow witness; its parser under damage; its telemetry."""

import itertools
import random
import zlib

import numpy as np
import pytest
from cobs import cobs
from heli_host import declaration as d
from heli_host.link.frames import Frame, encode_frame
from heli_test_native import link as core_link
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tests.channels.groups import SIGNED, UNSIGNED
from tests.link import host_reference as reference
from tests.link.core_harness import Harness, open_harness, payloads_of, slowly_changing_samples
from tests.running.long import samples

# Runs without a zero around the 254 bytes that a COBS block may hold.
RUNS = [b"\x01" * length for length in (0, 1, 253, 254, 255, 256, 507, 508, 509)]
BOUNDARIES = [*RUNS, *(run + b"\0" for run in RUNS), *(b"\0" + run for run in RUNS), b"\0" * 300]


@pytest.mark.medium
@given(st.binary(max_size=600), st.binary(max_size=50))
def test_crc_is_that_of_zlib_also_in_pieces(first: bytes, second: bytes) -> None:
    assert core_link.crc32(first) == zlib.crc32(first)
    assert core_link.crc32(second, core_link.crc32(first)) == zlib.crc32(first + second)


@pytest.mark.parametrize("plain", BOUNDARIES, ids=lambda b: f"{len(b)}:{b[:1].hex()}:{b[-1:].hex()}")
def test_cobs_is_that_of_the_cobs_package_at_block_boundaries(plain: bytes) -> None:
    assert core_link.cobs_encode(plain) == cobs.encode(plain)
    assert core_link.cobs_decode(cobs.encode(plain)) == plain


@pytest.mark.medium
@given(st.lists(st.one_of(st.binary(max_size=20), st.sampled_from(RUNS)), max_size=6).map(b"".join))
def test_cobs_is_that_of_the_cobs_package(plain: bytes) -> None:
    encoded = core_link.cobs_encode(plain)
    assert encoded == cobs.encode(plain)
    assert 0 not in encoded
    assert core_link.cobs_decode(encoded) == plain


@pytest.mark.medium
@given(st.binary(max_size=300).map(lambda b: b.replace(b"\0", b"\x01")))
def test_cobs_refuses_what_the_cobs_package_refuses(encoded: bytes) -> None:
    try:
        plain = cobs.decode(encoded)
    except cobs.DecodeError:
        with pytest.raises(ValueError, match="cut short"):
            core_link.cobs_decode(encoded)
    else:
        assert core_link.cobs_decode(encoded) == plain


@pytest.mark.medium
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=d.MAX_TELEMETRY_PAYLOAD)), max_size=5))
def test_frames_carry_protocol_id_sequence_payload_and_crc(messages: list[tuple[int, bytes]]) -> None:
    writer = core_link.FrameWriter()
    for sequence, (message_id, payload) in enumerate(messages):
        wire = writer.write(message_id, payload)
        plain = bytes([d.PROTOCOL, message_id, sequence]) + payload
        assert wire == cobs.encode(plain + zlib.crc32(plain).to_bytes(4, "little")) + b"\0"


def test_the_sequence_number_wraps_after_255() -> None:
    writer = core_link.FrameWriter()
    sequences = [cobs.decode(writer.write(1, b"")[:-1])[2] for _ in range(300)]
    assert sequences == [k % 256 for k in range(300)]


def unpacked(payloads: list[bytes], first_tick: int) -> list[list[int]]:
    """All rows of consecutive batches; fails when a tick is missing, double or out of order."""
    rows: list[list[int]] = []
    for payload in payloads:
        tick, batch = reference.telemetry_samples(payload)
        assert tick == (first_tick + len(rows)) % 2**32
        rows += batch
    return rows


def channel(wire_type: str) -> st.SearchStrategy[int]:
    low, high = reference.limits(wire_type)
    return st.one_of(st.integers(low, high), st.integers(0, 3), st.sampled_from([low, high]))


@st.composite
def raw_ticks(draw: st.DrawFn) -> np.ndarray:
    count = draw(st.integers(1, 70))
    columns = [
        draw(npst.arrays(np.int32, count, elements=channel(wire_type), fill=channel(wire_type)))
        for wire_type in reference.TYPES
    ]
    return np.stack(columns, axis=1).astype(np.int32, order="C")


@pytest.mark.slow
@settings(max_examples=samples(100, 30))
@given(st.integers(0, 2**32 - 1), raw_ticks())
@example(2**32 - 3, np.arange(10 * len(d.Channel), dtype=np.int32).reshape(10, -1))
def test_packed_ticks_come_out_of_the_witness_as_they_were(first_tick: int, raw: np.ndarray) -> None:
    payloads = core_link.pack_telemetry(first_tick, raw)
    assert unpacked(payloads, first_tick) == raw.tolist()
    assert all(len(payload) <= d.MAX_TELEMETRY_PAYLOAD for payload in payloads)


@pytest.mark.medium
@given(st.integers(1, 32), st.sampled_from([0, 1, 2, 7, 8, 127, 128]), st.integers(0, 2**32 - 1))
def test_a_batch_is_packed_byte_for_byte_as_the_witness_does(count: int, step: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    raw = np.zeros((count, len(d.Channel)), dtype=np.int32)
    raw[:, SIGNED] = np.cumsum(rng.integers(-step, step + 1, (count, len(SIGNED))), axis=0)
    raw[:, UNSIGNED] = rng.integers(0, 2, (count, len(UNSIGNED)))
    payload = core_link.pack_telemetry(1000, raw)[0]
    assert payload == reference.telemetry_payload(1000, raw[: payload[4]].tolist())


@pytest.mark.parametrize(
    ("code", "deltas"),
    [
        (0, (0,)),
        (1, (1, -2)),
        (2, (2, -3, 7, -8)),
        (3, (8, -9, 127, -128)),
        (4, (128, -129, 32767, -32768)),
        (5, (32768, -32769, -(2**31))),
    ],
)
def test_a_delta_gets_the_narrowest_width_that_holds_it(code: int, deltas: tuple[int, ...]) -> None:
    for delta in deltas:
        raw = np.zeros((2, len(d.Channel)), dtype=np.int32)
        raw[1, d.Channel.ELEVATION_COUNT] = delta
        (payload,) = core_link.pack_telemetry(0, raw)
        widths = payload[d.TelemetryMessage.STRUCT.size :]
        # A byte has the codes of two channels, the first in its lower half.
        byte, is_upper_half = divmod(d.Channel.ELEVATION_COUNT, 2)
        assert widths[byte] >> (4 * is_upper_half) & 15 == code, delta


def test_a_batch_too_large_for_a_frame_is_halved_until_it_fits() -> None:
    raw = np.zeros((32, len(d.Channel)), dtype=np.int32)
    # Differences of 2^16 - 1 take 32 bits.
    raw[::2, SIGNED] = 2**15 - 1
    raw[1::2, SIGNED] = -(2**15)
    payloads = core_link.pack_telemetry(0, raw)
    sizes, remaining = [], raw.tolist()
    while remaining:
        count = len(remaining)
        while len(reference.telemetry_payload(0, remaining[:count])) > d.MAX_TELEMETRY_PAYLOAD:
            count //= 2
        sizes.append(count)
        remaining = remaining[count:]
    assert [payload[4] for payload in payloads] == sizes
    assert len(sizes) > 1
    assert unpacked(payloads, 0) == raw.tolist()


payloads = st.binary(max_size=d.MAX_COMMAND_PAYLOAD)
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
    wire = encode_frame(128, 0, bytes(d.MAX_COMMAND_PAYLOAD + 1))
    assert parser.feed(wire) == []
    assert parser.frames_bad == 1
    assert parser.bytes_dropped == len(wire) - 1
    assert contents(parser.feed(encode_frame(10, 1, bytes(d.MAX_COMMAND_PAYLOAD)))) == [
        (10, bytes(d.MAX_COMMAND_PAYLOAD))
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
        encode_frame(10, 99, b"") + encode_frame(d.MessageId.HELLO, 0, bytes(9)) + encode_frame(10, 1, b"")
    )
    assert parser.frames_lost == 0


def test_what_a_noisy_line_delivers_is_always_what_was_sent() -> None:
    rng = random.Random(20240611)
    sent_values = [rng.randbytes(rng.randrange(d.MAX_COMMAND_PAYLOAD)) for _ in range(2000)]
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


BATCH = next(spec for spec in d.PARAMS if spec.name == "telemetry_batch_ticks")
RING_TICKS = 64


def turn_with_sample(harness: Harness, row: np.ndarray, received: bytes = b"") -> list[Frame]:
    """One millisecond in which the tick logs one sample."""
    harness.native.push_samples(harness.tick, row.reshape(1, -1))
    return harness.turn(received)


def batches(frames: list[Frame]) -> list[tuple[int, list[list[int]]]]:
    return [reference.telemetry_samples(payload) for payload in payloads_of(frames, d.MessageId.TELEMETRY)]


def ticks_of(frames: list[Frame]) -> list[int]:
    return [first + k for first, rows in batches(frames) for k in range(len(rows))]


def test_every_tick_of_a_session_arrives_once_and_in_order(harness: Harness) -> None:
    start = harness.tick
    raw = np.random.default_rng(1).integers(-100, 100, (400, len(d.Channel))).astype(np.int32)
    raw[:, UNSIGNED] &= 7
    frames: list[Frame] = []
    for row in raw:
        frames += turn_with_sample(harness, row)
    got = [row for _, rows in batches(frames) for row in rows]
    assert ticks_of(frames) == list(range(start, start + 400))
    assert got == raw.tolist()
    assert harness.status().ticks_dropped == 0


def test_a_batch_has_as_many_ticks_as_the_parameter_says() -> None:
    harness = Harness(lambda _id, _payload: (d.Result.OK, 0, 0.0))
    harness.hello()
    for count in (20, 4, 32):
        harness.native.params.set(BATCH.index, float(count), idle=True)
        harness.ask(d.ParamSetMessage(count, BATCH.index, float(count)))
        frames = [frame for row in slowly_changing_samples(200) for frame in turn_with_sample(harness, row)]
        sizes = [len(rows) for _, rows in batches(frames)]
        assert sizes[2:]
        assert set(sizes[2:]) == {count}


def test_a_gap_in_the_ticks_ends_a_batch(harness: Harness) -> None:
    harness.native.push_samples(100, slowly_changing_samples(7))
    harness.native.push_samples(200, slowly_changing_samples(20))
    assert [(first, len(rows)) for first, rows in batches(harness.turn())] == [(100, 7), (200, 20)]


def test_tick_numbers_may_wrap(harness: Harness) -> None:
    harness.native.push_samples(2**32 - 10, slowly_changing_samples(20))
    assert [(first, len(rows)) for first, rows in batches(harness.turn())] == [(2**32 - 10, 20)]


def test_an_idle_loop_that_is_late_loses_nothing_within_the_ring(harness: Harness) -> None:
    harness.native.push_samples(0, slowly_changing_samples(RING_TICKS))
    frames = harness.turn()
    harness.native.push_samples(RING_TICKS, slowly_changing_samples(16))
    assert ticks_of(frames + harness.turn()) == list(range(80))


def test_ticks_beyond_the_ring_are_lost_and_counted(harness: Harness) -> None:
    harness.native.push_samples(0, slowly_changing_samples(RING_TICKS + 9))
    harness.turn()
    assert harness.status().ticks_dropped == 9


def test_a_full_line_costs_whole_batches_which_are_counted(harness: Harness) -> None:
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


def test_replies_leave_before_events_and_events_before_telemetry(harness: Harness) -> None:
    harness.room = 0
    harness.native.push_event(0, 1)
    harness.native.push_samples(0, slowly_changing_samples(20))
    harness.turn(harness.frame(d.PingMessage(1, 0)), ticks=2)
    harness.room = 10000
    assert [frame.id for frame in harness.turn()] == [
        d.MessageId.PONG,
        d.MessageId.EVENT,
        d.MessageId.TELEMETRY,
    ]


@pytest.mark.slow
@given(st.lists(st.integers(0, 120), min_size=200, max_size=200))
def test_the_board_never_sends_more_than_there_is_room_for(rooms: list[int]) -> None:
    harness = open_harness()
    for number, room in enumerate(rooms):
        harness.room = room  # the bench raises when more is sent
        harness.native.push_event(harness.tick, 1)
        turn_with_sample(
            harness, slowly_changing_samples(1)[0], harness.frame(d.PingMessage(number % 256, 0))
        )


def test_status_comes_once_a_second_by_itself(harness: Harness) -> None:
    frames = harness.turn(ticks=5000)
    assert [payload[0] for payload in payloads_of(frames, d.MessageId.STATUS)] == [0] * 5


def test_of_too_many_events_the_first_sixteen_are_kept(harness: Harness) -> None:
    for tick in range(30):
        harness.native.push_event(tick, 1)
    events = payloads_of(harness.turn(), d.MessageId.EVENT)
    assert [event[0] for event in events] == list(range(16))
