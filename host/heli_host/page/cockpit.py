"""A connected board as the source of a page: it runs clients' requests and reports telemetry and events."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from heli_host.declaration import Axes, Channel, State
from heli_host.errors import HeliError, LinkError, ParameterError, SetpointError
from heli_host.fly.plan import Plan
from heli_host.link.clock import TICK_S
from heli_host.link.events import BOARD_RESTARTED, LAW_SIGNALS, LinkEvent
from heli_host.link.transport import transport_label, transport_rig
from heli_host.page.causes import cause, in_words, is_without_setpoints
from heli_host.page.flying import PlanFlight
from heli_host.page.law_choice import LawChoice
from heli_host.page.source import (
    KEPT_S,
    UNKNOWN,
    Action,
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
from heli_host.page.telemetry_buffer import TelemetryBuffer
from heli_host.twins import EVENT

if TYPE_CHECKING:
    from heli_host.fly.recorder import Recorder
    from heli_host.heli import Heli
    from heli_host.law_program import LawProgram
    from heli_host.link.telemetry import Ticks
    from heli_host.twins import TwinNews, TwinWatch

_LOOK_S = 0.2
_SETTLED_LOOKS = 15
"""Looks at a page that is there each time before plans begin: one that still loads is busy for a second,
which is a missing pilot."""
_HEARD_S = 0.5
"""Greatest age of the newest tick at which its state counts as the present state [s]. It equals
`heli_host.page.control_lease.PRESENT_S`. Shorter: a busy computer makes the state unknown. Longer: a page
shows a board as idle that may have begun to fly."""
_EVENTS_KEPT = 200
_MAX_UNDO = 100


class Cockpit:
    """A connected board as the source of a page.

    Parameters
    ----------
    heli : Heli
        Connected, with ``keep_alive`` on. Its owner switches the motors off at the end; `close` does not.
    new_recorder : callable taking (plans, duration_s), returning Recorder
        Creates a new log file and begins to record.
    plans : sequence of Plan
        Plans that clients may fly.
    board : str
        Description of the board, for the page's title.
    rig : Mapping of str to float
        Lengths [m] and masses [kg] of the rig by name; empty if they are unknown.
    twin : TwinWatch, optional
        Twin that compares the flight with a model.
    laws : sequence of LawProgram
        Control laws that clients may choose instead of the board's own.
    rig_name : str
        Name of the rig, for the page's badge; empty if it is unknown.

    Attributes
    ----------
    buffer : TelemetryBuffer
        Telemetry of the newest `KEPT_S` seconds; written by the session's reading thread.
    actions : mapping of str to Action
        Requests that clients may send, by name.
    """

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
        self._new_recorder = new_recorder
        self._plans = {plan.name: plan for plan in plans}
        self._board, self._rig, self._rig_name = board, dict(rig), rig_name
        self._law = LawChoice(heli, laws)
        self._news: News | None = None
        self._events: list[dict[str, Any]] = []
        self._signals: dict[str, str] = {}
        self._recorder: Recorder | None = None
        self._flight: PlanFlight | None = None
        self._doing = ""
        self._marks = 0
        self._heard_s = -math.inf
        self._present: Callable[[], bool] = lambda: False
        self._absence: Callable[[], str] = lambda: ""
        self._cause = ""
        self._last_absence = ""
        self._undo: list[tuple[str, float]] = []
        self._values = dict(heli.params)
        anybody, pilot, tuner = Role.OBSERVER, Role.PILOT, Role.TUNER
        self.actions: Mapping[str, Action] = {
            "take_off": Action(self._take_off, CommandQueue.FLIGHT, pilot),
            "fly": Action(self._fly, CommandQueue.FLIGHT, pilot),
            "land": Action(self._land, CommandQueue.QUICK, pilot),
            "clear_fault": Action(self._clear_fault, CommandQueue.QUICK, pilot),
            "zero": Action(self._zero, CommandQueue.QUICK, pilot),
            "setpoint": Action(self._setpoint, CommandQueue.SETPOINT, pilot),
            "hold": Action(self._hold, CommandQueue.SETPOINT, pilot),
            "set": Action(self._set, CommandQueue.QUICK, tuner),
            "undo": Action(self._undo_last, CommandQueue.QUICK, tuner),
            "save": Action(self._save, CommandQueue.QUICK, tuner),
            "law": Action(self._choose_law, CommandQueue.QUICK, pilot),
            "set_law": Action(self._set_law, CommandQueue.QUICK, tuner),
            "record": Action(self._record, CommandQueue.QUICK, pilot),
            "mark": Action(self._mark, CommandQueue.QUICK, anybody),
            "signal": Action(self._signal, CommandQueue.QUICK, anybody),
        }
        self._twin = twin
        if twin is not None:
            twin.listen(self._hear_twin)
        heli.session.subscribe_ticks(self._take_ticks)
        heli.session.subscribe_events(self._take_event)

    def describe(self) -> dict[str, Any]:
        """Return the constant facts that each client gets once; see `Source.describe`."""
        values = self._values
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
            "undo": len(self._undo),
            "limits_deg": self._heli.setpoint_limits_deg(),
            "plans": [{"name": plan.name, "title": plan.title} for plan in self._plans.values()],
            "laws": self._law.describe(),
            "events": self._events[-_EVENTS_KEPT:],
        }

    def status(self) -> dict[str, Any]:
        """Return the present status as JSON; see `Source.status`."""
        session = self._session
        newest, counters, clock = session.latest, session.counters, session.clock
        recorder, flight = self._recorder, self._flight
        state = int(newest[1][Channel.STATE]) if newest is not None else -1
        fault = int(newest[1][Channel.FAULT]) if newest is not None else 0
        return {
            "state": state,
            "fault": fault,
            "cause": self._cause,
            "connected": session.connected,
            "link": {
                "frames": counters.frames_ok,
                "bad": counters.frames_bad,
                "lost_ticks": counters.ticks_lost,
                "ticks": counters.ticks_received,
                "retries": counters.retries,
                "reconnects": counters.reconnects,
                "latency_ms": round(clock.round_trip_s * 1e3, 1) if clock is not None else None,
                "jitter_ms": round(clock.jitter_s * 1e3, 1) if clock is not None else None,
            },
            "recording": str(recorder.path) if recorder is not None else None,
            "trouble": str(recorder.error) if recorder is not None and recorder.error is not None else "",
            "doing": self._doing,
            "flight": flight.progress if flight is not None else None,
            "twin": self._twin_status(),
            "law": self._law.status(),
        }

    def state(self) -> tuple[int, int]:
        """Return the numbers of state and fault in the newest tick; `UNKNOWN` if that is older than 0.5 s."""
        newest = self._session.latest
        if newest is None or time.monotonic() - self._heard_s > _HEARD_S:
            return UNKNOWN
        return int(newest[1][Channel.STATE]), int(newest[1][Channel.FAULT])

    def listen(self, news: News) -> None:
        """Register the callback for events; see `Source.listen`.

        Parameters
        ----------
        news : callable taking a mapping
            Called with each event as JSON, from any thread.
        """
        self._news = news

    def stop(self) -> None:
        """Switch both motors off, ahead of all other commands; see `Source.stop`."""
        self._session.stop_now()

    def stop_epoch(self) -> int:
        """Return the number of stops so far; see `Source.stop_epoch`."""
        return self._session.stops

    def clear_stop(self, epoch: int) -> bool:
        """Accept commands again after a stop, if no further stop came since `epoch`; see `Source.clear_stop`.

        Parameters
        ----------
        epoch : int
            Value of `stop_epoch` when the request arrived.
        """
        return self._session.release_stop(epoch)

    def watch_pilot(self, present: Callable[[], bool], absence: Callable[[], str] = lambda: "") -> None:
        """Send setpoints and voltages only while the pilot's page answers; see `Source.watch_pilot`.

        Parameters
        ----------
        present : callable returning bool
            True while the pilot's page answers; it must not block.
        absence : callable returning str
            Why the pilot's page is absent, in words; empty while it is present.
        """
        self._present, self._absence = present, absence
        self._session.permit_streams(present)

    def fly_when_watched(self, names: Sequence[str], give_up: Callable[[], bool]) -> Mapping[str, Any]:
        """Wait until a pilot's page has answered for 3 s, then fly plans and return after the landing.

        Runs in the caller's thread. A stop before the take-off ends the call without a flight.

        Parameters
        ----------
        names : sequence of str
            Names of the plans, in the order of the flight.
        give_up : callable returning bool
            Asked five times per second while no pilot is present; True ends the call without a flight.

        Returns
        -------
        mapping
            ``outcome`` of the flight; empty without a flight.

        Raises
        ------
        HeliError
            A plan is unknown or cannot be flown on this board.
        """
        seen = 0
        while seen < _SETTLED_LOOKS:
            if give_up():
                return {}
            time.sleep(_LOOK_S)
            seen = seen + 1 if self._present() else 0
        if not self.clear_stop(self.stop_epoch()):
            return {}
        return self._fly({"plans": list(names)})

    def close(self, outcome: str = "recorded") -> None:
        """End the recording, if there is one, and write the log to its end. The motors are not touched.

        Parameters
        ----------
        outcome : str
            Outcome of the flight, for the log.
        """
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close(outcome)
            self._tell({"recorded": str(recorder.path)})

    def _take_off(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        elevation_deg = number(arguments, "elevation_deg") if "elevation_deg" in arguments else 0.0
        with self._busy("taking off"):
            self._heli.take_off(elevation_deg)
            self._law.engage()
        return {}

    def _fly(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        asked = arguments.get("plans")
        names = [str(name) for name in (asked if isinstance(asked, list) else [asked])]
        if not names:
            raise ParameterError("no plan is named", f"choose from {', '.join(self._plans)}")
        for name in names:
            if name not in self._plans:
                known = ", ".join(self._plans)
                raise ParameterError(f"unknown plan {name:.40}", f"choose from {known}")
        if self._heli.state is not State.IDLE:
            raise SetpointError("a plan starts only from the table, with the motors off", "land first")
        plans = [self._plans[name] for name in names]
        flight = PlanFlight(self._heli, plans, self._law.engage)
        own = self._recorder is None
        if own:
            self._begin_recording(plans, flight.duration_s)
        recorder = self._recorder
        if recorder is None:
            raise LinkError("the recording ended before the plan started", "start it again")
        self._flight = flight
        try:
            with self._busy(f"flying {', '.join(names)}"):
                outcome = flight.fly(recorder)
        finally:
            self._flight = None
            if own:
                self.close(flight.outcome)
        return {"outcome": in_words(outcome, self._last_absence)}

    def _land(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        self._heli.land(wait=False)
        return {}

    def _clear_fault(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        self._heli.clear_fault()
        return {}

    def _zero(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        self._heli.zero(Axes.ELEVATION | Axes.PITCH | Axes.TRAVEL)
        return {}

    def _setpoint(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        if self._flight is not None:
            raise SetpointError("a plan flies now, and controls the setpoints", "end it with Land")
        axes = ("elevation_deg", "travel_deg")
        self._heli.setpoint(**{name: number(arguments, name) for name in axes if name in arguments})
        return {}

    def _hold(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        if self._flight is not None:
            raise SetpointError("a plan flies now, and controls the setpoints", "end it with Land")
        self._heli.hold()
        return {}

    def _set(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        name = text(arguments, "name")
        before = self._heli.params[name]
        self._heli.params.set(name, number(arguments, "value"))
        self._undo = [*self._undo, (name, before)][-_MAX_UNDO:]
        self._note(f"{name}: {before:g} -> {self._heli.params[name]:g}", "parameter")
        self._tell_values()
        return {"value": self._heli.params[name]}

    def _undo_last(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        if not self._undo:
            raise ParameterError("this page has not changed any parameter", "change a parameter first")
        name, before = self._undo[-1]
        self._heli.params.set(name, before)
        self._undo.pop()
        self._note(f"{name}: back to {before:g}", "parameter")
        self._tell_values()
        return {"name": name, "value": before}

    def _choose_law(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        return self._law.choose(text(arguments, "name") if arguments.get("name") else "")

    def _set_law(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        name = text(arguments, "name")
        before, after = self._law.set(name, number(arguments, "value"))
        self._note(f"{self._law.chosen} {name}: {before:g} -> {after:g}", "parameter")
        return {"value": after}

    def _save(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"generation": self._heli.params.save()}

    def _record(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        if arguments.get("on"):
            if self._recorder is None:
                self._begin_recording((), 0.0)
        elif self._flight is not None:
            raise ParameterError("a plan flies now, and is always recorded", "land first")
        else:
            self.close()
        return {}

    def _mark(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        self._marks += 1
        words = text(arguments, "text") if arguments.get("text") else f"mark {self._marks}"
        self._note(words, "mark")
        return {"logged": self._recorder is not None}

    def _signal(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        name, value = text(arguments, "name", 40), number(arguments, "value")
        newest = self._session.latest
        recorder = self._recorder
        if recorder is not None:
            recorder.note("signal", f"{name} = {value!r}")
        self._tell({"signal": {"name": name, "value": value, "tick": newest[0] if newest else 0}})
        return {}

    def _begin_recording(self, plans: Sequence[Plan], duration_s: float) -> None:
        self._recorder = self._new_recorder(plans, duration_s)
        self._tell({"recording": str(self._recorder.path)})

    @contextlib.contextmanager
    def _busy(self, doing: str) -> Any:
        self._doing = doing
        try:
            yield
        finally:
            self._doing = ""

    def _note(self, words: str, kind: str) -> None:
        """Write something of the host's own into the log, and on the page."""
        recorder = self._recorder
        if recorder is not None:
            recorder.note(kind, words)
        newest = self._session.latest
        self._add_event(newest[0] if newest is not None else 0, kind, words)

    def _twin_status(self) -> dict[str, Any] | None:
        if self._twin is None:
            return None
        ghost = self._twin.ghost_rad()
        return {
            "words": self._twin.words(),
            "alarm": bool(self._twin.alarm),
            "ghost_rad": [round(angle, 4) for angle in ghost] if ghost is not None else None,
        }

    def _hear_twin(self, news: TwinNews) -> None:
        recorder = self._recorder
        if recorder is not None:
            recorder.note(EVENT, news.text)
        self._add_event(news.tick, EVENT, news.text)

    def _take_ticks(self, ticks: Ticks) -> None:
        self._heard_s = time.monotonic()
        self.buffer.append(self._session.ticks_counted_on(ticks), ticks.raw)

    def _take_event(self, event: LinkEvent) -> None:
        if event.kind == BOARD_RESTARTED:
            self.buffer.clear()
        self._law.take_event(event)
        self._add_event(event.tick, event.kind, self._in_words(event.text))
        if event.kind == LAW_SIGNALS:
            self._signals = {f"signal_{number}": name for number, name in enumerate(event.names, 1)}
            self._tell({"channels": channel_rows(self._values, self._signals)})

    def _in_words(self, text: str) -> str:
        """Return the text of an event with its cause in words, and note an absent pilot in the log too."""
        is_without = is_without_setpoints(text)
        absence = self._absence() if is_without else ""
        if absence and absence != self._cause and (recorder := self._recorder) is not None:
            recorder.note("pilot", absence)
        if is_without:
            self._last_absence = absence
        self._cause = cause(text, absence) or self._cause
        return in_words(text, absence)

    def _add_event(self, tick: int, kind: str, words: str) -> None:
        entry = {"t_s": round(tick * TICK_S, 3), "kind": kind, "text": words}
        self._events = [*self._events[1 - _EVENTS_KEPT :], entry]
        self._tell({"event": entry})

    def _tell_values(self) -> None:
        with contextlib.suppress(HeliError):
            self._values = dict(self._heli.params)
        self._tell(
            {
                "values": self._values,
                "undo": len(self._undo),
                "limits_deg": self._heli.setpoint_limits_deg(),
                "channels": channel_rows(self._values, self._signals),
            }
        )

    def _tell(self, news: Mapping[str, Any]) -> None:
        if self._news is not None:
            self._news(news)


def is_simulated(heli: Heli) -> bool:
    """Return whether a board is simulated: its transport names a rig or an emulated board, or its firmware
    runs on a computer.

    Parameters
    ----------
    heli : Heli
        Connected board.
    """
    transport = heli.session.transport
    return bool(transport_rig(transport) or transport_label(transport)) or heli.info.board == "native"
