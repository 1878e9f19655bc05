"""The way of a stop through the page's server: a separate socket, or a POST from programs without sockets."""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from typing import Final
from urllib.parse import unquote

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, Response
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from heli_host.errors import HeliError
from heli_host.ui.page.guard import Guard
from heli_host.ui.page.limits import POLICY_VIOLATION, Meter
from heli_host.ui.page.notes import Notes
from heli_host.ui.page.source import Source

STOPS_PER_S: Final = 20.0
"""Stops that a client may send per second over a socket [1/s]; more end the connection, after a stop."""
STOP_BURST: Final = 50.0

_READ_BYTES = 65536
_LONGEST_STOP_BYTES = 4096
_MESSAGES = (Opcode.TEXT, Opcode.BINARY, Opcode.CONT)
_REASONS = {200: "OK", 400: "Bad Request", 403: "Forbidden", 405: "Method Not Allowed"}


class StopEndpoint:
    """Switches the motors off as soon as the message of a stop is read.

    Everything runs in the thread of `gate.Gate`. That thread serves no other request, and it
    waits for no client: a stop waits for no queue, no role and not for the event loop that serves pages. It
    needs the token of the page, and nothing else.
    """

    def __init__(self, source: Source, guard: Guard, notes: Notes) -> None:
        self._source = source
        self._guard = guard
        self._notes = notes

    def open(self, connection: socket.socket, head: bytes) -> StopSocket | None:
        """Serve a request for ``/stop``.

        A POST is answered, and its connection is closed.
        """
        method, request = _parse_head(head, connection)
        refusal = self._guard.refusal(request)
        if refusal is None and method == "POST":
            trouble = stop_motors(self._source, self._notes)
            refusal = PlainTextResponse(f"{trouble or 'stopped'}\n", 503 if trouble else 200)
        elif (
            refusal is None and method == "GET" and request.headers.get("upgrade", "").lower() == "websocket"
        ):
            opened = StopSocket(connection, lambda: stop_motors(self._source, self._notes))
            if opened.begin(head):
                return opened
            connection.close()
            return None
        send_response(connection, refusal or PlainTextResponse("stop by POST, or by a WebSocket\n", 405))
        return None


def stop_motors(source: Source, notes: Notes) -> str:
    """Switch the motors off, without waiting for any queue or client."""
    try:
        source.stop()
    except HeliError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001
        notes.warn(f"a stop failed: {type(error).__name__}: {error}")
        return "the stop failed; use the rig's own stop switch"
    return ""


class StopSocket:
    """One open WebSocket for the stop."""

    def __init__(self, connection: socket.socket, stop: Callable[[], str]) -> None:
        self.connection = connection
        self._stop = stop
        self._protocol = ServerProtocol(max_size=_LONGEST_STOP_BYTES)
        self._meter = Meter(STOPS_PER_S, STOP_BURST)

    def begin(self, head: bytes) -> bool:
        """Answer the request that opens the socket; False if it is invalid."""
        self._protocol.receive_data(head)
        events = self._protocol.events_received()
        if not events or not isinstance(events[0], Request):
            return False
        self._protocol.send_response(self._protocol.accept(events[0]))
        self._answer(events[1:])
        return self._send()

    def read(self) -> bool:
        """Read what has arrived, and stop if it is a message, whatever it contains."""
        try:
            data = self.connection.recv(_READ_BYTES)
        except BlockingIOError:
            return True
        except OSError:
            return False
        if not data:
            return False
        if excess := self._meter.excess(data):
            self._stop()
            self._protocol.send_close(POLICY_VIOLATION, excess)
            self._send()
            return False
        self._protocol.receive_data(data)
        self._answer(self._protocol.events_received())
        return self._send()

    def _answer(self, events: Sequence[object]) -> None:
        """Stop once for all messages that arrived together, and answer each of them."""
        messages = [event for event in events if isinstance(event, Frame) and event.opcode in _MESSAGES]
        if not messages:
            return
        trouble = self._stop()
        answer = (f"error: {trouble}" if trouble else "stopped").encode()
        if self._protocol.state is State.OPEN:
            for message in messages:
                if message.fin:
                    self._protocol.send_text(answer)

    def _send(self) -> bool:
        """Send what waits; False at the end of the protocol, or if the client does not read."""
        data = b"".join(self._protocol.data_to_send())
        try:
            is_sent = not data or self.connection.send(data) == len(data)
        except OSError:
            return False
        return is_sent and self._protocol.state is State.OPEN


def send_response(connection: socket.socket, response: Response) -> None:
    """Send a short response without waiting, and close the connection."""
    code, body = response.status_code, bytes(response.body)
    head = (
        f"HTTP/1.1 {code} {_REASONS.get(code, 'Refused')}\r\nContent-Type: text/plain; charset=utf-8\r\n"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    try:
        connection.send(head.encode() + body)
        # A connection that is closed with unread bytes is reset, and the client may lose the response. This
        # reads once: a client that goes on sending would keep this thread.
        connection.recv(_READ_BYTES)
    except OSError:
        pass
    connection.close()


def _parse_head(head: bytes, connection: socket.socket) -> tuple[str, HTTPConnection]:
    """Return the method of a request, and what `Guard` needs to know of it."""
    lines = head.partition(b"\r\n\r\n")[0].split(b"\r\n")
    method, _, rest = lines[0].partition(b" ")
    path, _, query = rest.partition(b" ")[0].partition(b"?")
    headers = [line.partition(b":") for line in lines[1:]]
    try:
        client = connection.getpeername()[:2]
    except OSError:
        client = ("a client", 0)
    scope = {
        "type": "http",
        "path": unquote(path.decode("latin-1")),
        "query_string": query,
        "headers": [(name.strip().lower(), value.strip()) for name, _, value in headers],
        "client": client,
    }
    return method.decode("latin-1"), HTTPConnection(scope)
