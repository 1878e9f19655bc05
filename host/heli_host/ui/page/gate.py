"""Accepts all connections in a thread of its own: serves the stop there, and passes the others on.

A stop arrives on a separate socket (``/stop``), or as a POST from programs without sockets.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import unquote

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, Response
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from heli_host.errors import HeliError
from heli_host.ui.page.guard import POLICY_VIOLATION, Guard, Meter, Notes, RateLimit
from heli_host.ui.page.source import Source

_HandOver = Callable[[socket.socket, bytes], bool]
"""Passes a connection on, with the bytes that were read from it; False if there is no room."""
_REQUESTS_PER_S: Final = 100.0
"""New connections that are passed on per second [1/s]; more are refused. A page needs about 20."""
_REQUEST_BURST: Final = 400.0
"""New connections that are passed on together, after a pause: twenty pages that are opened together."""
_CLIENTS_PER_S: Final = 10.0
"""New clients (WebSockets) that are passed on per second [1/s]; more are refused. Each costs the server about
1 ms. Higher: clients that connect again and again keep the server busy."""
_CLIENT_BURST: Final = 60.0
"""New clients that are passed on together, after a pause: two for each of thirty students."""
MAX_ARRIVALS: Final = 128
"""Connections whose request is incomplete. A new one ends the oldest: clients that send nothing must not
keep others out."""
_MAX_STOP_SOCKETS: Final = 256
"""Open sockets for the stop. A new one ends the one that was silent for longest."""
_STOPS_PER_S: Final = 20.0
"""Stops that a client may send per second over a socket [1/s]; more end the connection, after a stop."""
_STOP_BURST: Final = 50.0

_BACKLOG = 128
_LONGEST_HEAD_BYTES = 16384
_HEAD_S = 5.0
_ACCEPTED_PER_TURN = 8
_NO_FILE_PAUSE_S = 0.01
_STOP_PATHS = (b"/stop ", b"/stop?")
_CLIENT_PATHS = (b"/ws ", b"/ws?")
_READ_BYTES = 65536
_LONGEST_STOP_BYTES = 4096
_MESSAGES = (Opcode.TEXT, Opcode.BINARY, Opcode.CONT)
_REASONS = {200: "OK", 400: "Bad Request", 403: "Forbidden", 405: "Method Not Allowed"}


@dataclass
class _Arrival:
    """A connection whose request is not complete yet."""

    connection: socket.socket
    head: bytes = b""
    deadline_s: float = field(default_factory=lambda: time.monotonic() + _HEAD_S)


class Gate:
    """The only place where connections are accepted. Its thread serves nothing but stops.

    It reads the head of each request. A request for ``/stop`` stays here; every other connection goes to
    `hand_over`. In each turn, open stop sockets come first, then requests, then new connections. No call in
    this thread waits for a client or for the event loop that serves pages.
    """

    def __init__(
        self, listening: socket.socket, stop: StopEndpoint, hand_over: _HandOver, notes: Notes
    ) -> None:
        self._listening = listening
        self._stop = stop
        self._hand_over = hand_over
        self._notes = notes
        self._requests = RateLimit(_REQUESTS_PER_S, _REQUEST_BURST)
        self._clients = RateLimit(_CLIENTS_PER_S, _CLIENT_BURST)
        self._arrivals: dict[socket.socket, _Arrival] = {}
        self._stop_sockets: dict[socket.socket, _StopSocket] = {}
        self._selector = selectors.DefaultSelector()
        self._wake, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name="heli-host stop", daemon=True)

    def start(self) -> None:
        """Listen, and serve from a background thread until `close`."""
        self._listening.setblocking(False)
        self._listening.listen(_BACKLOG)
        self._selector.register(self._listening, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._thread.start()

    def close(self) -> None:
        """End the thread, and close all connections that were not passed on."""
        self._wake.close()
        if self._thread.is_alive():
            self._thread.join()
        for connection in (*self._arrivals, *self._stop_sockets, self._woken):
            connection.close()
        self._selector.close()

    def _run(self) -> None:
        while True:
            timeout_s = _HEAD_S if self._arrivals else None
            ready = {key.fileobj for key, _ in self._selector.select(timeout_s)}
            if self._woken in ready:
                return
            for connection in [known for known in self._stop_sockets if known in ready]:
                self._guarded(self._read_stop, connection)
            for connection in [known for known in self._arrivals if known in ready]:
                self._guarded(self._read_head, connection)
            if self._listening in ready:
                self._accept()
            self._drop_late_arrivals()

    def _guarded(self, serve: Callable[[socket.socket], None], connection: socket.socket) -> None:
        """Serve a connection; an error ends this connection, and never the thread."""
        try:
            serve(connection)
        except Exception as error:  # noqa: BLE001 - without this thread there is no stop
            self._notes.warn(f"a connection failed: {type(error).__name__}: {error}")
            self._end(connection)

    def _read_stop(self, connection: socket.socket) -> None:
        """Read an open stop socket, which becomes the one that was heard last."""
        opened = self._stop_sockets.pop(connection)
        self._stop_sockets[connection] = opened
        if not opened.read():
            self._end(connection)

    def _accept(self) -> None:
        for _ in range(_ACCEPTED_PER_TURN):
            try:
                connection, _address = self._listening.accept()
            except BlockingIOError:
                return
            except OSError:
                # The process has no file descriptor left, or the client has gone.
                if not self._drop_oldest(self._arrivals):
                    time.sleep(_NO_FILE_PAUSE_S)
                return
            connection.setblocking(False)
            self._arrivals[connection] = _Arrival(connection)
            # The request has usually arrived together with its connection.
            self._guarded(self._read_head, connection)
            if connection in self._arrivals:
                self._selector.register(connection, selectors.EVENT_READ)
            if len(self._arrivals) > MAX_ARRIVALS:
                self._drop_oldest(self._arrivals)

    def _read_head(self, connection: socket.socket) -> None:
        """Read a request, and route it when its head is complete."""
        arrival = self._arrivals[connection]
        try:
            data = connection.recv(_LONGEST_HEAD_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        arrival.head += data
        if data and b"\r\n\r\n" not in arrival.head and len(arrival.head) < _LONGEST_HEAD_BYTES:
            return
        self._forget(connection)
        if not data:
            connection.close()
        elif b"\r\n\r\n" not in arrival.head:
            _send_response(connection, PlainTextResponse("the request is too long\n", 431))
        else:
            self._route(connection, arrival.head)

    def _route(self, connection: socket.socket, head: bytes) -> None:
        target = head[: head.index(b"\r\n")].partition(b" ")[2]
        if target.startswith(_STOP_PATHS):
            opened = self._stop.open(connection, head)
            if opened is None:
                return
            if len(self._stop_sockets) >= _MAX_STOP_SOCKETS:
                self._drop_oldest(self._stop_sockets)
            self._stop_sockets[connection] = opened
            self._selector.register(connection, selectors.EVENT_READ)
            return
        limit = self._clients if target.startswith(_CLIENT_PATHS) else self._requests
        if not limit.take() or not self._hand_over(connection, head):
            self._notes.warn("connections are refused, because there are too many")
            _send_response(connection, PlainTextResponse("too many connections; try again later\n", 503))

    def _drop_late_arrivals(self) -> None:
        """End connections that did not send a request in time; the oldest come first."""
        now_s = time.monotonic()
        while self._arrivals and next(iter(self._arrivals.values())).deadline_s <= now_s:
            self._drop_oldest(self._arrivals)

    def _drop_oldest(
        self, connections: dict[socket.socket, _Arrival] | dict[socket.socket, _StopSocket]
    ) -> bool:
        """End the first connection of a table, if there is any."""
        oldest = next(iter(connections), None)
        if oldest is None:
            return False
        self._end(oldest)
        return True

    def _end(self, connection: socket.socket) -> None:
        self._forget(connection)
        connection.close()

    def _forget(self, connection: socket.socket) -> None:
        self._arrivals.pop(connection, None)
        self._stop_sockets.pop(connection, None)
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(connection)


class StopEndpoint:
    """Switches the motors off as soon as the message of a stop is read.

    Everything runs in the thread of `Gate`. That thread serves no other request, and it
    waits for no client: a stop waits for no queue, no role and not for the event loop that serves pages. It
    needs the token of the page, and nothing else.
    """

    def __init__(self, source: Source, guard: Guard, notes: Notes) -> None:
        self._source = source
        self._guard = guard
        self._notes = notes

    def open(self, connection: socket.socket, head: bytes) -> _StopSocket | None:
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
            opened = _StopSocket(connection, lambda: stop_motors(self._source, self._notes))
            if opened.begin(head):
                return opened
            connection.close()
            return None
        _send_response(connection, refusal or PlainTextResponse("stop by POST, or by a WebSocket\n", 405))
        return None


def stop_motors(source: Source, notes: Notes) -> str:
    """Switch the motors off, without waiting for any queue or client."""
    try:
        source.stop()
    except HeliError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - the person who stops must read what to do, whatever failed
        notes.warn(f"a stop failed: {type(error).__name__}: {error}")
        return "the stop failed; use the rig's own stop switch"
    return ""


class _StopSocket:
    """One open WebSocket for the stop."""

    def __init__(self, connection: socket.socket, stop: Callable[[], str]) -> None:
        self.connection = connection
        self._stop = stop
        self._protocol = ServerProtocol(max_size=_LONGEST_STOP_BYTES)
        self._meter = Meter(_STOPS_PER_S, _STOP_BURST)

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


def _send_response(connection: socket.socket, response: Response) -> None:
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
