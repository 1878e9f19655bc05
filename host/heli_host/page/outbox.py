"""What goes to one client: words by one task, frames by another, at the pace at which the client reads."""

from __future__ import annotations

import asyncio
import contextlib
import time

from starlette.websockets import WebSocket

from heli_host.page.source import Source
from heli_host.page.wire import pack

FRAME_S = 0.05
"""Between two frames to a client [s]: 20 a second look smooth, and three tabs not quite double the work."""
MAX_ROWS = 5000
"""Rows of a frame: who falls behind by more than five seconds gets every second, third, ... of them."""
UNACKNOWLEDGED = 8
"""Frames on their way to a client: 0.4 s. Then it is waited for, and the rows become fewer."""
EMPTY_S = 0.08
"""Longest time without a frame to a client that keeps up [s]."""

_QUEUED = 500


class Outbox:
    """The way to one client.

    Parameters
    ----------
    socket : WebSocket
        Open.
    key : str
        Id of the client.
    name : str
        Name of the client for people.

    Attributes
    ----------
    sent, acknowledged : int
        Number of the newest frame that was sent, and of the newest that was shown.
    may_send : asyncio.Event
        Set by an acknowledgement.
    wants_rows : bool
        Whether it is sent frames.
    """

    def __init__(self, socket: WebSocket, key: str, name: str) -> None:
        self.socket = socket
        self.key = key
        self.name = name
        self.sent = 0
        self.acknowledged = 0
        self.may_send = asyncio.Event()
        self.wants_rows = True
        self._words: asyncio.Queue[str | None] = asyncio.Queue(_QUEUED)
        self._status = ""

    def tell(self, text: str) -> None:
        """Put words in line; a client that does not read them loses some.

        Parameters
        ----------
        text : str
            As JSON.
        """
        with contextlib.suppress(asyncio.QueueFull):
            self._words.put_nowait(text)

    def tell_status(self, text: str) -> None:
        """Put a status in line, in the place of one that still waits: an old status would pass for a new one.

        Parameters
        ----------
        text : str
            As JSON.
        """
        if not self._status:
            try:
                self._words.put_nowait(None)
            except asyncio.QueueFull:
                return
        self._status = text

    async def send_words(self) -> None:
        """Send words for as long as the socket is open."""
        while True:
            text = await self._words.get()
            if text is None:
                text, self._status = self._status, ""
            await self.socket.send_text(text)

    async def send_rows(self, source: Source) -> None:
        """Send frames for as long as the socket is open.

        Parameters
        ----------
        source : Source
            Whose buffer and state they hold.
        """
        position, sent_s = 0, 0.0
        while True:
            while self.sent - self.acknowledged >= UNACKNOWLEDGED:
                self.may_send.clear()
                await self.may_send.wait()
            cut = source.buffer.cut(position, MAX_ROWS)
            now_s = time.monotonic()
            # Without rows an empty frame asks for the sign of life: a board that is silent is no lost pilot.
            if len(cut.tick) or now_s - sent_s >= EMPTY_S:
                self.sent, sent_s = self.sent + 1, now_s
                await self.socket.send_bytes(pack(cut, self.sent, source.state()))
                position = cut.end
            await asyncio.sleep(FRAME_S)
