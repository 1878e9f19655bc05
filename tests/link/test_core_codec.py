"""The board's CRC, COBS, frames and telemetry packing against zlib, the cobs package and the slow witness."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from cobs import cobs
from heli_host.declaration import MAX_TELEMETRY_PAYLOAD, PROTOCOL, Channel, TelemetryMessage
from heli_test_native import link as core_link
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tests.channels.groups import SIGNED, UNSIGNED
from tests.link import host_reference as reference
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
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=MAX_TELEMETRY_PAYLOAD)), max_size=5))
def test_frames_carry_protocol_id_sequence_payload_and_crc(messages: list[tuple[int, bytes]]) -> None:
    writer = core_link.FrameWriter()
    for sequence, (message_id, payload) in enumerate(messages):
        wire = writer.write(message_id, payload)
        plain = bytes([PROTOCOL, message_id, sequence]) + payload
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
@example(2**32 - 3, np.arange(10 * len(Channel), dtype=np.int32).reshape(10, -1))
def test_packed_ticks_come_out_of_the_witness_as_they_were(first_tick: int, raw: np.ndarray) -> None:
    payloads = core_link.pack_telemetry(first_tick, raw)
    assert unpacked(payloads, first_tick) == raw.tolist()
    assert all(len(payload) <= MAX_TELEMETRY_PAYLOAD for payload in payloads)


@pytest.mark.medium
@given(st.integers(1, 32), st.sampled_from([0, 1, 2, 7, 8, 127, 128]), st.integers(0, 2**32 - 1))
def test_a_batch_is_packed_byte_for_byte_as_the_witness_does(count: int, step: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    raw = np.zeros((count, len(Channel)), dtype=np.int32)
    raw[:, SIGNED] = np.cumsum(rng.integers(-step, step + 1, (count, len(SIGNED))), axis=0)
    raw[:, UNSIGNED] = rng.integers(0, 2, (count, len(UNSIGNED)))
    payload = core_link.pack_telemetry(1000, raw)[0]
    assert payload == reference.telemetry_payload(1000, raw[: payload[4]].tolist())


@pytest.mark.parametrize(
    ("delta", "code"),
    [
        (0, 0),
        (1, 1),
        (-2, 1),
        (2, 2),
        (-3, 2),
        (7, 2),
        (-8, 2),
        (8, 3),
        (-9, 3),
        (127, 3),
        (-128, 3),
        (128, 4),
        (-129, 4),
        (32767, 4),
        (-32768, 4),
        (32768, 5),
        (-32769, 5),
        (-(2**31), 5),
    ],
)
def test_a_delta_gets_the_narrowest_width_that_holds_it(delta: int, code: int) -> None:
    raw = np.zeros((2, len(Channel)), dtype=np.int32)
    raw[1, Channel.ELEVATION_COUNT] = delta
    (payload,) = core_link.pack_telemetry(0, raw)
    widths = payload[TelemetryMessage.STRUCT.size :]
    assert widths[Channel.ELEVATION_COUNT // 2] >> (4 * (Channel.ELEVATION_COUNT % 2)) & 15 == code


def test_a_batch_too_large_for_a_frame_is_halved_until_it_fits() -> None:
    raw = np.zeros((32, len(Channel)), dtype=np.int32)
    # Differences of 2^16 - 1 take 32 bits.
    raw[::2, SIGNED] = 2**15 - 1
    raw[1::2, SIGNED] = -(2**15)
    payloads = core_link.pack_telemetry(0, raw)
    sizes, remaining = [], raw.tolist()
    while remaining:
        count = len(remaining)
        while len(reference.telemetry_payload(0, remaining[:count])) > MAX_TELEMETRY_PAYLOAD:
            count //= 2
        sizes.append(count)
        remaining = remaining[count:]
    assert [payload[4] for payload in payloads] == sizes
    assert len(sizes) > 1
    assert unpacked(payloads, 0) == raw.tolist()
