"""A connected board as the source of a page: the way of a stop, the table of requests, and the status."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from heli_host.board.twins import EVENT
from heli_host.declaration import Channel
from heli_host.errors import ParameterError
from heli_host.fly.plan import Plan
from heli_host.link.clock import TICK_S
from heli_host.link.events import BOARD_RESTARTED, LAW_SIGNAL_NAMES, LinkEvent
from heli_host.link.transport import transport_label, transport_rig
from heli_host.ui.page.actions import (
    EventFeed,
    FlightRequests,
    LawChoice,
    ParameterEdits,
    PilotWatch,
    Recording,
)
from heli_host.ui.page.source import (
    KEPT_S,
    UNKNOWN,
    Action,
    BoardState,
    CommandQueue,
    News,
    Role,
    channel_rows,
    fault_rows,
    number,
    parameter_rows,
    state_rows,
    text,
)
from heli_host.ui.page.telemetry import TelemetryBuffer

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.board.law_program import LawProgram
    from heli_host.board.twins import TwinNews, TwinWatch
    from heli_host.fly.recorder import Recorder
    from heli_host.link.session import Session
    from heli_host.link.telemetry import Ticks

_MAX_SAMPLE_AGE_S = 0.5
"""Largest age of the newest tick at which its state counts as the present state [s].

It equals `clients.PRESENT_S`. With a shorter time, a busy computer would make the state
unknown; with a longer one, a page might show "idle" although the board has begun to fly."""


class Cockpit:
    """A connected board as the source of a page."""

    # A stop goes straight from `stop` to the session, in the thread of the caller, and waits for no request.
    # All other requests run in the thread of their `CommandQueue`, after `clear_stop` has accepted them.
    # Samples and events arrive in the session's reading thread. `describe`, `status` and `state` may be
    # called from any thread.

    def __init__(
        self,
        heli: Heli,
        new_recorder: Callable[[Sequence[Plan], float], Recorder],
        plans: Sequence[Plan],
        board: str,
        rig: Mapping[str, float],
        twin: TwinWatch | None = None,
        laws: Sequence[LawProgram] = (),
        rig_name: str = "",
    ) -> None:
        self.buffer = TelemetryBuffer(round(KEPT_S / TICK_S))
        self._heli = heli
        self._session = heli.session
        self._board, self._rig, self._rig_name = board, dict(rig), rig_name
        self._feed = EventFeed()
        self._recording = Recording(heli.session, new_recorder, self._feed)
        self._pilot = PilotWatch(self._recording)
        self._law = LawChoice(heli, laws)
        self._flight = FlightRequests(heli, plans, self._law, self._recording, self._pilot)
        self._parameters = ParameterEdits(heli, self._recording, self._send_parameters)
        self._signals: dict[str, str] = {}
        self._last_sample_s = -math.inf
        flight, parameters = self._flight, self._parameters
        observer, pilot, tuner = Role.OBSERVER, Role.PILOT, Role.TUNER
        self.actions: Mapping[str, Action] = {
            "take_off": Action(flight.take_off, CommandQueue.FLIGHT, pilot),
            "fly": Action(flight.fly, CommandQueue.FLIGHT, pilot),
            "land": Action(flight.land, CommandQueue.QUICK, pilot),
            "clear_fault": Action(flight.clear_fault, CommandQueue.QUICK, pilot),
            "zero": Action(flight.zero, CommandQueue.QUICK, pilot),
            "setpoint": Action(flight.setpoint, CommandQueue.SETPOINT, pilot),
            "hold": Action(flight.hold, CommandQueue.SETPOINT, pilot),
            "set": Action(parameters.set, CommandQueue.QUICK, tuner),
            "undo": Action(parameters.undo_last, CommandQueue.QUICK, tuner),
            "save": Action(parameters.save, CommandQueue.QUICK, tuner),
            "law": Action(self._choose_law, CommandQueue.QUICK, pilot),
            "set_law": Action(self._set_law, CommandQueue.QUICK, tuner),
            "record": Action(self._set_recording, CommandQueue.QUICK, pilot),
            "mark": Action(self._recording.mark, CommandQueue.QUICK, observer),
            "signal": Action(self._recording.signal, CommandQueue.QUICK, observer),
        }
        self._twin = twin
        if twin is not None:
            twin.listen(self._note_twin_news)
        heli.session.subscribe_ticks(self._take_ticks)
        heli.session.subscribe_events(self._take_event)

    def describe(self) -> dict[str, Any]:
        """Return the constant facts that each client gets once; see `Source.describe`."""
        values = self._parameters.values
        return {
            "mode": "live",
            "kind": "simulation" if is_simulated(self._heli) else "real",
            "rig_name": self._rig_name,
            "board": self._board,
            "rig": self._rig,
            "tick_s": TICK_S,
            "channels": channel_rows(values, self._signals),
            "states": state_rows(),
            "faults": fault_rows(),
            "parameters": parameter_rows(),
            "values": values,
            "undo": self._parameters.undoable,
            "limits_deg": self._heli.setpoint_limits_deg(),
            "plans": [{"name": plan.name, "title": plan.title} for plan in self._flight.plans.values()],
            "laws": self._law.describe(),
            "events": self._feed.newest(),
        }

    def status(self) -> dict[str, Any]:
        """Return the present status as JSON; see `Source.status`."""
        newest = self._session.latest
        return {
            "state": int(newest.raw[Channel.STATE]) if newest is not None else -1,
            "fault": int(newest.raw[Channel.FAULT]) if newest is not None else 0,
            "cause": self._pilot.cause,
            "connected": self._session.connected,
            "link": _link_status(self._session),
            **self._recording.status(),
            "doing": self._flight.doing,
            "flight": self._flight.progress,
            "twin": self._twin_status(),
            "law": self._law.status(),
        }

    def state(self) -> BoardState:
        """Return the numbers of state and fault in the newest tick; `UNKNOWN` if that is older than 0.5 s."""
        newest = self._session.latest
        if newest is None or time.monotonic() - self._last_sample_s > _MAX_SAMPLE_AGE_S:
            return UNKNOWN
        return BoardState(int(newest.raw[Channel.STATE]), int(newest.raw[Channel.FAULT]))

    def listen(self, news: News) -> None:
        """Register the callback for events; see `Source.listen`."""
        self._feed.listen(news)

    def stop(self) -> None:
        """Switch both motors off, ahead of all other commands; see `Source.stop`."""
        self._session.stop_now()

    def stop_epoch(self) -> int:
        """Return the number of stops so far; see `Source.stop_epoch`."""
        return self._session.stops

    def clear_stop(self, epoch: int) -> bool:
        """Accept commands again after a stop, if no further stop came since `epoch`; see
        `Source.clear_stop`.
        """
        return self._session.release_stop(epoch)

    def watch_pilot(self, present: Callable[[], bool], absence: Callable[[], str] = lambda: "") -> None:
        """Send setpoints and voltages only while the pilot's page answers; see `Source.watch_pilot`."""
        # `present`: True while the pilot's page answers; it must not block.
        self._pilot.watch(present, absence)
        self._session.permit_streams(present)

    def fly_when_watched(self, names: Sequence[str], give_up: Callable[[], bool]) -> Mapping[str, Any]:
        """Wait until a pilot's page has answered for 3 s, then fly plans and return after the landing.

        Runs in the caller's thread. A stop before the take-off ends the call without a flight.
        """
        if not self._pilot.wait_until_settled(give_up) or not self.clear_stop(self.stop_epoch()):
            return {}
        return self._flight.fly({"plans": list(names)})

    def close(self, outcome: str = "recorded") -> None:
        """End the recording, if there is one, and write the log to its end. The motors are not touched."""
        self._recording.close(outcome)

    def _choose_law(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        return self._law.choose(text(arguments, "name") if arguments.get("name") else "")

    def _set_law(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``set_law``: change a parameter of the chosen control law."""
        name = text(arguments, "name")
        before, after = self._law.set(name, number(arguments, "value"))
        self._recording.announce("parameter", f"{self._law.chosen} {name}: {before:g} -> {after:g}")
        return {"value": after}

    def _set_recording(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``record``: begin or end a recording."""
        if arguments.get("on"):
            if self._recording.recorder is None:
                self._recording.begin((), 0.0)
        elif self._flight.flies_plan:
            raise ParameterError("a plan flies now, and is always recorded", "land first")
        else:
            self._recording.close()
        return {}

    def _twin_status(self) -> dict[str, Any] | None:
        """Return the twin's status for the page, with the predicted angles [rad]; None without a twin."""
        if self._twin is None:
            return None
        ghost = self._twin.ghost_rad()
        return {
            "words": self._twin.words(),
            "alarm": bool(self._twin.alarm),
            "ghost_rad": [round(angle, 4) for angle in ghost] if ghost is not None else None,
        }

    def _note_twin_news(self, news: TwinNews) -> None:
        self._recording.write(EVENT, news.text)
        self._feed.add(news.tick, EVENT, news.text)

    def _take_ticks(self, ticks: Ticks) -> None:
        self._last_sample_s = time.monotonic()
        self.buffer.append(self._session.ticks_counted_on(ticks), ticks.raw)

    def _take_event(self, event: LinkEvent) -> None:
        """Pass an event of the link to the page. A restart of the board clears the telemetry."""
        if event.kind == BOARD_RESTARTED:
            self.buffer.clear()
        self._law.take_event(event)
        self._feed.add(event.tick, event.kind, self._pilot.event_in_words(event.text))
        if event.kind == LAW_SIGNAL_NAMES:
            self._signals = {f"signal_{number}": name for number, name in enumerate(event.names, 1)}
            self._feed.tell({"channels": channel_rows(self._parameters.values, self._signals)})

    def _send_parameters(self) -> None:
        """Send the parameters to all clients, with what depends on them: limits and units of channels."""
        values = self._parameters.values
        self._feed.tell(
            {
                "values": values,
                "undo": self._parameters.undoable,
                "limits_deg": self._heli.setpoint_limits_deg(),
                "channels": channel_rows(values, self._signals),
            }
        )


def _link_status(session: Session) -> dict[str, Any]:
    """Return counters, latency and jitter of the link [ms] for the page."""
    counters, clock = session.counters, session.clock
    return {
        "frames": counters.frames_ok,
        "bad": counters.frames_bad,
        "lost_ticks": counters.ticks_lost,
        "ticks": counters.ticks_received,
        "retries": counters.retries,
        "reconnects": counters.reconnects,
        "latency_ms": round(clock.round_trip_s * 1e3, 1) if clock is not None else None,
        "jitter_ms": round(clock.jitter_s * 1e3, 1) if clock is not None else None,
    }


def is_simulated(heli: Heli) -> bool:
    """Return whether a board is simulated: its transport names a rig or an emulated board, or its firmware
    runs on a computer.
    """
    transport = heli.session.transport
    return bool(transport_rig(transport) or transport_label(transport)) or heli.info.board == "native"
