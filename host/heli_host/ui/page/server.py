"""The web server of the page's clients: it gets accepted connections, and limits what each may send."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, MutableMapping
from typing import Any, Final

import uvicorn
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.protocol import State

from heli_host.ui.page.limits import POLICY_VIOLATION, Meter

MAX_CONNECTIONS: Final = 100
"""Connections that are served at a time, all clients together; more are refused. Each page has one. Their
telemetry takes about 0.3 % of a processor each."""

_LONGEST_MESSAGE_BYTES = 65536


class MeteredWebSocket(WebSocketsSansIOProtocol):
    """A client's WebSocket, which is closed as soon as the client sends more than `Meter` allows.

    The bytes that exceed the limit are neither decoded nor queued, and messages that still wait are dropped.
    """

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


class _AcceptedConnection(H11Protocol):
    """An HTTP connection whose first bytes were already read."""

    def __init__(self, head: bytes, has_arrived: Callable[[], None], *arguments: Any) -> None:
        super().__init__(*arguments)
        self._read_head = head
        self._has_arrived = has_arrived

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin with the bytes that were read before."""
        super().connection_made(transport)
        # From now on the server counts it among its connections.
        self._has_arrived()
        self.data_received(self._read_head)

    def eof_received(self) -> bool:  # type: ignore[override]
        """Keep the connection open: a client that has sent all may still wait for its response."""
        return True


class PageServer(uvicorn.Server):
    """Serves an ASGI application to connections that another thread accepts."""

    def __init__(self, application: ASGIApp) -> None:
        super().__init__(
            uvicorn.Config(
                _closing(application),
                log_level="warning",
                access_log=False,
                lifespan="on",
                http=H11Protocol,
                ws=MeteredWebSocket,
                ws_max_size=_LONGEST_MESSAGE_BYTES,
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=1,
                server_header=False,
            )
        )
        self._loop: asyncio.AbstractEventLoop | None = None
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

        def has_arrived() -> None:
            self._arriving.discard(connection)

        def protocol() -> _AcceptedConnection:
            return _AcceptedConnection(head, has_arrived, self.config, self.server_state, self.lifespan.state)

        self._arriving.add(connection)
        future = asyncio.run_coroutine_threadsafe(
            self._loop.connect_accepted_socket(protocol, connection), self._loop
        )
        future.add_done_callback(lambda _: has_arrived())
        return True


def _closing(application: ASGIApp) -> ASGIApp:
    """Return an application that ends each connection after its response.

    The next request of a browser then arrives on a new connection. On an old one, a stop would reach the
    event loop of the other clients.
    """

    async def served(scope: Scope, receive: Receive, send: Send) -> None:
        async def send_closing(message: Message) -> None:
            await send(_with_close(message) if message["type"] == "http.response.start" else message)

        await application(scope, receive, send_closing)

    return served


def _with_close(message: MutableMapping[str, Any]) -> dict[str, Any]:
    return {**message, "headers": [*message.get("headers", ()), (b"connection", b"close")]}
