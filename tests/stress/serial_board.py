"""A simulated board behind a pseudo-terminal, and the truth about what reached it and what its motors did."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import termios
import tty
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

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
_WRITES_EVERY_S: Final = 0.1
_TICK_S: Final = 1e-3
_LANDINGS: Final = (MessageId.LAND, MessageId.STOP)


@dataclass
class Truth:
    """Events at the board's side of the port, in ticks of the board; -1 for an event that has not happened.

    Attributes
    ----------
    armed_tick : int
        When the newest frame came before the loops were closed, from the request to arm on.
    longest_silence_ticks : int
        The longest time without a frame, from arming to closing the loops.
    closed_tick : int
        When the request to close the loops arrived.
    fresh_tick : int
        When the newest setpoint arrived that the board could still follow.
    longest_gap_ticks : int
        The longest time without one, from closing the loops to the end of the flight.
    land_tick : int
        When the host's first request to land or to stop arrived.
    stop_tick : int
        When its first stop arrived.
    last_on_tick : int
        When a motor had a voltage last.
    """

    armed_tick: int = -1
    longest_silence_ticks: int = 0
    closed_tick: int = -1
    fresh_tick: int = -1
    longest_gap_ticks: int = 0
    land_tick: int = -1
    stop_tick: int = -1
    last_on_tick: int = -1

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
    """Serves a world behind a pseudo-terminal in the caller's thread.

    Parameters
    ----------
    path : Path
        Name of the port.
    seed : int
        Seed of the simulation.
    speed : float
        Simulated seconds per second.
    """

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


class SecondProgram:
    """A program that opens the port of a flight, as modem managers, terminals and colleagues do.

    Parameters
    ----------
    kind : str
        `TAKES_BYTES` from the host; `WRITES` a modem's commands; `CHANGES_SETTINGS` to those of a terminal
        with echo; `COMPETES`: another ``heli-host``.
    """

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
            self._settings = termios.tcgetattr(self._fd)
            settings = termios.tcgetattr(self._fd)
            settings[0] |= termios.ICRNL | termios.IXON
            settings[3] |= termios.ECHO | termios.ICANON | termios.ISIG
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
        """End it."""
        if self._fd < 0:
            return
        if self._kind == CHANGES_SETTINGS:
            with contextlib.suppress(OSError, termios.error):
                tty.setraw(self._fd)
        os.close(self._fd)
        self._fd = -1
