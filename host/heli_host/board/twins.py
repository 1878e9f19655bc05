"""Change detection during a flight: a twin, a model of the rig, raises an alarm when the rig changes.

This file contains no model. A package with a model offers a function in the entry-point group
``heli_host.twins``. Its twin gets every tick, in a separate thread, so that it does not delay the link.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from heli_host.declaration import TICK_US
from heli_host.errors import HeliError
from heli_host.link.installation import plugins

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from heli_host.link.session import Session
    from heli_host.link.telemetry import Ticks

ENTRY_POINT_GROUP: Final = "heli_host.twins"
ALARM: Final = "alarm"
"""Kind of the news that the rig has changed."""
EVENT: Final = "twin"
"""Kind of the events that a twin writes into the log."""
_MAX_BEHIND_TICKS: Final = 10_000
"""Greatest number of samples that wait for a twin: 10 s, 1 MB. More: an overloaded computer runs out of
memory, and alarms come late. Fewer: a short overload costs the twin its state."""
FALSE_ALARM_INTERVAL_h: Final = 10.0
"""Mean time of free flight between two false alarms, h."""


@dataclass(frozen=True)
class TwinNews:
    """A message of a twin."""

    kind: str
    """``free`` when it begins to compare, ``waits`` when it pauses, ``alarm`` when the rig has changed,
    ``diagnosed`` with the final ranking of causes. ``fits`` when the first seconds agree with the model,
    ``contradicts`` when the flight contradicts it, ``failed`` when the twin itself failed."""
    tick: int  # Device time [tick of 1 ms], unwrapped beyond 2^32
    text: str  # Message for people


class LiveTwin(Protocol):
    """A twin that a package with a model provides. One thread calls all its methods, except `ghost_rad` and
    `words`, which any thread may call.
    """

    def update(self, tick: npt.NDArray[np.int64], raw: npt.NDArray[np.int32]) -> Sequence[TwinNews]:
        """Process ticks and return the messages that they cause. Shapes: `tick` (n,), `raw` (n, channels)."""
        ...

    def ghost_rad(self) -> tuple[float, float, float] | None:
        """Elevation, pitch and travel [rad] that a short open-loop simulation (free run) predicts for now;
        None while the twin waits.
        """
        ...

    def words(self) -> str:
        """Return the twin's status in one line."""
        ...


TwinMaker = Callable[[Mapping[str, float], float], LiveTwin]
"""Makes a twin from the board's parameters and the mean time of free flight between two false alarms [h]."""
TwinOpener = Callable[[str], TwinMaker]


def open_twin(name: str) -> TwinMaker:
    """Read a rig or a twin's file, and return a function that makes its twin once a board is connected."""
    for entry in plugins(ENTRY_POINT_GROUP):
        opener: TwinOpener = entry.load()
        return opener(name)
    raise HeliError("no installed package provides twins", "reinstall heli-host")


class TwinWatch:
    """Passes the ticks of a session to a twin, and the twin's messages to listeners."""

    # Over a port the twin runs in a separate thread. In lockstep it runs in the thread that reads, so that a
    # simulated flight is reproducible. If the twin fails, it is switched off, and the flight continues. If it
    # is too slow for this computer, it skips the waiting samples and starts again with the newest one.

    def __init__(self, session: Session, twin: LiveTwin, on_change: Callable[[], None] | None = None) -> None:
        self.alarm = ""
        self.trouble = ""
        self.skipped_ticks = 0
        self._queued_ticks = self._processed_ticks = 0
        self._session, self._twin, self._on_change = session, twin, on_change
        self._listeners: list[Callable[[TwinNews], None]] = []
        self._queue: queue.SimpleQueue[tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]] | None] = (
            queue.SimpleQueue()
        )
        self._thread: threading.Thread | None = None
        if not session.lockstep:
            self._thread = threading.Thread(target=self._process_queue, name="twin", daemon=True)
            self._thread.start()
        self._unsubscribe = session.subscribe_ticks(self._take_ticks)

    def listen(self, listener: Callable[[TwinNews], None]) -> None:
        """Register a callback for the twin's messages."""
        self._listeners.append(listener)

    def ghost_rad(self) -> tuple[float, float, float] | None:
        """Elevation, pitch and travel [rad] of the free run; None if there is none."""
        return self._twin.ghost_rad() if not self.trouble else None

    def words(self) -> str:
        """Return the twin's status in one line."""
        skipped_s = self.skipped_ticks * TICK_US * 1e-6
        slow = f"; {skipped_s:.0f} s of samples skipped, because this computer is slow" if skipped_s else ""
        return self.trouble or self._twin.words() + slow

    def close(self) -> None:
        """Process the ticks that have arrived, then end the twin's thread."""
        self._unsubscribe()
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(5.0)
            self._thread = None

    def _take_ticks(self, ticks: Ticks) -> None:
        """Pass ticks to the twin, in its thread if it has one; it skips some if it falls behind."""
        tick = self._session.ticks_counted_on(ticks)
        if self._thread is None:
            self._update_twin(tick, ticks.raw)
        else:
            if self._queued_ticks - self.skipped_ticks - self._processed_ticks > _MAX_BEHIND_TICKS:
                self._discard_waiting()
            self._queued_ticks += len(tick)
            self._queue.put((tick, ticks.raw))

    def _discard_waiting(self) -> None:
        """Discard the samples that wait, because the twin is too slow."""
        with contextlib.suppress(queue.Empty):
            while (batch := self._queue.get_nowait()) is not None:
                self.skipped_ticks += len(batch[0])
            # None is the request of `close` to end the thread; it must not be lost.
            self._queue.put(None)

    def _process_queue(self) -> None:
        while (batch := self._queue.get()) is not None:
            self._update_twin(*batch)
            self._processed_ticks += len(batch[0])

    def _update_twin(self, tick: npt.NDArray[np.int64], raw: npt.NDArray[np.int32]) -> None:
        """Update the twin, and pass its news on; its first alarm may end the flight."""
        if self.trouble:
            return
        try:
            messages = self._twin.update(tick, raw)
        except (ArithmeticError, ValueError, HeliError) as error:
            # A twin that fails must not end the flight that it watches.
            self.trouble = f"the twin failed and is switched off: {error}"
            messages = [TwinNews("failed", int(tick[-1]) if len(tick) else 0, self.trouble)]
        for news in messages:
            first = news.kind == ALARM and not self.alarm
            if first:
                self.alarm = news.text
            for listener in self._listeners:
                listener(news)
            if first and self._on_change is not None:
                self._on_change()
