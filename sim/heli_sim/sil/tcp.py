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
_SEND_BUFFER: Final = 16384
"""Size of the send buffer in bytes. For a host that does not read, the bridge must soon overflow, as with a
serial driver; the default buffer of a system may hold megabytes."""


SILENT_S: Final = 3.0
"""A host that sends nothing for this time is replaced by a waiting one; a session sends every 0.2 s."""
PATIENCE_S: Final = 1.0
"""Time after which a waiting host receives the line that names the connected host."""


class TcpEndpoint(Endpoint):
    """The board's side of a TCP connection. One host is connected at a time. The next host waits, and
    receives a line that names the connected host.

    A connection does not transfer DTR. Its beginning counts as a rise of the line, and its end as a fall.
    """

    scheme = "socket"
    """Scheme of the addresses, as pyserial knows it."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._address = (host, port)
        self._now_s = now_s
        self._connected_name = ""
        self._last_received_s = 0.0
        self._waiting: socket.socket | None = None
        self._waiting_since_s = 0.0
        self._is_informed = False
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
        self._serve_waiting_host()
        if self._peer is None:
            return b""
        try:
            received = self._peer.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            received = b""
        if received:
            self._last_received_s = self._now_s()
        else:
            self._disconnect_host()
        return received

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
            self._disconnect_host()

    @override
    def take_lines(self) -> list[LineChange]:
        changes, self._changes[:] = self._changes[:], []
        return changes

    @override
    def fileno(self) -> int:
        socket_to_watch = self._peer or self._listener
        return socket_to_watch.fileno() if socket_to_watch is not None else -1

    @override
    def unplug(self) -> None:
        self._disconnect_host()
        if self._waiting is not None:
            self._waiting.close()
            self._waiting = None
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

    def _serve_waiting_host(self) -> None:
        """Connect the waiting host if the board is free; otherwise send it the name of the connected host."""
        if self._waiting is None:
            self._accept_waiting_host()
        if self._waiting is None:
            return
        now_s = self._now_s()
        if self._peer is not None and now_s - self._last_received_s >= SILENT_S:
            self._disconnect_host()
        if self._peer is None:
            self._peer, self._waiting = self._waiting, None
            self._connected_name = _address_text(self._peer)
            self._last_received_s = now_s
            self._note_dtr_rise()
        elif now_s - self._waiting_since_s >= PATIENCE_S and not self._is_informed:
            self._is_informed = True
            # Frames end with a zero, so this line does not become part of the board's first frame.
            with contextlib.suppress(OSError):
                self._waiting.send(f"\r\nthis board is held by {self._connected_name}\r\n\0".encode())
        else:
            self._drop_closed_waiting_host()

    def _accept_waiting_host(self) -> None:
        """Accept a waiting client."""
        if self._listener is None:
            return
        with contextlib.suppress(OSError):
            peer, _ = self._listener.accept()
            peer.setblocking(False)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            self._waiting, self._waiting_since_s, self._is_informed = peer, self._now_s(), False

    def _drop_closed_waiting_host(self) -> None:
        """Remove a waiting host that has closed its connection, because another one may wait behind it."""
        if self._waiting is None:
            return
        try:
            has_closed = self._waiting.recv(1, socket.MSG_PEEK) == b""
        except BlockingIOError:
            return
        except OSError:
            has_closed = True
        if has_closed:
            self._waiting.close()
            self._waiting = None

    def _disconnect_host(self) -> None:
        """Disconnect the host, and discard bytes that were not sent."""
        peer, self._peer, self._unsent = self._peer, None, b""
        if peer is not None:
            peer.close()
            self._note_dtr_fall()

    def _note_dtr_rise(self) -> None:
        """Record that DTR rises, because a host has connected."""
        self._changes.append(LineChange(True))

    def _note_dtr_fall(self) -> None:
        """Record that DTR falls, because the host has disconnected."""
        self._changes.append(LineChange(False))


def _address_text(peer: socket.socket) -> str:
    """Return address and port of a connected host."""
    try:
        host, port = peer.getpeername()[:2]
    except OSError:
        return "a host that has gone"
    return f"{host}:{port}"
