"""Flies a route: a setpoint every 20 ms of device time, commands when they are due, and a landing at the end.

Setpoints go out from the callback that brings the samples, so they follow the device's time and not the
host's, at any speed of a simulation. Commands, which wait for an answer, go out from the thread that called
`Pilot.fly`. In lockstep both are the same thread, and the flight is the same every time.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from heli_host.declaration import AXES, TICK_US, Axes, Channel, Event, Fault, SetpointMessage, State, Trigger
from heli_host.errors import CommandRefused, FlightAborted, HeliError, LinkLost, fault_text
from heli_host.flight.flown import LANDING
from heli_host.fly.interrupts import Interrupts, name_of, was_interrupted
from heli_host.fly.plan import TAKE_OFF
from heli_host.fly.route import Piece, Route
from heli_host.fly.tracking import Tolerance, TrackingMonitor
from heli_host.link.channels import rad_per_count
from heli_host.link.events import BOARD_RESTARTED, LinkEvent, state_text
from heli_host.log.schema import LEVEL_WARNING

if TYPE_CHECKING:
    from heli_host.fly.recorder import Recorder
    from heli_host.link.accounting import LinkCounters
    from heli_host.link.telemetry import Ticks
    from heli_host.samples import Sample
    from heli_host.vehicle import Vehicle

TICK_S = TICK_US * 1e-6
INTERVAL_TICKS = 20
"""Device time between two setpoints: 50 a second."""
LEAD_TICKS = 100
"""Device time from now to the tick at which a setpoint is reached. The board ramps towards it, so a frame may
be late by as much and the motion still goes on."""

_LONGEST_LEAD_TICKS = 400
_STALL_TICKS = 60
_LOOK_S = 0.05
_CLOSING_S = 2.0
# The log begins and ends at rest: these rows show the encoders' offsets and noise.
_BEFORE_TICKS = 500
_AFTER_TICKS = 200
_LONGEST_REST_S = 2.0
_DOWN = (State.IDLE, State.FAULT)
_REQUESTED = (Trigger.LAND, Trigger.STOP)
_FLYING = (State.ARMED, State.CLOSED_LOOP, State.HOLD)


@dataclass(frozen=True)
class Progress:
    """Progress of a flight.

    Parameters
    ----------
    t_s : float
        Device time since the loops were closed, in seconds.
    left_s : float or None
        Device time left until the landing; None during it.
    phase : str
        ``take-off``, the name of a plan, or ``landing``.
    """

    t_s: float
    left_s: float | None
    phase: str
    sample: Sample
    counters: LinkCounters


class Pilot:
    """One flight along a route. Every way in which it ends, including an error, leads to a landing or a stop.

    Parameters
    ----------
    heli : Vehicle
        Idle, with its arm at rest on the table.
    route : Route
        Setpoints over time, from the table on; checked against the board.
    axes : tuple of str
        Axes whose loops are closed.
    recorder : Recorder
        Records the flight. If it fails, the flight ends in a landing.
    on_progress : callable taking Progress, optional
        Called about twenty times per second in the thread of `fly`.
    tolerance : Tolerance, optional
        Tracking errors between take-off and landing that still count as tracked.
    interrupts : Interrupts, optional
        Handles signals during the flight; without it signals keep their handlers.
    end_when : callable returning str, optional
        Returns the reason why the flight must end now, otherwise an empty text. Called after every reading:
        it must not block.
    on_taken_off : callable, optional
        Called once, in the thread of `fly`, when the first plan begins. If it raises, the flight ends in a
        landing.

    Attributes
    ----------
    outcome : str
        ``completed``; ``not_tracked`` with the axis and its error; or one line with the reason of the end.
    """

    def __init__(
        self,
        heli: Vehicle,
        route: Route,
        axes: tuple[str, ...],
        recorder: Recorder,
        on_progress: Callable[[Progress], None] | None = None,
        tolerance: Tolerance | None = None,
        interrupts: Interrupts | None = None,
        end_when: Callable[[], str] | None = None,
        on_taken_off: Callable[[], object] | None = None,
    ) -> None:
        self._end_when = end_when or (lambda: "")
        self.outcome = "not flown"
        self._on_taken_off = on_taken_off
        self._interrupts = interrupts or Interrupts()
        self._heli = heli
        self._session = heli.session
        self._route = route
        self._axes = _mask(axes)
        self._recorder = recorder
        self._on_progress = on_progress
        self._lock = threading.Lock()
        self._streaming = False
        self._in_flight = False
        self._start_tick = 0
        self._sent_tick = 0
        self._phases = _phases(route)
        flown_s = next((piece.start_s for piece in self._phases if piece.phase != TAKE_OFF), route.duration_s)
        self._take_off_ticks = round(flown_s / TICK_S)
        self._tracking = TrackingMonitor(tolerance or Tolerance(), rad_per_count(heli.params), axes)
        self._excitations = [piece for piece in route.pieces if piece.excitation is not None]
        self._was_closed = False
        self._ended_by = ""
        self._report_error: Exception | None = None
        self._restarts = 0
        self._reconnects = 0

    def fly(self) -> None:
        """Arm, fly the route, land. Blocks until the motors are off, then `outcome` is set.

        An error of the link, the board or the log ends the flight in a landing and appears in `outcome` only.
        The first interrupt (Ctrl-C) does the same; a second one switches the motors off in the air. Any other
        error, such as one of ``on_progress``, is raised again after the landing. If the link is lost, the
        board holds level and lands by itself.
        """
        unsubscribe = self._session.subscribe_ticks(self._take_ticks)
        unsubscribe_events = self._session.subscribe_events(self._take_event)
        counters = self._session.counters
        self._restarts, self._reconnects = counters.restarts, counters.reconnects
        try:
            self._fly_route()
            self.outcome = self._tracking.verdict() or "completed"
        except KeyboardInterrupt as error:
            self.outcome = f"aborted: {name_of(error)}"
        except LinkLost as error:
            self.outcome = self._restarted() or (
                f"link lost: {error.cause}; the board holds level, then lands by itself"
            )
        except HeliError as error:
            self.outcome = self._restarted() or f"aborted: {error}"
        except BaseException as error:
            self.outcome = f"aborted: {type(error).__name__} in this program"
            raise
        finally:
            self._come_down()
            unsubscribe()
            unsubscribe_events()
            for name in self._interrupts.remembered:
                self._note_interrupt(f"{name} again, after the stop of the motors was sent")
        if self._report_error is not None:
            raise self._report_error

    def _fly_route(self) -> None:
        # The first evaluation takes 20 ms, most of it numpy's; at 50x real time that is a second of flight.
        self._target_rad(self._tick())
        self._wait_ticks(_BEFORE_TICKS)
        self._recorder.check()
        # Before the loops are closed: a process that is suspended meanwhile reads of the landing and the
        # answers to its commands in one reading.
        self._in_flight = True
        self._heli.arm()
        try:
            self._heli.control(self._axes)
        except CommandRefused:
            if self._session.state in _FLYING:
                raise
            raise FlightAborted(self._why_down()) from None
        with self._lock:
            self._start_tick = self._tick()
            self._sent_tick = self._start_tick - INTERVAL_TICKS
            self._streaming = True
        end_tick = self._start_tick + round(self._route.duration_s / TICK_S)
        while self._tick() < end_tick:
            self._check_up()
            taken_off_tick = self._start_tick + self._take_off_ticks
            if self._on_taken_off is not None and self._tick() >= taken_off_tick:
                taken_off, self._on_taken_off = self._on_taken_off, None
                taken_off()
            self._excite()
            self._report()
            due_tick = min([end_tick, *(self._tick_of(piece) for piece in self._excitations[:1])])
            if self._on_taken_off is not None:
                due_tick = min(due_tick, taken_off_tick)
            # mypy gives no type to a lambda with a default.
            self._session.wait_for(lambda due=due_tick: self._tick() >= due or self._trouble(), _LOOK_S)  # type: ignore[misc]
            self._bridge_a_stall()
        self._check_up()

    def _tick(self) -> int:
        newest = self._session.latest
        return newest[0] if newest is not None else 0

    def _tick_of(self, piece: Piece) -> int:
        return self._start_tick + round(piece.start_s / TICK_S)

    def _take_ticks(self, ticks: Ticks) -> None:
        tick = self._tick()
        with self._lock:
            if not self._streaming:
                return
            self._tracking.take(ticks, self._start_tick + self._take_off_ticks)
            while self._phases and tick >= self._tick_of(self._phases[0]):
                piece = self._phases.pop(0)
                self._recorder.mark_phase(self._tick_of(piece), piece.phase)
            if tick >= self._sent_tick + INTERVAL_TICKS:
                self._send(tick)

    def _take_event(self, event: LinkEvent) -> None:
        # The first event with a state that is not flying gives the cause; later ones are its consequences.
        message = event.message
        if not self._in_flight or self._ended_by or message is None or message.kind != Event.STATE:
            return
        # A touchdown follows from a landing, whose event was lost if this is the first.
        if message.cause != Trigger.TOUCHDOWN:
            self._ended_by = "" if message.detail in _FLYING else event.text

    def _bridge_a_stall(self) -> None:
        """Send setpoints on the estimated device time while no samples arrive, so that a pause of telemetry
        does not cause a landing.
        """
        if not self._session.connected:
            return
        tick = self._session.device_tick()
        with self._lock:
            if self._streaming and tick >= self._sent_tick + _STALL_TICKS:
                self._send(tick)

    def _send(self, tick: int) -> None:
        # Where samples come in larger portions than setpoints are due, the lead covers the time to the next
        # one.
        lead_ticks = min(max(LEAD_TICKS, tick - self._sent_tick + INTERVAL_TICKS), _LONGEST_LEAD_TICKS)
        at_tick = tick + lead_ticks
        message = SetpointMessage(at_tick & 0xFFFFFFFF, **self._target_rad(at_tick))
        self._sent_tick = tick
        self._session.stream(message)
        self._session.keep_alive(message if self._heli.keep_alive else None)

    def _target_rad(self, tick: int) -> dict[str, float]:
        t_s = np.array([(tick - self._start_tick) * TICK_S])
        angles_rad: list[float] = np.radians(self._route.evaluate(t_s)[0]).tolist()
        return {f"{axis}_rad": angle_rad for axis, angle_rad in zip(AXES, angles_rad, strict=True)}

    def _excite(self) -> None:
        while self._excitations and self._tick() >= self._tick_of(self._excitations[0]):
            excitation = self._excitations.pop(0).excitation
            if excitation is not None:
                self._heli.excite(
                    excitation.signal,
                    excitation.front_V,
                    excitation.back_V,
                    start_Hz=excitation.start_Hz,
                    stop_Hz=excitation.stop_Hz,
                    duration_s=excitation.duration_s,
                    seed=excitation.seed,
                )

    def _trouble(self) -> bool:
        state = self._session.state
        self._was_closed = self._was_closed or state is State.CLOSED_LOOP
        flying = (State.CLOSED_LOOP, State.HOLD) if self._was_closed else (State.CLOSED_LOOP, State.ARMED)
        wrong = (state is not None and state not in flying) or self._recorder.error is not None
        return wrong or bool(self._end_when())

    def _check_up(self) -> None:
        """Raise the error that must end the flight, if there is one."""
        self._recorder.check()
        if restarted := self._restarted():
            raise FlightAborted(restarted.removeprefix("aborted: "))
        slow = not self._was_closed and (self._tick() - self._start_tick) * TICK_S > _CLOSING_S
        if not self._trouble() and not slow:
            return
        raise FlightAborted(self._end_when() or self._why_down())

    def _why_down(self) -> str:
        """Reason for a state of the board that is not that of a flight."""
        state = self._session.state
        if state in (State.FAULT, State.EMERGENCY_LANDING):
            return f"fault {fault_text(self._fault())}"
        # Telemetry shows a state a moment before its events are handed over.
        self._session.wait_for(lambda: bool(self._ended_by), _LOOK_S)
        lost = ", after the link was lost" if self._session.counters.reconnects != self._reconnects else ""
        name = state.name.lower() if state is not None else "unknown"
        return f"the board went to state {name}{lost} ({self._ended_by or self._newest_state()})"

    def _newest_state(self) -> str:
        newest = self._session.latest
        if newest is None:
            return "no sample arrived"
        return state_text(int(newest[1][Channel.STATE]), int(newest[1][Channel.TRIGGER]))

    def _restarted(self) -> str:
        """Outcome of a flight whose board has restarted; empty if it has not."""
        if self._session.counters.restarts == self._restarts:
            return ""
        texts = (event.text for event in reversed(self._session.events) if event.kind == BOARD_RESTARTED)
        text = next(texts, "the board restarted")
        return f"aborted: {text} in flight, motors off; check its supply and the log's last events"

    def _fault(self) -> int:
        newest = self._session.latest
        return int(newest[1][Channel.FAULT]) if newest is not None else int(Fault.NONE)

    def _come_down(self) -> None:
        """Land if the motors may run. A Ctrl-C meanwhile switches them off immediately: the arm falls."""
        try:
            with self._lock:
                self._streaming = False
            if was_interrupted(self.outcome):
                self._note_interrupt(
                    f"{self.outcome.removeprefix('aborted: ')}: the flight ends in a landing"
                )
            self._interrupts.allow_one_more()
            trouble = self._land()
        except KeyboardInterrupt as error:
            self._interrupts.allow_no_more()
            # A pending error of a callback must not delay the stop.
            for _ in range(3):
                with contextlib.suppress(HeliError):
                    self._heli.stop()
                    break
            when = "again" if was_interrupted(self.outcome) else "while landing"
            trouble = f"{name_of(error)} {when}, motors stopped in the air"
            self._note_interrupt(trouble)
        except LinkLost as error:
            trouble = f"link lost while landing: {error.cause}; the board lands by itself"
        except HeliError as error:
            trouble = f"while landing: {error}"
        if trouble and (restarted := self._restarted()):
            trouble = "" if self.outcome == restarted else restarted.removeprefix("aborted: ")
        if trouble and self.outcome == "completed":
            self.outcome = f"aborted: {trouble}"
        elif trouble and not self.outcome.startswith("link lost"):
            self.outcome += f"; {trouble}"

    def _note_interrupt(self, text: str) -> None:
        # Half a record would cost the log more than a moment costs here.
        with self._interrupts.shielded():
            self._recorder.note("interrupt", text, LEVEL_WARNING)

    def _land(self) -> str:
        """Land, or wait for the end that the board reached by itself; return the error text, if any."""
        if not self._session.connected and not self._was_closed:
            return ""
        trouble = ""
        if self._restarted():
            # It is idle: there is nothing to land, and may be no sample yet that says so.
            pass
        elif self._session.state is State.ARMED:
            self._heli.stop()
        elif self._session.state not in _DOWN:
            trouble = self._descend()
        self._wait_ticks(_AFTER_TICKS)
        newest = self._session.latest
        if self.outcome == "completed" and not trouble and newest is not None:
            # A plan may be flown to its end, and the host suspended before it can land.
            by_itself = newest[1][Channel.TRIGGER] not in _REQUESTED
            return self._why_down() if by_itself and newest[1][Channel.STATE] in _DOWN else ""
        return trouble

    def _descend(self) -> str:
        begin_tick = self._tick()
        emergency = self._session.state is State.EMERGENCY_LANDING
        if self._session.state is not State.LANDING and not emergency:
            self._heli.land(wait=False)
        self._recorder.mark_phase(begin_tick, LANDING)
        timeout_s = self._heli.params["landing_timeout_s"] + 3.0
        until_tick = self._tick() + round(timeout_s / TICK_S)
        while self._session.state not in _DOWN:
            if self._tick() >= until_tick:
                self._heli.stop()
                return f"it did not land within {timeout_s:g} s; motors stopped"
            self._report_landing()
            self._session.wait_for(lambda: self._session.state in _DOWN, _LOOK_S)
        if self._session.state is not State.FAULT or emergency:
            return ""
        return f"fault {fault_text(self._fault())}"

    def _wait_ticks(self, count: int) -> None:
        last_tick = self._tick() + count
        self._session.wait_for(lambda: self._tick() >= last_tick, _LONGEST_REST_S)

    def _report_landing(self) -> None:
        """Report the progress; an error of the callback is kept until the arm is down."""
        try:
            self._report(landing=True)
        except Exception as error:  # noqa: BLE001 - the caller's own callback may raise anything
            self._report_error, self._on_progress = error, None

    def _report(self, *, landing: bool = False) -> None:
        if self._on_progress is None:
            return
        t_s = (self._tick() - self._start_tick) * TICK_S
        piece = self._route.piece_at(t_s)
        phase = LANDING if landing or piece is None else piece.phase
        left_s = None if landing else self._route.duration_s - t_s
        self._on_progress(Progress(t_s, left_s, phase, self._heli.latest, self._session.counters))


def _mask(axes: tuple[str, ...]) -> Axes:
    mask = Axes(0)
    for axis in axes:
        mask |= Axes[axis.upper()]
    return mask


def _phases(route: Route) -> list[Piece]:
    """Return the first piece of every phase, in order."""
    firsts: list[Piece] = []
    for piece in route.pieces:
        if not firsts or firsts[-1].phase != piece.phase:
            firsts.append(piece)
    return firsts
