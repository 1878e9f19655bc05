"""The page's server: files, one WebSocket for everything, and another for the stop alone.

Nothing is done without the token, nor for a page of another origin. Each client is fed by a task of its own,
at the pace at which it acknowledges: who is slow gets fewer rows, and holds nobody up.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from heli_host.errors import HeliError, printable
from heli_host.page.files import page_file
from heli_host.page.guard import Guard
from heli_host.page.seats import Seats
from heli_host.page.source import Action, Lane, Need, Source
from heli_host.page.wire import pack

FRAME_S = 0.05
"""Between two frames to a client [s]: 20 a second look smooth, and three tabs not quite double the work."""
MOST_ROWS = 5000
"""Rows of a frame: who falls behind by more than five seconds gets every second, third, ... of them."""
UNACKNOWLEDGED = 8
"""Frames on their way to a client: 0.4 s. Then it is waited for, and the rows become fewer."""
EMPTY_S = 0.08
"""Longest time without a frame to a client that keeps up [s]."""
STATUS_S = 0.1
PRESENCE_S = 0.5
"""How often a status goes out that says the same as before [s]."""

_QUEUED = 500
_LONGEST_MESSAGE = 4096


class Client:
    """One WebSocket: its words go out by one task, its frames by another.

    Parameters
    ----------
    socket : WebSocket
        Open.
    key : str
        Id of the client.

    Attributes
    ----------
    sent, acknowledged : int
        Number of the newest frame that was sent, and of the newest that was shown.
    may_send : asyncio.Event
        Set by an acknowledgement.
    wants_rows : bool
        Whether it is sent frames.
    """

    def __init__(self, socket: WebSocket, key: str) -> None:
        self.socket = socket
        self.key = key
        self.words: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue(_QUEUED)
        self.sent = 0
        self.acknowledged = 0
        self.may_send = asyncio.Event()
        self.wants_rows = True

    def tell(self, news: Mapping[str, Any]) -> None:
        """Put words in line; a client that does not read them loses some.

        Parameters
        ----------
        news : Mapping of str to object
            As JSON.
        """
        with contextlib.suppress(asyncio.QueueFull):
            self.words.put_nowait(news)


class Service:
    """Serves one source to any number of clients.

    Parameters
    ----------
    source : Source
        What is shown and commanded.
    guard : Guard
        Who is let in.

    Attributes
    ----------
    seats : Seats
        Who flies.
    """

    def __init__(self, source: Source, guard: Guard) -> None:
        self.seats = Seats()
        self._source = source
        self._guard = guard
        self._clients: dict[str, Client] = {}
        self._status: Mapping[str, Any] = {}
        self._names = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._lanes = {lane: ThreadPoolExecutor(1, f"page {lane.name.lower()}") for lane in Lane}
        source.watch_pilot(lambda: self.seats.present(time.monotonic()))
        source.listen(self._hear)

    def application(self) -> Starlette:
        """Return what a server serves."""
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
            for lane in self._lanes.values():
                lane.shutdown(wait=False, cancel_futures=True)

    async def _serve_file(self, request: Request) -> Response:
        refusal = self._guard.refusal(request)
        path = request.path_params["path"]
        if refusal is None and not path:
            refusal = self._guard.refusal_without_token(request)
        return refusal if refusal is not None else page_file(path, request.headers)

    async def _stop_by_post(self, request: Request) -> Response:
        """For a page whose socket is not open, and for ``curl``."""
        refusal = self._guard.refusal(request) or self._guard.refusal_without_token(request)
        if refusal is not None:
            return refusal
        try:
            self._source.stop()
        except HeliError as error:
            return Response(f"{error}\n", 503, media_type="text/plain")
        return Response("stopped\n", media_type="text/plain")

    async def _serve_stop(self, socket: WebSocket) -> None:
        if not await self._guard.admit(socket):
            return
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                message = await socket.receive()
                if message["type"] == "websocket.disconnect":
                    return
                try:
                    # In this thread, at once: it waits for no lane, no queue and no other client.
                    self._source.stop()
                    answer = "stopped"
                except HeliError as error:
                    answer = f"error: {error}"
                await socket.send_text(answer)

    async def _serve_client(self, socket: WebSocket) -> None:
        if not await self._guard.admit(socket):
            return
        client = self._enter(socket)
        tasks = [asyncio.create_task(part(client)) for part in (self._send_words, self._send_rows)]
        try:
            await self._listen_to(client)
        except (WebSocketDisconnect, RuntimeError):
            # RuntimeError is Starlette's word for a socket that was closed meanwhile.
            pass
        finally:
            for task in tasks:
                task.cancel()
            self._clients.pop(client.key, None)
            self.seats.leave(client.key)
            self._tell_seats()

    def _enter(self, socket: WebSocket) -> Client:
        query = socket.query_params
        is_program = query.get("role") == "program"
        key = printable(query.get("client", ""))[:40] or secrets.token_hex(8)
        self._names += 1
        name = f"{'program' if is_program else 'page'} {self._names}"
        now_s = time.monotonic()
        if not self.seats.join(key, name, now_s, may_fly=not is_program):
            # A tab that was duplicated brings the other's id.
            key = secrets.token_hex(8)
            self.seats.join(key, name, now_s, may_fly=not is_program)
        client = Client(socket, key)
        client.wants_rows = query.get("rows") != "0"
        client.tell(self._hello(client))
        self._clients[key] = client
        self._tell_seats()
        return client

    def _hello(self, client: Client) -> dict[str, Any]:
        described = self._source.describe()
        return {"hello": {"you": client.key, **described}, "status": self._source.status(), **self._seated()}

    def _seated(self) -> dict[str, Any]:
        seats = self.seats
        return {
            "seats": {
                "pilot": seats.pilot,
                "pilot_name": seats.name(seats.pilot),
                "present": seats.present(time.monotonic()),
                "asking": seats.asking,
                "asking_name": seats.name(seats.asking),
                "shared": seats.shared,
                "clients": seats.count(),
            }
        }

    async def _listen_to(self, client: Client) -> None:
        while True:
            message = await client.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data, words = message.get("bytes"), message.get("text")
            if data is not None:
                self._take_sign(client, data)
            elif words is not None:
                await self._take_words(client, words)

    def _take_sign(self, client: Client, data: bytes) -> None:
        """Four bytes: the number of the newest frame that was shown. It is also the sign of life."""
        if len(data) == 4:
            # A page that was connected before may still answer for what it got then.
            number = min(int.from_bytes(data, "little"), client.sent)
            client.acknowledged = max(client.acknowledged, number)
            client.may_send.set()
        self.seats.beat(client.key, time.monotonic())

    async def _take_words(self, client: Client, words: str) -> None:
        try:
            asked = json.loads(words) if len(words) <= _LONGEST_MESSAGE else None
        except ValueError:
            asked = None
        if not isinstance(asked, dict) or not isinstance(asked.get("do"), str):
            client.tell({"answer": None, "error": "that is no request", "remedy": "see docs/page.md"})
            return
        name = asked["do"]
        if name == "stop":
            self._source.stop()
            client.tell({"answer": asked.get("id"), "do": name})
        elif name in ("ask", "grant", "keep", "share"):
            self._seat_action(client, name, asked)
        elif name in self._source.actions:
            # Not awaited: the next words of this client may be more urgent.
            task = asyncio.create_task(self._act(client, name, self._source.actions[name], asked))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            client.tell(_refused(asked, f"nothing is called {name[:40]!r} here", "see docs/page.md"))

    def _seat_action(self, client: Client, name: str, asked: Mapping[str, Any]) -> None:
        now_s = time.monotonic()
        granted = True
        if name == "ask":
            granted = self.seats.ask(client.key, now_s)
        elif client.key != self.seats.pilot:
            client.tell(_refused(asked, "only who flies can answer that", "ask for control"))
            return
        elif name == "share":
            self.seats.shared = bool(asked.get("on"))
        else:
            granted = self.seats.answer(client.key, name == "grant")
        client.tell({"answer": asked.get("id"), "do": name, "granted": granted})
        self._tell_seats()

    async def _act(self, client: Client, name: str, action: Action, asked: Mapping[str, Any]) -> None:
        source, wish = self._source, self._source.wish()
        if not self._allowed(client, action):
            pilot = self.seats.name(self.seats.pilot) or "nobody"
            client.tell(_refused(asked, f"{pilot} flies, you watch", "ask for control"))
            return

        def run() -> Mapping[str, Any]:
            if not source.begin(wish):
                return {"error": "a stop came before it began", "remedy": "begin again"}
            return action.run(asked)

        loop = asyncio.get_running_loop()
        try:
            answer = await loop.run_in_executor(self._lanes[action.lane], run)
        except HeliError as error:
            client.tell(_refused(asked, error.cause, error.remedy))
        except OSError as error:
            client.tell(_refused(asked, error.strerror or str(error), "choose another place"))
        else:
            client.tell({"answer": asked.get("id"), "do": name, **answer})

    def _allowed(self, client: Client, action: Action) -> bool:
        if action.need is Need.ANYBODY or client.key == self.seats.pilot:
            return True
        return action.need is Need.TUNER and self.seats.shared

    async def _send_words(self, client: Client) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                words = await client.words.get()
                await client.socket.send_text(json.dumps(words, allow_nan=False, separators=(",", ":")))

    async def _send_rows(self, client: Client) -> None:
        if not client.wants_rows:
            return
        position, sent_s = 0, 0.0
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                while client.sent - client.acknowledged >= UNACKNOWLEDGED:
                    client.may_send.clear()
                    await client.may_send.wait()
                cut = self._source.tape.cut(position, MOST_ROWS)
                now_s = time.monotonic()
                # Without rows an empty frame asks for the sign of life: a board that is silent is no lost
                # pilot.
                if len(cut.tick) or now_s - sent_s >= EMPTY_S:
                    client.sent, sent_s = client.sent + 1, now_s
                    await client.socket.send_bytes(pack(cut, client.sent))
                    position = cut.end
                await asyncio.sleep(FRAME_S)

    def _hear(self, news: Mapping[str, Any]) -> None:
        """Take news from any thread."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._tell_all, news)

    def _tell_all(self, news: Mapping[str, Any]) -> None:
        for client in self._clients.values():
            client.tell(news)

    def _tell_seats(self) -> None:
        self._tell_all(self._seated())

    async def _watch(self) -> None:
        """Tell the status when it has changed, and from time to time that it has not."""
        told_s, seated = 0.0, self._seated()
        while True:
            await asyncio.sleep(STATUS_S)
            now_s = time.monotonic()
            status, seats = self._source.status(), self._seated()
            differs = {**status, "link": None} != {**self._status, "link": None}
            if differs or now_s - told_s >= PRESENCE_S:
                self._status, told_s = status, now_s
                self._tell_all({"status": status})
            if seats != seated:
                seated = seats
                self._tell_all(seats)


def _refused(asked: Mapping[str, Any], cause: str, remedy: str) -> dict[str, Any]:
    return {"answer": asked.get("id"), "do": asked.get("do"), "error": cause, "remedy": remedy}
