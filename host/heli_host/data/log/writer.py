"""Writes a flight as MCAP while it is flown.

One second of ticks makes one compressed chunk, which is passed to the operating system as a whole. After a
kill -9, the file contains everything up to the last chunk. Each chunk has a fixed number of ticks, and times
come from the device. Therefore the same flight gives the same bytes, however its telemetry arrived.

The writer of the mcap library takes one message per call. That costs 3.3 us per tick, and more for splitting
the batches. Here numpy lays out all messages of a chunk together, in 0.6 us per tick including compression
and file. The 50x simulation needs this speed. The library's record classes write everything else.
"""

from __future__ import annotations

import threading
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heli_host.data.log.clock import TickClock
from heli_host.data.log.disk import BackgroundFile, DirectFile, LogFile
from heli_host.data.log.records import (
    EVENT_CHANNEL,
    LINK_CHANNEL,
    JsonMessage,
    McapBytes,
    TickBatch,
    json_bytes,
    last_record,
)
from heli_host.data.log.schema import LEVEL_ERROR, LEVEL_INFO, LEVEL_WARNING
from heli_host.declaration import TICK_US
from heli_host.errors import LogWriteError

CHUNK_TICKS = 1_000_000 // TICK_US
"""Ticks in a chunk: one second, which is also the most that a killed host loses."""
DISK_BLOCKED, TICKS_DROPPED = "disk_blocked", "ticks_dropped"
"""Names of the events that the writer itself adds."""

_MAX_MESSAGES = 10_000


@dataclass(slots=True)
class LogCounters:
    """Counters of the content of a log so far."""

    ticks_logged: int = 0  # Ticks that are written, or wait for the disk
    ticks_lost: int = 0  # Gaps in the tick numbers between the first and the last tick logged
    ticks_dropped: int = 0  # Ticks that were not logged, because too many waited for a blocked disk
    events_logged: int = 0  # Events that are written, or wait for the disk
    bytes_written: int = 0  # Size of the file so far


class LogWriter:
    """An MCAP log being written; safe to call from several threads. `rad_per_count` has shape (axes,)."""

    def __init__(
        self,
        path: str | Path,
        *,
        start_wall_ns: int,
        metadata: Mapping[str, Mapping[str, str]],
        rad_per_count: NDArray[np.float64],
        level: int = 3,
        background: bool = False,
        overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        self._counters = LogCounters()
        self._clock = TickClock()
        self._bytes = McapBytes(start_wall_ns, rad_per_count, level)
        self._pending: list[TickBatch | JsonMessage] = []
        self._pending_ticks = 0
        self._untimed: list[tuple[NDArray[np.uint32], NDArray[np.int32]]] = []
        self._closed = False
        self._data_crc = 0
        self._lock = threading.RLock()
        self._last_tick = 0
        self._dropping = 0
        kind = BackgroundFile if background else DirectFile
        self._file: LogFile = kind(self.path, last_record=last_record, overwrite=overwrite)
        try:
            self._append_records(self._bytes.head())
            for name, values in metadata.items():
                self.write_metadata(name, values)
        except LogWriteError:
            self._file.close()
            raise

    @property
    def failed(self) -> LogWriteError | None:
        """Error that ended the writing, because the disk is full or gone; None if there is none."""
        return self._file.failed

    @property
    def nearly_full(self) -> LogWriteError | None:
        """Error that is set when the disk has just enough space left to land; writing continues."""
        return self._file.nearly_full

    @property
    def counters(self) -> LogCounters:
        """A copy of the counters."""
        with self._lock:
            self._assign_times()
            return replace(self._counters)

    def write_ticks(self, tick: NDArray[np.uint32], raw: NDArray[np.int32]) -> None:
        """Append a batch of ticks. Shapes: `tick` (n,), `raw` (n, channels)."""
        if tick.size == 0:
            return
        with self._lock:
            if self.failed is not None:
                raise self.failed
            start = 0
            while start < tick.size:
                stop = min(tick.size, start + CHUNK_TICKS - self._pending_ticks)
                self._untimed.append((tick[start:stop], raw[start:stop]))
                self._pending_ticks += stop - start
                start = stop
                if self._pending_ticks >= CHUNK_TICKS:
                    self.flush()

    def skip(self, gap_s: float) -> None:
        """Leave time for a restart of the board, which counts its ticks from the beginning."""
        with self._lock:
            self._assign_times()
            self._clock.skip(gap_s)

    def write_event(self, tick: int, name: str, text: str, level: int = LEVEL_INFO) -> None:
        """Append an event."""
        with self._lock:
            self._assign_times()
            time_us = self._clock.time_us(tick)
            wall_ns = self._bytes.wall_ns(time_us)
            body = {
                "timestamp": {"sec": wall_ns // 1_000_000_000, "nsec": wall_ns % 1_000_000_000},
                "level": level,
                "message": text,
                "name": name,
                "t_s": time_us / 1e6,
                "tick": tick,
            }
            self._pending.append(JsonMessage(EVENT_CHANNEL, time_us, json_bytes(body)))
            self._counters.events_logged += 1

    def write_link(self, tick: int, counters: Mapping[str, float]) -> None:
        """Append the counters of the link."""
        with self._lock:
            self._assign_times()
            time_us = self._clock.time_us(tick)
            body = json_bytes({"t_s": time_us / 1e6, **counters})
            self._pending.append(JsonMessage(LINK_CHANNEL, time_us, body))

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a record of names and values, behind everything taken in so far."""
        with self._lock:
            self.flush()
            self._append_records(self._bytes.metadata(name, values, self._counters.bytes_written))

    def flush(self) -> None:
        """Hand everything taken in so far to the system."""
        with self._lock:
            self._write_stall_events()
            self._assign_times()
            pending, self._pending, self._pending_ticks = self._pending, [], 0
            if not self._file.has_room:
                self._drop_pending_ticks(pending)
            elif pending and not self._closed:
                self._append_records(self._bytes.chunk(pending, self._counters.bytes_written))

    def close(self, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Write what is left, the last metadata and the summary that lets viewers jump; a second call does
        nothing.
        """
        with self._lock:
            if self._closed:
                return
            try:
                # The last chunk reports what blocked until now.
                self._file.drain()
                self.flush()
                for name, values in (metadata or {}).items():
                    self.write_metadata(name, values)
                self._append_records(self._bytes.tail(self._counters.bytes_written, self._data_crc))
            finally:
                self._closed = True
                self._file.close()

    def _write_stall_events(self) -> None:
        """Write an event for each pause of the disk, and for ticks that had to be dropped in it."""
        for stall_s in self._file.take_stalls_s():
            self.write_event(
                self._last_tick, DISK_BLOCKED, f"the disk blocked for {stall_s:.1f} s", LEVEL_WARNING
            )
        if self._dropping and self._file.has_room:
            text = f"{self._dropping} ticks were not logged: more waited for the disk than may"
            self._dropping = 0
            self.write_event(self._last_tick, TICKS_DROPPED, text, LEVEL_ERROR)

    def _drop_pending_ticks(self, pending: list[TickBatch | JsonMessage]) -> None:
        """Discard pending ticks and count them, because the disk is blocked; keep the newest messages."""
        dropped_ticks = sum(int(part.tick.size) for part in pending if isinstance(part, TickBatch))
        self._dropping += dropped_ticks
        self._counters.ticks_dropped += dropped_ticks
        self._counters.ticks_logged -= dropped_ticks
        self._counters.ticks_lost += dropped_ticks
        messages = [part for part in pending if isinstance(part, JsonMessage)]
        self._pending = [*messages[-_MAX_MESSAGES:]]

    def _assign_times(self) -> None:
        """Compute the times of the ticks in all waiting batches together, which is faster than one by one."""
        if not self._untimed:
            return
        tick = np.concatenate([batch[0] for batch in self._untimed])
        raw = np.concatenate([batch[1] for batch in self._untimed])
        self._untimed.clear()
        time_us, lost = self._clock.advance(tick)
        self._counters.ticks_logged += int(tick.size)
        self._counters.ticks_lost += lost
        self._last_tick = int(tick[-1])
        self._pending.append(TickBatch(time_us, tick, raw))

    def _append_records(self, data: bytes) -> None:
        """Append whole records to the file, and count their bytes."""
        self._file.append(data)
        self._counters.bytes_written += len(data)
        self._data_crc = zlib.crc32(data, self._data_crc)
