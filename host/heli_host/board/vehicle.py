"""The vehicle of a session: arm, setpoint, take off, land, stop; in degrees and volts."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from numbers import Real
from types import TracebackType
from typing import Final, Literal, Self, get_args

import numpy as np

from heli_host.board.interrupts import Interrupts, name_of
from heli_host.board.open_loop import ALL_AXES, OpenLoopCommands
from heli_host.board.rest_check import RestAngles
from heli_host.board.samples import Sample, Samples
from heli_host.board.setpoints import check_setpoint, setpoint_bounds
from heli_host.board.telemetry_view import HISTORY_S
from heli_host.declaration import (
    ArmMessage,
    Axes,
    ControlMessage,
    Fault,
    LandMessage,
    SetpointMessage,
    State,
    StopMessage,
    Trigger,
)
from heli_host.errors import (
    CommandRefused,
    FlightAborted,
    HeliError,
    LinkLost,
    SetpointError,
    announce,
    fault_text,
)
from heli_host.link.clock import TICK_S
from heli_host.link.events import BOARD_RESTARTED
from heli_host.link.session import Session
from heli_host.link.telemetry import Ticks

AfterLaw = Literal["hold", "land", "stop"]
"""Action of the board when a control law of the host, or an uploaded one, has ended."""
AFTER_LAW: Final = get_args(AfterLaw)
LEAD_S = 0.04
MAX_LEAD_S = 0.5

_TRIES = 3
"""Attempts of a stop or of a landing: a failed callback raises its error in the next command, once."""
_LOOK_S = 0.05
_DOWN = (State.IDLE, State.FAULT)
_DESCENDING = (State.LANDING, State.EMERGENCY_LANDING)
_LANDED_BY = (Trigger.LAND, Trigger.STALE_LAND)
"""Triggers in the samples of an idle board whose arm has touched down."""
_TABLE_DEG = 3.0
"""Distance of elevation from its rest angle up to which an arm in open loop is on the table [deg]: twice the
distance at which the board takes a landing for finished."""
_LANDING_TIMES = 3.0
"""Longest wait for a landing, as a multiple of ``landing_timeout_s``. The board ends each of at most two
landings, an ordinary one and an emergency landing that follows it, within one."""
_CLIMB_SPARE_S = 20.0
"""Time for which a climb may lag behind its setpoint [s]; the shipped rigs need less than 3 s."""
_FLOAT_LOOK_S = 1.0
_TURNING_DEG_S = 5.0
"""Rate of travel above which an arm is stopped before its landing [deg/s]. Below it the tilt of the landing
stays so small that the arm comes down."""
_STOPPED_DEG_S = 2.0
_LEVEL_DEG = 5.0
_BRAKING_S = 1.5
_BRAKING_TIMEOUT_S = 8.0
_RATE_S = 0.2
_REST_S = 0.5
_REST_LOOK_S = 0.2
_REACHED_DEG = 2.0
_REACHED_FOR_S = 0.3
_FOLLOWING = (State.CLOSED_LOOP, State.HOLD)
"""States in which a setpoint has an effect: fresh ones end the hold."""


class Vehicle(OpenLoopCommands):
    """A helicopter with an open session: the commands that flights of plans and control laws are built on.

    Leaving its ``with`` block, or `close`, lands an arm that is in the air, whatever ended the block. A
    Ctrl-C during this landing switches the motors off. A line on standard error reports both.

    A method that changes the board's state returns when telemetry shows the new state. Methods may be called
    from any thread; `stop` waits for a command of another thread, `Session.stop_now` does not. Callbacks run
    in the session's reading thread: they may read samples and send setpoints, but must not wait.

    Parameters
    ----------
    session : Session
        Connected session; the vehicle closes it.
    keep_alive : bool
        True repeats the last setpoint ten times per second, so that the board keeps flying while the program
        pauses, such as between two cells of a notebook. False: without a new setpoint the board holds level
        after ``setpoint_hold_s`` and lands after ``setpoint_land_s``.
    land_on_exit : bool
        False switches the motors off at an end without an error, instead of landing: an arm in the air falls.
        After an error the arm lands in any case.
    history_s : float
        Length of the history that `samples` can return [s].

    Attributes
    ----------
    land_on_exit : bool
        As above; may be changed at any time.
    """

    def __init__(
        self,
        session: Session,
        *,
        keep_alive: bool = True,
        land_on_exit: bool = True,
        history_s: float = HISTORY_S,
    ) -> None:
        self.land_on_exit = land_on_exit
        self._keep_alive = keep_alive
        self._target: SetpointMessage | None = None
        self._closed = False
        self._at_rest: RestAngles | None = None
        self._axes = ALL_AXES
        super().__init__(session, history_s)
        session.subscribe_ticks(self._take_hover)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(error)

    def close(self) -> None:
        """Land if the arm is in the air, switch the motors off, and end the session; a second call does
        nothing.

        Raises
        ------
        FlightAborted
            The landing failed, or the arm rests at other angles than before the take-off.
        """
        self._end(None)

    def leave_flying(self) -> None:
        """End the session, but not the flight: the board holds level, and lands unless another program takes
        over.
        """
        self._closed = True
        self.session.close()

    @property
    def is_in_the_air(self) -> bool:
        """Whether the motors run, and the arm would fall without them."""
        state = self.session.state
        if state is None or state in _DOWN or state is State.ARMED:
            return False
        if state is not State.OPEN_LOOP:
            return True
        # On a bench, open-loop voltages drive a motor while the arm rests on the table.
        return self.latest.elevation_deg > self.params["elevation_rest_deg"] + _TABLE_DEG

    def bring_down(
        self,
        on_landing: Callable[[], object] | None = None,
        on_wait: Callable[[], object] | None = None,
    ) -> str:
        """Bring the arm onto the table from any state, and wait until the board reports that the motors are
        off.

        This is the end of every flight. A landing that the board has begun by itself is not interrupted. The
        motors of an arm that rests on the table are switched off.

        Parameters
        ----------
        on_landing, on_wait : callable, optional
            Called when the landing begins, and about twenty times per second until it ends.

        Returns
        -------
        str
            The fault that ended the flight, the restart of the board, or the axes whose angles at rest differ
            from those before the take-off; empty after an ordinary landing.

        Raises
        ------
        LinkLost
            The board cannot be reached; it lands by itself.
        HeliError
            The board refuses to land.
        KeyboardInterrupt
            An interrupt came. The landing continues.
        """
        restarts = self.session.counters.restarts
        for attempts_left in reversed(range(_TRIES)):
            try:
                self._descend(restarts, on_landing, on_wait)
                break
            except LinkLost:
                raise
            except HeliError:
                if not attempts_left:
                    raise
        if self.session.counters.restarts != restarts:
            return self.restart_text()
        sample = self.latest
        # A log ends with the arm at rest.
        self.wait(_REST_LOOK_S)
        if sample.state is State.FAULT:
            return self._text_of_fault(sample.fault)
        if sample.state is not State.IDLE:
            limit_s = _LANDING_TIMES * self.params["landing_timeout_s"]
            return f"the board did not land within {limit_s:g} s, and still tries; switch its supply off"
        return self._shift_at_rest(sample)

    @contextlib.contextmanager
    def landing_on_error(self) -> Iterator[None]:
        """Land if any error, or an interrupt, ends a ``with`` block while the arm is in the air; the error
        then goes on, with a note if the landing failed.
        """
        try:
            yield
        except BaseException as error:
            if self.is_in_the_air:
                self._land_after(error)
            raise

    def restart_text(self) -> str:
        """Return the newest restart of the board with its reason, and what to do."""
        texts = (event.text for event in reversed(self.session.events) if event.kind == BOARD_RESTARTED)
        text = next(texts, "the board restarted")
        return f"{text} in flight, motors off; check its supply and the log's last events"

    def cut_motors(self, cause: str) -> str:
        """Switch the motors off in the air, because a landing is impossible or not wanted, and say so on
        standard error.

        Parameters
        ----------
        cause : str
            Reason for which the landing was ended.

        Returns
        -------
        str
            One line for the outcome.
        """
        # A pending error of a callback must not delay the stop.
        for _ in range(_TRIES):
            with contextlib.suppress(HeliError):
                self.stop()
                text = f"{cause}, motors stopped in the air"
                break
        else:
            text = f"{cause}, and the board did not confirm the stop: use the rig's own stop switch"
        announce(text)
        return text

    @property
    def keep_alive(self) -> bool:
        """Whether the last setpoint is repeated ten times per second; may be set."""
        return self._keep_alive

    @keep_alive.setter
    def keep_alive(self, on: bool) -> None:
        self._keep_alive = on
        self.session.keep_alive(self._target if on else None)

    def arm(self) -> None:
        """Let the board run its pre-flight checks and enable the motor drivers, at 0 V.

        Raises
        ------
        CommandRefused
            A check failed, or the board is not idle; the message names the check and the fix. The motors stay
            off.
        """
        pitch_count_deg = 360.0 / abs(self.params["pitch_counts_per_rev"])
        at_rest = RestAngles.of(self.latest, self.samples(_REST_S), pitch_count_deg)
        self.session.command(ArmMessage(0))
        self._at_rest = at_rest
        self._wait_for_state(State.ARMED)

    def stop(self) -> None:
        """Switch both motors off immediately, in any state, and wait until telemetry shows it. An arm in the
        air falls.

        Raises
        ------
        LinkError
            The board did not answer. Use the rig's own stop switch.
        """
        self._forget_target()
        self.session.command(StopMessage(0))
        self._wait_for_state(State.IDLE, State.FAULT)

    def control(self, axes: Axes = ALL_AXES, front_V: float = 0.0, back_V: float = 0.0) -> None:
        """Close the board's control loops with the arm's present position as the setpoint.

        The motors may turn from now on, but the arm stays where it is until a setpoint moves it.

        Parameters
        ----------
        axes : Axes
            Axes whose loops are closed; travel needs pitch. ``Axes(0)`` drives the motors in open loop.
        front_V, back_V : float
            Motor voltages for the axes that are not closed [V].

        Raises
        ------
        CommandRefused
            The board is not armed, or a value is out of range.
        """
        was_flying = self.session.state is State.CLOSED_LOOP
        self.session.command(ControlMessage(0, int(axes), front_V, back_V))
        self._axes = axes
        if not axes:
            self._forget_target()
            self._wait_for_state(State.OPEN_LOOP)
            return
        if self._target is None or not was_flying:
            self._target = self._target_here()
        self._send_target()
        self._wait_for_state(State.CLOSED_LOOP)

    def hold(self) -> None:
        """Make the arm's present position the setpoint, limited to the setpoints that the board accepts."""
        self._target = self._target_here()
        self._send_target()

    def setpoint(
        self,
        *,
        elevation_deg: float | None = None,
        travel_deg: float | None = None,
        pitch_deg: float | None = None,
        lead_s: float = LEAD_S,
    ) -> None:
        """Send a setpoint, without waiting for an answer or for the motion.

        Parameters
        ----------
        elevation_deg, travel_deg : float or None
            Targets [deg]; None leaves a target unchanged.
        pitch_deg : float or None
            Target [deg]; it has an effect only if the loop of travel is open.
        lead_s : float
            Device time from now in which the board moves the setpoint to the targets, within its slew limits
            [s]; 0 to 0.5.

        Raises
        ------
        SetpointError
            A target is outside the limits that the board's parameters set, or no loop is closed. Nothing was
            sent.
        """
        previous = self._target if self._target is not None else self._target_here()
        options_deg = {"elevation": elevation_deg, "pitch": pitch_deg, "travel": travel_deg}
        targets_deg = {axis: value for axis, value in options_deg.items() if value is not None}
        check_setpoint(targets_deg, self.params)
        if not (isinstance(lead_s, Real) and 0.0 <= lead_s <= MAX_LEAD_S):
            raise SetpointError(f"lead_s is {lead_s!r}", f"give 0 to {MAX_LEAD_S:g} s")
        state = self.session.state
        if state not in _FOLLOWING:
            name = state.name.lower() if state is not None else "not heard yet"
            raise SetpointError(
                f"the board is {name}, and does not follow setpoints", "call take_off() first, or control()"
            )
        apply_tick = self.session.device_tick() + round(lead_s / TICK_S)
        targets_rad = {f"{axis}_rad": float(np.radians(value)) for axis, value in targets_deg.items()}
        self._target = replace(previous, apply_tick=apply_tick & 0xFFFFFFFF, **targets_rad)
        self._send_target()

    def setpoint_limits_deg(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest setpoint [deg] that the board accepts, for ``elevation``,
        ``pitch`` and ``travel``.
        """
        bounds = setpoint_bounds(self.params)
        return {axis: (bound.least_deg, bound.most_deg) for axis, bound in bounds.items()}

    def take_off(
        self, elevation_deg: float = 0.0, *, axes: Axes = ALL_AXES, timeout_s: float | None = None
    ) -> Sample:
        """Arm if idle, close the loops, climb, and wait until the elevation is reached.

        Parameters
        ----------
        elevation_deg : float
            Target [deg]; 0 is level.
        axes : Axes
            Axes whose loops are closed.
        timeout_s : float or None
            Longest climb in device time [s]; None takes the time that the setpoint needs at
            ``elevation_slew_deg_s``, plus 20 s.

        Returns
        -------
        Sample
            First sample after the elevation has been within 2 degrees of the target for 0.3 s.

        Raises
        ------
        SetpointError
            The elevation is outside the limits that the board's parameters set. The motors stay off.
        CommandRefused
            A pre-flight check failed. The motors stay off.
        FlightAborted
            A fault switched the motors off.
        WaitTimeout
            The elevation was not reached in time. The motors keep running: call `land`. The end of the
            ``with`` block lands, too.
        """
        check_setpoint({"elevation": elevation_deg}, self.params)
        if self.state is State.IDLE:
            self.arm()
        self.control(axes)
        self.setpoint(elevation_deg=elevation_deg)
        near_since_s: list[float] = []

        def there_or_off(sample: Sample) -> bool:
            """Whether the arm has stayed at its target for a while, or the motors are off."""
            if abs(sample.elevation_deg - elevation_deg) > _REACHED_DEG:
                near_since_s.clear()
            elif not near_since_s:
                near_since_s.append(sample.t_s)
            stayed = bool(near_since_s) and sample.t_s - near_since_s[0] >= _REACHED_FOR_S
            return stayed or sample.state in (State.FAULT, State.IDLE)

        if timeout_s is None:
            climb_deg = abs(elevation_deg - self.latest.elevation_deg)
            timeout_s = climb_deg / self.params["elevation_slew_deg_s"] + _CLIMB_SPARE_S
        sample = self.wait_until(there_or_off, timeout_s)
        self._abort_on_fault(sample)
        return sample

    def land(self, *, wait: bool = True) -> None:
        """Let the board descend under control and switch the motors off on the table; on an idle board, do
        nothing.

        Parameters
        ----------
        wait : bool
            True returns when the motors are off; False returns when the board has accepted the command.

        Raises
        ------
        FlightAborted
            A fault switched the motors off before the table was reached, or the arm rests at other angles
            than before the take-off.
        """
        if self.state is State.IDLE:
            return
        if not wait:
            self._forget_target()
            self.session.command(LandMessage(0))
        elif trouble := self.bring_down():
            raise FlightAborted(trouble)

    def _target_here(self) -> SetpointMessage:
        """Return a setpoint at the present angles, within the limits, with level pitch."""
        sample, limits = self.latest, self.setpoint_limits_deg()

        def within(axis: str, angle_deg: float) -> float:
            return float(np.radians(np.clip(angle_deg, *limits[axis])))

        tick = self.session.device_tick() & 0xFFFFFFFF
        elevation_rad = within("elevation", sample.elevation_deg)
        return SetpointMessage(tick, elevation_rad, 0.0, within("travel", sample.travel_deg))

    def _send_target(self) -> None:
        if self._target is not None:
            self.session.stream(self._target)
            self.session.keep_alive(self._target if self._keep_alive else None)

    def _forget_target(self) -> None:
        self._target = None
        self.session.keep_alive(None)

    def _end(self, error: BaseException | None) -> None:
        """End the session, after a landing if the arm is in the air; `error` ended the block."""
        if self._closed:
            return
        self._closed = True
        trouble = ""
        try:
            if self.is_in_the_air and (self.land_on_exit or error is not None):
                trouble = self._land_after(error)
            else:
                # The motors of an arm on the table, or of one that the program wants to fall.
                for _ in range(_TRIES):
                    if not self.motors_may_run:
                        break
                    with contextlib.suppress(HeliError):
                        self.stop()
        finally:
            self.session.close()
        if trouble and error is None:
            raise FlightAborted(trouble)

    def _land_after(self, error: BaseException | None) -> str:
        """Land after an error, or at the end of a program, and return what went wrong meanwhile."""
        if error is not None:
            cause = name_of(error) if isinstance(error, KeyboardInterrupt) else type(error).__name__
            announce(f"{cause}: the board lands; Ctrl-C now switches the motors off")
        with Interrupts() as interrupts:
            try:
                trouble = self.bring_down()
            except KeyboardInterrupt as interrupt:
                interrupts.allow_no_more()
                trouble = self.cut_motors(f"{name_of(interrupt)} while landing")
            except HeliError as failure:
                announce(f"{failure.cause}; without a host the board lands by itself")
                trouble = ""
            else:
                # Further interrupts are only recorded: the arm is down.
                interrupts.allow_no_more()
                if error is not None:
                    announce(trouble or "landed")
        if error is not None and trouble:
            error.add_note(trouble)
        return trouble

    def _descend(
        self, restarts: int, on_landing: Callable[[], object] | None, on_wait: Callable[[], object] | None
    ) -> None:
        """Land, and return when the motors are off, the board has restarted, or the time is over."""
        session = self.session
        self._forget_target()
        limit_ticks = round(_LANDING_TIMES * self.params["landing_timeout_s"] / TICK_S)
        since_tick = None

        def state_if_running() -> State | None:
            """Return the state of a board whose motors run; None if they are off."""
            state = session.state
            is_over = session.counters.restarts != restarts or state in _DOWN
            return None if is_over else state

        while (state := state_if_running()) is not None:
            if since_tick is None:
                since_tick = self.latest.tick
                if on_landing is not None and state is not State.ARMED:
                    on_landing()
            if self.latest.tick - since_tick > limit_ticks:
                return
            if state not in _DESCENDING:
                self._begin_descent(state)
            if on_wait is not None:
                on_wait()
            session.wait_for(lambda seen=state: state_if_running() is not seen, _LOOK_S)  # type: ignore[misc]

    def _begin_descent(self, state: State) -> None:
        """Let the board land, or stop the motors if the arm is on the table, and wait until telemetry shows
        it.
        """
        try:
            if self.is_in_the_air:
                self._stop_turning(state)
                self.session.command(LandMessage(0))
            else:
                self.session.command(StopMessage(0))
        except CommandRefused:
            # The board has left the state meanwhile, which the next sample shows.
            self.session.wait_for(lambda: self.session.state is not state, _LOOK_S)
            if self.session.state is state:
                raise
        else:
            self.session.wait_for(lambda: self.session.state is not state, 1.0)

    def _take_hover(self, ticks: Ticks) -> None:
        """Measure the tilt of the hover in the session's reading thread."""
        at_rest = self._at_rest
        if at_rest is not None:
            at_rest.hover.take(ticks)

    def _text_of_fault(self, fault: Fault) -> str:
        """Return the fault of a landing, with its reason if the host knows it better."""
        floating = ""
        if fault is Fault.LANDING_TIMEOUT:
            floating = _float_text(self.samples(2.0 * _FLOAT_LOOK_S), self.params)
        return floating or f"fault {fault_text(fault)}"

    def _stop_turning(self, state: State) -> None:
        """Let the board brake an arm that turns, at the height of the flight.

        A landing closes the loop of travel. If that loop was open, the board then brakes with a large tilt,
        in which the rotors carry the arm badly, and it may lose the fall that brings it onto the table.
        """
        is_free = state is State.STREAMED or (state is State.CLOSED_LOOP and not self._axes & Axes.TRAVEL)
        if not is_free or abs(_turning_deg_s(self.samples(_RATE_S))) < _TURNING_DEG_S:
            return
        self.control()
        # The arm needs this way to stop; a setpoint behind it would look like a following error.
        ahead_deg = self.latest.travel_deg + _BRAKING_S * _turning_deg_s(self.samples(_RATE_S))
        self.setpoint(travel_deg=float(np.clip(ahead_deg, *self.setpoint_limits_deg()["travel"])))
        end_tick = self.latest.tick + round(_BRAKING_TIMEOUT_S / TICK_S)
        while self.state is State.CLOSED_LOOP and self.latest.tick < end_tick:
            if (
                abs(_turning_deg_s(self.samples(_RATE_S))) < _STOPPED_DEG_S
                and abs(self.latest.pitch_deg) < _LEVEL_DEG
            ):
                break
            self.wait(_LOOK_S)
        self._forget_target()

    def _shift_at_rest(self, sample: Sample) -> str:
        """Return the axes whose angles at rest differ from those before the take-off; empty if none does, or
        if this program saw no take-off or no landing.
        """
        before, self._at_rest = self._at_rest, None
        if before is None or sample.trigger not in _LANDED_BY:
            return ""
        while self.state is State.IDLE:
            since_landing = self.samples((self.latest.tick - sample.tick) * TICK_S)
            shift = before.shift_after(since_landing)
            if shift is not None:
                return shift
            self.wait(_REST_LOOK_S)
        return ""

    def _abort_on_fault(self, sample: Sample) -> None:
        if sample.state is State.FAULT:
            raise FlightAborted(f"the board switched the motors off: {fault_text(sample.fault)}")


def _float_text(descent: Samples, parameters: Mapping[str, float]) -> str:
    """Explain a landing that took too long although the motors gave no thrust; empty if they gave some."""
    rows = np.flatnonzero(np.isin(descent.state, _DESCENDING))[-round(_FLOAT_LOOK_S / TICK_S) :]
    if not len(rows):
        return ""
    volts_V = max(float(descent.front_V[rows].mean()), float(descent.back_V[rows].mean()))
    if volts_V > parameters["dead_zone_V"]:
        return ""
    elevation_deg = float(np.degrees(descent.elevation_rad[rows]).mean())
    return (
        f"fault {Fault.LANDING_TIMEOUT}: the arm stayed at {elevation_deg:.1f} degrees, above the table at "
        f"{parameters['elevation_rest_deg']:g}, although the motors gave no thrust: it floats; make the "
        "counterweight lighter, or check what holds the arm"
    )


def _turning_deg_s(recent: Samples) -> float:
    """Return the mean rate of travel [deg/s] of samples; 0 of fewer than two."""
    if len(recent) < 2:
        return 0.0
    turned_deg = float(np.degrees(recent.travel_rad[-1] - recent.travel_rad[0]))
    return turned_deg / (float(recent.tick[-1] - recent.tick[0]) * TICK_S)
