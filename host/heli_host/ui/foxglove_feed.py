"""Live samples over Foxglove's WebSocket protocol, for viewers such as Foxglove and PlotJuggler.

The feed is read-only, listens on this computer only, and refuses pages of other origins. A process of its own
serves the viewers; see `heli_host.ui.foxglove_server`.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from heli_host.data.log.blind import hide
from heli_host.errors import HeliError, PortError, install_remedy
from heli_host.link.channels import rad_per_count
from heli_host.link.events import BOARD_RESTARTED
from heli_host.ui.foxglove_server import EVENT, HEADER, HOST, SETTINGS, TICKS

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.link.events import LinkEvent
    from heli_host.link.telemetry import Ticks

_WAITING_PARTS: Final = 2_000
"""Batches of ticks that wait for the server: 40 s of ticks, at 20 ticks per batch. More: a server that hangs
costs memory. Fewer: a busy computer costs samples."""
_END_S: Final = 5.0


class FoxgloveFeed:
    """Sends every tick and event of a session to a server for viewers."""

    # The link's thread only appends to a queue: neither flight nor stop waits for a viewer.

    def __init__(self, heli: Heli, port: int = 0, *, hidden: bool = False) -> None:
        if importlib.util.find_spec("foxglove") is None:
            raise HeliError("--foxglove needs foxglove-sdk", install_remedy("foxglove"))
        self.dropped = 0
        self._hidden = hidden
        self._transport = heli.session.transport
        self._last_wall_ns = self._transport.wall_ns()
        self._server = subprocess.Popen(
            [sys.executable, "-m", "heli_host.ui.foxglove_server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # In a separate session, Ctrl-C does not end the server, so that viewers still see the landing.
            start_new_session=True,
        )
        settings = {
            "port": port,
            "start_wall_ns": self._last_wall_ns,
            "rad_per_count": rad_per_count(dict(heli.params)).tolist(),
        }
        self._send_message(SETTINGS, json.dumps(settings).encode())
        # The server answers when viewers can connect, or when it has failed.
        answer = self._first_answer()
        if "port" not in answer:
            self._end_server()
            raise PortError(
                f"cannot serve Foxglove on {HOST}:{port}: {answer.get('error', 'the server ended')}",
                "give --foxglove another port, or 0 for a free one",
            )
        self.address = f"ws://{HOST}:{answer['port']}"
        """URL for viewers."""
        self._queue: queue.Queue[tuple[int, bytes] | None] = queue.Queue(_WAITING_PARTS)
        self._thread = threading.Thread(target=self._send_queued, name="foxglove", daemon=True)
        self._thread.start()
        self._unsubscribe = (
            heli.session.subscribe_ticks(self._take_ticks),
            heli.session.subscribe_events(self._take_event),
        )

    @property
    def server_pid(self) -> int:
        """Process number of the server."""
        return self._server.pid

    def close(self) -> None:
        """Publish what has arrived, then disconnect all viewers."""
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=_END_S)
        self._thread.join(_END_S)
        self._end_server()

    def _first_answer(self) -> dict[str, Any]:
        """Read the first line of the server: its port, or an error; empty if it ends without a line."""
        assert self._server.stdout is not None
        try:
            answer = json.loads(self._server.stdout.readline())
        except ValueError:
            return {}
        return answer if isinstance(answer, dict) else {}

    def _send_message(self, kind: int, content: bytes) -> None:
        """Send a message of a `kind` to the server."""
        assert self._server.stdin is not None
        # A server that has ended must not end the flight.
        with contextlib.suppress(OSError, ValueError):
            self._server.stdin.write(HEADER.pack(kind, len(content)) + content)
            self._server.stdin.flush()

    def _end_server(self) -> None:
        """End the server by closing its input, and kill it if it does not end in time."""
        with contextlib.suppress(OSError):
            if self._server.stdin is not None:
                self._server.stdin.close()
        try:
            self._server.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()
        if self._server.stdout is not None:
            self._server.stdout.close()

    def _send_queued(self) -> None:
        """Send queued messages until `None` ends the thread."""
        while (message := self._queue.get()) is not None:
            self._send_message(*message)

    def _enqueue(self, kind: int, content: bytes) -> None:
        """Queue a message for the server, or drop it if too many wait."""
        try:
            self._queue.put_nowait((kind, content))
        except queue.Full:
            self.dropped += 1

    def _take_ticks(self, ticks: Ticks) -> None:
        """Queue new samples."""
        if not len(ticks):
            return
        self._last_wall_ns = self._transport.wall_ns()
        tick, raw = np.ascontiguousarray(ticks.tick, "<u4"), np.ascontiguousarray(ticks.raw, "<i4")
        self._enqueue(TICKS, tick.tobytes() + raw.tobytes())

    def _take_event(self, event: LinkEvent) -> None:
        """Queue an event; after a restart of the board, with the time that has passed."""
        text = hide(event.text) if self._hidden else event.text
        body = {"tick": event.tick & 0xFFFFFFFF, "name": event.kind, "message": text}
        gap = {"gap_s": max(0, event.wall_ns - self._last_wall_ns) / 1e9}
        self._enqueue(EVENT, json.dumps(body | gap if event.kind == BOARD_RESTARTED else body).encode())


@contextlib.contextmanager
def foxglove_feed(heli: Heli, port: int | None, *, hidden: bool = False) -> Iterator[FoxgloveFeed | None]:
    """Serve viewers until the ``with`` block ends; without a port, serve none."""
    if port is None:
        yield None
        return
    feed = FoxgloveFeed(heli, port, hidden=hidden)
    try:
        yield feed
    finally:
        feed.close()
