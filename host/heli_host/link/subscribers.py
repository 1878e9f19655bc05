"""Who is told what a session receives, and what happens when one of them fails."""

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
    """The callbacks of a session.

    Attributes
    ----------
    on_ticks, on_event, on_status : tuple of callable
        Who is told; replaced as a whole, so that a delivery under way is not disturbed.
    events : deque of LinkEvent
        The last thousand.
    error : HeliError or None
        What the first failed callback raised, until somebody is told.
    """

    def __init__(self) -> None:
        self.on_ticks: tuple[TicksCallback, ...] = ()
        self.on_event: tuple[EventCallback, ...] = ()
        self.on_status: tuple[StatusCallback, ...] = ()
        self.events: deque[LinkEvent] = deque(maxlen=_EVENTS_KEPT)
        self.error: HeliError | None = None

    def remove(self, callback: object) -> None:
        """Tell somebody no more.

        Parameters
        ----------
        callback : object
            As it was added.
        """
        self.on_ticks = tuple(one for one in self.on_ticks if one is not callback)
        self.on_event = tuple(one for one in self.on_event if one is not callback)
        self.on_status = tuple(one for one in self.on_status if one is not callback)

    def deliver(self, ticks: Ticks, events: list[LinkEvent], statuses: list[StatusMessage]) -> None:
        """Tell everybody.

        Parameters
        ----------
        ticks : Ticks
            New samples; may be empty.
        statuses : list of StatusMessage
            New counters of the board.
        """
        if len(ticks):
            for on_ticks in self.on_ticks:
                self._call(on_ticks, ticks)
        for event in events:
            self.events.append(event)
            for on_event in self.on_event:
                self._call(on_event, event)
        for status in statuses:
            for on_status in self.on_status:
                self._call(on_status, status)

    def take_error(self) -> HeliError | None:
        """Return what a callback raised, once.

        Returns
        -------
        HeliError or None
            None when all went well, or somebody was told before.
        """
        error, self.error = self.error, None
        return error

    def _call(self, callback: Callable[[_T], None], value: _T) -> None:
        try:
            callback(value)
        # Whatever a user's function raises, the link must live on: it keeps the arm in the air.
        except Exception as error:  # noqa: BLE001
            self.remove(callback)
            if isinstance(error, HeliError):
                failed = error
            else:
                failed = HeliError(
                    f"a callback failed: {type(error).__name__}: {error}", "mend it; it is called no more"
                )
                failed.__cause__ = error
            if self.error is None:
                self.error = failed
            newest = self.events[-1] if self.events else None
            tick, wall_ns = (newest.tick, newest.wall_ns) if newest is not None else (0, 0)
            self.events.append(LinkEvent(tick, wall_ns, CALLBACK_FAILED, str(failed)))
