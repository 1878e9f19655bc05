"""``heli-host fly`` in a forked process whose port reads slowly, fails, or goes away within a write."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_MOST_FDS = 256
SLOW, READ_FAILS, WRITE_FAILS, CUT_WRITE = "slow reads", "EIO on read", "EIO on write", "hang-up in a write"


@dataclass(frozen=True)
class PortTrouble:
    """Trouble inside the host's own system calls.

    Parameters
    ----------
    kind : str
        `SLOW`, `READ_FAILS`, `WRITE_FAILS` or `CUT_WRITE`.
    at_s, until_s : float
        When it begins and when slow reads end, in seconds of this computer since the host's start.
    """

    kind: str
    at_s: float
    until_s: float


class TroubledOs:
    """Stands between pyserial and the system's ``os``: each failure happens once.

    Parameters
    ----------
    cut : callable
        Takes the cable out, and returns when it is out.
    """

    def __init__(self, troubles: list[PortTrouble], cut: Callable[[], None]) -> None:
        self._troubles = list(troubles)
        self._cut = cut
        self._begin_s = time.monotonic()

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def read(self, fd: int, size: int) -> bytes:
        """Read as ``os.read`` does, or slowly, or fail."""
        if self._due(READ_FAILS):
            raise OSError(errno.EIO, "Input/output error")
        now_s = time.monotonic() - self._begin_s
        if any(
            trouble.kind == SLOW and trouble.at_s <= now_s < trouble.until_s for trouble in self._troubles
        ):
            time.sleep(0.004)
            size = min(size, 40)
        return os.read(fd, size)

    def write(self, fd: int, data: Any) -> int:
        """Write as ``os.write`` does, or fail, or lose the port after half of the bytes."""
        if self._due(WRITE_FAILS):
            raise OSError(errno.EIO, "Input/output error")
        if len(data) > 1 and self._due(CUT_WRITE):
            half = os.write(fd, data[: len(data) // 2])
            self._cut()
            return half
        return os.write(fd, data)

    def _due(self, kind: str) -> bool:
        now_s = time.monotonic() - self._begin_s
        due = next(
            (trouble for trouble in self._troubles if trouble.kind == kind and trouble.at_s <= now_s), None
        )
        if due is not None:
            self._troubles.remove(due)
        return due is not None


@dataclass(frozen=True)
class Host:
    """A running host.

    Parameters
    ----------
    pid : int
        Its process.
    asks : int
        File descriptor that gives a byte when the host wants its cable out.
    answers : int
        File descriptor that takes a byte when it is out.
    """

    pid: int
    asks: int
    answers: int


def start_host(words: list[str], folder: Path, troubles: list[PortTrouble]) -> Host:
    """Fork a process that runs ``heli-host`` with these words; its output goes to two files of the folder.

    Call it from a process with one thread, in which everything that flies is imported already.
    """
    asks, ask = os.pipe()
    answered, answer = os.pipe()
    pid = os.fork()
    if pid:
        os.close(ask)
        os.close(answered)
        os.set_blocking(asks, False)
        return Host(pid, asks, answer)
    code = 70
    try:
        os.close(asks)
        os.close(answer)
        code = _run(words, folder, troubles, ask, answered)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _run(words: list[str], folder: Path, troubles: list[PortTrouble], ask: int, answered: int) -> int:
    for number, name in ((1, "stdout"), (2, "stderr")):
        fd = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(fd, number)
        os.close(fd)
    # A copy of the board's side of the terminal would keep the port alive after its unplugging.
    for fd in range(3, _MOST_FDS):
        if fd not in (ask, answered):
            with contextlib.suppress(OSError):
                os.close(fd)
    os.chdir(folder)

    def cut() -> None:
        os.write(ask, b"x")
        os.read(answered, 1)

    from serial import serialposix

    serialposix.os = TroubledOs(troubles, cut)  # type: ignore[attr-defined]
    from heli_host.ui.cli.entry import run

    return run(words)
