"""Serves clients: files, and one WebSocket per client. `heli_host.ui.page.gate` serves the stop.

Every request needs the token, and pages of other origins are refused. A separate task serves each client at
the rate at which the client acknowledges frames: a slow client gets fewer rows and delays no other client.
The files are part of this package; the page loads nothing from the internet.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import secrets
import time
from collections.abc import Coroutine, Iterator, Mapping
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import PurePosixPath
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from heli_host.errors import printable
from heli_host.ui.page.clients import Broadcast, ControlLease, Outbox, lease_news
from heli_host.ui.page.guard import POLICY_VIOLATION, WATCHERS_PER_S, Guard, Notes, RateLimit
from heli_host.ui.page.requests import RequestDispatcher
from heli_host.ui.page.source import Source

_STATUS_S = 0.1
_PRESENCE_S = 0.2
"""Interval at which an unchanged status is sent again [s]. A page warns when its status is older than 0.6 s.
Longer: a briefly busy server raises that warning. Shorter: costs processor time."""

_FAILED = 1011
_PACKED = ".gz"
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_HEADERS = {
    # The policy forbids the page to load anything from another server, even if its code were changed.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-cache",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Service:
    """Serves one source to any number of clients."""

    # It owns the connections: it accepts clients, reads what they send, and sends them status and telemetry.
    # Everything here runs in the event loop's thread. All requests go through `RequestDispatcher`, which has
    # the queues. The stop has its own thread: see `heli_host.ui.page.gate.Gate`.

    def __init__(self, source: Source, guard: Guard, notes: Notes) -> None:
        self.lease = ControlLease()
        self._source = source
        self._guard = guard
        self._notes = notes
        self._broadcast = Broadcast(self._notes)
        self._dispatcher = RequestDispatcher(source, self.lease, self._broadcast, self._notes)
        self._watchers = RateLimit(WATCHERS_PER_S, WATCHERS_PER_S)
        self._watchers_turn = asyncio.Lock()
        self._status: Mapping[str, Any] = {}
        self._status_s = 0.0
        self._lease_status: Mapping[str, Any] = {}
        self._client_count = 0
        source.watch_pilot(
            lambda: self.lease.present(time.monotonic()), lambda: self.lease.absence(time.monotonic())
        )
        source.listen(self._broadcast.tell_all_soon)

    def application(self) -> Starlette:
        """Return the ASGI application, to be run by a web server."""
        return Starlette(
            routes=[
                WebSocketRoute("/ws", self._serve_client),
                Route("/{path:path}", self._serve_file, methods=["GET"]),
            ],
            lifespan=self._while_server_runs,
        )

    @contextlib.asynccontextmanager
    async def _while_server_runs(self, _: Starlette) -> Any:
        """Watch the source while the web server runs."""
        self._broadcast.loop = asyncio.get_running_loop()
        task = asyncio.create_task(self._send_status_when_changed())
        try:
            yield
        finally:
            task.cancel()
            self._dispatcher.close()

    async def _serve_file(self, request: Request) -> Response:
        """Answer a request for a static file."""
        path = request.path_params["path"]
        # Only the page itself needs the token; its files are part of this public package.
        refusal = self._guard.refusal(request, needs_token=not path)
        return refusal if refusal is not None else page_file(path, request.headers)

    async def _serve_client(self, socket: WebSocket) -> None:
        """Serve a client until one of its tasks ends, because it disconnected or failed."""
        if not await self._guard.admit(socket):
            return
        client = self._register_client(socket)
        tasks: set[asyncio.Task[None]] = set()
        try:
            self._broadcast.tell(client, self._first_message(client))
            self._broadcast.add(client)
            self._broadcast.tell_all(lease_news(self.lease))
            tasks = {asyncio.create_task(part) for part in self._client_tasks(client)}
            finished, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in finished:
                task.result()
        except Exception as error:  # noqa: BLE001 - otherwise the client would stay open and show old news
            await self._close_failed(client, error)
        finally:
            for task in tasks:
                task.cancel()
            # Two tasks may fail together; asyncio prints a trace for an error that is not retrieved.
            await asyncio.gather(*tasks, return_exceptions=True)
            self._broadcast.remove(client)
            self.lease.leave(client.key, time.monotonic())
            self._broadcast.tell_all(lease_news(self.lease))

    def _client_tasks(self, client: Outbox) -> Iterator[Coroutine[Any, Any, None]]:
        """Yield the tasks that serve a client: receive, send messages, send telemetry."""
        yield self._process_messages(client)
        yield client.send_words()
        if client.wants_rows:
            yield client.send_rows(self._source)

    async def _close_failed(self, client: Outbox, error: Exception) -> None:
        """Close the socket of a client whose task failed, and log why unless the client itself has gone."""
        states = (client.socket.client_state, client.socket.application_state)
        # Starlette raises RuntimeError if the socket was closed in the meantime.
        is_closed = isinstance(error, RuntimeError) and WebSocketState.DISCONNECTED in states
        if is_closed or isinstance(error, WebSocketDisconnect):
            return
        self._notes.warn(f"{client.name} is disconnected: {type(error).__name__}: {error}")
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await client.socket.close(_FAILED)

    def _register_client(self, socket: WebSocket) -> Outbox:
        """Register a client with its own key, and return its queue of messages. Programs do not fly."""
        query = socket.query_params
        is_program = query.get("role") == "program"
        key = printable(query.get("client", ""))[:40] or secrets.token_hex(8)
        self._client_count += 1
        name = f"{'program' if is_program else 'page'} {self._client_count}"
        now_s = time.monotonic()
        if not self.lease.join(key, name, now_s, may_fly=not is_program):
            # A duplicated browser tab, or a page that is reloaded, has the same key as the original.
            tab, key = key, secrets.token_hex(8)
            self.lease.join(key, name, now_s, may_fly=not is_program, reload_of=tab)
        client = Outbox(socket, key, name)
        client.wants_rows = query.get("rows") != "0"
        return client

    def _first_message(self, client: Outbox) -> dict[str, Any]:
        """Return the first message to a client: the board, its status and the pilot."""
        described = self._source.describe()
        return {
            "hello": {"you": client.key, **described},
            "status": _with_time(self._source.status()),
            **lease_news(self.lease),
        }

    async def _process_messages(self, client: Outbox) -> None:
        """Process the messages of a client until it disconnects."""
        while True:
            message = await client.socket.receive()
            if message["type"] == "websocket.disconnect":
                if message.get("code") == POLICY_VIOLATION:
                    self._notes.warn(f"{client.name} is disconnected: {message.get('reason')}")
                return
            data, text = message.get("bytes"), message.get("text")
            if data is not None:
                self._take_acknowledgement(client, data)
            elif text is not None:
                if client.key != self.lease.pilot:
                    await self._wait_for_turn()
                self._dispatcher.take(client, text)

    async def _wait_for_turn(self) -> None:
        """Wait until all clients but the pilot may send one more request. Meanwhile nothing of this client is
        read, and the next ones wait in the order of their requests.
        """
        async with self._watchers_turn:
            while not self._watchers.take():
                await asyncio.sleep(self._watchers.wait_s())

    def _take_acknowledgement(self, client: Outbox, data: bytes) -> None:
        """Process an acknowledgement, which is also a sign of life of the client."""
        if len(data) == 4:
            # A page that has reconnected may still acknowledge frames of its earlier connection.
            number = min(int.from_bytes(data, "little"), client.sent)
            client.acknowledged = max(client.acknowledged, number)
            client.may_send.set()
        self.lease.beat(client.key, time.monotonic())

    async def _send_status_when_changed(self) -> None:
        """Send the status when it has changed, and every `_PRESENCE_S` even if it has not."""
        while True:
            await asyncio.sleep(_STATUS_S)
            try:
                self._send_if_changed()
            except Exception as error:  # noqa: BLE001 - without this task every page would show an old status
                self._notes.warn(f"the status cannot be read: {type(error).__name__}: {error}")

    def _send_if_changed(self) -> None:
        """Send status and control to all clients if they have changed; the status also from time to time."""
        now_s = time.monotonic()
        lease = lease_news(self.lease)
        if lease != self._lease_status:
            self._lease_status = lease
            self._broadcast.tell_all(lease)
        status = self._source.status()
        differs = {**status, "link": None} != {**self._status, "link": None}
        if differs or now_s - self._status_s >= _PRESENCE_S:
            self._status, self._status_s = status, now_s
            self._broadcast.tell_all({"status": _with_time(status)})


def _with_time(status: Mapping[str, Any]) -> dict[str, Any]:
    """Add the time: a client that was suspended finds old statuses in its socket, and must not show them."""
    return {**status, "sent_s": round(time.monotonic(), 3)}


def page_file(path: str, headers: Mapping[str, str]) -> Response:
    """Return the response for a static file; 404 if no file has this name."""
    # Only listed names are served, so that no text of a client becomes a path in the file system.
    stored = _files_by_path().get(path or "index.html")
    if stored is None:
        return PlainTextResponse("there is no such file\n", 404)
    kind, body = _TYPES[PurePosixPath(path or "index.html").suffix], stored.read_bytes()
    if not stored.name.endswith(_PACKED):
        return Response(body, media_type=kind, headers=_HEADERS)
    if "gzip" not in headers.get("accept-encoding", ""):
        return Response(gzip.decompress(body), media_type=kind, headers=_HEADERS)
    return Response(body, media_type=kind, headers={**_HEADERS, "Content-Encoding": "gzip"})


@cache
def _files_by_path() -> dict[str, Traversable]:
    """All files that are served, by their paths as a browser asks for them."""
    served: dict[str, Traversable] = {}
    folders = [("", files(__package__) / "static")]
    while folders:
        prefix, folder = folders.pop()
        for file in folder.iterdir():
            name = f"{prefix}{file.name.removesuffix(_PACKED)}"
            if file.is_dir():
                folders.append((f"{name}/", file))
            elif PurePosixPath(name).suffix in _TYPES:
                served[name] = file
    return served
