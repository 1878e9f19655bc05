"""The connected clients: which of them is the pilot, and the messages to each.

One task sends text to a client, another telemetry, at the rate at which the client reads.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from starlette.websockets import WebSocket

from heli_host.ui.page.guard import Notes
from heli_host.ui.page.source import Source
from heli_host.ui.page.telemetry import NO_ROWS, as_json, pack

PRESENT_S = 0.5
"""Largest age of the pilot's last sign of life at which setpoints are sent [s].

A page sends ten signs of life in that time. When they stop, the board gets no more setpoints: it holds level
after another ``setpoint_hold_s``, and lands after ``setpoint_land_s``. A page that was closed or has crashed
counts as absent immediately, because its socket closes. With a shorter time, a busy browser would interrupt
the
flight; with a longer one, a frozen page would keep the board flying for longer."""
ABSENT_S = 3.0
"""Absence of the pilot after which another client gets control without the pilot's answer [s]. Shorter: a
page that is reloaded loses control. Longer: a dead page keeps control."""
_RELOAD_S = 1.0
"""Longest time from a page's connection to the end of an older one from the same tab that counts as a reload
[s]. A browser may connect the new page milliseconds before the server sees the old socket close. Longer: a
duplicated tab would get the control when the pilot closes the original."""
_FRAME_S = 0.05
"""Interval between two frames to a client [s]: 20 frames per second look smooth."""
_MAX_MESSAGE_ROWS = 5000
"""Greatest number of rows in a frame. A client more than 5 s behind gets every second, third, ... row."""
_UNACKNOWLEDGED = 8
"""Greatest number of unacknowledged frames, 0.4 s. No more are sent until the client acknowledges."""
_EMPTY_S = 0.08
"""Longest time without a frame to a client that acknowledges [s]."""

_QUEUED = 500


@dataclass
class _Client:
    name: str
    connected: bool
    beat_s: float  # Time of its last sign of life
    joined_s: float
    reload_of: str  # Key of the client of the same tab that was still connected; empty: none


class ControlLease:
    """The connected clients, and which of them is the pilot."""

    # All methods may be called from any thread.
    # Nothing here talks to the board. `present` decides whether setpoints are sent.

    def __init__(self) -> None:
        self.pilot: str | None = None
        self.asking: str | None = None
        self.shared = False
        self._clients: dict[str, _Client] = {}
        self._lock = threading.RLock()

    def join(
        self, client: str, name: str, now_s: float, *, may_fly: bool = True, reload_of: str = ""
    ) -> bool:
        """Add a client, unless its key is connected. It becomes the pilot if there is none and `may_fly` is
        true. `reload_of` is the key of a connected client of the same tab.
        """
        with self._lock:
            registered = self._clients.get(client)
            if registered is not None and registered.connected:
                return False
            self._clients[client] = _Client(name, True, now_s, now_s, reload_of)
            if self.pilot is None and may_fly:
                self.pilot = client
            return True

    def leave(self, client: str, now_s: float) -> None:
        """Mark a client as disconnected and withdraw its request for control. If its page was reloaded, the
        new page gets its control.
        """
        # A disconnected pilot keeps the lease until another client asks for it, but counts as absent: no
        # setpoints are sent.
        with self._lock:
            if client in self._clients:
                self._clients[client].connected = False
            if self.asking == client:
                self.asking = None
            if client != self.pilot:
                self._clients.pop(client, None)
                return
            for key, other in list(self._clients.items()):
                if other.connected and other.reload_of == client and now_s - other.joined_s <= _RELOAD_S:
                    self._grant(key)

    def beat(self, client: str, now_s: float) -> None:
        """Record a sign of life of a client."""
        with self._lock:
            if client in self._clients:
                self._clients[client].beat_s = now_s

    def pilot_age_s(self, now_s: float) -> float:
        """Return the age of the pilot's last sign of life [s]; infinite if no pilot is connected."""
        # Called with the link's lock held. It reads single references only, so it needs no lock; taking one
        # could deadlock with a thread that holds it and waits for the link.
        pilot = self._clients.get(self.pilot or "")
        return now_s - pilot.beat_s if pilot is not None and pilot.connected else float("inf")

    def present(self, now_s: float) -> bool:
        """Whether the pilot's page has given a sign of life within `PRESENT_S`."""
        return self.pilot_age_s(now_s) <= PRESENT_S

    def absence(self, now_s: float) -> str:
        """Return in words why the pilot's page sends no setpoints; empty while it is present."""
        age_s = self.pilot_age_s(now_s)
        if age_s <= PRESENT_S:
            return ""
        if self.pilot is None:
            return "no page has the control"
        return "the pilot's page was closed" if age_s == float("inf") else "the pilot's page does not answer"

    def ask(self, client: str, now_s: float) -> bool:
        """Request control for a client."""
        with self._lock:
            if client == self.pilot:
                return True
            if self.pilot is None or self.pilot_age_s(now_s) > ABSENT_S:
                self._grant(client)
                return True
            self.asking = client
            return False

    def answer(self, client: str, grant: bool) -> bool:
        """Answer the pending request for control."""
        with self._lock:
            if client != self.pilot or self.asking is None:
                return False
            if grant:
                self._grant(self.asking)
            self.asking = None
            return grant

    def name(self, client: str | None) -> str:
        """Return the display name of a client; empty if it is unknown or None."""
        with self._lock:
            registered = self._clients.get(client or "")
            return registered.name if registered is not None else ""

    def count(self) -> int:
        """Return the number of connected clients."""
        with self._lock:
            return sum(client.connected for client in self._clients.values())

    def _grant(self, client: str) -> None:
        before, self.pilot, self.asking = self.pilot, client, None
        if before is not None and before in self._clients and not self._clients[before].connected:
            del self._clients[before]


def lease_news(lease: ControlLease) -> dict[str, Any]:
    """Return who is the pilot and who asks for control, as news for all clients."""
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


class Outbox:
    """Queue of messages to one client. Use it in the event loop's thread only."""

    def __init__(self, socket: WebSocket, key: str, name: str) -> None:
        self.socket = socket
        self.key = key
        self.name = name
        self.sent = 0
        self.acknowledged = 0
        self.may_send = asyncio.Event()
        self.wants_rows = True
        self.pending = 0
        self._words: asyncio.Queue[str | None] = asyncio.Queue(_QUEUED)
        self._status = ""

    def tell(self, text: str) -> None:
        """Append a text message. If 500 messages wait already, it is dropped."""
        with contextlib.suppress(asyncio.QueueFull):
            self._words.put_nowait(text)

    def tell_status(self, text: str) -> None:
        """Append a status, or replace the one that still waits: an old status must not arrive as the
        present.
        """
        if not self._status:
            try:
                self._words.put_nowait(None)
            except asyncio.QueueFull:
                return
        self._status = text

    async def send_words(self) -> None:
        """Send text messages until the socket closes."""
        while True:
            text = await self._words.get()
            if text is None:
                text, self._status = self._status, ""
            await self.socket.send_text(text)

    async def send_rows(self, source: Source) -> None:
        """Send telemetry frames until the socket closes."""
        position, sent_s = 0, 0.0
        # The history takes half a megabyte: only a client that has answered an empty frame gets it.
        self.sent = 1
        await self.socket.send_bytes(pack(NO_ROWS, self.sent, source.state()))
        while True:
            while self.acknowledged == 0 or self.sent - self.acknowledged >= _UNACKNOWLEDGED:
                self.may_send.clear()
                await self.may_send.wait()
            cut = source.buffer.rows_since(position, _MAX_MESSAGE_ROWS)
            now_s = time.monotonic()
            # Without rows, an empty frame asks the client for its sign of life, so that a silent board does
            # not make the pilot look absent.
            if len(cut.tick) or now_s - sent_s >= _EMPTY_S:
                self.sent, sent_s = self.sent + 1, now_s
                await self.socket.send_bytes(pack(cut, self.sent, source.state()))
                position = cut.end
            await asyncio.sleep(_FRAME_S)


class Broadcast:
    """The connected clients, as addressees."""

    # It owns their outboxes while they are connected. All methods run in the event loop's thread, except
    # `tell_all_soon`. None blocks: a slow client loses messages of its own and delays no other.

    def __init__(self, notes: Notes) -> None:
        self.loop: asyncio.AbstractEventLoop | None = None
        self._notes = notes
        self._clients: dict[str, Outbox] = {}

    def add(self, client: Outbox) -> None:
        """Send news to a client from now on."""
        self._clients[client.key] = client

    def remove(self, client: Outbox) -> None:
        """Send a client nothing more."""
        self._clients.pop(client.key, None)

    def tell(self, client: Outbox, news: Mapping[str, Any]) -> None:
        """Send news to a client."""
        client.tell(self.as_json(news))

    def tell_all(self, news: Mapping[str, Any]) -> None:
        """Send news to all clients."""
        try:
            text = self.as_json(news)
        except Exception as error:  # noqa: BLE001 - news that cannot be written must not cost the news after them
            self._notes.warn(f"{', '.join(news)} cannot be sent: {type(error).__name__}: {error}")
            return
        for client in self._clients.values():
            if "status" in news:
                client.tell_status(text)
            else:
                client.tell(text)

    def tell_all_soon(self, news: Mapping[str, Any]) -> None:
        """Send news to all clients, from any thread: the event loop does it next."""
        if self.loop is not None:
            with contextlib.suppress(RuntimeError):
                self.loop.call_soon_threadsafe(self.tell_all, news)

    def as_json(self, news: Mapping[str, Any]) -> str:
        """Return news as JSON, and log numbers that are not finite."""
        text, is_not_finite = as_json(news)
        if is_not_finite:
            self._notes.warn(f"{', '.join(news)} holds a number that is not finite; pages get null")
        return text
