"""A log as the source of a page: replayed at any speed from any moment."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from heli_host.declaration import Channel
from heli_host.errors import TruncatedLog
from heli_host.link.clock import TICK_S
from heli_host.ui.page.source import (
    KEPT_S,
    REPLAY_WORDS,
    Action,
    BoardState,
    CommandQueue,
    News,
    Role,
    channel_rows,
    fault_rows,
    in_words,
    number,
    state_rows,
)
from heli_host.ui.page.telemetry import TelemetryBuffer

if TYPE_CHECKING:
    from heli_host.data.log.reader import Log

_STEP_S = 0.02
_MAX_SPEED = 50.0
_MAX_EVENTS = 1000
"""Events that the page lists, the newest ones: it gets them in one message."""
_BEFORE_S = 60.0
"""Length of the history that is shown before the moment of a seek [s]."""


class Replay:
    """A log as the source of a page."""

    def __init__(self, log: Log, rig: Mapping[str, float]) -> None:
        if not len(log.ticks):
            raise TruncatedLog(
                f"{log.path} holds no ticks",
                "record again: the board sent nothing, or the host stopped immediately",
            )
        self.buffer = TelemetryBuffer(round(KEPT_S / TICK_S))
        self._log, self._rig = log, dict(rig)
        self._raw = log.raw
        # The time of the log continues over restarts of the board and over 2^32 ticks.
        self._tick = np.rint(log.ticks["t_s"] / TICK_S).astype(np.int64)
        self._position = 0
        self._speed, self._playing = 1.0, True
        self._ended = threading.Event()
        self._lock = threading.Lock()
        pilot = Role.PILOT
        self.actions: Mapping[str, Action] = {
            "play": Action(self._set_playing, CommandQueue.QUICK, pilot),
            "seek": Action(self._continue_at, CommandQueue.QUICK, pilot),
        }

    def describe(self) -> dict[str, Any]:
        """Return the constant facts that each client gets once; see `Source.describe`."""
        session = self._log.metadata.get("session", {})
        return {
            "mode": "replay",
            "kind": "replay",
            "rig_name": session.get("rig", ""),
            "board": f"{self._log.path.name}: {session.get('board', 'a board')}{_start_text(session)}",
            "rig": self._rig,
            "tick_s": TICK_S,
            "channels": channel_rows(self._log.parameters, self._log.law_signals),
            "states": state_rows(REPLAY_WORDS),
            "faults": fault_rows(),
            "parameters": [],
            "values": self._log.parameters,
            "undo": 0,
            "limits_deg": {},
            "plans": [],
            "span_s": [float(self._tick[0]) * TICK_S, float(self._tick[-1]) * TICK_S],
            "events": [
                {
                    "t_s": round(float(event["t_s"]), 3),
                    "kind": str(event["name"]),
                    "text": in_words(str(event["message"])),
                }
                for event in self._log.events[-_MAX_EVENTS:]
            ],
        }

    def status(self) -> dict[str, Any]:
        """Return the present status of the replay as JSON; see `Source.status`."""
        row = max(self._position - 1, 0)
        state, fault = self.state()
        return {
            "state": state,
            "fault": fault,
            "connected": True,
            "link": {"ticks": self._position, "lost_ticks": self._log.ticks_lost},
            "recording": None,
            "trouble": "; ".join(self._log.notes),
            "doing": "",
            "flight": None,
            "at_s": round(float(self._tick[row]) * TICK_S, 2),
            "playing": self._playing,
            "speed": self._speed,
        }

    def state(self) -> BoardState:
        """Return the numbers of state and fault in the log at the moment that is shown."""
        row = max(self._position - 1, 0)
        return BoardState(int(self._raw[row, Channel.STATE]), int(self._raw[row, Channel.FAULT]))

    def listen(self, news: News) -> None:
        """Ignore the callback: a replay has only the events in its description."""

    def stop(self) -> None:
        """Pause the replay; no motors are involved."""
        self._playing = False

    def stop_epoch(self) -> int:
        """Return 0: a stop blocks no later request of a replay."""
        return 0

    def clear_stop(self, epoch: int) -> bool:
        """Permit every request: a replay moves no motors."""
        return epoch == 0

    def watch_pilot(self, present: Callable[[], bool], absence: Callable[[], str] = lambda: "") -> None:
        """Ignore the pilot's presence: a replay sends no setpoints."""

    def run(self) -> None:
        """Replay the log in the caller's thread until another thread calls `close`."""
        before_s, due_ticks = time.monotonic(), 0.0
        while not self._ended.wait(_STEP_S):
            now_s = time.monotonic()
            if self._playing:
                due_ticks += (now_s - before_s) * self._speed / TICK_S
            before_s = now_s
            whole_ticks = int(due_ticks)
            due_ticks -= whole_ticks
            with self._lock:
                self._advance(whole_ticks)

    def close(self) -> None:
        """End `run`."""
        self._ended.set()

    def _advance(self, ticks: int) -> None:
        """Pass the next `ticks` of the log to the page."""
        if not ticks or self._position >= len(self._tick):
            return
        until = int(np.searchsorted(self._tick, self._tick[max(self._position - 1, 0)] + ticks, side="right"))
        until = max(until, self._position + 1)
        self.buffer.append(self._tick[self._position : until], self._raw[self._position : until])
        self._position = min(until, len(self._tick))
        if self._position >= len(self._tick):
            self._playing = False

    def _set_playing(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``play``: start, pause or change the speed; at the end, start again."""
        if "speed" in arguments:
            self._speed = min(max(number(arguments, "speed"), 0.1), _MAX_SPEED)
        self._playing = bool(arguments.get("on", True))
        if self._playing and self._position >= len(self._tick):
            self._continue_at({"t_s": float(self._tick[0]) * TICK_S})
        return {}

    def _continue_at(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``seek``: continue at another time of the log, with some seconds before it."""
        first_s, last_s = float(self._tick[0]) * TICK_S, float(self._tick[-1]) * TICK_S
        # A client may ask for any finite time; one far outside the log would not fit into a tick.
        tick = round(min(max(number(arguments, "t_s"), first_s - 1.0), last_s + 1.0) / TICK_S)
        with self._lock:
            self._position = int(np.clip(np.searchsorted(self._tick, tick), 0, len(self._tick)))
            first = int(np.searchsorted(self._tick, tick - round(_BEFORE_S / TICK_S)))
            self.buffer.clear()
            self.buffer.append(self._tick[first : self._position], self._raw[first : self._position])
        return {}


def _start_text(session: Mapping[str, Any]) -> str:
    """Return when the log begins, such as ", 2026-01-31 12:00 UTC"; empty for a log without a valid time."""
    try:
        start = datetime.fromisoformat(str(session.get("start", "")))
    except ValueError:
        return ""
    return f", {start.astimezone(UTC):%Y-%m-%d %H:%M} UTC"
