"""The index at the end of an MCAP file: positions of the records, and a copy of schemas and channels."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, MetadataIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

RECORD_HEADER = struct.Struct("<BQ")
DATA_END_BYTES = RECORD_HEADER.size + 4
PARSE_ERRORS = (McapError, ValueError, struct.error)
"""Exceptions of the mcap library for a damaged record."""

_FOOTER_BYTES = RECORD_HEADER.size + 20
_MAGIC = bytes(MCAP0_MAGIC)
_KINDS = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.STATISTICS: Statistics,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
}


@dataclass(frozen=True)
class Index:
    """An index whose CRC fits."""

    data_end: int  # Offset of the record that ends the data
    offsets: tuple[int, ...]  # Offsets of chunks, of metadata records and of `data_end`, in rising order
    schemas: tuple[Schema, ...]  # schemas, channels: All schemas and channels of the file
    channels: tuple[Channel, ...]
    message_counts: dict[int, int]  # Messages by channel id


def read_index(data: memoryview) -> Index | None:
    """Read the index of a file."""
    footer_start = len(data) - len(_MAGIC) - _FOOTER_BYTES
    if footer_start < 0 or data[-len(_MAGIC) :] != _MAGIC:
        return None
    if RECORD_HEADER.unpack_from(data, footer_start) != (Opcode.FOOTER, _FOOTER_BYTES - RECORD_HEADER.size):
        return None
    footer = parse(Footer, data[footer_start + RECORD_HEADER.size :][:20])
    start = footer.summary_start
    # The CRC covers the bytes from the start of the summary to the field of the CRC.
    checked = data[start : footer_start + _FOOTER_BYTES - 4]
    if not len(_MAGIC) <= start <= footer_start or footer.summary_crc != zlib.crc32(checked):
        return None
    records: dict[type, list[Any]] = {kind: [] for kind in _KINDS.values()}
    try:
        for opcode, body in _index_records(data[start:footer_start]):
            kind = _KINDS.get(Opcode(opcode))
            if kind is not None:
                records[kind].append(parse(kind, body))
    except PARSE_ERRORS:
        return None
    data_end = start - DATA_END_BYTES
    offsets = {chunk.chunk_start_offset for chunk in records[ChunkIndex]}
    offsets |= {metadata.offset for metadata in records[MetadataIndex]} | {data_end}
    return Index(
        data_end=data_end,
        offsets=tuple(sorted(offsets)),
        schemas=tuple(records[Schema]),
        channels=tuple(records[Channel]),
        message_counts={
            k: v for statistics in records[Statistics] for k, v in statistics.channel_message_counts.items()
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


def _index_records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and content of each record of the index, in the order of the file."""
    position = 0
    while position < len(data):
        opcode, length = RECORD_HEADER.unpack_from(data, position)
        position += RECORD_HEADER.size
        if length > len(data) - position:
            raise ValueError("a record reaches beyond the index")
        yield opcode, data[position : position + length]
        position += length
