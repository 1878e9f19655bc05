"""Unpacked size of a file from another program, computed before that much memory is used."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from heli_host.data.tables.limits import (
    MAX_BYTES,
    MAX_ROWS,
    check_columns,
    check_numbers,
    too_large,
    unpacked_bytes,
)

if TYPE_CHECKING:
    import pyarrow.parquet

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
_STEP_BYTES: Final = 1 << 20
_COMPRESSED: Final = 15
_MAT_HEAD: Final = 128
_HDF: Final = b"\x89HDF\r\n\x1a\n"
_MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
_CHUNK, _CHUNK_INDEX = 0x06, 0x08


def check_mat(path: Path) -> None:
    """Refuse a MATLAB file at `path`, version 4 to 7.3, that unpacks to more than `MAX_BYTES`."""
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise too_large(path, f"{MAX_BYTES >> 20} MiB")
    with path.open("rb") as file:
        header = file.read(_MAT_HEAD)
        if file.seek(512) and file.read(len(_HDF)) == _HDF:
            _check_hdf(path)
            return
        if len(header) < _MAT_HEAD or header[-2:] not in (b"IM", b"MI"):
            return
        order = "<" if header[-2:] == b"IM" else ">"
        file.seek(_MAT_HEAD)
        total = 0
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            if kind == _COMPRESSED:
                total += unpacked_bytes("zlib", file.read(length), MAX_BYTES - total)
            else:
                total += length
                file.seek(length, 1)
            if total > MAX_BYTES:
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
