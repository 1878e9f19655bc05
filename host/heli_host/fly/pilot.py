"""Flies a route: a setpoint every 20 ms of device time, commands when they are due, and a landing at the end.

Setpoints go out from the callback that brings the samples, so they follow the device's time and not the
host's, at any speed of a simulation. Commands, which wait for an answer, go out from the thread that called
`Pilot.fly`. In lockstep both are the same thread, and the flight is the same every time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from heli_host.board.interrupts import Interrupts, name_of, was_interrupted
from heli_host.board.rest_check import ANGLE_SHIFTED
from heli_host.data.log.schema import LEVEL_WARNING
from heli_host.data.response import LANDING, TAKE_OFF
from heli_host.declaration import AXES, Axes, Channel, Event, Fault, SetpointMessage, State, Takeover, Trigger
from heli_host.errors import CommandRefused, FlightAborted, HeliError, LinkLost, fault_text
from heli_host.fly.route import Piece, Route
from heli_host.fly.tracking import Tolerance, TrackingMonitor
from heli_host.link.channels import rad_per_count
from heli_host.link.clock import TICK_S
from heli_host.link.events import LinkEvent, state_text

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.board.samples import Sample
    from heli_host.declaration import EventMessage
    from heli_host.fly.recorder import Recorder
    from heli_host.fly.route import Route
    from heli_host.fly.tracking import TrackingMonitor
    from heli_host.link.session import Session
    from heli_host.link.telemetry import LinkCounters, Ticks


_LONGEST_WAIT_S = 2.0


def newest_tick(session: Session) -> int:
    """Return the tick of the newest sample; 0 before the first."""
    newest = session.latest
    return newest.tick if newest is not None else 0


def wait_ticks(session: Session, count: int) -> None:
    """Wait for some milliseconds of device time, for at most 2 s."""
    last_tick = newest_tick(session) + count
    session.wait_for(lambda: newest_tick(session) >= last_tick, _LONGEST_WAIT_S)


@dataclass(frozen=True)
class Progress:
    """Progress of a flight."""

    # `t_s`: Device time since the loops were closed, in seconds.
    # `left_s`: Device time left until the landing; None during it.
    # `phase`: ``take-off``, the name of a plan, or ``landing``.

    t_s: float
    left_s: float | None
    phase: str
    sample: Sample
    counters: LinkCounters


class ProgressReports:
    """Calls the callback of a flight's caller, in the thread of `heli_host.fly.pilot.Pilot.fly`."""

    def __init__(self, heli: Heli, route: Route, callback: Callable[[Progress], None] | None) -> None:
        self.error: Exception | None = None
        self._heli = heli
        self._route = route
        self._callback = callback

    def report(self, t_s: float) -> None:
        """Report the progress of the route. An error of the callback is raised."""
        if self._callback is None:
            return
        piece = self._route.piece_at(t_s)
        self._call(t_s, LANDING if piece is None else piece.phase, self._route.duration_s - t_s)

    def report_landing(self, t_s: float) -> None:
        """Report the progress of the landing. An error of the callback is kept until the arm is down."""
        try:
            self._call(t_s, LANDING, None)
        except Exception as error:  # noqa: BLE001 - the caller's own callback may raise anything
            self.error, self._callback = error, None

    def _call(self, t_s: float, phase: str, left_s: float | None) -> None:
        # A board that has restarted has sent no sample yet.
        if self._callback is not None and self._heli.session.latest is not None:
            self._callback(
                Progress(t_s, left_s, phase, sample=self._heli.latest, counters=self._heli.session.counters)
            )


LAW_TAKEN_OVER: Final = "law_taken_over"
"""Beginning of the outcome of a flight in which the board's own law took over from an uploaded one."""
_EXPECTED_TAKEOVERS: Final = (Takeover.COMMAND, Takeover.STATE)
"""The host's own request, and the landing, which ends the closed loop."""
_LOOK_S = 0.05
_CLOSING_S = 2.0
FLYING = (State.ARMED, State.CLOSED_LOOP, State.HOLD)


class FlightMonitor:
    """Watches one flight."""

    # It sends nothing: `heli_host.fly.pilot.Pilot` acts on what it raises.
    # A stop from elsewhere, such as a page, is seen here as a state of the board that is not that of a
    # flight. `take_event` runs in the session's reading thread, all other methods in that of `Pilot.fly`.

    def __init__(self, heli: Heli, recorder: Recorder, end_when: Callable[[], str]) -> None:
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
        """Raise the error that must end the flight, if there is one."""
        # `t_s`: Device time since the loops were to be closed [s]; they must be closed within 2 s.
        closes_too_slowly = not self.was_closed and t_s > _CLOSING_S
        # Before the reasons are looked at: a log that fails between the two would end the flight without one.
        must_end = self.must_end()
        self._recorder.check()
        if restarted := self.restarted():
            raise FlightAborted(restarted.removeprefix("aborted: "))
        if not must_end and not closes_too_slowly:
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
        return int(newest.raw[Channel.FAULT]) if newest is not None else int(Fault.NONE)

    def _newest_state(self) -> str:
        """Return the state and its trigger in the newest sample, as text."""
        newest = self._session.latest
        if newest is None:
            return "no sample arrived"
        return state_text(int(newest.raw[Channel.STATE]), int(newest.raw[Channel.TRIGGER]))


INTERVAL_TICKS = 20
"""Device time between two setpoints: 50 a second."""
LEAD_TICKS = 100
"""Device time from now to the tick at which a setpoint is to be reached. The board ramps towards it, so that
the motion continues even if the next frame is late by this time."""

_LONGEST_LEAD_TICKS = 400
_STALL_TICKS = 60


class RouteStream:
    """Setpoints of one flight."""

    # It owns whether setpoints are sent at present, and its lock makes `end` final: no setpoint leaves after
    # it has returned. `take_ticks` runs in the session's reading thread, all other methods in that of
    # `heli_host.fly.pilot.Pilot.fly`. In lockstep both are the same thread.

    def __init__(self, heli: Heli, route: Route, recorder: Recorder, tracking: TrackingMonitor) -> None:
        self.start_tick = 0
        self._heli = heli
        self._session = heli.session
        self._route = route
        self._recorder = recorder
        self._tracking = tracking
        self._lock = threading.Lock()
        self._streaming = False
        self._sent_tick = 0
        self._unended_pieces = list(route.pieces)
        self._phases_ahead = _first_piece_of_phases(route)
        # The take-off lasts until the first phase of another name begins.
        take_off_s = next(
            (piece.start_s for piece in self._phases_ahead if piece.phase != TAKE_OFF), route.duration_s
        )
        self._take_off_ticks = round(take_off_s / TICK_S)

    @property
    def taken_off_tick(self) -> int:
        """Tick at which the first plan begins."""
        return self.start_tick + self._take_off_ticks

    @property
    def end_tick(self) -> int:
        """Tick at which the route ends."""
        return self.start_tick + round(self._route.duration_s / TICK_S)

    @property
    def t_s(self) -> float:
        """Device time since the loops were closed [s]."""
        return (newest_tick(self._session) - self.start_tick) * TICK_S

    def tick_of(self, piece: Piece) -> int:
        """Return the tick at which a piece of the route begins."""
        return self.start_tick + round(piece.start_s / TICK_S)

    def _end_tick_of(self, piece: Piece) -> int:
        return self.start_tick + round((piece.start_s + piece.duration_s) / TICK_S)

    def warm_up(self) -> None:
        """Evaluate the route once. The first evaluation takes 20 ms, most of it numpy's; at 50x real time
        that is a second of flight.
        """
        self._setpoint_rad_at(newest_tick(self._session))

    def begin(self) -> None:
        """Send setpoints from the newest tick on."""
        with self._lock:
            self.start_tick = newest_tick(self._session)
            self._sent_tick = self.start_tick - INTERVAL_TICKS
            self._streaming = True

    def end(self) -> None:
        """Send no more setpoints."""
        with self._lock:
            self._streaming = False

    def take_ticks(self, ticks: Ticks) -> None:
        """Follow the route on the device time of new samples."""
        tick = newest_tick(self._session)
        with self._lock:
            if not self._streaming:
                return
            self._tracking.take(ticks, self.taken_off_tick)
            while self._unended_pieces and tick >= self._end_tick_of(self._unended_pieces[0]):
                ended_piece = self._unended_pieces.pop(0)
                end_tick = self._end_tick_of(ended_piece)
                is_last = not self._unended_pieces
                self._tracking.take_end(ticks, end_tick, ended_piece, is_last)
            while self._phases_ahead and tick >= self.tick_of(self._phases_ahead[0]):
                begun_piece = self._phases_ahead.pop(0)
                self._recorder.mark_phase(self.tick_of(begun_piece), begun_piece.phase)
            if tick >= self._sent_tick + INTERVAL_TICKS:
                self._send_setpoint_due_after(tick)

    def bridge_a_stall(self) -> None:
        """Send setpoints on the estimated device time while no samples arrive, so that a pause of telemetry
        does not cause a landing.
        """
        if not self._session.connected:
            return
        tick = self._session.device_tick()
        with self._lock:
            if self._streaming and tick >= self._sent_tick + _STALL_TICKS:
                self._send_setpoint_due_after(tick)

    def _send_setpoint_due_after(self, tick: int) -> None:
        """Stream the setpoint that is due some ticks after `tick`, so that it arrives in time."""
        # Where samples come in larger portions than setpoints are due, the lead covers the time to the next
        # one.
        lead_ticks = min(max(LEAD_TICKS, tick - self._sent_tick + INTERVAL_TICKS), _LONGEST_LEAD_TICKS)
        at_tick = tick + lead_ticks
        message = SetpointMessage(at_tick & 0xFFFFFFFF, **self._setpoint_rad_at(at_tick))
        self._sent_tick = tick
        self._session.stream(message)
        self._session.keep_alive(message if self._heli.keep_alive else None)

    def _setpoint_rad_at(self, tick: int) -> dict[str, float]:
        t_s = np.array([(tick - self.start_tick) * TICK_S])
        angles_rad: list[float] = np.radians(self._route.evaluate(t_s)[0]).tolist()
        return {f"{axis}_rad": angle_rad for axis, angle_rad in zip(AXES, angles_rad, strict=True)}


def _first_piece_of_phases(route: Route) -> list[Piece]:
    """Return the first piece of every phase, in order."""
    firsts: list[Piece] = []
    for piece in route.pieces:
        if not firsts or firsts[-1].phase != piece.phase:
            firsts.append(piece)
    return firsts


# The log ends at rest: these rows show the encoders' offsets and noise.
_AFTER_TICKS = 200
_DOWN = (State.IDLE, State.FAULT)
_REQUESTED = (Trigger.LAND, Trigger.STOP)


class PlanLanding:
    """Brings the arm down, in the thread of `heli_host.fly.pilot.Pilot.fly`, which handles its errors."""

    def __init__(
        self,
        heli: Heli,
        stream: RouteStream,
        recorder: Recorder,
        monitor: FlightMonitor,
        reports: ProgressReports,
    ) -> None:
        self._heli = heli
        self._session = heli.session
        self._stream = stream
        self._recorder = recorder
        self._monitor = monitor
        self._reports = reports

    def land(self, *, is_completed: bool) -> str:
        """Land, or wait for the end that the board reached by itself."""
        if not self._session.connected and not self._monitor.was_closed:
            return ""
        # An idle board needs no landing, although a sample with this state may not have arrived yet.
        has_flown = self._monitor.was_closed or self._session.state not in _DOWN
        trouble = ""
        if has_flown and not self._monitor.restarted():
            trouble = self._heli.bring_down(
                lambda: self._recorder.mark_phase(newest_tick(self._session), LANDING),
                lambda: self._reports.report_landing(self._stream.t_s),
            )
        else:
            wait_ticks(self._session, _AFTER_TICKS)
        newest = self._session.latest
        if is_completed and not trouble and newest is not None and not self._monitor.restarted():
            # The board may have landed by itself, if the host was suspended between the end of the plan and
            # the landing.
            was_requested = newest.raw[Channel.TRIGGER] in _REQUESTED
            if newest.raw[Channel.STATE] in _DOWN and not was_requested:
                return self._monitor.why_down()
        return trouble


# The log begins at rest: these rows show the encoders' offsets and noise.
_BEFORE_TICKS = 500


class Pilot:
    """One flight along a route."""

    # Every way in which it ends, including an error, leads to a landing or a stop.
    # It owns the order of a flight and its outcome, and runs in the thread that calls `fly`. Setpoints go out
    # from `RouteStream`, `FlightMonitor` decides that the flight must end, `PlanLanding` brings the arm down.
    # It switches the motors off in the air only after a second interrupt.
    # `heli`: Idle, with its arm at rest on the table.
    # `route`: Setpoints over time, from the table on; checked against the board.
    # `axes`: Axes whose loops are closed.
    # `recorder`: Records the flight. If it fails, the flight ends in a landing.
    # `on_progress`: Called about twenty times per second in the thread of `fly`.
    # `tolerance`: Tracking errors between take-off and landing that still count as tracked.
    # `interrupts`: Handles signals during the flight; without it signals keep their handlers.
    # `end_when`: Returns the reason why the flight must end now, otherwise an empty text. Called after every
    # reading: it must not block.
    # `on_taken_off`: Called once, in the thread of `fly`, when the first plan begins. If it raises, the
    # flight ends in a landing.
    # `outcome`: ``completed``; ``not_tracked`` with the axis and its error; ``law_taken_over`` with the
    # reason; ``angle_shifted`` with the axis; or one line with the reason of the end.

    def __init__(
        self,
        heli: Heli,
        route: Route,
        axes: tuple[str, ...],
        recorder: Recorder,
        on_progress: Callable[[Progress], None] | None = None,
        tolerance: Tolerance | None = None,
        interrupts: Interrupts | None = None,
        end_when: Callable[[], str] | None = None,
        on_taken_off: Callable[[], object] | None = None,
    ) -> None:
        self.outcome = "not flown"
        self._on_taken_off = on_taken_off
        self._interrupts = interrupts or Interrupts()
        self._heli = heli
        self._session = heli.session
        self._axes = _axes_bit_mask(axes)
        self._recorder = recorder
        self._tracking = TrackingMonitor(tolerance or Tolerance(), rad_per_count(heli.params), axes)
        self._stream = RouteStream(heli, route, recorder, self._tracking)
        self._monitor = FlightMonitor(heli, recorder, end_when or (lambda: ""))
        self._reports = ProgressReports(heli, route, on_progress)
        self._landing = PlanLanding(heli, self._stream, recorder, self._monitor, self._reports)
        self._excitations = [piece for piece in route.pieces if piece.excitation is not None]

    def fly(self) -> None:
        """Arm, fly the route, land."""
        # Blocks until the motors are off, then `outcome` is set.
        # An error of the link, the board or the log ends the flight in a landing and appears in `outcome`
        # only. The first interrupt (Ctrl-C) does the same; a second one switches the motors off in the air.
        # Any other error, such as one of ``on_progress``, is raised again after the landing. If the link is
        # lost, the board holds level and lands by itself.
        unsubscribe = self._session.subscribe_ticks(self._stream.take_ticks)
        unsubscribe_events = self._session.subscribe_events(self._monitor.take_event)
        self._monitor.begin()
        try:
            self._fly_route()
            self.outcome = self._monitor.takeover or self._tracking.verdict() or "completed"
        except KeyboardInterrupt as error:
            self.outcome = f"aborted: {name_of(error)}"
        except LinkLost as error:
            self.outcome = self._monitor.restarted() or (
                f"link lost: {error.cause}; the board holds level, then lands by itself"
            )
        except HeliError as error:
            self.outcome = self._monitor.restarted() or f"aborted: {error}"
        except BaseException as error:
            self.outcome = f"aborted: {type(error).__name__} in this program"
            raise
        finally:
            self._land_or_stop()
            unsubscribe()
            unsubscribe_events()
            for name in self._interrupts.remembered:
                self._note_interrupt(f"{name} again, after the stop of the motors was sent")
        if self._reports.error is not None:
            raise self._reports.error

    def _fly_route(self) -> None:
        """Arm, close the loops, stream the route, and return when it has ended. Any reason to end it earlier
        raises FlightAborted.
        """
        stream, monitor, session = self._stream, self._monitor, self._session
        stream.warm_up()
        wait_ticks(session, _BEFORE_TICKS)
        self._recorder.check()
        # Before the loops are closed: a process that is suspended meanwhile reads of the landing and the
        # answers to its commands in one reading.
        monitor.hear_events()
        self._heli.arm()
        try:
            self._heli.control(self._axes)
        except CommandRefused:
            if session.state in FLYING:
                raise
            raise FlightAborted(monitor.why_down()) from None
        stream.begin()
        end_tick = stream.end_tick

        def is_due(tick: int) -> bool:
            return newest_tick(session) >= tick or monitor.must_end()

        while newest_tick(session) < end_tick:
            monitor.check(stream.t_s)
            on_taken_off = self._on_taken_off
            if on_taken_off is not None and newest_tick(session) >= stream.taken_off_tick:
                self._on_taken_off = None  # called once only
                on_taken_off()
            self._start_due_excitations()
            self._reports.report(stream.t_s)
            due_ticks = [end_tick]
            if self._excitations:
                due_ticks.append(stream.tick_of(self._excitations[0]))
            if self._on_taken_off is not None:
                due_ticks.append(stream.taken_off_tick)
            session.wait_for(partial(is_due, min(due_ticks)), _LOOK_S)
            stream.bridge_a_stall()
        monitor.check(stream.t_s)

    def _start_due_excitations(self) -> None:
        """Start the excitations that are due."""
        while self._excitations and newest_tick(self._session) >= self._stream.tick_of(self._excitations[0]):
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

    def _land_or_stop(self) -> None:
        """Land if the motors may run. A Ctrl-C meanwhile switches them off immediately: the arm falls."""
        try:
            self._stream.end()
            if was_interrupted(self.outcome):
                self._note_interrupt(
                    f"{self.outcome.removeprefix('aborted: ')}: the flight ends in a landing"
                )
            self._interrupts.allow_one_more()
            trouble = self._landing.land(is_completed=self.outcome == "completed")
        except KeyboardInterrupt as error:
            self._interrupts.allow_no_more()
            moment_text = "again" if was_interrupted(self.outcome) else "while landing"
            trouble = self._heli.cut_motors(f"{name_of(error)} {moment_text}")
            self._note_interrupt(trouble)
        except LinkLost as error:
            trouble = f"link lost while landing: {error.cause}; the board lands by itself"
        except HeliError as error:
            trouble = f"while landing: {error}"
        if trouble and (restarted := self._monitor.restarted()):
            trouble = "" if self.outcome == restarted else restarted.removeprefix("aborted: ")
        # A fault whose landing a restart has ended is in no sample any more.
        self.outcome = _outcome_with(_outcome_with(self.outcome, trouble), self._monitor.board_fault)

    def _note_interrupt(self, text: str) -> None:
        # Half a record would cost the log more than a moment costs here.
        with self._interrupts.shielded():
            self._recorder.note("interrupt", text, LEVEL_WARNING)


def _outcome_with(outcome: str, trouble: str) -> str:
    """Return the outcome of a flight whose landing went wrong; a fault of the board comes first."""
    # A fault has one name, and may have several explanations.
    if not trouble or (trouble.partition(":")[0] if trouble.startswith("fault ") else trouble) in outcome:
        return outcome
    if outcome == "completed":
        return trouble if trouble.startswith(ANGLE_SHIFTED) else f"aborted: {trouble}"
    if trouble.startswith("fault "):
        return f"aborted: {trouble}; {outcome.removeprefix('aborted: ')}"
    return f"{outcome}; {trouble}"


def _axes_bit_mask(axes: tuple[str, ...]) -> Axes:
    """Return the names of axes as a bit mask."""
    mask = Axes(0)
    for axis in axes:
        mask |= Axes[axis.upper()]
    return mask
