"""Flies a route: a setpoint every 20 ms of device time, commands when they are due, and a landing at the end.

Setpoints go out from the callback that brings the samples, so they follow the device's time and not the
host's, at any speed of a simulation. Commands, which wait for an answer, go out from the thread that called
`Pilot.fly`. In lockstep both are the same thread, and the flight is the same every time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from heli_host.board.rest_check import ANGLE_SHIFTED
from heli_host.data.log.schema import LEVEL_WARNING
from heli_host.declaration import Axes
from heli_host.errors import CommandRefused, FlightAborted, HeliError, LinkLost
from heli_host.fly.flight_monitor import FLYING, FlightMonitor
from heli_host.fly.landing import Landing
from heli_host.fly.progress import Progress, ProgressReports
from heli_host.fly.route import Route
from heli_host.fly.route_stream import RouteStream
from heli_host.fly.ticks import newest_tick, wait_ticks
from heli_host.fly.tracking import Tolerance, TrackingMonitor
from heli_host.interrupts import Interrupts, name_of, was_interrupted
from heli_host.link.channels import rad_per_count

if TYPE_CHECKING:
    from heli_host.board.vehicle import Vehicle
    from heli_host.fly.recorder import Recorder

_LOOK_S = 0.05
# The log begins at rest: these rows show the encoders' offsets and noise.
_BEFORE_TICKS = 500


class Pilot:
    """One flight along a route. Every way in which it ends, including an error, leads to a landing or a stop.

    It owns the order of a flight and its outcome, and runs in the thread that calls `fly`. Setpoints go out
    from `RouteStream`, `FlightMonitor` decides that the flight must end, `Landing` brings the arm down. It
    switches the motors off in the air only after a second interrupt.

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
        ``completed``; ``not_tracked`` with the axis and its error; ``law_taken_over`` with the reason;
        ``angle_shifted`` with the axis; or one line with the reason of the end.
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
        self._landing = Landing(heli, self._stream, recorder, self._monitor, self._reports)
        self._excitations = [piece for piece in route.pieces if piece.excitation is not None]

    def fly(self) -> None:
        """Arm, fly the route, land. Blocks until the motors are off, then `outcome` is set.

        An error of the link, the board or the log ends the flight in a landing and appears in `outcome` only.
        The first interrupt (Ctrl-C) does the same; a second one switches the motors off in the air. Any other
        error, such as one of ``on_progress``, is raised again after the landing. If the link is lost, the
        board holds level and lands by itself.
        """
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
        while newest_tick(session) < end_tick:
            monitor.check(stream.t_s)
            if self._on_taken_off is not None and newest_tick(session) >= stream.taken_off_tick:
                taken_off, self._on_taken_off = self._on_taken_off, None
                taken_off()
            self._start_due_excitations()
            self._reports.report(stream.t_s)
            due_tick = min([end_tick, *(stream.tick_of(piece) for piece in self._excitations[:1])])
            if self._on_taken_off is not None:
                due_tick = min(due_tick, stream.taken_off_tick)
            # mypy gives no type to a lambda with a default.
            session.wait_for(lambda due=due_tick: newest_tick(session) >= due or monitor.must_end(), _LOOK_S)  # type: ignore[misc]
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
