"""Writes a flight as MCAP while it is flown.

One second of ticks makes one compressed chunk, which is passed to the operating system as a whole. After a
kill -9, the file contains everything up to the last chunk. Each chunk has a fixed number of ticks, and times
come from the device. Therefore the same flight gives the same bytes, however its telemetry arrived.

The writer of the mcap library takes one message per call. That costs 3.3 us per tick, and more for splitting
the batches. Here numpy lays out all messages of a chunk together, in 0.6 us per tick including compression
and file. The 50x simulation needs this speed. The library's record classes write everything else.
"""

from __future__ import annotations

import json
import struct
import threading
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
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

from heli_host.data.files import LOG_WRITER
from heli_host.data.log.disk import BackgroundFile, DirectFile, LogFile
from heli_host.data.log.schema import (
    CDR_LITTLE_ENDIAN,
    EVENT_SCHEMA,
    EVENT_SCHEMA_NAME,
    EVENT_TOPIC,
    FOOTER_BODY_BYTES,
    HEAD,
    LEVEL_ERROR,
    LEVEL_INFO,
    LEVEL_WARNING,
    LINK_SCHEMA,
    LINK_SCHEMA_NAME,
    LINK_TOPIC,
    RECORD_CRC,
    TICK_LAYOUT,
    TICK_SCHEMA,
    TICK_SCHEMA_NAME,
    TICK_TOPIC,
    fill_ticks,
    head_values,
    metadata_crc,
    tick_record,
)
from heli_host.declaration import LINK_VERSION, TICK_US
from heli_host.errors import LogWriteError


class TickClock:
    """Converts the board's 32-bit tick counter, which wraps after 49.7 days, to time that always grows."""

    # After a restart of the board, whose counter starts at 0, the time continues.

    def __init__(self) -> None:
        self._last_tick: int | None = None
        self._last_us = 0

    def advance(self, tick: NDArray[np.uint32]) -> tuple[NDArray[np.int64], int]:
        """Place a batch of ticks on the axis. Shapes: `tick` (n,); returns `time_us` (n,)."""
        has_previous = self._last_tick is not None
        before = self._last_tick if self._last_tick is not None else int(tick[0])
        # A tick has 32 bits: differences modulo 2^32, read as signed, are right over an overflow too.
        step = np.diff(tick, prepend=np.uint32(before)).view(np.int32).astype(np.int64)
        first_counted = 0 if has_previous else 1
        # A step that is not positive is a restart of the board; it counts as one tick.
        is_restart = step[first_counted:] <= 0
        step[first_counted:][is_restart] = 1
        lost = int(step.sum()) - (step.size - first_counted)
        time_us = self._last_us + np.cumsum(step) * TICK_US
        self._last_tick, self._last_us = int(tick[-1]), int(time_us[-1])
        return time_us, lost

    def skip(self, gap_s: float) -> None:
        """Leave time for a restart of the board."""
        if self._last_tick is not None:
            self._last_us += max(1, round(gap_s * 1e6 / TICK_US)) * TICK_US
            self._last_tick = None

    def time_us(self, tick: int) -> int:
        """Place an event on the axis, without moving on."""
        if self._last_tick is None:
            return self._last_us
        step = (tick - self._last_tick) & 0xFFFFFFFF
        return max(0, self._last_us + (step - (1 << 32) if step >= 1 << 31 else step) * TICK_US)


TICK_CHANNEL, EVENT_CHANNEL, LINK_CHANNEL = 1, 2, 3

_RECORD_HEADER_BYTES = 9
_MESSAGE_HEADER = struct.Struct("<BQHIQQ")
_INDEX_HEADER = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("log_time_ns", "<u8"), ("offset", "<u8")])
_FOOTER_START = struct.Struct("<BQQQ")
_TICK_RECORD = tick_record(TICK_LAYOUT)

_SCHEMAS = (
    Schema(id=1, name=TICK_SCHEMA_NAME, encoding=SchemaEncoding.ROS2, data=TICK_SCHEMA.encode()),
    Schema(id=2, name=EVENT_SCHEMA_NAME, encoding=SchemaEncoding.JSONSchema, data=EVENT_SCHEMA.encode()),
    Schema(id=3, name=LINK_SCHEMA_NAME, encoding=SchemaEncoding.JSONSchema, data=LINK_SCHEMA.encode()),
)
_CHANNELS = (
    Channel(
        id=TICK_CHANNEL, topic=TICK_TOPIC, message_encoding=MessageEncoding.CDR, metadata={}, schema_id=1
    ),
    Channel(
        id=EVENT_CHANNEL, topic=EVENT_TOPIC, message_encoding=MessageEncoding.JSON, metadata={}, schema_id=2
    ),
    Channel(
        id=LINK_CHANNEL, topic=LINK_TOPIC, message_encoding=MessageEncoding.JSON, metadata={}, schema_id=3
    ),
)


@dataclass(frozen=True)
class TickBatch:
    """Ticks that wait to be written."""

    time_us: NDArray[np.int64]  # (n,): Time of each since the log's first tick, in microseconds
    tick: NDArray[np.uint32]  # (n,): The board's tick numbers
    raw: NDArray[np.int32]  # (n, channels): Telemetry channels in the declared order


@dataclass(frozen=True)
class JsonMessage:
    """A message of one of the rare topics that waits to be written."""

    channel: int  # `EVENT_CHANNEL` or `LINK_CHANNEL`
    time_us: int  # Time since the log's first tick, in microseconds
    body: bytes  # The JSON


class _Records(RecordBuilder):
    """Collects records' bytes."""

    def data(self) -> bytes:
        return bytes(self.end())  # type: ignore[no-untyped-call]  # mcap has no types here


def json_bytes(body: Mapping[str, Any]) -> bytes:
    """Return a message as compact JSON."""
    # `body`: The message; its numbers must be finite.
    return json.dumps(body, separators=(",", ":"), allow_nan=False).encode()


class McapBytes:
    """Makes the bytes of one MCAP file, piece by piece, and keeps the index that comes last. `rad_per_count`
    has shape (axes,).
    """

    def __init__(self, start_wall_ns: int, rad_per_count: NDArray[np.float64], level: int) -> None:
        self._start_wall_ns = start_wall_ns
        self._rad_per_count = np.asarray(rad_per_count, np.float64)
        self._compressor = zstandard.ZstdCompressor(level=level)
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._message_counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0

    def wall_ns(self, time_us: int) -> int:
        """Return the Unix time of a time of the log."""
        return max(0, self._start_wall_ns + time_us * 1000)

    def head(self) -> bytes:
        """Return the first bytes of a file: magic, header, schemas, channels, and the record with the CRC of
        all these.
        """
        builder = _Records()
        Header(profile="", library=f"{LOG_WRITER} {LINK_VERSION})").write(builder)
        for record in (*_SCHEMAS, *_CHANNELS):
            record.write(builder)
        head = bytes(MCAP0_MAGIC) + builder.data()
        return head + self.metadata(HEAD, head_values(head), len(head))

    def metadata(self, name: str, values: Mapping[str, str], file_offset: int) -> bytes:
        """Return a metadata record with its CRC."""
        data = _metadata(name, values)
        self._metadata_indexes.append(MetadataIndex(offset=file_offset, length=len(data), name=name))
        return data

    def chunk(self, messages: Iterable[TickBatch | JsonMessage], file_offset: int) -> bytes:
        """Return a compressed chunk, which begins at `file_offset`, followed by its index."""
        blocks: list[bytes] = []
        entries_of_blocks: dict[int, list[NDArray[Any]]] = {}  # by channel
        block_offset = 0
        for message in _join_batches(messages):
            if isinstance(message, JsonMessage):
                channel, (entries, block) = message.channel, self._json_message(message, block_offset)
            else:
                channel, (entries, block) = TICK_CHANNEL, self._tick_messages(message, block_offset)
            entries_of_blocks.setdefault(channel, []).append(entries)
            blocks.append(block)
            block_offset += len(block)
        body = b"".join(blocks)
        indexes = {channel: np.concatenate(entries) for channel, entries in sorted(entries_of_blocks.items())}
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
        index_records, index_offsets = _message_index_records(indexes, file_offset + len(chunk))
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_start_offset=file_offset,
                chunk_length=len(chunk),
                compression="zstd",
                compressed_size=len(packed),
                uncompressed_size=len(body),
                message_start_time=first_ns,
                message_end_time=last_ns,
                message_index_length=len(index_records),
                message_index_offsets=index_offsets,
            )
        )
        for channel, entries in indexes.items():
            self._message_counts[channel] = self._message_counts.get(channel, 0) + len(entries)
        self._first_ns = first_ns if self._first_ns is None else min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)
        return chunk + index_records

    def _tick_messages(self, batch: TickBatch, offset: int) -> tuple[NDArray[Any], bytes]:
        """Return ticks as MCAP messages: their entries in the index, and their bytes."""
        records = np.zeros(batch.tick.size, _TICK_RECORD)
        records["opcode"] = int(Opcode.MESSAGE)
        records["length"] = _TICK_RECORD.itemsize - _RECORD_HEADER_BYTES
        records["channel"] = TICK_CHANNEL
        records["sequence"] = batch.tick
        wall_ns = np.maximum(self._start_wall_ns + batch.time_us * 1000, 0)
        records["log_time_ns"] = wall_ns
        records["publish_time_ns"] = wall_ns
        records["cdr"] = int.from_bytes(CDR_LITTLE_ENDIAN, "little")
        fill_ticks(records["payload"], batch.time_us / 1e6, batch.tick, batch.raw, self._rad_per_count)
        entries = np.empty(batch.tick.size, _INDEX_ENTRY)
        entries["log_time_ns"] = wall_ns
        entries["offset"] = offset + np.arange(batch.tick.size) * _TICK_RECORD.itemsize
        return entries, records.tobytes()

    def _json_message(self, message: JsonMessage, offset: int) -> tuple[NDArray[Any], bytes]:
        """Return a JSON message: its entry in the index, and its bytes, at `offset` in the chunk."""
        wall_ns = self.wall_ns(message.time_us)
        head = _MESSAGE_HEADER.pack(
            Opcode.MESSAGE,
            _MESSAGE_HEADER.size - _RECORD_HEADER_BYTES + len(message.body),
            message.channel,
            0,
            wall_ns,
            wall_ns,
        )
        return np.array([(wall_ns, offset)], _INDEX_ENTRY), head + message.body

    def tail(self, file_offset: int, data_crc: int) -> bytes:
        """Return the end of a file: statistics, indexes and footer, by which viewers find each time
        quickly.
        """
        start = _Records()
        DataEnd(data_section_crc=data_crc).write(start)
        data_end = start.data()
        summary_start = file_offset + len(data_end)
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
            length = builder.count - group_start
            if length:
                offsets.append(SummaryOffset(opcode, summary_start + group_start, length))
        summary_offset_start = summary_start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = builder.data()
        # The CRC covers the summary and the footer up to the CRC itself.
        footer_start = _FOOTER_START.pack(
            Opcode.FOOTER, FOOTER_BODY_BYTES, summary_start, summary_offset_start
        )
        crc = zlib.crc32(footer_start, zlib.crc32(summary))
        Footer(summary_start=summary_start, summary_offset_start=summary_offset_start, summary_crc=crc).write(
            builder
        )
        return data_end + summary + builder.data() + bytes(MCAP0_MAGIC)


def last_record(reason: str) -> bytes:
    """Return the record of the outcome for a log that can't be written further."""
    return _metadata("result", {"outcome": f"not closed: the log could not be written further ({reason})"})


def _metadata(name: str, values: Mapping[str, str]) -> bytes:
    builder = _Records()
    Metadata(name=name, metadata={**values, RECORD_CRC: metadata_crc(name, values)}).write(builder)
    return builder.data()


def _message_index_records(
    indexes: Mapping[int, NDArray[Any]], file_offset: int
) -> tuple[bytes, dict[int, int]]:
    """Return the records with the index of each channel, and the place of each record in the file."""
    data = b""
    offsets: dict[int, int] = {}
    for channel, entries in indexes.items():
        offsets[channel] = file_offset + len(data)
        # The record's length counts the channel (2 bytes) and the length of the entries (4 bytes) too.
        length = 2 + 4 + entries.nbytes
        data += _INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, length, channel, entries.nbytes)
        data += entries.tobytes()
    return data, offsets


def _join_batches(unjoined: Iterable[TickBatch | JsonMessage]) -> list[TickBatch | JsonMessage]:
    """Join neighbouring batches of ticks, so that numpy works on one array instead of fifty."""
    joined: list[TickBatch | JsonMessage] = []
    neighbours: list[TickBatch] = []

    def join_neighbours() -> None:
        if neighbours:
            joined.append(
                TickBatch(
                    time_us=np.concatenate([batch.time_us for batch in neighbours]),
                    tick=np.concatenate([batch.tick for batch in neighbours]),
                    raw=np.concatenate([batch.raw for batch in neighbours]),
                )
            )
            neighbours.clear()

    for message in unjoined:
        if isinstance(message, TickBatch):
            neighbours.append(message)
        else:
            join_neighbours()
            joined.append(message)
    join_neighbours()
    return joined


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
        # Batches without a time yet: tick (n,), raw (n, channels). Times are computed for many at once.
        self._untimed: list[tuple[NDArray[np.uint32], NDArray[np.int32]]] = []
        self._closed = False
        self._data_crc = 0  # of all bytes before the record that ends the data
        self._lock = threading.RLock()
        self._last_tick = 0
        self._unreported_drops = 0  # dropped ticks that no event of the log states yet
        file_type = BackgroundFile if background else DirectFile
        self._file: LogFile = file_type(self.path, last_record=last_record, overwrite=overwrite)
        try:
            self._append_records(self._bytes.head())
            for name, values in metadata.items():
                self.write_metadata(name, values)
        except LogWriteError:
            self._file.close()
            raise

    @property
    def write_error(self) -> LogWriteError | None:
        """Error that ended the writing, because the disk is full or gone; None if there is none."""
        return self._file.write_error

    @property
    def space_error(self) -> LogWriteError | None:
        """Error that is set when the disk has just enough space left to land; writing continues."""
        return self._file.space_error

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
            if self.write_error is not None:
                raise self.write_error
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
        if self._unreported_drops and self._file.has_room:
            text = f"{self._unreported_drops} ticks were not logged: more waited for the disk than may"
            self._unreported_drops = 0
            self.write_event(self._last_tick, TICKS_DROPPED, text, LEVEL_ERROR)

    def _drop_pending_ticks(self, pending: list[TickBatch | JsonMessage]) -> None:
        """Discard pending ticks and count them, because the disk is blocked; keep the newest messages."""
        # They were counted as logged when they began to wait; in the log, they are a gap like lost ticks.
        dropped_ticks = sum(int(part.tick.size) for part in pending if isinstance(part, TickBatch))
        self._unreported_drops += dropped_ticks
        self._counters.ticks_dropped += dropped_ticks
        self._counters.ticks_logged -= dropped_ticks
        self._counters.ticks_lost += dropped_ticks
        messages = [part for part in pending if isinstance(part, JsonMessage)]
        self._pending = [*messages[-_MAX_MESSAGES:]]

    def _assign_times(self) -> None:
        """Compute the times of the ticks in all waiting batches together, which is faster than one by one."""
        if not self._untimed:
            return
        ticks, raws = zip(*self._untimed, strict=True)
        tick, raw = np.concatenate(ticks), np.concatenate(raws)
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
