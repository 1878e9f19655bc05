"""A TCP port as serial port, for pyserial's ``socket://HOST:PORT`` on systems without pseudo-terminals."""

from __future__ import annotations

import contextlib
import socket
from typing import Final

from typing_extensions import override

from heli_sim.errors import EndpointError
from heli_sim.sil.endpoint import Endpoint, LineChange

_CHUNK: Final = 65536
# A host that does not read must see the bridge overflow in the end, as with a serial driver, and not only
# after the megabytes that a system may buffer.
_SEND_BUFFER: Final = 16384


class TcpEndpoint(Endpoint):
    """The board's side of a TCP connection; one host at a time, the next one waits.

    A connection carries no DTR: its beginning stands for a rise of the line, its end for a fall.

    Parameters
    ----------
    host : str
        Address to listen on; ``127.0.0.1`` keeps it on this machine.
    port : int
        Port to listen on; 0 takes any free one.

    Raises
    ------
    EndpointError
        When the address cannot be listened on.
    """

    scheme = "socket"
    """Of the addresses that pyserial knows."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self._address = (host, port)
        self._listener: socket.socket | None = None
        self._peer: socket.socket | None = None
        self._changes: list[LineChange] = []
        self._kept = b""
        self.url = ""
        self.plug()

    @override
    @property
    def ready(self) -> bool:
        """Whether a host is connected and takes its bytes."""
        return self._peer is not None and not self._kept

    @override
    def receive(self) -> bytes:
        if self._peer is None:
            self._accept()
        if self._peer is None:
            return b""
        try:
            data = self._peer.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    @override
    def send(self, data: bytes) -> None:
        if self._peer is None:
            return
        self._kept += data
        if not self._kept:
            return
        try:
            self._kept = self._kept[self._peer.send(self._kept) :]
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
            raise EndpointError(f"cannot listen on {host}:{port}: {reason}", "choose another port") from None
        listener.setblocking(False)
        self._listener = listener
        self._address = (self._address[0], listener.getsockname()[1])
        self.url = f"{self.scheme}://{self._address[0]}:{self._address[1]}"

    @override
    def close(self) -> None:
        self.unplug()

    def _accept(self) -> None:
        if self._listener is None:
            return
        with contextlib.suppress(OSError):
            peer, _ = self._listener.accept()
            peer.setblocking(False)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            self._peer = peer
            self._rise()

    def _hang_up(self) -> None:
        peer, self._peer, self._kept = self._peer, None, b""
        if peer is not None:
            peer.close()
            self._fall()

    def _rise(self) -> None:
        self._changes.append(LineChange(True))

    def _fall(self) -> None:
        self._changes.append(LineChange(False))
