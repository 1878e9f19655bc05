"""A log's file on a disk that may be full, slow, or gone for seconds.

`DirectFile` writes in the caller's thread. It is for simulations in lockstep, whose time does not advance
during the write, and for work without a board. `BackgroundFile` writes in a separate thread. A blocked disk
then delays neither the reading of the board nor the setpoints.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import shutil
import stat
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from heli_host.data.log.schema import TICK_LAYOUT
from heli_host.errors import LogWriteError

_OVERHEAD_BYTES = 21
"""Largest number of bytes that the log adds to the values of a tick. Measured: 17, including the index."""
MAX_BYTES_PER_S = 1000 * (TICK_LAYOUT.dtype.itemsize + _OVERHEAD_BYTES)
"""Size of one second of ticks with their index, if it cannot be compressed; 15 to 20 kB are common."""
QUEUED_BYTES = 32 * 1024 * 1024
"""Most data that may wait for the disk: half an hour of a usual flight, 4 minutes of incompressible ticks."""
RESERVED_BYTES = 4 * 1024 * 1024
"""Free disk space at which a flight ends. The landing, the summary and the figure still have room."""

_MIN_FLIGHT_S = 60.0
_SYNC_S = 1.0
"""Time between two synchronisations: a power failure loses about as much of the log."""
_STALL_S = 0.5
"""Time of a write from which on the log reports that the disk blocked."""
_CLOSE_TIMEOUT_S = 60.0
_LOOK_S = 0.1
_FULL = (errno.ENOSPC, errno.EDQUOT)
_sync = getattr(os, "fdatasync", os.fsync)


class LogFile(Protocol):
    """Interface of the file that a log is written to."""

    @property
    def write_error(self) -> LogWriteError | None:
        """Error that ended the writing; the file then ends with a whole record. None if there is none."""
        ...

    @property
    def space_error(self) -> LogWriteError | None:
        """Error that is set when the disk has at most `RESERVED_BYTES` left; writing continues."""
        ...

    @property
    def has_room(self) -> bool:
        """Whether more may be appended without waiting for the disk."""
        ...

    def append(self, data: bytes) -> None:
        """Write whole records behind what was appended before."""
        ...

    def take_stalls_s(self) -> list[float]:
        """Return how long the disk blocked, for each time that was not reported yet [s]."""
        ...

    def drain(self) -> None:
        """Wait until the disk has taken everything."""
        ...

    def close(self) -> None:
        """Write what is left and close the file."""
        ...


LastRecord = Callable[[str], bytes]
"""Makes the last record of a log that could not be completed, with the reason."""


class DirectFile:
    """A log's file that `append` writes directly, without a thread."""

    def __init__(self, path: Path, last_record: LastRecord | None = None, *, overwrite: bool = False) -> None:
        self.write_error: LogWriteError | None = None
        self.space_error: LogWriteError | None = None
        self._path = path
        self._last_record = last_record
        self._file = _create_file(path, overwrite)
        self._bytes_written = 0

    @property
    def has_room(self) -> bool:
        """Always true, because `append` waits for the disk."""
        return True

    def append(self, data: bytes) -> None:
        """Write whole records; after a failure, the file ends with the last complete record."""
        if self.write_error is not None:
            raise self.write_error
        view = memoryview(data)
        try:
            while view:
                # The file is unbuffered, and may take only a part.
                view = view[self._file.write(view) or 0 :]
        except OSError as error:
            raise self._note_failure(error) from error
        self._bytes_written += len(data)
        if self.space_error is not None:
            return  # it ends the flight; the first reason counts
        free = free_bytes(self._path.parent)
        if free is not None and free < RESERVED_BYTES:
            self.space_error = LogWriteError(
                f"the disk of the log {self._path} is almost full, {_megabytes_text(free)} are left",
                "free some disk space",
            )
        max_bytes = max_file_bytes()
        if max_bytes is not None and max_bytes - self._bytes_written < RESERVED_BYTES:
            self.space_error = LogWriteError(
                f"the log {self._path} has almost the size that a file may have here, "
                f"{_megabytes_text(max_bytes)}",
                "raise the limit (ulimit -f), or fly for a shorter time",
            )

    def sync(self) -> None:
        """Synchronise the written bytes to the disk."""
        try:
            _sync(self._file.fileno())
        except OSError as error:
            # Devices and pipes have nothing to keep.
            if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EROFS):
                raise self._note_failure(error) from error

    def take_stalls_s(self) -> list[float]:
        """Return an empty list, because only the caller waits for the disk."""
        return []

    def drain(self) -> None:
        """Do nothing, because `append` has written everything."""

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _note_failure(self, error: OSError) -> LogWriteError:
        """Note that the log cannot be written, cut it to its last complete record, and return the error."""
        remedy = "the log is readable up to here"
        if error.errno in _FULL:
            remedy = f"free some disk space; {remedy}"
        elif error.errno == errno.EFBIG:
            remedy = f"raise the limit of a file's size (ulimit -f); {remedy}"
        self.write_error = LogWriteError(
            f"cannot write the log {self._path}: {error.strerror or error}", remedy
        )
        with contextlib.suppress(OSError):
            self._file.truncate(self._bytes_written)
            self._write_reason(error.strerror or str(error))
        return self.write_error

    def _write_reason(self, reason: str) -> None:
        """Write a record with the reason why the log ends, if there is room for the whole record."""
        if self._last_record is None:
            return
        data = self._last_record(reason)
        written_bytes = 0
        with contextlib.suppress(OSError):
            self._file.seek(self._bytes_written)
            written_bytes = self._file.write(data) or 0
        if written_bytes < len(data):
            self._file.truncate(self._bytes_written)


class BackgroundFile:
    """A log's file, written by a thread of its own and kept by the disk about every second."""

    def __init__(
        self,
        path: Path,
        queued_bytes: int = QUEUED_BYTES,
        now_s: Callable[[], float] = time.monotonic,
        last_record: LastRecord | None = None,
        *,
        overwrite: bool = False,
    ) -> None:
        self._file = DirectFile(path, last_record, overwrite=overwrite)
        self._path = path
        self._now_s = now_s
        self._max_queued_bytes = queued_bytes
        self._changed = threading.Condition()
        self._queue: deque[bytes] = deque()
        self._queued_bytes = 0
        self._stalls_s: list[float] = []
        self._closing = False
        self._failure: LogWriteError | None = None
        self._thread = threading.Thread(target=self._write_until_closed, name="heli-host log", daemon=True)
        self._thread.start()

    @property
    def write_error(self) -> LogWriteError | None:
        """Error that ended the writing; None if there is none."""
        return self._failure or self._file.write_error

    @property
    def space_error(self) -> LogWriteError | None:
        """Error that is set when the disk has little space left."""
        return self._file.space_error

    @property
    def has_room(self) -> bool:
        """Whether fewer bytes wait for the disk than `queued_bytes`."""
        return self._queued_bytes < self._max_queued_bytes

    def append(self, data: bytes) -> None:
        """Queue whole records for the thread, without waiting for the disk."""
        if self.write_error is not None:
            raise self.write_error
        with self._changed:
            self._queue.append(data)
            self._queued_bytes += len(data)
            self._changed.notify_all()

    def take_stalls_s(self) -> list[float]:
        """Return how long the disk blocked, for each time that was not reported yet [s]."""
        with self._changed:
            stalls_s, self._stalls_s = self._stalls_s, []
        return stalls_s

    def close(self) -> None:
        """Wait until the disk has everything, and close the file."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._wait_while(self._thread.is_alive)

    def drain(self) -> None:
        """Wait until the disk has taken everything."""
        self._wait_while(lambda: self._queued_bytes > 0)

    def _wait_while(self, busy: Callable[[], bool]) -> None:
        """Wait while the disk is `busy`, but give up if it accepts no byte for a long time."""
        queued_before, last_progress_s = self._queued_bytes, self._now_s()
        while busy() and self.write_error is None:
            with self._changed:
                self._changed.wait(_LOOK_S)
            if self._queued_bytes != queued_before:
                queued_before, last_progress_s = self._queued_bytes, self._now_s()
            elif self._now_s() - last_progress_s > _CLOSE_TIMEOUT_S:
                self._failure = LogWriteError(
                    f"the disk of the log {self._path} has accepted no data for {_CLOSE_TIMEOUT_S:g} s",
                    "find out what blocks the disk; the log is readable up to that moment",
                )
        if self.write_error is not None:
            raise self.write_error

    def _write_until_closed(self) -> None:
        """Write queued records until the file is closed or fails; any error of this thread is reported."""
        try:
            sync_folder(self._path.parent)
            synced_s = self._now_s()
            while (data := self._wait_for_records()) is not None:
                before_s = self._now_s()
                self._file.append(data)
                if self._now_s() - synced_s >= _SYNC_S:
                    self._file.sync()
                    synced_s = self._now_s()
                blocked_s = self._now_s() - before_s
                with self._changed:
                    self._queued_bytes -= len(data)
                    if blocked_s >= _STALL_S:
                        self._stalls_s.append(blocked_s)
                    self._changed.notify_all()
            self._file.sync()
        except LogWriteError:
            pass  # the file keeps its error, and `write_error` reports it
        except Exception as error:  # noqa: BLE001 - a thread that dies must say so, whatever killed it
            self._failure = LogWriteError(
                f"cannot write the log {self._path}: {type(error).__name__}: {error}", "report it"
            )
        finally:
            self._file.close()
            with self._changed:
                self._queue.clear()
                self._queued_bytes = 0
                self._changed.notify_all()

    def _wait_for_records(self) -> bytes | None:
        """Wait for queued records and return them; None after the file was closed."""
        with self._changed:
            while not self._queue:
                if self._closing:
                    return None
                self._changed.wait()
            return self._queue.popleft()


def check_new(path: Path) -> None:
    """Refuse to write over a log, or one under a name that other programs take for a table."""
    if path.suffix.lower() != ".mcap" and not _is_device(path):
        raise LogWriteError(
            f"cannot record into {path}, because a log is an .mcap file",
            "give a name that ends in .mcap, and convert the log with heli-host export --csv",
        )
    if path.exists() and not _is_device(path):
        raise LogWriteError(
            f"{path} exists already, and heli-host never replaces a log",
            "give another name, or move the file",
        )


def check_free_space(path: Path, duration_s: float) -> None:
    """Refuse to begin a flight that the disk may not hold."""
    needed_bytes = RESERVED_BYTES + max(_MIN_FLIGHT_S, duration_s) * MAX_BYTES_PER_S
    available_bytes = free_bytes(path.parent)
    if available_bytes is not None and available_bytes < needed_bytes:
        raise LogWriteError(
            f"the disk of the log {path} has {_megabytes_text(available_bytes)} left, but the flight can "
            f"need {_megabytes_text(needed_bytes)}",
            "free disk space, or choose another disk with --log",
        )
    max_bytes = max_file_bytes()
    if max_bytes is not None and max_bytes < needed_bytes:
        raise LogWriteError(
            f"this system allows files of {_megabytes_text(max_bytes)}, but the log {path} can need "
            f"{_megabytes_text(needed_bytes)}",
            "raise the limit (ulimit -f), or fly for a shorter time",
        )


def max_file_bytes() -> int | None:
    """Return the largest size to which this process may write a file; None where there is no such limit."""
    try:
        import resource
    except ImportError:  # Windows has no limits of a process
        return None
    soft_limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    return None if soft_limit == resource.RLIM_INFINITY else soft_limit


def free_bytes(folder: Path) -> int | None:
    """Return the free space of the disk that contains a folder."""
    for candidate in (folder, *folder.absolute().parents):
        try:
            return shutil.disk_usage(candidate).free
        except FileNotFoundError:
            continue
        except OSError:
            return None
    return None


def sync_folder(folder: Path) -> None:
    """Synchronise the folder of a new file; without this, a power cut may lose the whole file."""
    # Windows cannot open folders, and stores names without this call.
    with contextlib.suppress(OSError):
        opened = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


def _create_file(path: Path, overwrite: bool) -> io.FileIO:
    """Create the log file and its folder; an existing log is an error unless `overwrite` is set."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if overwrite and path.is_file():
            # The old file is replaced, not emptied, so that a program that reads it is not disturbed.
            path.unlink()
        check_new(path)
        return io.FileIO(path, "w" if _is_device(path) else "x")
    except OSError as error:
        raise LogWriteError(
            f"cannot write the log {path}: {error.strerror or error}", "choose another path with --log"
        ) from error


def _is_device(path: Path) -> bool:
    """Whether it is such as ``/dev/null``, which holds nothing that could be lost."""
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except OSError:
        return False


def _megabytes_text(count: float) -> str:
    return f"{count / 1e6:.1f} MB"
