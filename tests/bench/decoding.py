"""Decoding: bytes of the line to arrays, against pymavlink decoding one message a tick."""

from __future__ import annotations

import time
from collections.abc import Iterator

from heli_host.declaration import MessageId
from heli_host.link.frames import FrameParser
from heli_host.link.telemetry import TelemetryDecoder

from tests.bench.result import Measured

REPETITIONS = 5
# Size of the pieces in which a program reads a port or a saved stream: about 6 s of flight.
CHUNK_BYTES = 65536


def chunks(data: bytes) -> Iterator[bytes]:
    for start in range(0, len(data), CHUNK_BYTES):
        yield data[start : start + CHUNK_BYTES]


def decode_ours(data: bytes) -> int:
    """Ticks decoded from the bytes of a flight."""
    parser, decoder = FrameParser(), TelemetryDecoder()
    ticks = 0
    for chunk in chunks(data):
        frames = parser.feed(chunk)
        ticks += len(decoder.decode([frame.payload for frame in frames if frame.id == MessageId.TELEMETRY]))
    return ticks


def mavlink_bytes(ticks: int) -> bytes:
    """As many HIL_CONTROLS messages: 11 fields in 42 bytes, about as many as a tick holds."""
    from pymavlink.dialects.v20 import common

    link = common.MAVLink(None)
    return b"".join(
        link.hil_controls_encode(
            1000 * tick, 0.1, 0.01 * (tick % 100), -0.2, 5.0, 5.1, 0.3, 0.2, 0.1, 2, 3
        ).pack(link)
        for tick in range(ticks)
    )


def decode_mavlink(data: bytes) -> int:
    """Messages decoded from a MAVLink stream."""
    from pymavlink.dialects.v20 import common

    link = common.MAVLink(None)
    return sum(len(link.parse_buffer(chunk) or ()) for chunk in chunks(data))


def measure(flight_bytes: bytes) -> list[Measured]:
    """Decode the same number of ticks both ways, in turn."""
    ticks = decode_ours(flight_bytes)
    theirs = mavlink_bytes(ticks)
    rates: list[tuple[float, float]] = []
    for _ in range(REPETITIONS):
        start_s = time.perf_counter()
        assert decode_ours(flight_bytes) == ticks
        middle_s = time.perf_counter()
        assert decode_mavlink(theirs) == ticks
        end_s = time.perf_counter()
        rates.append((ticks / (middle_s - start_s), ticks / (end_s - middle_s)))
    return [
        Measured("host_decode_ticks_per_s", [ours for ours, _ in rates]),
        Measured("pymavlink_messages_per_s", [peer for _, peer in rates]),
        Measured("host_decode_ratio_to_pymavlink", [ours / peer for ours, peer in rates]),
    ]
