"""Share of the line that telemetry uses."""

from __future__ import annotations

import numpy as np
from heli_host.declaration import BAUD, CHANNELS, Channel, MessageId
from heli_host.fly.runner import fly
from heli_host.link.frames import FrameParser, encode_frame
from heli_host.link.telemetry import TelemetryDecoder, Ticks
from heli_test_native import link as core_link

from tests.bench.flights import demonstration, tapped_board
from tests.bench.result import Measured

BYTES_A_SECOND = BAUD / 10
"""8N1: ten bits a byte."""
VOLTAGE_RANGE_mV = 12000


def flight_bytes() -> tuple[bytes, float]:
    """Fly hover and sine; return what the board sent, and in how many seconds."""
    with tapped_board() as (heli, transport):
        transport.sent.clear()
        start_s = transport.now_s()
        fly(heli, demonstration())
        return b"".join(transport.sent), transport.now_s() - start_s


def worst_case_bytes(sent: bytes, batch_ticks: int) -> tuple[int, int]:
    """Pack the flight again with every voltage random; return bytes and ticks."""
    ticks = _ticks(sent)
    raw = ticks.raw.copy()
    random = np.random.default_rng(1)
    for channel in Channel:
        if CHANNELS[channel].unit == "V":
            raw[:, channel] = random.integers(0, VOLTAGE_RANGE_mV, len(raw))
    size = 0
    for start in range(0, len(raw) - batch_ticks, batch_ticks):
        payloads = core_link.pack_telemetry(int(ticks.tick[start]), raw[start : start + batch_ticks])
        size += sum(len(encode_frame(MessageId.TELEMETRY, 0, payload)) for payload in payloads)
    return size, len(raw) - batch_ticks


def _ticks(sent: bytes) -> Ticks:
    frames = FrameParser().feed(sent)
    return TelemetryDecoder().decode([frame.payload for frame in frames if frame.id == MessageId.TELEMETRY])


def measure(sent: bytes, duration_s: float) -> list[Measured]:
    """Count the bytes of a flight; one repetition, the simulation being deterministic."""
    with tapped_board() as (heli, _):
        batch_ticks = round(heli.params["telemetry_batch_ticks"])
    worst, ticks = worst_case_bytes(sent, batch_ticks)
    return [
        Measured("telemetry_line_use", [len(sent) / duration_s / BYTES_A_SECOND]),
        Measured("telemetry_line_use_worst", [worst / (ticks * 1e-3) / BYTES_A_SECOND]),
    ]
