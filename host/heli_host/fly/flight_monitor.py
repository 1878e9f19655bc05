"""Decides whether a flight must end, and derives why from the board's samples and events."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from heli_host.declaration import Channel, Event, Fault, State, Takeover, Trigger
from heli_host.errors import FlightAborted, fault_text
from heli_host.link.clock import TICK_S
from heli_host.link.events import LinkEvent, state_text

if TYPE_CHECKING:
    from heli_host.board.vehicle import Vehicle
    from heli_host.declaration import EventMessage
    from heli_host.fly.recorder import Recorder

LAW_TAKEN_OVER: Final = "law_taken_over"
"""Beginning of the outcome of a flight in which the board's own law took over from an uploaded one."""
_EXPECTED_TAKEOVERS: Final = (Takeover.COMMAND, Takeover.STATE)
"""The host's own request, and the landing, which ends the closed loop."""
_LOOK_S = 0.05
_CLOSING_S = 2.0
FLYING = (State.ARMED, State.CLOSED_LOOP, State.HOLD)


class FlightMonitor:
    """Watches one flight. It sends nothing: `heli_host.fly.pilot.Pilot` acts on what it raises.

    A stop from elsewhere, such as a page, is seen here as a state of the board that is not that of a flight.
    `take_event` runs in the session's reading thread, all other methods in that of `Pilot.fly`.
    """

    def __init__(self, heli: Vehicle, recorder: Recorder, end_when: Callable[[], str]) -> None:
        self.was_closed = False
        self.takeover = ""
        self.board_fault = ""
        self._law_engaged_tick = 0
        self._heli = heli
        self._session = heli.session
        self._recorder = recorder
        self._end_when = end_when
        self._hears = False
        self._ended_by = ""
        self._restarts = self._reconnects = 0

    def begin(self) -> None:
        """Compare restarts and reconnects with those of now."""
        counters = self._session.counters
        self._restarts, self._reconnects = counters.restarts, counters.reconnects

    def hear_events(self) -> None:
        """Take the cause of the end from events that arrive from now on."""
        self._hears = True

    def take_event(self, event: LinkEvent) -> None:
        """Remember the event that ended the flight."""
        if event.message is not None:
            self._take_law_event(event.message)
            if event.message.kind == Event.FAULT and self._hears and not self.board_fault:
                self.board_fault = f"fault {fault_text(event.message.detail)}"
        # The first event with a state that is not flying gives the cause; later ones are its consequences.
        message = event.message
        if not self._hears or self._ended_by or message is None or message.kind != Event.STATE:
            return
        # A touchdown follows from a landing, whose event was lost if this is the first.
        if message.cause != Trigger.TOUCHDOWN:
            self._ended_by = "" if message.detail in FLYING else event.text

    def _take_law_event(self, message: EventMessage) -> None:
        """Remember the first takeover from an uploaded law that nobody requested."""
        if message.kind == Event.LAW_ENGAGED:
            self._law_engaged_tick = message.tick
        if message.kind != Event.LAW_TAKEN_OVER or message.detail in _EXPECTED_TAKEOVERS or self.takeover:
            return
        known = message.detail in Takeover._value2member_map_
        reason = Takeover(message.detail).name.lower() if known else f"reason {message.detail}"
        flown_s = ((message.tick - self._law_engaged_tick) & 0xFFFFFFFF) * TICK_S
        self.takeover = (
            f"{LAW_TAKEN_OVER}: {reason} ({message.value:.3g}), {flown_s:.1f} s after the uploaded law "
            "began; the board's own law flew the rest"
        )

    def must_end(self) -> bool:
        """Whether the board does not fly any more, the recorder has failed, or the caller ends the flight."""
        state = self._session.state
        self.was_closed = self.was_closed or state is State.CLOSED_LOOP
        flying = (State.CLOSED_LOOP, State.HOLD) if self.was_closed else (State.CLOSED_LOOP, State.ARMED)
        is_wrong = (state is not None and state not in flying) or self._recorder.error is not None
        return is_wrong or bool(self._end_when())

    def check(self, t_s: float) -> None:
        """Raise the error that must end the flight, if there is one.

        `t_s`: Device time since the loops were to be closed [s]; they must be closed within 2 s.
        """
        self._recorder.check()
        if restarted := self.restarted():
            raise FlightAborted(restarted.removeprefix("aborted: "))
        closes_too_slowly = not self.was_closed and t_s > _CLOSING_S
        if not self.must_end() and not closes_too_slowly:
            return
        raise FlightAborted(self._end_when() or self.why_down())

    def why_down(self) -> str:
        """Return the reason for a state of the board that is not that of a flight."""
        state = self._session.state
        if state in (State.FAULT, State.EMERGENCY_LANDING):
            return f"fault {fault_text(self.fault())}"
        # Telemetry shows a state slightly before the event with its reason arrives.
        self._session.wait_for(lambda: bool(self._ended_by), _LOOK_S)
        lost_link_text = (
            ", after the link was lost" if self._session.counters.reconnects != self._reconnects else ""
        )
        state_name = state.name.lower() if state is not None else "unknown"
        reason = self._ended_by or self._newest_state()
        # Most events begin with the name of the state, which the message below already contains.
        text_before, _, cause_after_state = reason.partition(f"state {state_name}, ")
        if cause_after_state and not text_before:
            return f"the board went to state {state_name}{lost_link_text}, {cause_after_state}"
        return f"the board went to state {state_name}{lost_link_text} ({reason})"

    def restarted(self) -> str:
        """Return the outcome of a flight whose board has restarted; empty if it has not."""
        if self._session.counters.restarts == self._restarts:
            return ""
        return f"aborted: {self._heli.restart_text()}"

    def fault(self) -> int:
        """Return the number of the fault in the newest sample."""
        newest = self._session.latest
        return int(newest[1][Channel.FAULT]) if newest is not None else int(Fault.NONE)

    def _newest_state(self) -> str:
        """Return the state and its trigger in the newest sample, as text."""
        newest = self._session.latest
        if newest is None:
            return "no sample arrived"
        return state_text(int(newest[1][Channel.STATE]), int(newest[1][Channel.TRIGGER]))
