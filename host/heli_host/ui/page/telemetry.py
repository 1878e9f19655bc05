"""Telemetry for clients: a ring buffer of raw rows, and the frames that carry them over the WebSocket.

A frame begins with a header of 24 bytes, little-endian. Its fields are kind (u8, 1), flags (u8), number of
channels (u16), frame number (u32) and number of rows (u32). Then follow the present state of the board (u8,
255 without telemetry), its fault (u8), 0 (u16), and the tick of the first row (f64). Bit 0 of the flags means
that rows between the rows of this frame were left out. Bit 1 means that rows before the first are missing.

The ticks since the first follow (u32 each), then the raw numbers (i32) of all rows, channel by channel.
"""

from __future__ import annotations

import json
import math
import struct
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heli_host.errors import LinkError
from heli_host.link.telemetry import CHANNEL_COUNT

THINNED, RESET = 1, 2

_SAMPLES = 1
_HEADER = struct.Struct("<BBHIIBBHd")


@dataclass(frozen=True)
class BufferRows:
    """A copy of consecutive or thinned rows of a buffer."""

    tick: npt.NDArray[np.int64]  # (n,): Device time [tick of 1 ms], unwrapped beyond 2^32
    raw: npt.NDArray[np.int32]  # (n, channels): Raw numbers in the order of the declaration's ``CHANNELS``
    end: int  # Position after the last row; the reader passes it to the next `TelemetryBuffer.rows_since`
    reset: bool
    """True if rows are missing between the reader's position and the first of these: the buffer was cleared,
    or overwrote them before they were read."""
    thinned: bool  # True if some rows were omitted, because there were more than the limit


NO_ROWS = BufferRows(
    tick=np.empty(0, np.int64), raw=np.empty((0, CHANNEL_COUNT), np.int32), end=0, reset=False, thinned=False
)


class TelemetryBuffer:
    """Keeps the newest `capacity` rows. One thread may append; any number of threads may read."""

    def __init__(self, capacity: int) -> None:
        self._tick = np.empty(capacity, np.int64)
        self._raw = np.empty((capacity, CHANNEL_COUNT), np.int32)
        self._written = 0
        self._begin = 0
        self._lock = threading.Lock()

    @property
    def end(self) -> int:
        """Position after the newest row: the number of rows ever written."""
        with self._lock:
            return self._written

    def clear(self) -> None:
        """Remove all rows, because the device's time starts again at 0."""
        with self._lock:
            self._begin = self._written

    def append(self, tick: npt.NDArray[np.int64], raw: npt.NDArray[np.int32]) -> None:
        """Add rows. Shapes: `tick` (n,), `raw` (n, channels)."""
        capacity = len(self._tick)
        newest_tick, newest_raw = tick[-capacity:], raw[-capacity:]
        with self._lock:
            # Rows that the buffer cannot hold count as written: readers see that they missed them.
            self._written += len(tick) - len(newest_tick)
            index = (self._written + np.arange(len(newest_tick))) % capacity
            self._tick[index] = newest_tick
            self._raw[index] = newest_raw
            self._written += len(newest_tick)
            self._begin = max(self._begin, self._written - capacity)

    def rows_since(self, position: int, max_rows: int) -> BufferRows:
        """Return a copy of the rows from a position to the newest."""
        with self._lock:
            start = max(position, self._begin)
            count = self._written - start
            step = max(math.ceil(count / max_rows), 1)
            # Counted from the newest back, so that the newest is always among them.
            positions = self._written - 1 - np.arange(0, count, step)[::-1]
            index = positions % len(self._tick)
            return BufferRows(
                tick=self._tick[index],
                raw=self._raw[index],
                end=self._written,
                reset=start > position,
                thinned=step > 1,
            )


@dataclass(frozen=True)
class Rows:
    """Contents of a frame."""

    number: int  # Number of the frame; the client acknowledges it by this number
    flags: int  # `THINNED` and `RESET`, combined
    state: int
    """state, fault: State and fault of the board when the frame was sent; `heli_host.ui.page.source.UNKNOWN`
    if unknown."""
    fault: int
    tick: npt.NDArray[np.int64]  # (n,): Device time [tick of 1 ms], unwrapped beyond 2^32
    raw: npt.NDArray[np.int32]  # (n, channels): Raw numbers in the order of the declaration's ``CHANNELS``


def pack(cut: BufferRows, number: int, board_state: tuple[int, int]) -> bytes:
    """Encode a frame."""
    flags = THINNED * cut.thinned + RESET * cut.reset
    first = int(cut.tick[0]) if len(cut.tick) else 0
    rows, channels = cut.raw.shape
    head = _HEADER.pack(_SAMPLES, flags, channels, number & 0xFFFFFFFF, rows, *board_state, 0, float(first))
    offsets = (cut.tick - first).astype("<u4").tobytes()
    return head + offsets + np.ascontiguousarray(cut.raw.T, "<i4").tobytes()


def unpack(frame: bytes) -> Rows:
    """Decode a `frame` that `pack` made."""
    if len(frame) < _HEADER.size:
        raise LinkError(
            "the dashboard sent an incomplete frame", "use the same version of heli-host at both ends"
        )
    kind, flags, channels, number, rows, state, fault, _, first = _HEADER.unpack_from(frame)
    if kind != _SAMPLES or len(frame) != _HEADER.size + 4 * rows * (1 + channels):
        raise LinkError(
            "the dashboard sent an unknown frame", "use the same version of heli-host at both ends"
        )
    offsets = np.frombuffer(frame, "<u4", rows, _HEADER.size)
    raw = np.frombuffer(frame, "<i4", rows * channels, _HEADER.size + 4 * rows)
    return Rows(
        number=number,
        flags=flags,
        state=state,
        fault=fault,
        tick=offsets.astype(np.int64) + int(first),
        raw=raw.reshape(channels, rows).T,
    )


def as_json(news: Mapping[str, Any]) -> tuple[str, bool]:
    """Encode a message as JSON, with null for numbers that are not finite, and return whether there were
    any.
    """
    try:
        return json.dumps(news, allow_nan=False, separators=(",", ":")), False
    except ValueError:
        return json.dumps(_without_nan(news), allow_nan=False, separators=(",", ":")), True


def _without_nan(news: Any) -> Any:
    """Return a JSON value with None instead of each number that is not finite."""
    if isinstance(news, Mapping):
        return {name: _without_nan(value) for name, value in news.items()}
    if isinstance(news, list | tuple):
        return [_without_nan(value) for value in news]
    return None if isinstance(news, float) and not math.isfinite(news) else news
