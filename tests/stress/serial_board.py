"""A simulated board behind a pseudo-terminal, and the truth about what reached it and what its motors did."""

import contextlib
import errno
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from heli_host.declaration import MessageId
from heli_host.errors import HeliError, PortError
from heli_host.link.frames import FrameParser
from heli_host.link.transport import open_transport
from heli_sim.sil.faults import Span
from heli_sim.sil.options import parse_options
from heli_sim.sil.pty import PtyEndpoint
from heli_sim.sil.server import SilServer, TimedClock
from heli_sim.sil.world import SilWorld

from tests.sil.faulty_flights import Heard

LAND_AFTER_TICKS: Final = 2000
"""Age of the newest setpoint at which a board lands by itself: `setpoint_land_s`."""
TAKES_BYTES: Final = "another program takes bytes"
WRITES: Final = "another program writes"
CHANGES_SETTINGS: Final = "another program changes the settings"
COMPETES: Final = "a second heli-host"
SLOW, READ_FAILS, WRITE_FAILS, CUT_WRITE = "slow reads", "EIO on read", "EIO on write", "hang-up in a write"

_WRITES_EVERY_S: Final = 0.1
_TICK_S: Final = 1e-3
_LANDINGS: Final = (MessageId.LAND, MessageId.STOP)
_MOST_FDS = 256


@dataclass
class Truth:
    """Events at the board's side of the port, in ticks of the board; -1 if an event has not happened."""

    armed_tick: int = -1  # Newest frame before the loops were closed, from the request to arm on
    longest_silence_ticks: int = 0  # Longest time without a frame, from arming to closing the loops
    closed_tick: int = -1  # Request to close the loops
    fresh_tick: int = -1  # Newest setpoint that the board could still follow
    longest_gap_ticks: int = 0  # Longest time without one, from closing the loops to the end
    land_tick: int = -1  # The host's first request to land or to stop
    stop_tick: int = -1  # Its first stop
    last_on_tick: int = -1  # The last voltage on a motor

    def hear(self, message: int, tick: int) -> None:
        """Note a frame of the host that reached the board."""
        if self.closed_tick < 0 and (message == MessageId.ARM or self.armed_tick >= 0):
            if self.armed_tick >= 0:
                self.longest_silence_ticks = max(self.longest_silence_ticks, tick - self.armed_tick)
            self.armed_tick = tick
        if message in (MessageId.CONTROL, MessageId.SETPOINT) and self._follows:
            # A request that is sent again is answered, but not carried out again.
            if message == MessageId.CONTROL and self.closed_tick < 0:
                self.closed_tick = self.fresh_tick = tick
            elif message == MessageId.SETPOINT and self.closed_tick >= 0:
                self.age(tick)
                self.fresh_tick = tick if self._follows else self.fresh_tick
        elif message in _LANDINGS and self.closed_tick >= 0:
            if self._follows:
                self.age(tick)
                self.land_tick = tick
            if message == MessageId.STOP and self.stop_tick < 0:
                self.stop_tick = tick

    def age(self, tick: int) -> None:
        """Note that the newest setpoint is as old as this tick makes it."""
        if self.closed_tick >= 0 and self.land_tick < 0:
            self.longest_gap_ticks = max(self.longest_gap_ticks, tick - self.fresh_tick)

    @property
    def longest_ticks(self) -> int:
        """The longest time in which the board waited for its host."""
        return max(self.longest_gap_ticks, self.longest_silence_ticks)

    @property
    def _follows(self) -> bool:
        return self.land_tick < 0 and self.longest_ticks <= LAND_AFTER_TICKS


class SerialBoard:
    """Serves a world behind a pseudo-terminal in the caller's thread."""

    def __init__(self, path: Path, seed: int, speed: float) -> None:
        self.world = SilWorld(parse_options({"seed": str(seed), "board": "native"}))
        self.endpoint = PtyEndpoint(path)
        self.heard = Heard()
        self.heard.listen(self.world)
        self.truth = Truth()
        self.sent_bytes = 0
        self._path = path
        self._server = SilServer(self.endpoint, self.world, TimedClock(speed))
        self._parser = FrameParser()
        self._carry = self.world.to_board.pass_through
        self.world.to_board.pass_through = self._listen  # type: ignore[method-assign]

    @property
    def time_s(self) -> float:
        """Time of the board [s]."""
        return self.world.time_s

    @property
    def flies(self) -> bool:
        """Whether the loops are closed and a motor runs."""
        return self.truth.closed_tick >= 0 and any(self.world.native.volts_V)

    def turn(self) -> None:
        """Serve the port once, then wait until there is something to do."""
        wait_s = self._server.turn()
        self._look()
        self.truth.age(self.world.tick)
        select.select([], [], [], wait_s)

    def alone(self, duration_s: float) -> None:
        """Let simulated time pass immediately, without a host."""
        for _ in range(round(duration_s / _TICK_S / 10.0)):
            self.world.advance(10)
            self._look()

    def unplug(self, duration_s: float) -> None:
        """Take the cable out now, for so long."""
        world = self.world
        span = Span(world.time_s, duration_s)
        faults = replace(world.options.faults, unplugs=(*world.options.faults.unplugs, span))
        world.options = replace(world.options, faults=faults)
        self._server.turn()
        # The next host begins with a fresh parser: it accepts a frame behind half of another one.
        self.heard.listen(world)

    def close(self) -> None:
        """Take the port away."""
        self.endpoint.close()

    def _listen(self, data: bytes) -> bytes:
        for frame in self._parser.feed(data):
            self.truth.hear(frame.id, self.world.tick)
        return self._carry(data)

    def _look(self) -> None:
        if any(self.world.native.volts_V):
            self.truth.last_on_tick = self.world.tick
            self.truth.age(self.world.tick)


_INPUT_MODES, _LOCAL_MODES = 0, 3
"""Places in the list of tcgetattr."""


class SecondProgram:
    """A program that opens the port of a flight, as modem managers, terminals and colleagues do."""

    def __init__(self, kind: str, board: SerialBoard) -> None:
        self.reply = ""
        """Reply to a second ``heli-host``; ``opened`` if it got the port."""
        self.in_flight = board.flies
        """Whether the first one flew then."""
        self._kind = kind
        self._fd = -1
        self._board = board
        self._next_s = 0.0
        if kind == COMPETES:
            try:
                open_transport(str(board.endpoint.terminal)).close()
                self.reply = "opened"
            except HeliError as error:
                self.reply = (
                    str(error) if isinstance(error, PortError) else f"{type(error).__name__}: {error}"
                )
            return
        with contextlib.suppress(OSError):
            self._fd = os.open(board.endpoint.terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        if kind == CHANGES_SETTINGS and self._fd >= 0:
            settings = termios.tcgetattr(self._fd)
            settings[_INPUT_MODES] |= termios.ICRNL | termios.IXON
            settings[_LOCAL_MODES] |= termios.ECHO | termios.ICANON | termios.ISIG
            termios.tcsetattr(self._fd, termios.TCSANOW, settings)

    def turn(self) -> None:
        """Do once what it does all the time."""
        if self._fd < 0:
            return
        try:
            if self._kind == TAKES_BYTES:
                os.read(self._fd, 300)
            elif self._kind == WRITES and self._board.time_s >= self._next_s:
                self._next_s = self._board.time_s + _WRITES_EVERY_S
                os.write(self._fd, b"AT\r\n\x00ATE0")
        except OSError as error:
            if error.errno != errno.EAGAIN:
                self.close()

    def close(self) -> None:
        """End it, as a program does that leaves the terminal as it should be."""
        if self._fd < 0:
            return
        if self._kind == CHANGES_SETTINGS:
            with contextlib.suppress(OSError, termios.error):
                tty.setraw(self._fd)
        os.close(self._fd)
        self._fd = -1


@dataclass(frozen=True)
class PortTrouble:
    """Trouble inside the host's own system calls."""

    kind: str
    at_s: float
    until_s: float


class TroubledOs:
    """Stands between pyserial and the system's ``os``: each failure happens once."""

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
            # 40 bytes per 4 ms: less than half of what the board sends.
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
    """A running host."""

    pid: int
    asks: int
    answers: int


def start_host(words: list[str], folder: Path, troubles: list[PortTrouble]) -> Host:
    """Fork a process that runs ``heli-host`` with these words; its output goes to two files of the folder."""
    # Call it from a process with one thread, in which everything that flies is imported already.
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
        """Let the parent unplug the board, and wait until it has."""
        os.write(ask, b"x")
        os.read(answered, 1)

    from serial import serialposix

    serialposix.os = TroubledOs(troubles, cut)  # type: ignore[attr-defined]
    from heli_host.ui.cli.entry import run

    return run(words)
