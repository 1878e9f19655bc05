"""Runs the page's web server: one thread accepts connections and serves the stop, another serves clients.

The server of clients counts what a client sends before it decodes it, and closes the connection beyond the
limit.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, MutableMapping
from dataclasses import dataclass
from typing import Any, Final

import uvicorn
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.protocol import State

from heli_host.errors import PortError, listening_remedy
from heli_host.ui.page.gate import Gate, StopEndpoint
from heli_host.ui.page.guard import LOCAL_HOSTS, POLICY_VIOLATION, Guard, Meter, Notes, new_token
from heli_host.ui.page.service import Service
from heli_host.ui.page.source import Source

MAX_CONNECTIONS: Final = 100
"""Connections that are served at a time, all clients together; more are refused. Each page has one. Their
telemetry takes about 0.3 % of a processor each."""

_SWITCH_S = 0.001
"""Time after which a thread that computes lets another one run [s]. A stop needs about eight turns, from the
accepted connection to the port. With Python's 0.005 s and two busy threads, these take 80 ms."""
_RECEIVE_BUFFER_BYTES = 65536
_START_S = 10.0
_START_LOOK_S = 0.01
_END_S = 3.0
_LONGEST_MESSAGE_BYTES = 65536


@dataclass(frozen=True)
class Address:
    """Address of a running page server."""

    host: str  # Address that the server is bound to
    port: int  # TCP port
    token: str  # Secret that clients must send

    @property
    def page(self) -> str:
        """URL for a browser, with the token."""
        return f"http://{self._host_name}:{self.port}/?token={self.token}"

    @property
    def program(self) -> str:
        """URL for `heli_host.join`, with the token."""
        return f"page://{self._host_name}:{self.port}/?token={self.token}"

    @property
    def is_local(self) -> bool:
        """Whether only programs on this machine can reach the server."""
        return self.host in LOCAL_HOSTS

    @property
    def _host_name(self) -> str:
        name = self.host if self.host not in ("0.0.0.0", "::") else socket.gethostname()
        return f"[{name}]" if ":" in name else name


@contextlib.contextmanager
def serving(source: Source, host: str = "127.0.0.1", port: int = 0, token: str = "") -> Iterator[Address]:
    """Serve a page from a background thread until the ``with`` block ends."""
    # The end of the block closes the server only: the caller lands the helicopter or switches its motors off.
    # `token`: Secret that clients must send; empty for a new random one.
    guard, notes = Guard(token or new_token(), host), Notes()
    listening = _open_socket(host, port)
    server = _PageServer(Service(source, guard, notes).application())
    gate = Gate(listening, StopEndpoint(source, guard, notes), server.take, notes)
    thread = threading.Thread(target=server.run, kwargs={"sockets": []}, name="heli-host page", daemon=True)
    switch_interval_before_s = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    thread.start()
    end_s = time.monotonic() + _START_S
    try:
        while not server.started and thread.is_alive() and time.monotonic() < end_s:
            time.sleep(_START_LOOK_S)
        if not server.started:
            raise PortError(
                "the server of the dashboard did not start", "report this with the output of the server"
            )
        gate.start()
        yield Address(host, listening.getsockname()[1], guard.token)
    finally:
        gate.close()
        server.should_exit = True
        thread.join(_END_S)
        listening.close()
        sys.setswitchinterval(switch_interval_before_s)


def _open_socket(host: str, port: int) -> socket.socket:
    """Open the socket on which the page is served; a PortError names the fix if the port is taken."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # Accepted connections inherit both options. With a small receive buffer, a client cannot make the system
    # keep megabytes that nobody reads. Without delay, a stop of a few bytes does not wait for more bytes.
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        reason = error.strerror or str(error)
        raise PortError(
            f"cannot serve on {host}:{port}: {reason}", listening_remedy(error, "--http-port")
        ) from error
    return listening


class _PageServer(uvicorn.Server):
    """Serves an ASGI application to connections that another thread accepts."""

    def __init__(self, application: ASGIApp) -> None:
        super().__init__(
            uvicorn.Config(
                _closing_each_connection(application),
                log_level="warning",
                access_log=False,
                lifespan="on",
                http=H11Protocol,
                ws=_MeteredWebSocket,
                ws_max_size=_LONGEST_MESSAGE_BYTES,
                # A small message may unpack to a large one, which `Meter` does not see.
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=1,  # A page may never end its connection [s]
                server_header=False,
            )
        )
        # Event loop in which connections are served; None before the server has started.
        self._loop: asyncio.AbstractEventLoop | None = None
        # Connections that were accepted, but that the server does not count yet.
        self._arriving: set[socket.socket] = set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and note the event loop in which connections are served."""
        self._loop = asyncio.get_running_loop()
        await super().startup(sockets=sockets)

    def take(self, connection: socket.socket, head: bytes) -> bool:
        """Serve an accepted connection; may be called from any thread, and does not wait."""
        is_full = len(self.server_state.connections) + len(self._arriving) >= MAX_CONNECTIONS
        if is_full or self._loop is None or self._loop.is_closed():
            return False

        # Until the event loop has made the connection, the server does not count it, so it is counted here.
        def has_arrived() -> None:
            self._arriving.discard(connection)

        def protocol() -> _AcceptedConnection:
            return _AcceptedConnection(head, has_arrived, self.config, self.server_state, self.lifespan.state)

        self._arriving.add(connection)
        future = asyncio.run_coroutine_threadsafe(
            self._loop.connect_accepted_socket(protocol, connection), self._loop
        )
        # A connection that fails never becomes one of the server's.
        future.add_done_callback(lambda _: has_arrived())
        return True


class _AcceptedConnection(H11Protocol):
    """An HTTP connection whose first bytes were already read."""

    def __init__(self, head: bytes, has_arrived: Callable[[], None], *arguments: Any) -> None:
        super().__init__(*arguments)
        self._read_head = head
        self._has_arrived = has_arrived

    # asyncio declares any transport here; uvicorn declares no result of `eof_received`.
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin with the bytes that were read before."""
        super().connection_made(transport)
        # From now on the server counts it among its connections.
        self._has_arrived()
        self.data_received(self._read_head)

    def eof_received(self) -> bool:  # type: ignore[override]
        """Keep the connection open: a client that has sent all may still wait for its response."""
        return True


class _MeteredWebSocket(WebSocketsSansIOProtocol):
    """A client's WebSocket, which is closed as soon as the client sends more than `Meter` allows."""

    # The bytes that exceed the limit are neither decoded nor queued, and messages that still wait are
    # dropped.

    def data_received(self, data: bytes) -> None:
        """Process received bytes, unless they exceed the limit."""
        if not self.handshake_initiated:
            self._meter = Meter()
        elif excess := self._meter.excess(data):
            self._disconnect(excess)
            return
        super().data_received(data)

    def _disconnect(self, reason: str) -> None:
        """Drop what waits, send the reason if the client reads it, and close."""
        while not self.queue.empty():
            self.queue.get_nowait()
        self.queue.put_nowait({"type": "websocket.disconnect", "code": POLICY_VIOLATION, "reason": reason})
        # A client that does not read would keep the connection open until it has read the reason.
        if self.conn.state is State.OPEN and not self.transport.get_write_buffer_size():
            self.conn.send_close(POLICY_VIOLATION, reason)
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.close_sent = True
            self.transport.close()
        else:
            self.transport.abort()


def _closing_each_connection(application: ASGIApp) -> ASGIApp:
    """Return an application that ends each connection after its response."""
    # The next request of a browser then arrives on a new connection. On an old one, a stop would reach the
    # event loop of the other clients.

    async def served(scope: Scope, receive: Receive, send: Send) -> None:
        async def send_closing(message: Message) -> None:
            await send(_with_close(message) if message["type"] == "http.response.start" else message)

        await application(scope, receive, send_closing)

    return served


def _with_close(message: MutableMapping[str, Any]) -> dict[str, Any]:
    return {**message, "headers": [*message.get("headers", ()), (b"connection", b"close")]}
