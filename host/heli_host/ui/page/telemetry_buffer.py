"""A ring buffer of raw telemetry: one thread writes, each reader reads at its own pace."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heli_host.link.telemetry import CHANNEL_COUNT


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
    tick=np.empty(0, np.int64),
    raw=np.empty((0, CHANNEL_COUNT), np.int32),
    end=0,
    reset=False,
    thinned=False,
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
