"""A TCP port as a serial port, for pyserial's ``socket://HOST:PORT`` on systems without pseudo-terminals."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable
from typing import Final

from heli_host.errors import listening_remedy
from typing_extensions import override

from heli_sim.errors import EndpointError
from heli_sim.sil.endpoint import Endpoint, LineChange

_CHUNK: Final = 65536
# A host that does not read must see the bridge overflow in the end, as with a serial driver, and not only
# after the megabytes that a system may buffer.
_SEND_BUFFER: Final = 16384


SILENT_S: Final = 3.0
"""A host that has sent nothing for so long gives way to one that waits; a session sends every 0.2 s."""
PATIENCE_S: Final = 1.0
"""How long the next host waits before it is informed who holds the board."""


class TcpEndpoint(Endpoint):
    """The board's side of a TCP connection. One host is connected at a time. The next host waits, and
    receives a line that names the connected host.

    A connection carries no DTR: its beginning stands for a rise of the line, its end for a fall.

    Parameters
    ----------
    host : str
        Address to listen on; ``127.0.0.1`` keeps it on this machine.
    port : int
        Port to listen on; 0 takes any free one.
    now_s : callable returning float
        Monotonic clock of the machine [s].

    Raises
    ------
    EndpointError
        When the address cannot be listened on.
    """

    scheme = "socket"
    """Scheme of the addresses, as pyserial knows it."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._address = (host, port)
        self._now_s = now_s
        self._holder = ""
        self._heard_s = 0.0
        self._next: socket.socket | None = None
        self._next_since_s = 0.0
        self._next_told = False
        self._listener: socket.socket | None = None
        self._peer: socket.socket | None = None
        self._changes: list[LineChange] = []
        self._unsent = b""
        self.url = ""
        self.plug()

    @override
    @property
    def ready(self) -> bool:
        """Whether a host is connected and reads."""
        return self._peer is not None and not self._unsent

    @override
    def receive(self) -> bytes:
        self._attend_to_next()
        if self._peer is None:
            return b""
        try:
            data = self._peer.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if data:
            self._heard_s = self._now_s()
        else:
            self._hang_up()
        return data

    @override
    def send(self, data: bytes) -> None:
        if self._peer is None:
            return
        self._unsent += data
        if not self._unsent:
            return
        try:
            self._unsent = self._unsent[self._peer.send(self._unsent) :]
        except BlockingIOError:
            pass
        except OSError:
            self._hang_up()

    @override
    def take_lines(self) -> list[LineChange]:
        changes, self._changes[:] = self._changes[:], []
        return changes

    @override
    def fileno(self) -> int:
        watched = self._peer or self._listener
        return watched.fileno() if watched is not None else -1

    @override
    def unplug(self) -> None:
        self._hang_up()
        if self._next is not None:
            self._next.close()
            self._next = None
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    @override
    def plug(self) -> None:
        if self._listener is not None:
            return
        try:
            listener = socket.create_server(self._address, backlog=1)
        except (OSError, OverflowError) as error:
            host, port = self._address
            reason = getattr(error, "strerror", None) or str(error)
            remedy = listening_remedy(error, "HOST:PORT")
            raise EndpointError(f"cannot listen on {host}:{port}: {reason}", remedy) from None
        listener.setblocking(False)
        self._listener = listener
        self._address = (self._address[0], listener.getsockname()[1])
        self.url = f"{self.scheme}://{self._address[0]}:{self._address[1]}"

    @override
    def close(self) -> None:
        self.unplug()

    def _attend_to_next(self) -> None:
        """Connect the waiting host if the board is free; otherwise send it the line that names the connected
        host.
        """
        if self._next is None:
            self._accept()
        if self._next is None:
            return
        now_s = self._now_s()
        if self._peer is not None and now_s - self._heard_s >= SILENT_S:
            self._hang_up()
        if self._peer is None:
            self._peer, self._next = self._next, None
            self._holder = _name(self._peer)
            self._heard_s = now_s
            self._rise()
        elif now_s - self._next_since_s >= PATIENCE_S and not self._next_told:
            self._next_told = True
            # A zero ends what might be taken for the beginning of the board's first frame.
            with contextlib.suppress(OSError):
                self._next.send(f"\r\nthis board is held by {self._holder}\r\n\0".encode())
        else:
            self._drop_gone()

    def _accept(self) -> None:
        """Accept a waiting client."""
        if self._listener is None:
            return
        with contextlib.suppress(OSError):
            peer, _ = self._listener.accept()
            peer.setblocking(False)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            self._next, self._next_since_s, self._next_told = peer, self._now_s(), False

    def _drop_gone(self) -> None:
        """Remove a waiting host that has closed its connection, because another one may wait behind it."""
        if self._next is None:
            return
        try:
            gone = self._next.recv(1, socket.MSG_PEEK) == b""
        except BlockingIOError:
            return
        except OSError:
            gone = True
        if gone:
            self._next.close()
            self._next = None

    def _hang_up(self) -> None:
        peer, self._peer, self._unsent = self._peer, None, b""
        if peer is not None:
            peer.close()
            self._fall()

    def _rise(self) -> None:
        self._changes.append(LineChange(True))

    def _fall(self) -> None:
        self._changes.append(LineChange(False))


def _name(peer: socket.socket) -> str:
    try:
        host, port = peer.getpeername()[:2]
    except OSError:
        return "a host that has gone"
    return f"{host}:{port}"
