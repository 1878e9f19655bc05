"""Messages to one client: one task sends text, another telemetry, at the rate at which the client reads."""

from __future__ import annotations

import asyncio
import contextlib
import time

from starlette.websockets import WebSocket

from heli_host.ui.page.source import Source
from heli_host.ui.page.telemetry_buffer import NO_ROWS
from heli_host.ui.page.wire import pack

FRAME_S = 0.05
"""Interval between two frames to a client [s]: 20 frames per second look smooth."""
MAX_MESSAGE_ROWS = 5000
"""Greatest number of rows in a frame. A client more than 5 s behind gets every second, third, ... row."""
UNACKNOWLEDGED = 8
"""Greatest number of unacknowledged frames, 0.4 s. No more are sent until the client acknowledges."""
EMPTY_S = 0.08
"""Longest time without a frame to a client that acknowledges [s]."""

_QUEUED = 500


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
            while self.acknowledged == 0 or self.sent - self.acknowledged >= UNACKNOWLEDGED:
                self.may_send.clear()
                await self.may_send.wait()
            cut = source.buffer.rows_since(position, MAX_MESSAGE_ROWS)
            now_s = time.monotonic()
            # Without rows, an empty frame asks the client for its sign of life, so that a silent board does
            # not make the pilot look absent.
            if len(cut.tick) or now_s - sent_s >= EMPTY_S:
                self.sent, sent_s = self.sent + 1, now_s
                await self.socket.send_bytes(pack(cut, self.sent, source.state()))
                position = cut.end
            await asyncio.sleep(FRAME_S)
