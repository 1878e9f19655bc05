"""The page's web server: files, one WebSocket per client, and a separate WebSocket for the stop.

Every request needs the token, and pages of other origins are refused. A separate task serves each client at
the rate at which the client acknowledges frames: a slow client gets fewer rows and delays no other client.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import Coroutine, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from heli_host.errors import HeliError, file_remedy, printable
from heli_host.page.control_lease import ControlLease
from heli_host.page.files import page_file
from heli_host.page.guard import Guard
from heli_host.page.notes import Notes
from heli_host.page.outbox import Outbox
from heli_host.page.request import BadRequest, read_request
from heli_host.page.source import Action, CommandQueue, Role, Source
from heli_host.page.wire import as_json

STATUS_S = 0.1
PRESENCE_S = 0.2
"""Interval at which an unchanged status is sent again [s]. A page warns when its status is older than 0.6 s.
Longer: a briefly busy server raises that warning. Shorter: costs processor time."""

_FAILED = 1011
_REPORT = "report it with the line in the server's log"


class Service:
    """Serves one source to any number of clients.

    Everything runs in the event loop's thread, except the actions of the source, which run in one thread per
    `CommandQueue`. A stop runs in the event loop's thread as soon as its message is read: it waits for no
    queue, no role and no other client.

    Parameters
    ----------
    source : Source
        Board or replay that clients see and command.
    guard : Guard
        Decides which connections are accepted.

    Attributes
    ----------
    lease : ControlLease
        The connected clients and the pilot.
    """

    def __init__(self, source: Source, guard: Guard) -> None:
        self.lease = ControlLease()
        self._source = source
        self._guard = guard
        self._clients: dict[str, Outbox] = {}
        self._notes = Notes()
        self._status: Mapping[str, Any] = {}
        self._status_s = 0.0
        self._lease_status: Mapping[str, Any] = {}
        self._names = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._queues = {queue: ThreadPoolExecutor(1, f"page {queue.name.lower()}") for queue in CommandQueue}
        source.watch_pilot(
            lambda: self.lease.present(time.monotonic()), lambda: self.lease.absence(time.monotonic())
        )
        source.listen(self._hear)

    def application(self) -> Starlette:
        """Return the ASGI application, to be run by a web server."""
        return Starlette(
            routes=[
                WebSocketRoute("/ws", self._serve_client),
                WebSocketRoute("/stop", self._serve_stop),
                Route("/stop", self._stop_by_post, methods=["POST"]),
                Route("/{path:path}", self._serve_file, methods=["GET"]),
            ],
            lifespan=self._lifespan,
        )

    @contextlib.asynccontextmanager
    async def _lifespan(self, _: Starlette) -> Any:
        self._loop = asyncio.get_running_loop()
        task = asyncio.create_task(self._watch())
        try:
            yield
        finally:
            task.cancel()
            for queue in self._queues.values():
                queue.shutdown(wait=False, cancel_futures=True)

    async def _serve_file(self, request: Request) -> Response:
        path = request.path_params["path"]
        # The page itself is for who has the token; its files hold nothing but what everybody can download.
        refusal = self._guard.refusal(request, needs_token=not path)
        return refusal if refusal is not None else page_file(path, request.headers)

    async def _stop_by_post(self, request: Request) -> Response:
        """For a page whose socket is not open, and for ``curl``."""
        refusal = self._guard.refusal(request)
        if refusal is not None:
            return refusal
        trouble = self._stop()
        return Response(f"{trouble or 'stopped'}\n", 503 if trouble else 200, media_type="text/plain")

    def _stop(self) -> str:
        """Switch the motors off from this thread, without waiting for any queue or client. Return the error
        text, empty on success: the client must get an answer even if the stop fails.
        """
        try:
            self._source.stop()
        except HeliError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001
            self._notes.warn(f"a stop failed: {type(error).__name__}: {error}")
            return "the stop failed; use the rig's own stop switch"
        return ""

    async def _serve_stop(self, socket: WebSocket) -> None:
        if not await self._guard.admit(socket):
            return
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                message = await socket.receive()
                if message["type"] == "websocket.disconnect":
                    return
                trouble = self._stop()
                await socket.send_text(f"error: {trouble}" if trouble else "stopped")

    async def _serve_client(self, socket: WebSocket) -> None:
        if not await self._guard.admit(socket):
            return
        client = self._enter(socket)
        tasks: set[asyncio.Task[None]] = set()
        try:
            self._tell(client, self._hello(client))
            self._clients[client.key] = client
            self._tell_lease()
            tasks = {asyncio.create_task(part) for part in self._parts(client)}
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        except Exception as error:  # noqa: BLE001 - a client without a task for its news would show old news
            await self._see_off(client, error)
        finally:
            for task in tasks:
                task.cancel()
            # Two may have failed together: asyncio prints a trace for the one that is not looked at.
            await asyncio.gather(*tasks, return_exceptions=True)
            self._clients.pop(client.key, None)
            self.lease.leave(client.key)
            self._tell_lease()

    def _parts(self, client: Outbox) -> Iterator[Coroutine[Any, Any, None]]:
        yield self._listen_to(client)
        yield client.send_words()
        if client.wants_rows:
            yield client.send_rows(self._source)

    async def _see_off(self, client: Outbox, error: Exception) -> None:
        """Close the socket of a client whose task failed, and log why unless the client itself has gone."""
        states = (client.socket.client_state, client.socket.application_state)
        # RuntimeError is Starlette's word for a socket that was closed in the meantime.
        is_closed = isinstance(error, RuntimeError) and WebSocketState.DISCONNECTED in states
        if is_closed or isinstance(error, WebSocketDisconnect):
            return
        self._notes.warn(f"{client.name} is disconnected: {type(error).__name__}: {error}")
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await client.socket.close(_FAILED)

    def _enter(self, socket: WebSocket) -> Outbox:
        query = socket.query_params
        is_program = query.get("role") == "program"
        key = printable(query.get("client", ""))[:40] or secrets.token_hex(8)
        self._names += 1
        name = f"{'program' if is_program else 'page'} {self._names}"
        now_s = time.monotonic()
        if not self.lease.join(key, name, now_s, may_fly=not is_program):
            # A tab that was duplicated brings the other's id.
            key = secrets.token_hex(8)
            self.lease.join(key, name, now_s, may_fly=not is_program)
        client = Outbox(socket, key, name)
        client.wants_rows = query.get("rows") != "0"
        return client

    def _hello(self, client: Outbox) -> dict[str, Any]:
        described = self._source.describe()
        return {
            "hello": {"you": client.key, **described},
            "status": _stamped(self._source.status()),
            **self._lease_news(),
        }

    def _lease_news(self) -> dict[str, Any]:
        lease = self.lease
        return {
            "control": {
                "pilot": lease.pilot,
                "pilot_name": lease.name(lease.pilot),
                "present": lease.present(time.monotonic()),
                "asking": lease.asking,
                "asking_name": lease.name(lease.asking),
                "shared": lease.shared,
                "clients": lease.count(),
            }
        }

    async def _listen_to(self, client: Outbox) -> None:
        while True:
            message = await client.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data, words = message.get("bytes"), message.get("text")
            if data is not None:
                self._take_sign(client, data)
            elif words is not None:
                await self._take_words(client, words)

    def _take_sign(self, client: Outbox, data: bytes) -> None:
        """Four bytes: the number of the newest frame that was shown. It is also the sign of life."""
        if len(data) == 4:
            # A page that was connected before may still answer for what it got then.
            number = min(int.from_bytes(data, "little"), client.sent)
            client.acknowledged = max(client.acknowledged, number)
            client.may_send.set()
        self.lease.beat(client.key, time.monotonic())

    async def _take_words(self, client: Outbox, words: str) -> None:
        try:
            request = read_request(words)
        except BadRequest as error:
            self._notes.warn(f"a request of {client.name} is refused: {error}")
            self._tell(client, _refused(error.message, error.cause, error.remedy))
            return
        name, message = request.name, request.message
        if name == "stop":
            trouble = self._stop()
            answer = {"answer": message.get("id"), "do": name}
            self._tell(client, _refused(message, trouble, "") if trouble else answer)
        elif name in ("ask", "grant", "keep", "share"):
            self._lease_action(client, name, message)
        elif name in self._source.actions:
            # Not awaited: the next words of this client may be more urgent.
            task = asyncio.create_task(self._act(client, name, self._source.actions[name], message))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            self._tell(
                client,
                _refused(
                    message,
                    f"unknown request {name[:40]!r}",
                    "see docs/reference/dashboard-protocol.md",
                ),
            )

    def _lease_action(self, client: Outbox, name: str, message: Mapping[str, Any]) -> None:
        now_s = time.monotonic()
        granted = True
        if name == "ask":
            granted = self.lease.ask(client.key, now_s)
        elif client.key != self.lease.pilot:
            self._tell(client, _refused(message, "only the pilot can answer this", "ask for control"))
            return
        elif name == "share":
            self.lease.shared = bool(message.get("on"))
        else:
            granted = self.lease.answer(client.key, name == "grant")
        self._tell(client, {"answer": message.get("id"), "do": name, "granted": granted})
        self._tell_lease()

    async def _act(self, client: Outbox, name: str, action: Action, message: Mapping[str, Any]) -> None:
        source, epoch = self._source, self._source.stop_epoch()
        if not self._allowed(client, action):
            pilot = self.lease.name(self.lease.pilot) or "no page"
            self._tell(client, _refused(message, f"{pilot} is the pilot, and you watch", "ask for control"))
            return

        def run() -> Mapping[str, Any]:
            if not source.clear_stop(epoch):
                return {"error": "a stop came before it began", "remedy": "begin again"}
            return action.run(message)

        loop = asyncio.get_running_loop()
        try:
            answer = await loop.run_in_executor(self._queues[action.queue], run)
            text = self._as_json({"answer": message.get("id"), "do": name, **answer})
        except HeliError as error:
            self._tell(client, _refused(message, error.cause, error.remedy))
        except OSError as error:
            self._tell(client, _refused(message, error.strerror or str(error), file_remedy(error)))
        except Exception as error:  # noqa: BLE001 - the client must get an answer, and asyncio would print a trace
            self._notes.warn(f"{name} of {client.name} failed: {type(error).__name__}: {error}")
            self._tell(client, _refused(message, f"{name} failed: {type(error).__name__}", _REPORT))
        else:
            client.tell(text)

    def _allowed(self, client: Outbox, action: Action) -> bool:
        if action.role is Role.OBSERVER or client.key == self.lease.pilot:
            return True
        return action.role is Role.TUNER and self.lease.shared

    def _hear(self, news: Mapping[str, Any]) -> None:
        """Forward an event of the source to all clients; called from any thread."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._tell_all, news)

    def _tell(self, client: Outbox, news: Mapping[str, Any]) -> None:
        client.tell(self._as_json(news))

    def _tell_all(self, news: Mapping[str, Any]) -> None:
        try:
            text = self._as_json(news)
        except Exception as error:  # noqa: BLE001 - news that cannot be written must not cost the news after them
            self._notes.warn(f"{', '.join(news)} cannot be sent: {type(error).__name__}: {error}")
            return
        for client in self._clients.values():
            if "status" in news:
                client.tell_status(text)
            else:
                client.tell(text)

    def _as_json(self, news: Mapping[str, Any]) -> str:
        text, is_not_finite = as_json(news)
        if is_not_finite:
            self._notes.warn(f"{', '.join(news)} holds a number that is not finite; pages get null")
        return text

    def _tell_lease(self) -> None:
        self._tell_all(self._lease_news())

    async def _watch(self) -> None:
        """Send the status when it has changed, and every `PRESENCE_S` even if it has not."""
        while True:
            await asyncio.sleep(STATUS_S)
            try:
                self._look()
            except Exception as error:  # noqa: BLE001 - without this task every page would show an old status
                self._notes.warn(f"the status cannot be read: {type(error).__name__}: {error}")

    def _look(self) -> None:
        now_s = time.monotonic()
        lease = self._lease_news()
        if lease != self._lease_status:
            self._lease_status = lease
            self._tell_all(lease)
        status = self._source.status()
        differs = {**status, "link": None} != {**self._status, "link": None}
        if differs or now_s - self._status_s >= PRESENCE_S:
            self._status, self._status_s = status, now_s
            self._tell_all({"status": _stamped(status)})


def _stamped(status: Mapping[str, Any]) -> dict[str, Any]:
    """Add the time: a client that was suspended finds old statuses in its socket, and must not show them."""
    return {**status, "sent_s": round(time.monotonic(), 3)}


def _refused(message: Mapping[str, Any], cause: str, remedy: str) -> dict[str, Any]:
    return {"answer": message.get("id"), "do": message.get("do"), "error": cause, "remedy": remedy}
