"""Reads a log record by record, and continues after damaged parts.

The mcap library parses the records and the index at the end of the file; runs of ticks are read as arrays. A
record is used only if it is complete and its CRC is right. If the bytes at the present position are not a
record, the index gives the position of the next record. Without an index, the next chunk is searched. The
notes list all parts that were skipped.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
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
)
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from heli_host.data.flight import OWN_COLUMNS
from heli_host.data.log.schema import (
    CDR_LITTLE_ENDIAN,
    EVENT_TOPIC,
    FOOTER_BODY_BYTES,
    HEAD,
    LINK_TOPIC,
    RECORD_CRC,
    TICK_LAYOUT,
    TICK_SCHEMA_NAME,
    TICK_TOPIC,
    MessageLayout,
    head_values,
    metadata_crc,
    parse_layout,
    tick_record,
)
from heli_host.declaration import CHANNELS
from heli_host.errors import LogError

RECORD_HEADER = struct.Struct("<BQ")
DATA_END_BYTES = RECORD_HEADER.size + 4
PARSE_ERRORS = (McapError, ValueError, struct.error)
"""Exceptions of the mcap library for a damaged record."""

_FOOTER_BYTES = RECORD_HEADER.size + FOOTER_BODY_BYTES
_CRC_BYTES = 4
_MAGIC = bytes(MCAP0_MAGIC)


@dataclass(frozen=True)
class Index:
    """An index whose CRC fits."""

    data_end: int  # Offset of the record that ends the data
    offsets: tuple[int, ...]  # Offsets of chunks, of metadata records and of `data_end`, in rising order
    schemas: tuple[Schema, ...]  # schemas, channels: All schemas and channels of the file
    channels: tuple[Channel, ...]
    message_counts: dict[int, int]  # Messages by channel id


def read_index(data: memoryview) -> Index | None:
    """Read the index of a file; None if the file has no index, or a damaged one."""
    # A complete file ends with a summary, which is the index, a footer and the magic bytes.
    footer_start = len(data) - len(_MAGIC) - _FOOTER_BYTES
    if footer_start < 0 or data[-len(_MAGIC) :] != _MAGIC:
        return None
    if RECORD_HEADER.unpack_from(data, footer_start) != (Opcode.FOOTER, FOOTER_BODY_BYTES):
        return None
    body_start = footer_start + RECORD_HEADER.size
    footer = parse(Footer, data[body_start : body_start + FOOTER_BODY_BYTES])
    summary_start = footer.summary_start
    if not len(_MAGIC) <= summary_start <= footer_start:
        return None
    # The CRC covers the bytes from the start of the summary to the field of the CRC.
    covered = data[summary_start : footer_start + _FOOTER_BYTES - _CRC_BYTES]
    if footer.summary_crc != zlib.crc32(covered):
        return None
    records: dict[type, list[Any]] = defaultdict(list)
    try:
        for record in StreamReader(io.BytesIO(data[summary_start:]), skip_magic=True).records:
            records[type(record)].append(record)
    except PARSE_ERRORS:
        return None
    data_end = summary_start - DATA_END_BYTES
    offsets = {chunk.chunk_start_offset for chunk in records[ChunkIndex]}
    offsets |= {metadata.offset for metadata in records[MetadataIndex]} | {data_end}
    return Index(
        data_end=data_end,
        offsets=tuple(sorted(offsets)),
        schemas=tuple(records[Schema]),
        channels=tuple(records[Channel]),
        message_counts={
            channel: count
            for statistics in records[Statistics]
            for channel, count in statistics.channel_message_counts.items()
        },
    )


def parse(kind: Any, body: memoryview) -> Any:
    """Parse a record with the mcap library."""
    stream = ReadDataStream(io.BytesIO(body))
    record = kind.read(stream)
    # The library does not notice a string that should be longer than the record; it ends early.
    if stream.count != len(body):
        raise ValueError("the record does not have its stated length")
    return record


LARGEST_CHUNK_BYTES = 1 << 26
"""Most that a chunk may claim to hold; writers put about 1 MiB into one. More is damage."""


@dataclass
class TickRecord:
    """The record of a tick in this log."""

    layout: np.dtype[Any] | None = None  # Layout of the bytes of a tick; None until a record has described it
    channel: int = -1  # Number of the channel of ticks


def unpacked(chunk: Chunk, has_crcs: bool, path: Path) -> bytes:
    """Return the content of a `chunk` of the log at `path`."""
    if chunk.uncompressed_size > LARGEST_CHUNK_BYTES:
        raise ValueError("the stated size of the chunk is larger than any writer makes it")
    if chunk.compression == "zstd":
        # The frame's own word is what would be allocated.
        if zstandard.get_frame_parameters(chunk.data).content_size != chunk.uncompressed_size:
            raise ValueError("the chunk does not have its stated size")
        body = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
    elif chunk.compression == "":
        body = chunk.data
    elif chunk.compression == "lz4":
        raise LogError(f"{path} is compressed by lz4", "convert it to zstd")
    else:
        raise ValueError("an unknown compression")
    # In MCAP, 0 means that the chunk has no CRC; heli-host always writes one.
    has_crc = chunk.uncompressed_crc or has_crcs
    if len(body) != chunk.uncompressed_size or (has_crc and zlib.crc32(body) != chunk.uncompressed_crc):
        raise ValueError("the chunk's CRC does not match its content")
    return body


def records_of(body: bytes, tick: TickRecord) -> Iterator[NDArray[Any] | tuple[int, memoryview]]:
    """Yield runs of ticks as arrays, and every other record of a chunk with its opcode."""
    view = memoryview(body)
    position = 0
    while position < len(body):
        run = _ticks_in_a_row(body, position, tick)
        if run is not None:
            yield run["payload"]
            position += run.nbytes
            continue
        opcode, length = RECORD_HEADER.unpack_from(body, position)
        start = position + RECORD_HEADER.size
        if length > len(body) - start:
            raise ValueError("a record reaches beyond its chunk")
        yield opcode, view[start : start + length]
        position = start + length


def _ticks_in_a_row(body: bytes, position: int, tick: TickRecord) -> NDArray[Any] | None:
    """Map the ticks that follow each other from `position` on; None if there is none."""
    record = tick.layout
    if record is None:
        return None
    max_count = (len(body) - position) // record.itemsize
    if max_count == 0:
        return None
    rows = np.frombuffer(body, record, count=max_count, offset=position)
    is_tick = (
        (rows["opcode"] == int(Opcode.MESSAGE))
        & (rows["length"] == record.itemsize - RECORD_HEADER.size)
        & (rows["channel"] == tick.channel)
        & (rows["cdr"] == int.from_bytes(CDR_LITTLE_ENDIAN, "little"))
    )
    count = max_count if is_tick.all() else int(np.argmin(is_tick))
    return rows[:count] if count else None


_HEAD = re.compile(re.escape(_MAGIC) + rb"\x01")
"""Begin of a log: the magic bytes and a header record."""
_MESSAGE_HEADER = struct.Struct("<HIQQ")
_MESSAGE_INDEX = struct.Struct("<HI")
_INDEX_ENTRY_BYTES = 16
_MAX_MESSAGE_BYTES = 1 << 16
_MAX_MESSAGES = 1_000_000
_MAX_TIME_S = 1e10
_PRIVATE_OPCODES = 0x80
_IN_DATA = (Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.METADATA, Opcode.DATA_END)
_LANDMARK = re.compile(rb"\x06.{36}\x04\x00{3}zstd|\x0f\x04\x00{7}", re.DOTALL)
"""How a compressed chunk begins, and the record that ends the data."""
_DAMAGE = (*PARSE_ERRORS, zstandard.ZstdError, zlib.error, KeyError, RecursionError)
_ANGLES = tuple(spec.column for spec in CHANNELS if spec.axis is not None)
_NEEDED_FIELDS = ("t_s", "tick", *_ANGLES, *(spec.field for spec in CHANNELS if spec.column in OWN_COLUMNS))
"""Fields that every version writes: a flight has columns of its own for them."""


MAX_LOG_BYTES = 1 << 30
"""Most that a log may hold, packed and unpacked: about four hours."""


@dataclass
class Scan:
    """A log while it is being read, and the records found so far."""

    path: Path  # Path of the log, for messages
    data: memoryview  # The whole file
    layout: MessageLayout | None = None  # Layout of the ticks; None until their channel was found
    ticks: list[NDArray[Any]] = field(default_factory=list)  # Ticks in the order of the file
    events: list[dict[str, Any]] = field(default_factory=list)  # events, link: Messages of the rare topics
    link: list[dict[str, Any]] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    """Named records; the later of two values counts."""
    notes: list[str] = field(default_factory=list)  # Defects of the file
    closed: bool = False  # Whether the record was found that ends the data of a closed log
    _index: Index | None = None
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, Channel] = field(default_factory=dict)
    _tick: TickRecord = field(default_factory=TickRecord)
    _records: list[Metadata] = field(default_factory=list)
    _has_crcs: bool = False
    _unpacked_bytes: int = 0
    _head_is_intact: bool = False
    _damaged_chunks: int = 0
    _lost: list[tuple[int, int]] = field(default_factory=list)
    _in_head: bool = True

    def run(self) -> None:
        """Walk the whole file."""
        self._refuse_joined_logs()
        # With the index, ticks are readable even if the schemas at the head are damaged.
        self._index = read_index(self.data)
        for schema in self._index.schemas if self._index else ():
            self._schemas[schema.id] = schema
        for channel in self._index.channels if self._index else ():
            self._add_channel(channel)
        position = len(_MAGIC)
        while position < len(self.data) and not self.closed:
            try:
                position = self._read_record(position)
            except _NotARecord:
                next_position = _next_record(self.data, position, self._index)
                if next_position is None:
                    self._note_early_end(position)
                    break
                self._lost.append((position, next_position))
                position = next_position
        if not self.closed and position == len(self.data):
            self._note_early_end(position)  # cut exactly between two records
        self._check_description()
        self._merge_intact_metadata()
        self._note_damage()

    def _refuse_joined_logs(self) -> None:
        """Refuse a file with the head of a second log: two flights would be read as one, or the second one
        would be left out.
        """
        second = _HEAD.search(self.data, len(_MAGIC))
        if second is not None:
            at = second.start()
            raise LogError(
                f"{self.path} holds two logs that were joined; the second begins after {at} bytes",
                f"give the logs themselves, or cut it: head -c {at} FILE > 1.mcap; "
                f"tail -c +{at + 1} FILE > 2.mcap",
            )

    def _read_record(self, position: int) -> int:
        """Read the record at ``position``; return the position of the next record."""
        if len(self.data) - position < RECORD_HEADER.size:
            raise _NotARecord
        opcode, length = RECORD_HEADER.unpack_from(self.data, position)
        start: int = position + RECORD_HEADER.size
        if length > len(self.data) - start:
            raise _NotARecord
        body = self.data[start : start + length]
        if opcode == Opcode.CHUNK:
            chunk = _parse_all_bytes(Chunk, body)
            try:
                self._read_chunk(chunk)
            except _DAMAGE:
                self._damaged_chunks += 1
        elif opcode == Opcode.METADATA:
            self._add_metadata(_parse_all_bytes(Metadata, body), position)
        elif opcode == Opcode.MESSAGE_INDEX:
            # Its content is not needed, but a wrong length would lead to a wrong next record.
            if length < _MESSAGE_INDEX.size or _stated_entries_bytes(body) != length - _MESSAGE_INDEX.size:
                raise _NotARecord
        elif opcode == Opcode.DATA_END:
            self._end_data_section(_parse_all_bytes(DataEnd, body), position)
        elif opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL) and self._in_head:
            self._read_description(opcode, body)
        elif opcode == Opcode.ATTACHMENT or opcode >= _PRIVATE_OPCODES:
            self.notes.append(f"the record at byte {position} is of a kind unknown to heli-host")
        else:
            raise _NotARecord
        self._in_head = self._in_head and opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL)
        return start + int(length)

    def _read_description(self, opcode: int, body: memoryview) -> None:
        """Process a header, schema or channel. The index has all channels, so those of the data are then
        ignored.
        """
        if opcode == Opcode.HEADER:
            _parse_all_bytes(Header, body)
        elif self._index is not None and self._index.channels:
            return
        elif opcode == Opcode.SCHEMA:
            schema = _parse_all_bytes(Schema, body)
            self._schemas[schema.id] = schema
        else:
            self._add_channel(_parse_all_bytes(Channel, body))

    def _add_channel(self, channel: Channel) -> None:
        """Note a channel of the log; that of the ticks determines the layout of their records."""
        self._channels[channel.id] = channel
        if channel.topic != TICK_TOPIC or channel.id == self._tick.channel:
            return
        schema = self._schemas.get(channel.schema_id)
        if schema is None or schema.name != TICK_SCHEMA_NAME or schema.encoding != "ros2msg":
            raise LogError(
                f"{self.path}: {TICK_TOPIC} is not written by heli-host", "give a log written by heli-host"
            )
        layout = parse_layout(schema.data.decode("utf-8", errors="replace"))
        missing = [name for name in _NEEDED_FIELDS if name not in (layout.dtype.names or ())]
        if missing:
            raise LogError(
                f"{self.path} has no column {missing[0]}", "read it with the heli-host version that wrote it"
            )
        self.layout = layout
        self._tick.layout, self._tick.channel = tick_record(layout), channel.id

    def _add_metadata(self, record: Metadata, position: int) -> None:
        """Process a metadata record; the record `HEAD` shows whether the bytes before it are intact."""
        self._records.append(record)
        self._has_crcs = self._has_crcs or RECORD_CRC in record.metadata
        if record.name == HEAD and _matches_its_crc(record):
            head = head_values(bytes(self.data[:position]))
            self._head_is_intact = head.items() <= record.metadata.items()

    def _check_description(self) -> None:
        """Raise a LogError if the beginning is damaged and the meaning of the numbers is uncertain."""
        if self._head_is_intact or (self._records and not self._has_crcs):
            return
        self.notes.append("the first bytes, which say how the numbers are to be read, are damaged")
        has_index_copy = self._index is not None and self._index.channels
        is_standard_layout = self.layout == TICK_LAYOUT and sorted(self._channel_topics()) == [
            EVENT_TOPIC,
            LINK_TOPIC,
            TICK_TOPIC,
        ]
        if self.layout is not None and not has_index_copy and not is_standard_layout:
            raise LogError(f"{self.path} is damaged in the description of its columns", "copy it again")

    def _channel_topics(self) -> list[str]:
        return [channel.topic for channel in self._channels.values()]

    def _end_data_section(self, record: DataEnd, position: int) -> None:
        """Process the end of the data section: compare its CRC, and note an index that is missing."""
        if self._index is not None and position != self._index.data_end:
            raise _NotARecord
        self.closed = True
        # A CRC of 0 means that the writer did not compute it, unless the log states that it has CRCs.
        has_crc = record.data_section_crc != 0 or self._has_crcs
        is_intact = has_crc and record.data_section_crc == zlib.crc32(self.data[:position])
        if has_crc and not is_intact:
            self.notes.append("the CRC of the whole file does not fit: it is not as it was written")
        if self._index is None:
            data_text = "; all data before it is whole" if is_intact else ""
            self.notes.append(f"the index at its end is damaged or missing{data_text}")

    def _note_early_end(self, position: int) -> None:
        """Note that the log ends at `position`, because it was cut short or because its end is damaged."""
        bytes_left = len(self.data) - position
        if self.data[-len(_MAGIC) :] == _MAGIC and bytes_left:
            self.notes.append(f"its last {bytes_left} bytes are damaged and were left out")
        else:
            self.notes.append(
                f"the log was not closed (it ends {bytes_left} bytes into a record): "
                f"{sum(map(len, self.ticks))} ticks were readable"
            )

    def _merge_intact_metadata(self) -> None:
        """Merge the records that fit their CRC; those of a log without any are taken as they are."""
        if not self._has_crcs:
            self.notes.append(
                "written before logs carried a CRC of their metadata: damage to its parameters would not show"
            )
        damaged: list[str] = []
        for record in self._records:
            if self._has_crcs and not _matches_its_crc(record):
                damaged.append(record.name)
            elif record.name != HEAD:
                values = {key: value for key, value in record.metadata.items() if key != RECORD_CRC}
                self.metadata.setdefault(record.name, {}).update(values)
        if damaged:
            names = ", ".join(repr(name[:40]) for name in damaged)
            self.notes.append(f"metadata is damaged and was left out: {names}")

    def _note_damage(self) -> None:
        """Note what is missing: damaged chunks, damaged bytes, and ticks that were written but are not
        readable.
        """
        if self._damaged_chunks:
            self.notes.append(f"{self._damaged_chunks} chunks are damaged and were left out")
        for start, stop in self._lost:
            self.notes.append(f"bytes {start} to {stop} are damaged and were left out")
        written_count = self._index.message_counts.get(self._tick.channel) if self._index else None
        read_count = sum(map(len, self.ticks))
        if written_count is not None and written_count != read_count:
            self.notes.append(f"{written_count} ticks were written, {read_count} are readable")

    def _read_chunk(self, chunk: Chunk) -> None:
        """Add ticks and messages of a chunk. A damaged chunk adds nothing, because its content is checked
        before.
        """
        # A chunk that claims more is damaged, which `unpacked` finds: its claim does not count.
        if chunk.uncompressed_size <= LARGEST_CHUNK_BYTES:
            self._unpacked_bytes += chunk.uncompressed_size
        if self._unpacked_bytes > MAX_LOG_BYTES:
            raise LogError(
                f"{self.path} unpacks to more than {MAX_LOG_BYTES >> 20} MiB", "cut it into pieces"
            )
        body = unpacked(chunk, self._has_crcs, self.path)
        ticks: list[NDArray[Any]] = []
        messages: list[memoryview] = []
        for item in records_of(body, self._tick):
            if isinstance(item, np.ndarray):
                ticks.append(item)
                continue
            opcode, record = item
            if opcode == Opcode.MESSAGE:
                messages.append(record)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._read_description(opcode, record)
        for message in messages:
            self._add_json_message(message)
        self.ticks += ticks

    def _add_json_message(self, record: memoryview) -> None:
        """Add the JSON message of an event or of the link counters; messages of other topics are ignored."""
        channel_id, *_ = _MESSAGE_HEADER.unpack_from(record)
        topic = self._channels[channel_id].topic if channel_id in self._channels else ""
        if topic not in (EVENT_TOPIC, LINK_TOPIC):
            return
        if len(record) > _MAX_MESSAGE_BYTES or len(self.link) + len(self.events) >= _MAX_MESSAGES:
            raise ValueError("more messages than any flight has")
        message = json.loads(bytes(record[_MESSAGE_HEADER.size :]))
        if not isinstance(message, dict) or not _is_time(message.get("t_s")):
            raise ValueError("a message without a time")
        if topic == LINK_TOPIC:
            self.link.append(message)
        elif isinstance(message.get("name"), str) and isinstance(message.get("message"), str):
            self.events.append(message)


class _NotARecord(Exception):
    """The bytes at an expected record are not a record."""


def _parse_all_bytes(kind: Any, body: memoryview) -> Any:
    """Parse a record that must use all its bytes."""
    try:
        return parse(kind, body)
    except PARSE_ERRORS as error:
        raise _NotARecord from error


def _is_time(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) < _MAX_TIME_S


def _stated_entries_bytes(body: memoryview) -> int:
    entries_bytes = int(_MESSAGE_INDEX.unpack_from(body)[1])
    return -1 if entries_bytes % _INDEX_ENTRY_BYTES else entries_bytes


def _matches_its_crc(record: Metadata) -> bool:
    return record.metadata.get(RECORD_CRC) == metadata_crc(record.name, record.metadata)


def _next_record(data: memoryview, position: int, index: Index | None) -> int | None:
    """Return the position after a damaged one at which reading can continue; None if there is none."""
    if index is not None:
        return next((offset for offset in index.offsets if offset > position), None)
    if len(data) - position >= RECORD_HEADER.size:
        after_record = position + RECORD_HEADER.size + RECORD_HEADER.unpack_from(data, position)[1]
        if _may_begin_record(data, after_record):
            return int(after_record)
    landmark = _LANDMARK.search(data, position + 1)
    return landmark.start() if landmark is not None else None


def _may_begin_record(data: memoryview, position: int) -> bool:
    """Whether a record of the data may begin at a position."""
    if position > len(data) - RECORD_HEADER.size:
        return False
    opcode, length = RECORD_HEADER.unpack_from(data, position)
    return opcode in _IN_DATA and length <= len(data) - position - RECORD_HEADER.size
