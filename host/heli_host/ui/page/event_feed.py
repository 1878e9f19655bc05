"""News for the pages: the newest events, and the callback that forwards each piece of news."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from heli_host.link.clock import TICK_S
from heli_host.ui.page.source import News

_EVENTS_KEPT = 200


class EventFeed:
    """News of a `Cockpit` on its way to the pages. Its methods may be called from any thread.

    It owns the newest events, which a page that connects later gets as well.
    """

    def __init__(self) -> None:
        self._news: News | None = None
        self._events: list[dict[str, Any]] = []

    def listen(self, news: News) -> None:
        """Register the callback for news; see `heli_host.ui.page.source.Source.listen`."""
        self._news = news

    def tell(self, news: Mapping[str, Any]) -> None:
        """Send news to all pages."""
        if self._news is not None:
            self._news(news)

    def add(self, tick: int, kind: str, words: str) -> None:
        """Keep an event, and send it to all pages."""
        entry = {"t_s": round(tick * TICK_S, 3), "kind": kind, "text": words}
        self._events = [*self._events[1 - _EVENTS_KEPT :], entry]
        self.tell({"event": entry})

    def newest(self) -> list[dict[str, Any]]:
        """Return the newest events as JSON, oldest first."""
        return self._events[-_EVENTS_KEPT:]
