"""A source of a page without a board: it counts what reaches it, and blocks where a test wants."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from heli_host.ui.page.source import Action, CommandQueue, News, Role
from heli_host.ui.page.telemetry import TelemetryBuffer


class Desk:
    """Source of a page.

    While `status_may_return` is cleared, `status` does not return, and with it the event loop that serves all
    clients. While `action_may_return` is cleared, no request is answered.
    """

    def __init__(self) -> None:
        self.buffer = TelemetryBuffer(100)
        self.actions: Mapping[str, Action] = {"count": Action(self._count, CommandQueue.QUICK, Role.OBSERVER)}
        self.stops = self.counted = 0
        self.status_may_return = threading.Event()
        self.status_may_return.set()
        self.status_is_called = threading.Event()
        self.action_may_return = threading.Event()
        self.action_may_return.set()

    def _count(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        self.action_may_return.wait()
        self.counted += 1
        return {}

    def describe(self) -> dict[str, Any]:
        return {"states": {"0": {"name": "idle"}}}

    def status(self) -> dict[str, Any]:
        self.status_is_called.set()
        self.status_may_return.wait()
        return {"state": 0}

    def state(self) -> tuple[int, int]:
        return 0, 0

    def listen(self, news: News) -> None:
        pass

    def stop(self) -> None:
        self.stops += 1

    def stop_epoch(self) -> int:
        return self.stops

    def clear_stop(self, epoch: int) -> bool:
        return epoch == self.stops

    def watch_pilot(self, present: Callable[[], bool], absence: Callable[[], str] = lambda: "") -> None:
        pass
