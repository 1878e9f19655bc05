"""Limits for the unpacked size of foreign files, because a small file can unpack to any size."""

from __future__ import annotations

import contextlib
import io
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from heli_host.errors import FlightDataError

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
            f"{path} needs more than {MAX_MEMORY_BYTES >> 30} GiB of memory to read",
            _REMEDY,
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
