"""How large a file from another program may be once it is unpacked: a small file can claim any size."""

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


def too_large(path: Path, what: str) -> FlightDataError:
    """Return the error for the file at `path`, which unpacks to more than `what`, such as "256 MiB"."""
    return FlightDataError(f"{path} unpacks to more than {what}", _REMEDY)


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
    """Read the file at `path` within `MAX_MEMORY_BYTES` more than this process has; on Linux only.

    Raises
    ------
    FlightDataError
        When the block needs more.
    """
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + MAX_MEMORY_BYTES
    if before[0] != resource.RLIM_INFINITY:
        most = min(most, before[0])
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    try:
        yield
    except MemoryError as error:
        raise FlightDataError(
            f"{path} needs more than {MAX_MEMORY_BYTES >> 30} GiB of memory to read",
            _REMEDY,
        ) from error
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def unpacked_bytes(codec: str, data: bytes | memoryview, most_bytes: int) -> int:
    """Count the bytes that packed data gives, a step at a time, and stop beyond a limit.

    Parameters
    ----------
    codec : str
        ``zlib``, ``bz2``, ``lz4``, ``zstd``, or ``""`` and ``none`` for data as it is.
    data : bytes or memoryview
        The packed data.
    most_bytes : int
        Where to stop.

    Returns
    -------
    int
        The count; more than `most_bytes` where it was stopped.
    """
    if codec in ("", "none"):
        return len(data)
    if codec == "zstd":
        import zstandard

        count = 0
        with zstandard.ZstdDecompressor(max_window_size=MAX_BYTES).stream_reader(io.BytesIO(data)) as stream:
            while count <= most_bytes and (step := stream.read(_STEP_BYTES)):
                count += len(step)
        return count
    unpacker = _unpacker(codec)
    count, rest = 0, data
    while count <= most_bytes:
        step = unpacker.decompress(rest, _STEP_BYTES)
        count += len(step)
        # zlib hands back what it has not read; the others keep it.
        rest = getattr(unpacker, "unconsumed_tail", b"")
        if unpacker.eof or (not step and not rest):
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
