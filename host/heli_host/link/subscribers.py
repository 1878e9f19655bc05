"""The callbacks to which a session delivers samples, events and status, and the errors of these callbacks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeVar

from heli_host.declaration import StatusMessage
from heli_host.errors import HeliError
from heli_host.link.events import CALLBACK_FAILED, LinkEvent
from heli_host.link.telemetry import Ticks

TicksCallback = Callable[[Ticks], None]
EventCallback = Callable[[LinkEvent], None]
StatusCallback = Callable[[StatusMessage], None]
Unsubscribe = Callable[[], None]

_EVENTS_KEPT = 1000

_T = TypeVar("_T")


class Subscribers:
    """The callbacks of a session."""

    def __init__(self) -> None:
        self.on_ticks: tuple[TicksCallback, ...] = ()
        self.on_event: tuple[EventCallback, ...] = ()
        self.on_status: tuple[StatusCallback, ...] = ()
        self.events: deque[LinkEvent] = deque(maxlen=_EVENTS_KEPT)
        self.error: HeliError | None = None

    def remove(self, callback: object) -> None:
        """Cancel all subscriptions of `callback`."""
        self.on_ticks = tuple(each for each in self.on_ticks if each is not callback)
        self.on_event = tuple(each for each in self.on_event if each is not callback)
        self.on_status = tuple(each for each in self.on_status if each is not callback)

    def deliver(self, ticks: Ticks, events: list[LinkEvent], statuses: list[StatusMessage]) -> None:
        """Call the callbacks, in the caller's thread. One that raises is removed; the others still run."""
        if len(ticks):
            for on_ticks in self.on_ticks:
                self._call_safely(on_ticks, ticks)
        for event in events:
            self.events.append(event)
            for on_event in self.on_event:
                self._call_safely(on_event, event)
        for status in statuses:
            for on_status in self.on_status:
                self._call_safely(on_status, status)

    def take_error(self) -> HeliError | None:
        """Return and clear the error of the first callback that failed; None if there is none."""
        error, self.error = self.error, None
        return error

    def _call_safely(self, callback: Callable[[_T], None], value: _T) -> None:
        """Call a subscriber; one that raises is removed, and its error becomes an event of the link."""
        try:
            callback(value)
        # The link must survive any error of a user's function, because it keeps the arm in the air.
        except Exception as error:  # noqa: BLE001
            self.remove(callback)
            if isinstance(error, HeliError):
                failed = error
            else:
                failed = HeliError(
                    f"a callback failed: {type(error).__name__}: {error}", "fix it; it is not called again"
                )
                failed.__cause__ = error
            if self.error is None:
                self.error = failed
            newest = self.events[-1] if self.events else None
            tick, wall_ns = (newest.tick, newest.wall_ns) if newest is not None else (0, 0)
            self.events.append(LinkEvent(tick, wall_ns, CALLBACK_FAILED, str(failed)))
