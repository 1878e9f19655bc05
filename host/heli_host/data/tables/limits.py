"""Limits for foreign files: a small file can unpack to any size, so the size is computed first."""

from __future__ import annotations

import contextlib
import io
import os
import struct
import sys
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from heli_host.errors import FlightDataError

if TYPE_CHECKING:
    import pyarrow.parquet


MAX_BYTES: Final = 1 << 28
"""Largest table, unpacked: half an hour at 1 kHz with 18 columns. Smaller refuses long flights; larger takes
more memory than a small computer can spare."""
MAX_NUMBERS: Final = MAX_BYTES // 8
"""Most numbers in a table, 8 bytes each in memory, however few bytes the file spends on them."""
MAX_ROWS: Final = 4_000_000
"""Most rows, messages or lines: an hour at 1 kHz. A line in memory takes 50 bytes or more."""
MAX_COLUMNS: Final = 1000
MAX_MEMORY_BYTES: Final = 1 << 31
"""Memory that reading may take in all, on Linux: for files that lie about their sizes. Measured: 0.6 GiB for
a .mat of 30 million numbers. Smaller refuses such files; larger lets a bomb stop a small computer."""
_STEP_BYTES: Final = 1 << 20
_REMEDY: Final = "cut it into pieces, or export fewer signals"


def too_large(path: Path, limit_text: str) -> FlightDataError:
    """Return the error for a file at `path` that unpacks to more than `limit_text`, such as "256 MiB"."""
    return FlightDataError(f"{path} unpacks to more than {limit_text}", _REMEDY)


def check_numbers(path: Path, count: int) -> None:
    """Refuse the table at `path` if its `count` of numbers is above `MAX_NUMBERS`."""
    if count > MAX_NUMBERS:
        raise too_large(path, f"{MAX_NUMBERS // 1_000_000} million numbers")


def check_columns(path: Path, count: int) -> None:
    """Refuse the table at `path` if its `count` of columns is above `MAX_COLUMNS`."""
    if count > MAX_COLUMNS:
        raise FlightDataError(
            f"{path} has more than {MAX_COLUMNS} columns", "remove columns that are not needed"
        )


@contextlib.contextmanager
def within_memory(path: Path) -> Iterator[None]:
    """Read the file at `path` within `MAX_MEMORY_BYTES` more than this process has; on Linux only."""
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit_before = resource.getrlimit(resource.RLIMIT_AS)
    limit_bytes = pages * resource.getpagesize() + MAX_MEMORY_BYTES
    if limit_before[0] != resource.RLIM_INFINITY:
        limit_bytes = min(limit_bytes, limit_before[0])
    resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, limit_before[1]))
    try:
        yield
    except MemoryError as error:
        raise FlightDataError(
            f"{path} needs more than {MAX_MEMORY_BYTES >> 30} GiB of memory to read", _REMEDY
        ) from error
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limit_before)


def unpacked_bytes(codec: str, data: bytes | memoryview, max_bytes: int) -> int:
    """Count the bytes to which compressed data unpacks, piece by piece, and stop beyond a limit."""
    if codec in ("", "none"):
        return len(data)
    if codec == "zstd":
        import zstandard

        count = 0
        with zstandard.ZstdDecompressor(max_window_size=MAX_BYTES).stream_reader(io.BytesIO(data)) as stream:
            while count <= max_bytes and (piece := stream.read(_STEP_BYTES)):
                count += len(piece)
        return count
    unpacker = _unpacker(codec)
    count, unread = 0, data
    while count <= max_bytes:
        piece = unpacker.decompress(unread, _STEP_BYTES)
        count += len(piece)
        # zlib returns the bytes that it has not read; the other unpackers keep them.
        unread = getattr(unpacker, "unconsumed_tail", b"")
        if unpacker.eof or (not piece and not unread):
            break
    return count


def _unpacker(codec: str) -> Any:
    """Return the decompressor of a codec."""
    if codec == "zlib":
        return zlib.decompressobj()
    if codec == "bz2":
        import bz2

        return bz2.BZ2Decompressor()
    if codec == "lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameDecompressor()
    raise ValueError(f"unknown compression {codec}")


MAX_CHUNK_BYTES: Final = 1 << 27
"""Largest chunk of a bag, which is in memory as a whole: one image of a large camera is 100 MB."""
MAX_RATIO: Final = 30
"""How much a bag above `MAX_BYTES` may unpack to, in sizes of its file. Bags of sensors compress 2 to 10
times; a bomb 1000 times."""
MAX_SHEET_BYTES: Final = 1 << 27
"""All XML of a spreadsheet. A million cells have 30 MB."""
MAX_CELLS: Final = 2_000_000
"""Cells of a sheet, empty ones between the first and the last too: half an hour at 100 Hz with 11 columns."""
MAX_ELEMENTS: Final = 3 * MAX_CELLS
"""XML elements of a spreadsheet: cells and their values, shared texts, styles. Each takes time."""
_COMPRESSED: Final = 15
_MAT_HEAD: Final = 128
_HDF: Final = b"\x89HDF\r\n\x1a\n"
_MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
_CHUNK, _CHUNK_INDEX = 0x06, 0x08


def check_mat(path: Path) -> None:
    """Refuse a file at `path`, of MATLAB 4 to 7.3 or of NumPy, that unpacks to more than `MAX_BYTES`."""
    size = path.stat().st_size
    if path.suffix.lower() == ".npz":
        with zipfile.ZipFile(path) as archive:
            size = max(size, sum(member.file_size for member in archive.infolist()))
    if size > MAX_BYTES:
        raise too_large(path, f"{MAX_BYTES >> 20} MiB")
    with path.open("rb") as file:
        header = file.read(_MAT_HEAD)
        # Version 7.3 is HDF5 behind a block of 512 bytes.
        if file.seek(512) and file.read(len(_HDF)) == _HDF:
            _check_hdf(path)
            return
        byte_order = {b"IM": "<", b"MI": ">"}.get(header[-2:])
        if len(header) < _MAT_HEAD or byte_order is None:
            return  # version 4, text of Octave, or NumPy, whose unpacked size is checked elsewhere
        # From version 5 on, the head is followed by elements: kind, length and content.
        file.seek(_MAT_HEAD)
        element_head = struct.Struct(f"{byte_order}II")
        total_bytes = 0
        while len(head := file.read(element_head.size)) == element_head.size:
            kind, length = element_head.unpack(head)
            if kind == _COMPRESSED:
                total_bytes += unpacked_bytes("zlib", file.read(length), MAX_BYTES - total_bytes)
            else:
                total_bytes += length
                file.seek(length, os.SEEK_CUR)
            if total_bytes > MAX_BYTES:
                raise too_large(path, f"{MAX_BYTES >> 20} MiB")


def _check_hdf(path: Path) -> None:
    """Refuse an HDF5 file (MATLAB 7.3) with too many numbers, by the sizes that its data sets state."""
    import h5py

    numbers = objects = 0

    def count(_: str, item: Any) -> None:
        """Count an object of the file and its numbers, and raise an error beyond the limits."""
        nonlocal numbers, objects
        objects += 1
        numbers += int(item.size or 0) if isinstance(item, h5py.Dataset) else 0
        check_numbers(path, numbers)
        if objects > MAX_ROWS:
            raise too_large(path, f"{MAX_ROWS // 1_000_000} million variables")

    with h5py.File(path, "r") as file:
        file.visititems(count)


def check_parquet(path: Path, file: pyarrow.parquet.ParquetFile) -> None:
    """Refuse the Parquet `file` at `path` if its row groups hold more than `MAX_NUMBERS` or `MAX_BYTES`.

    Both count: a run of equal numbers takes two bytes.
    """
    check_columns(path, file.metadata.num_columns)
    rows = numbers = size = 0
    for index in range(file.metadata.num_row_groups):
        group = file.metadata.row_group(index)
        rows += group.num_rows
        for number in range(group.num_columns):
            column = group.column(number)
            numbers += max(column.num_values, group.num_rows)
            size += column.total_uncompressed_size
    check_numbers(path, numbers)
    if size > MAX_BYTES:
        raise too_large(path, f"{MAX_BYTES >> 20} MiB")
    if rows > MAX_ROWS:
        raise too_large(path, f"{MAX_ROWS // 1_000_000} million rows")


def check_workbook(path: Path) -> None:
    """Refuse a spreadsheet (.xlsx) at `path` with more XML or elements than the limits of this module."""
    with zipfile.ZipFile(path) as archive:
        members = [
            member for member in archive.infolist() if member.filename.lower().endswith((".xml", ".rels"))
        ]
        # zipfile never returns more bytes of a member than the size that the member declares.
        if sum(member.file_size for member in members) > MAX_SHEET_BYTES:
            raise too_large(path, f"{MAX_SHEET_BYTES >> 20} MiB")
        elements = 0
        for member in members:
            with archive.open(member) as file:
                while step := file.read(_STEP_BYTES):
                    elements += step.count(b"<") - step.count(b"</")
                    if elements > MAX_ELEMENTS:
                        raise too_large(path, f"{MAX_ELEMENTS // 1_000_000} million elements")


def check_bag(path: Path) -> None:
    """Refuse a bag (.bag, .mcap) at `path` whose chunks unpack to more than a bag of this size can hold."""
    size = path.stat().st_size
    max_bytes = max(MAX_BYTES, MAX_RATIO * size)
    total, seen_offsets = 0, set()
    for offset, codec, data in _chunks_of_bag(path, size):
        if data is None:
            # A malicious index may list a chunk many times, so that it would be unpacked each time.
            if offset in seen_offsets:
                raise too_large(path, f"{max_bytes >> 20} MiB")
            seen_offsets.add(offset)
            continue
        count = unpacked_bytes(codec, data, MAX_CHUNK_BYTES)
        if count > MAX_CHUNK_BYTES:
            raise too_large(path, f"{MAX_CHUNK_BYTES >> 20} MiB in a chunk")
        total += count
        if total > max_bytes:
            raise too_large(path, f"{max_bytes >> 20} MiB")


def _chunks_of_bag(path: Path, size: int) -> Iterator[tuple[int, str, bytes | None]]:
    """Yield position, compression and packed bytes of each chunk, and the position in each index entry.

    An index entry has None instead of bytes.
    """
    with path.open("rb") as file:
        magic = file.read(13)
        if magic.startswith(_MCAP_MAGIC):
            yield from _mcap_chunks(file, size)
        elif magic == b"#ROSBAG V2.0\n":
            yield from _rosbag_chunks(file, size)


def _mcap_chunks(file: Any, size: int) -> Iterator[tuple[int, str, bytes | None]]:
    """Yield offset, codec and packed bytes of each chunk of an MCAP file, and None instead of bytes for each
    entry of its index.
    """
    offset = len(_MCAP_MAGIC)
    while offset + 9 <= size:
        file.seek(offset)
        kind, length = struct.unpack("<BQ", file.read(9))
        if offset + 9 + length > size:
            return
        if kind == _CHUNK and length >= 40:
            name_bytes = struct.unpack("<8x8x8x4xI", file.read(32))[0]
            codec = file.read(min(name_bytes, 8)).decode("ascii", errors="replace")
            data_bytes = struct.unpack("<Q", file.read(8))[0]
            yield offset, codec, file.read(min(data_bytes, length))
        elif kind == _CHUNK_INDEX and length >= 24:
            yield struct.unpack("<8x8xQ", file.read(24))[0], "", None
        offset += 9 + length


def _rosbag_chunks(file: Any, size: int) -> Iterator[tuple[int, str, bytes | None]]:
    """Yield offset, codec and packed bytes of each chunk of a ROS 1 bag, and None instead of bytes for each
    entry of its index.
    """
    offset = 13
    while offset + 8 <= size:
        file.seek(offset)
        head_bytes = struct.unpack("<I", file.read(4))[0]
        if offset + 8 + head_bytes > size:
            return
        header = _rosbag_fields(file.read(head_bytes))
        data_bytes = struct.unpack("<I", file.read(4))[0]
        kind = header.get(b"op", b"")
        if kind == b"\x05":
            yield (
                offset,
                header.get(b"compression", b"").decode("ascii", errors="replace"),
                file.read(data_bytes),
            )
        elif kind == b"\x06" and len(header.get(b"chunk_pos", b"")) == 8:
            yield struct.unpack("<Q", header[b"chunk_pos"])[0], "", None
        offset += 8 + head_bytes + data_bytes


def _rosbag_fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a record of a ROS 1 bag, by name."""
    fields, offset = {}, 0
    while offset + 4 <= len(header):
        length = struct.unpack_from("<I", header, offset)[0]
        name, _, value = header[offset + 4 : offset + 4 + length].partition(b"=")
        fields[name] = value
        offset += 4 + length
    return fields
