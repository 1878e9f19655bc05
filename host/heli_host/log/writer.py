"""Writes a flight as MCAP while it is flown.

A second of ticks makes one compressed chunk, handed to the system whole: after a kill -9 the file holds
everything up to the last chunk. Chunks are cut after a fixed number of ticks, and times come from the device,
so the same flight gives the same bytes however its telemetry arrived.

The library's own writer takes one message a call: 3.3 us a tick, besides cutting the ticks apart. Here a
chunk's messages are laid out by numpy in one go, 1.1 us a tick with compression and file included, which
the 50x simulation needs; the library's record classes write everything around them.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import struct
import threading
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from heli_host.errors import LogWriteError
from heli_host.link.declaration import LINK_VERSION, TICK_US
from heli_host.log.clock import TickClock
from heli_host.log.schema import (
    CDR_LITTLE_ENDIAN,
    EVENT_SCHEMA,
    EVENT_SCHEMA_NAME,
    EVENT_TOPIC,
    LEVEL_INFO,
    LINK_SCHEMA,
    LINK_SCHEMA_NAME,
    LINK_TOPIC,
    TICK_LAYOUT,
    TICK_SCHEMA,
    TICK_SCHEMA_NAME,
    TICK_TOPIC,
    fill_ticks,
)

CHUNK_TICKS = 1_000_000 // TICK_US
"""Ticks in a chunk: one second, which is also the most that a killed host loses."""

_TICK_CHANNEL, _EVENT_CHANNEL, _LINK_CHANNEL = 1, 2, 3
_MESSAGE_HEADER = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS_BYTES = 22
_INDEX_HEADER = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("log_time_ns", "<u8"), ("offset", "<u8")])
_FOOTER_START = struct.Struct("<BQQQ")

TICK_RECORD = np.dtype(
    [
        ("opcode", "<u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<u8"),
        ("publish_time_ns", "<u8"),
        ("cdr", "<u4"),
        ("payload", TICK_LAYOUT.dtype),
    ]
)
"""One MCAP message record of the tick topic."""


class _Records(RecordBuilder):
    """Collects records' bytes."""

    def data(self) -> bytes:
        return bytes(self.end())  # type: ignore[no-untyped-call]


@dataclass
class _Pending:
    """What the next chunk will hold, in the order of arrival."""

    parts: list[tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.int32]] | tuple[int, int, bytes]] = (
        field(default_factory=list)
    )
    tick_count: int = 0


@dataclass
class LogCounters:
    """What a log has taken in.

    Parameters
    ----------
    ticks_logged : int
        Ticks written or waiting to be.
    ticks_lost : int
        Gaps in the tick numbers between the first and the last tick logged.
    events_logged : int
        Events written or waiting to be.
    bytes_written : int
        Size of the file so far.
    """

    ticks_logged: int = 0
    ticks_lost: int = 0
    events_logged: int = 0
    bytes_written: int = 0


class LogWriter:
    """An MCAP log being written; safe to call from several threads.

    Parameters
    ----------
    path : str or Path
        File to write; one that exists is replaced, a missing folder is made.
    start_wall_ns : int
        Unix time of the log's time zero, in nanoseconds; the same value gives the same bytes.
    metadata : Mapping[str, Mapping[str, str]]
        Named records written first: versions, rig, parameters, plans ...
    rad_per_count : ndarray (3,)
        Size of an encoder count of elevation, pitch and travel.
    level : int
        zstd's compression level.

    Raises
    ------
    LogWriteError
        If the file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        start_wall_ns: int,
        metadata: Mapping[str, Mapping[str, str]],
        rad_per_count: NDArray[np.float64],
        level: int = 3,
    ) -> None:
        self.path = Path(path)
        self.counters = LogCounters()
        self.clock = TickClock()
        self.failed: LogWriteError | None = None
        self._start_wall_ns = start_wall_ns
        self._rad_per_count = np.asarray(rad_per_count, np.float64)
        self._compressor = zstandard.ZstdCompressor(level=level)
        self._pending = _Pending()
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._message_counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._closed = False
        self._lock = threading.RLock()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = io.FileIO(self.path, "w")
        except OSError as error:
            raise LogWriteError(
                f"cannot write the log {self.path}: {error.strerror or error}",
                "choose another place with --log",
            ) from error
        self._write(self._head())
        for name, values in metadata.items():
            self.write_metadata(name, values)

    def write_ticks(self, tick: NDArray[np.uint32], raw: NDArray[np.int32]) -> None:
        """Take in a batch of ticks.

        Parameters
        ----------
        tick : ndarray of uint32 (n,)
            Tick numbers in the order of arrival; a number that does not rise means that the board restarted.
        raw : ndarray of int32 (n, 11)
            Telemetry channels in the declared order, as the board sent them. The arrays are kept, not copied.

        Raises
        ------
        LogWriteError
            If the disk is full or gone; what was written before stays readable.
        """
        if tick.size == 0:
            return
        with self._lock:
            if self.failed is not None:
                raise self.failed
            time_us, lost = self.clock.advance(tick)
            self.counters.ticks_logged += int(tick.size)
            self.counters.ticks_lost += lost
            start = 0
            while start < tick.size:
                stop = min(tick.size, start + CHUNK_TICKS - self._pending.tick_count)
                self._pending.parts.append((time_us[start:stop], tick[start:stop], raw[start:stop]))
                self._pending.tick_count += stop - start
                start = stop
                if self._pending.tick_count >= CHUNK_TICKS:
                    self.flush()

    def skip(self, gap_s: float) -> None:
        """Leave time for a restart of the board, which begins to count its ticks anew.

        Parameters
        ----------
        gap_s : float
            Seconds from the last tick to the first of the restarted board.
        """
        with self._lock:
            self.clock.skip(gap_s)

    def write_event(self, tick: int, name: str, text: str, level: int = LEVEL_INFO) -> None:
        """Take in an event.

        Parameters
        ----------
        tick : int
            Device tick at which it happened.
        name : str
            Kind of event.
        text : str
            What happened and why.
        level : int
            Severity as in ``foxglove.Log``: 2 information, 3 warning, 4 error.
        """
        with self._lock:
            time_us = self.clock.time_us(tick)
            wall_ns = self._wall_ns(time_us)
            body = {
                "timestamp": {"sec": wall_ns // 1_000_000_000, "nsec": wall_ns % 1_000_000_000},
                "level": level,
                "message": text,
                "name": name,
                "t_s": time_us / 1e6,
                "tick": tick,
            }
            self._pending.parts.append((_EVENT_CHANNEL, time_us, _json(body)))
            self.counters.events_logged += 1

    def write_link(self, tick: int, counters: Mapping[str, float]) -> None:
        """Take in the link's counters.

        Parameters
        ----------
        tick : int
            Device tick at which they were read.
        counters : Mapping[str, float]
            Counters of both ends by name.
        """
        with self._lock:
            time_us = self.clock.time_us(tick)
            self._pending.parts.append((_LINK_CHANNEL, time_us, _json({"t_s": time_us / 1e6, **counters})))

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a record of names and values, behind everything taken in so far.

        Parameters
        ----------
        name : str
            Name of the record; readers merge records of one name, the later value wins.
        values : Mapping[str, str]
            Names and values.

        Raises
        ------
        LogWriteError
            If the disk is full or gone.
        """
        with self._lock:
            self.flush()
            builder = _Records()
            Metadata(name=name, metadata=dict(values)).write(builder)
            data = builder.data()
            offset = self.counters.bytes_written
            self._write(data)
            self._metadata_indexes.append(MetadataIndex(offset=offset, length=len(data), name=name))

    def flush(self) -> None:
        """Hand everything taken in so far to the system.

        Raises
        ------
        LogWriteError
            If the disk is full or gone; what was written before stays readable.
        """
        with self._lock:
            pending, self._pending = self._pending, _Pending()
            if pending.parts and not self._closed:
                self._write_chunk(pending)

    def close(self, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Write what is left, the last metadata and the summary that lets viewers jump; a second call does
        nothing.

        Parameters
        ----------
        metadata : Mapping[str, Mapping[str, str]], optional
            Last records: counters and outcome.

        Raises
        ------
        LogWriteError
            If the disk is full or gone; the file is closed all the same.
        """
        with self._lock:
            if self._closed:
                return
            try:
                self.flush()
                for name, values in (metadata or {}).items():
                    self.write_metadata(name, values)
                self._write(self._summary())
            finally:
                self._closed = True
                self._file.close()

    def _head(self) -> bytes:
        builder = _Records()
        Header(profile="", library=f"heli_host (link {LINK_VERSION})").write(builder)
        for record in (*_SCHEMAS, *_CHANNELS):
            record.write(builder)
        return bytes(MCAP0_MAGIC) + builder.data()

    def _wall_ns(self, time_us: int) -> int:
        return max(0, self._start_wall_ns + time_us * 1000)

    def _write_chunk(self, pending: _Pending) -> None:
        blocks: list[bytes] = []
        index: dict[int, list[NDArray[Any]]] = {}
        offset = 0
        for part in _joined(pending.parts):
            if isinstance(part[0], int):
                channel, entries, block = self._json_message(part, offset)
            else:
                channel, entries, block = self._tick_messages(part, offset)
            index.setdefault(channel, []).append(entries)
            blocks.append(block)
            offset += len(block)
        body = b"".join(blocks)
        indexes = {channel: np.concatenate(entries) for channel, entries in sorted(index.items())}
        first_ns = min(int(entries["log_time_ns"].min()) for entries in indexes.values())
        last_ns = max(int(entries["log_time_ns"].max()) for entries in indexes.values())
        packed = self._compressor.compress(body)
        builder = _Records()
        Chunk(
            compression="zstd",
            data=packed,
            message_start_time=first_ns,
            message_end_time=last_ns,
            uncompressed_crc=zlib.crc32(body),
            uncompressed_size=len(body),
        ).write(builder)
        chunk = builder.data()
        chunk_start = self.counters.bytes_written
        index_offsets: dict[int, int] = {}
        tail = b""
        for channel, entries in indexes.items():
            index_offsets[channel] = chunk_start + len(chunk) + len(tail)
            tail += _INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes)
            tail += entries.tobytes()
        self._write(chunk + tail)
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_start_offset=chunk_start,
                chunk_length=len(chunk),
                compression="zstd",
                compressed_size=len(packed),
                uncompressed_size=len(body),
                message_start_time=first_ns,
                message_end_time=last_ns,
                message_index_length=len(tail),
                message_index_offsets=index_offsets,
            )
        )
        for channel, entries in indexes.items():
            self._message_counts[channel] = self._message_counts.get(channel, 0) + len(entries)
        self._first_ns = first_ns if self._first_ns is None else min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)

    def _tick_messages(
        self, part: tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.int32]], offset: int
    ) -> tuple[int, NDArray[Any], bytes]:
        time_us, tick, raw = part
        records = np.zeros(tick.size, TICK_RECORD)
        records["opcode"] = int(Opcode.MESSAGE)
        records["length"] = TICK_RECORD.itemsize - 9
        records["channel"] = _TICK_CHANNEL
        records["sequence"] = tick
        wall_ns = np.maximum(self._start_wall_ns + time_us * 1000, 0)
        records["log_time_ns"] = wall_ns
        records["publish_time_ns"] = wall_ns
        records["cdr"] = int.from_bytes(CDR_LITTLE_ENDIAN, "little")
        fill_ticks(records["payload"], time_us / 1e6, tick, raw, self._rad_per_count)
        entries = np.empty(tick.size, _INDEX_ENTRY)
        entries["log_time_ns"] = wall_ns
        entries["offset"] = offset + np.arange(tick.size) * TICK_RECORD.itemsize
        return _TICK_CHANNEL, entries, records.tobytes()

    def _json_message(self, part: tuple[int, int, bytes], offset: int) -> tuple[int, NDArray[Any], bytes]:
        channel, time_us, body = part
        wall_ns = self._wall_ns(time_us)
        sequence = self._message_counts.get(channel, 0) & 0xFFFFFFFF
        head = _MESSAGE_HEADER.pack(
            Opcode.MESSAGE, _MESSAGE_FIELDS_BYTES + len(body), channel, sequence, wall_ns, wall_ns
        )
        return channel, np.array([(wall_ns, offset)], _INDEX_ENTRY), head + body

    def _summary(self) -> bytes:
        start = _Records()
        DataEnd(data_section_crc=0).write(start)
        data_end = start.data()
        summary_start = self.counters.bytes_written + len(data_end)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(_CHANNELS),
            channel_message_counts=dict(sorted(self._message_counts.items())),
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._message_counts.values()),
            message_start_time=self._first_ns or 0,
            message_end_time=self._last_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(_SCHEMAS),
        )
        groups: tuple[tuple[Opcode, Any], ...] = (
            (Opcode.SCHEMA, _SCHEMAS),
            (Opcode.CHANNEL, _CHANNELS),
            (Opcode.STATISTICS, (statistics,)),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        )
        builder = _Records()
        offsets: list[SummaryOffset] = []
        for opcode, records in groups:
            group_start = builder.count
            for record in records:
                record.write(builder)
            if builder.count > group_start:
                offsets.append(
                    SummaryOffset(opcode, summary_start + group_start, builder.count - group_start)
                )
        summary_offset_start = summary_start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = builder.data()
        crc = zlib.crc32(
            _FOOTER_START.pack(Opcode.FOOTER, 20, summary_start, summary_offset_start), zlib.crc32(summary)
        )
        Footer(summary_start=summary_start, summary_offset_start=summary_offset_start, summary_crc=crc).write(
            builder
        )
        return data_end + summary + builder.data() + bytes(MCAP0_MAGIC)

    def _write(self, data: bytes) -> None:
        """Append whole records; after a failure the file ends behind the last whole one, and nothing more
        follows.
        """
        if self.failed is not None:
            raise self.failed
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) or 0 :]
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
            self.failed = LogWriteError(
                f"cannot write the log {self.path}: {error.strerror or error}",
                "free some disk space; the log is readable up to here"
                if full
                else "the log is readable up to here",
            )
            with contextlib.suppress(OSError):
                self._file.truncate(self.counters.bytes_written)
            raise self.failed from error
        self.counters.bytes_written += len(data)


def _joined(parts: list[Any]) -> list[Any]:
    """Join neighbouring batches of ticks, so that numpy works on one array instead of fifty."""
    joined: list[Any] = []
    run: list[Any] = []
    for part in [*parts, None]:
        if part is not None and not isinstance(part[0], int):
            run.append(part)
            continue
        if run:
            joined.append(tuple(np.concatenate(arrays) for arrays in zip(*run, strict=True)))
            run = []
        if part is not None:
            joined.append(part)
    return joined


def _json(body: Mapping[str, Any]) -> bytes:
    return json.dumps(body, separators=(",", ":"), allow_nan=False).encode()


_SCHEMAS = (
    Schema(id=1, name=TICK_SCHEMA_NAME, encoding=SchemaEncoding.ROS2, data=TICK_SCHEMA.encode()),
    Schema(id=2, name=EVENT_SCHEMA_NAME, encoding=SchemaEncoding.JSONSchema, data=EVENT_SCHEMA.encode()),
    Schema(id=3, name=LINK_SCHEMA_NAME, encoding=SchemaEncoding.JSONSchema, data=LINK_SCHEMA.encode()),
)
_CHANNELS = (
    Channel(id=1, topic=TICK_TOPIC, message_encoding=MessageEncoding.CDR, metadata={}, schema_id=1),
    Channel(id=2, topic=EVENT_TOPIC, message_encoding=MessageEncoding.JSON, metadata={}, schema_id=2),
    Channel(id=3, topic=LINK_TOPIC, message_encoding=MessageEncoding.JSON, metadata={}, schema_id=3),
)
