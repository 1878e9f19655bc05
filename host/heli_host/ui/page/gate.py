"""Accepts all connections in a thread of its own: serves the stop there, and passes the others on."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from starlette.responses import PlainTextResponse

from heli_host.ui.page.limits import RateLimit
from heli_host.ui.page.notes import Notes
from heli_host.ui.page.stop_endpoint import StopEndpoint, StopSocket, send_response

HandOver = Callable[[socket.socket, bytes], bool]
"""Passes a connection on, with the bytes that were read from it; False if there is no room."""

REQUESTS_PER_S: Final = 100.0
"""New connections that are passed on per second [1/s]; more are refused. A page needs about 20."""
REQUEST_BURST: Final = 400.0
"""New connections that are passed on together, after a pause: twenty pages that are opened together."""
CLIENTS_PER_S: Final = 10.0
"""New clients (WebSockets) that are passed on per second [1/s]; more are refused. Each costs the server about
1 ms. Higher: clients that connect again and again keep the server busy."""
CLIENT_BURST: Final = 60.0
"""New clients that are passed on together, after a pause: two for each of thirty students."""
MAX_ARRIVALS: Final = 128
"""Connections whose request is incomplete. A new one ends the oldest: clients that send nothing must not
keep others out."""
MAX_STOP_SOCKETS: Final = 256
"""Open sockets for the stop. A new one ends the one that was silent for longest."""

_BACKLOG = 128
_LONGEST_HEAD_BYTES = 16384
_HEAD_S = 5.0
_ACCEPTED_PER_TURN = 8
_NO_FILE_PAUSE_S = 0.01
_STOP_PATHS = (b"/stop ", b"/stop?")
_CLIENT_PATHS = (b"/ws ", b"/ws?")


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
        self, listening: socket.socket, stop: StopEndpoint, hand_over: HandOver, notes: Notes
    ) -> None:
        self._listening = listening
        self._stop = stop
        self._hand_over = hand_over
        self._notes = notes
        self._requests = RateLimit(REQUESTS_PER_S, REQUEST_BURST)
        self._clients = RateLimit(CLIENTS_PER_S, CLIENT_BURST)
        self._arrivals: dict[socket.socket, _Arrival] = {}
        self._stop_sockets: dict[socket.socket, StopSocket] = {}
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
            send_response(connection, PlainTextResponse("the request is too long\n", 431))
        else:
            self._route(connection, arrival.head)

    def _route(self, connection: socket.socket, head: bytes) -> None:
        target = head[: head.index(b"\r\n")].partition(b" ")[2]
        if target.startswith(_STOP_PATHS):
            opened = self._stop.open(connection, head)
            if opened is None:
                return
            if len(self._stop_sockets) >= MAX_STOP_SOCKETS:
                self._drop_oldest(self._stop_sockets)
            self._stop_sockets[connection] = opened
            self._selector.register(connection, selectors.EVENT_READ)
            return
        limit = self._clients if target.startswith(_CLIENT_PATHS) else self._requests
        if not limit.take() or not self._hand_over(connection, head):
            self._notes.warn("connections are refused, because there are too many")
            send_response(connection, PlainTextResponse("too many connections; try again later\n", 503))

    def _drop_late_arrivals(self) -> None:
        """End connections that did not send a request in time; the oldest come first."""
        now_s = time.monotonic()
        while self._arrivals and next(iter(self._arrivals.values())).deadline_s <= now_s:
            self._drop_oldest(self._arrivals)

    def _drop_oldest(
        self, connections: dict[socket.socket, _Arrival] | dict[socket.socket, StopSocket]
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
