"""The log that a page's board writes at present, and the lines that the host adds to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from heli_host.ui.page.source import number, text

if TYPE_CHECKING:
    from heli_host.fly.plan import Plan
    from heli_host.fly.recorder import Recorder
    from heli_host.link.session import Session
    from heli_host.ui.page.event_feed import EventFeed


class Recording:
    """The recorder of a `Cockpit`, while there is one. Its methods may be called from any thread.

    It owns the recorder from `begin` to `close`. Nothing here moves the rig or stops it.
    """

    def __init__(
        self, session: Session, new_recorder: Callable[[Sequence[Plan], float], Recorder], feed: EventFeed
    ) -> None:
        self._session = session
        self._new_recorder = new_recorder
        self._feed = feed
        self._recorder: Recorder | None = None
        self._marks = 0

    @property
    def recorder(self) -> Recorder | None:
        """The present recorder; None while nothing is recorded."""
        return self._recorder

    def status(self) -> dict[str, Any]:
        """Return the path of the log and the error of the recorder, as JSON."""
        recorder = self._recorder
        return {
            "recording": str(recorder.path) if recorder is not None else None,
            "trouble": str(recorder.error) if recorder is not None and recorder.error is not None else "",
        }

    def begin(self, plans: Sequence[Plan], duration_s: float) -> None:
        """Create a log file and begin to record."""
        self._recorder = self._new_recorder(plans, duration_s)
        self._feed.tell({"recording": str(self._recorder.path)})

    def close(self, outcome: str = "recorded") -> None:
        """End the recording, if there is one, and write the log to its end. The motors are not touched."""
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close(outcome)
            self._feed.tell({"recorded": str(recorder.path)})

    def write(self, kind: str, words: str) -> None:
        """Write a line of the host's own into the log, if there is one."""
        recorder = self._recorder
        if recorder is not None:
            recorder.note(kind, words)

    def announce(self, kind: str, words: str) -> None:
        """Write a line into the log, and show it on all pages as an event."""
        self.write(kind, words)
        self._feed.add(self._newest_tick(), kind, words)

    def mark(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``mark``: a line of a person's own, numbered if it has no text."""
        self._marks += 1
        words = text(arguments, "text") if arguments.get("text") else f"mark {self._marks}"
        self.announce("mark", words)
        return {"logged": self._recorder is not None}

    def signal(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``signal``: a number of another program, for the log and for a strip on each
        page.
        """
        name, value = text(arguments, "name", 40), number(arguments, "value")
        tick = self._newest_tick()
        self.write("signal", f"{name} = {value!r}")
        self._feed.tell({"signal": {"name": name, "value": value, "tick": tick}})
        return {}

    def _newest_tick(self) -> int:
        newest = self._session.latest
        return newest[0] if newest is not None else 0
