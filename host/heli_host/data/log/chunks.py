"""Unpacks the chunks of a log, and reads their records: runs of ticks as arrays, others one by one."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk
from numpy.typing import NDArray

from heli_host.data.log.index import RECORD_HEADER
from heli_host.data.log.schema import CDR_LITTLE_ENDIAN
from heli_host.errors import LogError

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
