"""Watches whether the pilot's page answers, and explains by its absence why the board holds or lands."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from heli_host.ui.page.causes import cause, in_words, is_without_setpoints

if TYPE_CHECKING:
    from heli_host.ui.page.recording import Recording

_LOOK_S = 0.2
_SETTLED_LOOKS = 15
"""Number of successive checks at which the pilot's page must be present before plans begin. A page that still
loads may not answer for a second."""


class PilotWatch:
    """Presence of the pilot's page, and the cause of the board's last change of state.

    It owns the cause of the board's last change of state. The server's lease decides whether the page is
    present. The session asks the same callable before each setpoint: see
    `heli_host.link.session.Session.permit_streams`.
    """

    def __init__(self, recording: Recording) -> None:
        self.cause = ""
        self._recording = recording
        self._present: Callable[[], bool] = lambda: False
        self._absence: Callable[[], str] = lambda: ""
        self._last_absence = ""

    def watch(self, present: Callable[[], bool], absence: Callable[[], str]) -> None:
        """Register the conditions; see `heli_host.ui.page.source.Source.watch_pilot`.

        `present`: True while the pilot's page answers; it must not block.
        """
        self._present, self._absence = present, absence

    def wait_until_settled(self, give_up: Callable[[], bool]) -> bool:
        """Wait, in the caller's thread, until a pilot's page has answered for 3 s without a break."""
        looks = 0
        while looks < _SETTLED_LOOKS:
            if give_up():
                return False
            time.sleep(_LOOK_S)
            looks = looks + 1 if self._present() else 0
        return True

    def event_in_words(self, text: str) -> str:
        """Return the text of an event with its cause in words, and write an absent pilot into the log."""
        is_without = is_without_setpoints(text)
        absence = self._absence() if is_without else ""
        if absence and absence != self.cause:
            self._recording.write("pilot", absence)
        if is_without:
            self._last_absence = absence
        self.cause = cause(text, absence) or self.cause
        return in_words(text, absence)

    def outcome_in_words(self, outcome: str) -> str:
        """Return the outcome of a flight with its cause in words."""
        return in_words(outcome, self._last_absence)
