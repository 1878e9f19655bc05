"""Hosts for a simulated board: in frames on simulated time, over a port, and with patience."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host import Heli
from heli_host import declaration as d
from heli_host.link.frames import Frame, FrameParser, encode_frame
from heli_sim.sil.boards import EmulatedDue
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions, parse_options
from heli_sim.sil.ports import Endpoint
from heli_sim.sil.pty import PtyEndpoint
from heli_sim.sil.server import SilServer, TimedClock
from heli_sim.sil.world import SilWorld


def world(**options: str) -> SilWorld:
    return SilWorld(parse_options(options))


def world_of(heli: Heli) -> SilWorld:
    """The world behind an open connection."""
    transport = heli.session.transport
    assert isinstance(transport, InProcessTransport)
    return transport.world


def due_of(world: SilWorld) -> EmulatedDue:
    """The emulated Due of a world."""
    assert isinstance(world.board, EmulatedDue)
    return world.board


def turn_unseen(world: SilWorld, axis: int, turn_deg: float, *, unseen: bool = True) -> None:
    """Turn the arm while an encoder does not count, or while it counts: there and back, its reading jumps."""
    state = world.state
    state[axis] += np.radians(turn_deg)
    world.state = state
    world.native.encoders_out = [unseen and index == axis for index in range(len(d.AXES))]


def hello_frame(seq: int = 0) -> bytes:
    return encode_frame(
        d.MessageId.HELLO, seq, d.HelloMessage(request=1, link_hash=d.LINK_HASH, session=77).pack()
    )


class Host:
    """Frames to and from one world; time passes in `wait` and while an answer is awaited."""

    def __init__(self, world: SilWorld | None = None) -> None:
        self.world = world if world is not None else SilWorld(SilOptions())
        self.frames: list[Frame] = []
        self._parser = FrameParser()
        self._seq = 0
        self._request = 0

    @property
    def frames_bad(self) -> int:
        return self._parser.frames_bad

    def wait(self, ticks: int, data: bytes = b"") -> list[Frame]:
        new = self._parser.feed(self.world.advance(ticks, data))
        self.frames += new
        return new

    def ask(self, kind: Any, *fields: float) -> Any:
        """Send a command; the payload of its reply."""
        self._request = self._request % 255 + 1
        message = kind(self._request, *fields)
        data = encode_frame(kind.ID, self._seq, message.pack())
        self._seq = (self._seq + 1) % 256
        for _ in range(100):
            for frame in self.wait(1, data):
                if frame.id == kind.REPLY and frame.payload[0] == self._request:
                    return frame.payload
            data = b""
        raise AssertionError(f"no answer to {kind.__name__}")

    def hello(self) -> d.WelcomeMessage:
        welcome = d.WelcomeMessage.unpack(self.ask(d.HelloMessage, d.LINK_HASH, 77))
        assert welcome.result == d.Result.OK
        return welcome

    def order(self, kind: Any, *fields: float) -> d.AckMessage:
        return d.AckMessage.unpack(self.ask(kind, *fields))

    def drive(self, front_V: float, back_V: float) -> None:
        """Hand the motors open-loop voltages; the rig is held until they have built up, then let go."""
        self.hello()
        assert self.order(d.ParamSetMessage, d.Param.BUMPLESS_S, 0.02).result == d.Result.OK
        self.world.native.locked = [True] * 3
        assert self.order(d.ArmMessage).result == d.Result.OK
        assert self.order(d.ControlMessage, 0, front_V, back_V).result == d.Result.OK
        self.wait(300)
        self.world.native.locked = [False] * 3


# Only how long a failing test takes.
PATIENCE = 2000


class Bench:
    """Endpoint, world and server; `turn` lets a slice of 4 ms pass."""

    def __init__(self, endpoint: Endpoint, world: SilWorld) -> None:
        self.endpoint = endpoint
        self.world = world
        self.now_s = 0.0
        self.server = SilServer(endpoint, world, TimedClock(1.0), now_s=lambda: self.now_s)

    def open(self) -> PtyHost | TcpHost:
        """Open the port, as a host does."""
        kind = PtyHost if isinstance(self.endpoint, PtyEndpoint) else TcpHost
        return kind(self.endpoint.url)

    def turn(self, count: int = 1) -> None:
        for _ in range(count):
            self.now_s += 0.004
            self.server.turn()

    def turn_all(self, count: int) -> bool:
        """Turn, as part of a condition."""
        self.turn(count)
        return True

    def until(self, done: Callable[[], object]) -> None:
        """Turn until something is so; the kernel carries bytes in its own time."""
        for _ in range(PATIENCE):
            if done():
                return
            self.turn()
            select.select([], [], [], 0.0005)
        raise AssertionError("it never happened")


class PtyHost:
    """A host with the port open."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def write(self, data: bytes) -> None:
        assert os.write(self._fd, data) == len(data)

    def read(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self._fd, 65536)
        return b""

    def gone(self) -> bool:
        try:
            return os.read(self._fd, 65536) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def close(self) -> None:
        os.close(self._fd)


class TcpHost:
    """A host with a connection open."""

    def __init__(self, url: str) -> None:
        host, port = url.removeprefix("socket://").split(":")
        self._socket = socket.create_connection((host, int(port)))
        self._socket.setblocking(False)

    def write(self, data: bytes) -> None:
        assert self._socket.send(data) == len(data)

    def read(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return self._socket.recv(65536)
        return b""

    def gone(self) -> bool:
        try:
            return self._socket.recv(65536) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def close(self) -> None:
        self._socket.close()


PATIENT: Final = {"setpoint_hold_s": 5.0, "setpoint_land_s": 30.0}
"""Longest declared times that a board waits for a setpoint, s; for `Parameters.restore`."""
SOON_LANDING: Final = {"setpoint_hold_s": 5.0, "setpoint_land_s": 10.0}
"""The same where a test waits for the landing."""
SOON_HOLDING: Final = {"setpoint_hold_s": 2.0, "setpoint_land_s": 5.0}
"""The same where it waits for the hold as well, in real time."""


def patient_file(folder: Path) -> Path:
    """Write them as a file for ``--params``."""
    path = folder / "patient.toml"
    path.write_text("[parameters]\n" + "".join(f"{name} = {value}\n" for name, value in PATIENT.items()))
    return path
