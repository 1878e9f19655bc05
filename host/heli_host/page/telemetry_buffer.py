"""The newest minutes of a flight as raw numbers, read by many at their own pace."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heli_host.link.telemetry import CHANNEL_COUNT


@dataclass(frozen=True)
class Cut:
    """Rows taken from a buffer.

    Parameters
    ----------
    tick : ndarray of int64, shape (n,)
        Device time [tick], counted on over 2^32.
    raw : ndarray of int32, shape (n, channels)
        Raw numbers in the order of the declaration's ``CHANNELS``.
    end : int
        Position after the last row; the next cut begins there.
    reset : bool
        Whether what was read before does not go on in these: the buffer was cleared, or ran away from its
        reader.
    thinned : bool
        Whether rows between them were left out.
    """

    tick: npt.NDArray[np.int64]
    raw: npt.NDArray[np.int32]
    end: int
    reset: bool
    thinned: bool


class TelemetryBuffer:
    """Keeps the newest rows, at most `capacity`; one thread appends, any number read."""

    def __init__(self, capacity: int) -> None:
        self._tick = np.empty(capacity, np.int64)
        self._raw = np.empty((capacity, CHANNEL_COUNT), np.int32)
        self._written = 0
        self._begin = 0
        self._lock = threading.Lock()

    @property
    def end(self) -> int:
        """Position after the newest row: rows ever written."""
        with self._lock:
            return self._written

    def clear(self) -> None:
        """Forget all rows: time begins anew."""
        with self._lock:
            self._begin = self._written

    def append(self, tick: npt.NDArray[np.int64], raw: npt.NDArray[np.int32]) -> None:
        """Add rows.

        Parameters
        ----------
        tick : ndarray of int64, shape (n,)
            Device time [tick], rising.
        raw : ndarray of int32, shape (n, channels)
            Raw numbers in the order of the declaration.
        """
        capacity = len(self._tick)
        kept_tick, kept_raw = tick[-capacity:], raw[-capacity:]
        with self._lock:
            self._written += len(tick) - len(kept_tick)
            place = (self._written + np.arange(len(kept_tick))) % capacity
            self._tick[place] = kept_tick
            self._raw[place] = kept_raw
            self._written += len(kept_tick)
            self._begin = max(self._begin, self._written - capacity)

    def cut(self, position: int, most: int) -> Cut:
        """Take the rows from a position on.

        Parameters
        ----------
        position : int
            Where the reader is: the `end` of its last cut, 0 in the beginning.
        most : int
            Rows to take at most; of more, every second, third, ... is taken, and always the newest.
        """
        with self._lock:
            start = max(position, self._begin)
            count = self._written - start
            step = max(-(-count // most), 1)
            # Counted from the newest back, so that the newest is always among them.
            place = (self._written - 1 - np.arange(0, count, step)[::-1]) % len(self._tick)
            return Cut(self._tick[place], self._raw[place], self._written, start > position, step > 1)
