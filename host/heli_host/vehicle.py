"""The vehicle of a session: arm, setpoint, take off, land, stop; in degrees and volts."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from types import TracebackType
from typing import Literal, Self

import numpy as np

from heli_host.declaration import (
    ArmMessage,
    Axes,
    ControlMessage,
    LandMessage,
    SetpointMessage,
    State,
    StopMessage,
)
from heli_host.errors import FlightAborted, HeliError, SetpointError, fault_text
from heli_host.link.clock import TICK_S
from heli_host.link.session import Session
from heli_host.open_loop import ALL_AXES, OpenLoopCommands
from heli_host.samples import Sample
from heli_host.setpoints import check_setpoint, setpoint_bounds
from heli_host.telemetry_view import HISTORY_S

AfterLaw = Literal["hold", "land", "stop"]
"""Action of the board when a control law of the host, or an uploaded one, has ended."""
LEAD_S = 0.04
MAX_LEAD_S = 0.5

_STOP_TRIES = 3
_REACHED_DEG = 2.0
_REACHED_FOR_S = 0.3
_FOLLOWING = (State.CLOSED_LOOP, State.HOLD)
"""States in which a setpoint has an effect: fresh ones end the hold."""


class Vehicle(OpenLoopCommands):
    """A helicopter with an open session: the commands that flights of plans and control laws are built on.

    Leaving its ``with`` block, or `close`, switches the motors off if they may be on: an arm in the air
    falls. With ``land_on_exit=True`` it lands first, if the block ends without an error.

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
        Land before the motors are switched off at the end.
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
        land_on_exit: bool = False,
        history_s: float = HISTORY_S,
    ) -> None:
        self.land_on_exit = land_on_exit
        self._keep_alive = keep_alive
        self._target: SetpointMessage | None = None
        self._closed = False
        super().__init__(session, history_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self.land_on_exit and kind is None and self.motors_may_run:
                self.land()
        finally:
            self.close()

    def close(self) -> None:
        """Switch the motors off if they may be on, then end the session; a second call does nothing.

        The stop is tried three times. If the board does not answer, the motors are not confirmed to be off:
        the board then misses its setpoints, holds level and lands.
        """
        if self._closed:
            return
        self._closed = True
        try:
            for _ in range(_STOP_TRIES):
                if not self.motors_may_run:
                    break
                # A pending error of a callback must not keep the motors running.
                with contextlib.suppress(HeliError):
                    self.stop()
        finally:
            self.session.close()

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
        self.session.command(ArmMessage(0))
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
        if not 0.0 <= lead_s <= MAX_LEAD_S:
            raise SetpointError(f"a lead of {lead_s:g} s is too long", f"give 0 to {MAX_LEAD_S:g} s")
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
        self, elevation_deg: float = 0.0, *, axes: Axes = ALL_AXES, timeout_s: float = 20.0
    ) -> Sample:
        """Arm if idle, close the loops, climb, and wait until the elevation is reached.

        Parameters
        ----------
        elevation_deg : float
            Target [deg]; 0 is level.
        axes : Axes
            Axes whose loops are closed.
        timeout_s : float
            Longest climb in device time [s].

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
            The elevation was not reached in time. The motors keep running: call `land` or `stop`.
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

        sample = self.wait_until(there_or_off, timeout_s)
        self._abort_on_fault(sample)
        return sample

    def land(self, *, wait: bool = True, timeout_s: float | None = None) -> None:
        """Let the board descend under control and switch the motors off on the table; on an idle board, do
        nothing.

        Parameters
        ----------
        wait : bool
            True returns when the motors are off; False returns when the board has accepted the command.
        timeout_s : float or None
            Longest wait in device time [s]; None takes the board's ``landing_timeout_s`` plus 3 s.

        Raises
        ------
        FlightAborted
            A fault switched the motors off before the table was reached.
        WaitTimeout
            The motors were not off in time; they may still run: call `stop`.
        """
        if self.state is State.IDLE:
            return
        self._forget_target()
        self.session.command(LandMessage(0))
        if wait:
            timeout_s = self.params["landing_timeout_s"] + 3.0 if timeout_s is None else timeout_s
            sample = self.wait_until(lambda s: s.state in (State.IDLE, State.FAULT), timeout_s)
            self._abort_on_fault(sample)

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

    def _abort_on_fault(self, sample: Sample) -> None:
        if sample.state is State.FAULT:
            raise FlightAborted(f"the board switched the motors off: {fault_text(sample.fault)}")
