"""A server that turns when the test says so, on a clock that the test moves, and hosts of its ports."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections.abc import Callable

from heli_sim.sil.clock import TimedClock
from heli_sim.sil.endpoint import Endpoint
from heli_sim.sil.server import SilServer
from heli_sim.sil.world import SilWorld

# Only how long a failing test takes.
PATIENCE = 2000
WAIT_s = 0.01


class Bench:
    """Endpoint, world and server; `turn` lets a slice of 4 ms pass."""

    def __init__(self, endpoint: Endpoint, world: SilWorld) -> None:
        self.endpoint = endpoint
        self.world = world
        self.now_s = 0.0
        self.server = SilServer(endpoint, world, TimedClock(1.0), now_s=lambda: self.now_s)

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
