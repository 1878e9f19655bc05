"""Live samples for viewers over Foxglove's WebSocket protocol: Foxglove, PlotJuggler and others connect to it.

The feed is read-only: it advertises no capability, so that a client can neither publish nor call or set
anything. It listens on this computer only. Topics and layouts are those of the log.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

from heli_host.errors import HeliError, PortError
from heli_host.link.channels import rad_per_count
from heli_host.link.events import BOARD_RESTARTED
from heli_host.log.blind import hide
from heli_host.log.clock import TickClock
from heli_host.log.records import json_bytes
from heli_host.log.schema import (
    CDR_LITTLE_ENDIAN,
    EVENT_SCHEMA,
    EVENT_SCHEMA_NAME,
    EVENT_TOPIC,
    LEVEL_INFO,
    TICK_LAYOUT,
    TICK_SCHEMA,
    TICK_SCHEMA_NAME,
    TICK_TOPIC,
    fill_ticks,
)

if TYPE_CHECKING:
    import numpy.typing as npt

    from heli_host.link.events import LinkEvent
    from heli_host.link.telemetry import Ticks
    from heli_host.vehicle import Vehicle

HOST: Final = "127.0.0.1"
BACKLOG: Final = 20_000
"""Messages that wait for one slow client: 20 s of ticks, 4 MB. More: a client that hangs costs memory. Fewer: a
client that pauses for a second, as browsers do, misses samples."""
_WAITING_BATCHES: Final = 2_000
"""Batches of ticks that wait for the feed's own thread: 40 s of ticks, at 20 ticks per batch."""
_MESSAGE = np.dtype([("cdr", "<u4"), ("payload", TICK_LAYOUT.dtype)])


class FoxgloveFeed:
    """Publishes every tick and event of a session to all connected viewers.

    A separate thread publishes, so that neither flight nor stop waits for a viewer. In lockstep the thread that
    reads publishes.

    Parameters
    ----------
    heli : Vehicle
        Connected board.
    port : int
        TCP port on this computer; 0 chooses a free one.
    hidden : bool
        Leave out of events what reveals a sealed flight.

    Attributes
    ----------
    dropped : int
        Ticks that the feed has left out because its thread was too slow.

    Raises
    ------
    PortError
        The port is in use.
    HeliError
        foxglove-sdk is not installed.
    """

    def __init__(self, heli: Vehicle, port: int = 0, *, hidden: bool = False) -> None:
        try:
            import foxglove
        except ImportError as error:
            raise HeliError("--foxglove needs foxglove-sdk", "pip install 'heli-host[foxglove]'") from error
        session = heli.session
        self.dropped = 0
        self._hidden = hidden
        self._session = session
        self._start_wall_ns = session.transport.wall_ns()
        self._last_wall_ns = self._start_wall_ns
        self._clock = TickClock()
        self._rad_per_count = rad_per_count(dict(heli.params))
        # Without a reference of our own, the context would end, and its channels with it.
        context = self._context = foxglove.Context()
        self._ticks = foxglove.Channel(
            TICK_TOPIC,
            schema=foxglove.Schema(name=TICK_SCHEMA_NAME, encoding="ros2msg", data=TICK_SCHEMA.encode()),
            message_encoding="cdr",
            context=context,
        )
        self._events = foxglove.Channel(
            EVENT_TOPIC,
            schema=foxglove.Schema(name=EVENT_SCHEMA_NAME, encoding="jsonschema", data=EVENT_SCHEMA.encode()),
            message_encoding="json",
            context=context,
        )
        try:
            self._server = foxglove.start_server(
                name="heli-lab",
                host=HOST,
                port=port,
                capabilities=[],
                context=context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise PortError(
                f"cannot serve Foxglove on {HOST}:{port}: {error}",
                "give --foxglove another port, or 0 for a free one",
            ) from error
        self._queue: queue.Queue[Ticks | LinkEvent | None] = queue.Queue(_WAITING_BATCHES)
        self._thread: threading.Thread | None = None
        if not session.lockstep:
            self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
            self._thread.start()
        self._unsubscribe = (session.subscribe_ticks(self._take), session.subscribe_events(self._take))

    @property
    def address(self) -> str:
        """URL for viewers."""
        return f"ws://{HOST}:{self._server.port}"

    def close(self) -> None:
        """Publish what has arrived, then disconnect all viewers."""
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(5.0)
            self._thread = None
        self._server.stop()

    def _take(self, news: Ticks | LinkEvent) -> None:
        if self._thread is None:
            self._publish(news)
            return
        try:
            self._queue.put_nowait(news)
        except queue.Full:
            # The link's thread must not wait for a viewer.
            self.dropped += 1 if not hasattr(news, "raw") else len(news)

    def _run(self) -> None:
        while (news := self._queue.get()) is not None:
            self._publish(news)

    def _publish(self, news: Ticks | LinkEvent) -> None:
        from heli_host.link.events import LinkEvent

        if isinstance(news, LinkEvent):
            self._publish_event(news)
        elif len(news):
            self._publish_ticks(news.tick, news.raw)

    def _publish_ticks(self, tick: npt.NDArray[np.uint32], raw: npt.NDArray[np.int32]) -> None:
        time_us, _ = self._clock.advance(tick)
        self._last_wall_ns = self._session.transport.wall_ns()
        if not self._ticks.has_sinks():
            return
        messages = np.zeros(tick.size, _MESSAGE)
        messages["cdr"] = int.from_bytes(CDR_LITTLE_ENDIAN, "little")
        fill_ticks(messages["payload"], time_us / 1e6, tick, raw, self._rad_per_count)
        data, size, log = messages.tobytes(), _MESSAGE.itemsize, self._ticks.log
        for number, time_ns in enumerate((self._start_wall_ns + time_us * 1000).tolist()):
            log(data[number * size : (number + 1) * size], log_time=time_ns)

    def _publish_event(self, event: LinkEvent) -> None:
        if event.kind == BOARD_RESTARTED:
            self._clock.skip(max(0, event.wall_ns - self._last_wall_ns) / 1e9)
        time_us = self._clock.time_us(event.tick & 0xFFFFFFFF)
        wall_ns = max(0, self._start_wall_ns + time_us * 1000)
        body = {
            "timestamp": {"sec": wall_ns // 1_000_000_000, "nsec": wall_ns % 1_000_000_000},
            "level": LEVEL_INFO,
            "message": hide(event.text) if self._hidden else event.text,
            "name": event.kind,
            "t_s": time_us / 1e6,
            "tick": event.tick & 0xFFFFFFFF,
        }
        self._events.log(json_bytes(body), log_time=wall_ns)


@contextlib.contextmanager
def foxglove_feed(heli: Vehicle, port: int | None, *, hidden: bool = False) -> Iterator[FoxgloveFeed | None]:
    """Serve viewers until the ``with`` block ends; without a port, serve none.

    Parameters
    ----------
    heli : Vehicle
        Connected board.
    port : int or None
        TCP port on this computer, 0 for a free one; None for no feed.
    hidden : bool
        Leave out of events what reveals a sealed flight.
    """
    if port is None:
        yield None
        return
    feed = FoxgloveFeed(heli, port, hidden=hidden)
    try:
        yield feed
    finally:
        feed.close()
