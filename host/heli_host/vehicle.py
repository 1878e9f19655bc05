"""The vehicle behind a session: arm, setpoint, take off, land, stop; degrees and volts in, samples out."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from types import TracebackType
from typing import Self

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

LEAD_S = 0.04
MOST_LEAD_S = 0.5

_STOP_TRIES = 3
_REACHED_DEG = 2.0
_REACHED_FOR_S = 0.3
_FOLLOWING = (State.CLOSED_LOOP, State.HOLD)
"""States in which a setpoint has an effect: fresh ones end the hold."""


class Vehicle(OpenLoopCommands):
    """A helicopter behind an open session; what flies plans and control laws stands on it.

    As a context manager it ends with the motors off: leaving the block while they may run sends ``stop``, and
    an arm in the air falls. ``land_on_exit=True`` lands first, when the block ends without an error.

    A method that changes the state returns when the board's telemetry shows it. Callbacks run in the reading
    thread; they may read samples and send setpoints, but should not wait.

    Parameters
    ----------
    keep_alive : bool
        Send the last setpoint again ten times a second. The board's failsafe is there for a host that died or
        hangs, and a person between two cells of a notebook is neither. False: after ``setpoint_hold_s``
        without a setpoint the board hovers level, after ``setpoint_land_s`` it lands.
    land_on_exit : bool
        Land before the motors are switched off at the end.
    history_s : float
        How much `samples` keeps [s].

    Attributes
    ----------
    land_on_exit : bool
        As above; may be changed.
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
        """Switch the motors off if they may be on, and let go of the board; harmless when called twice."""
        if self._closed:
            return
        self._closed = True
        try:
            for _ in range(_STOP_TRIES):
                if not self.motors_may_run:
                    break
                # An error of a callback that waits to be told must not keep the motors running.
                with contextlib.suppress(HeliError):
                    self.stop()
        finally:
            self.session.close()

    @property
    def keep_alive(self) -> bool:
        """Whether the last setpoint is sent again ten times a second; may be set."""
        return self._keep_alive

    @keep_alive.setter
    def keep_alive(self, on: bool) -> None:
        self._keep_alive = on
        self.session.keep_alive(self._target if on else None)

    def arm(self) -> None:
        """Run the pre-flight checks and enable the motor drivers, at zero voltage.

        Raises
        ------
        CommandRefused
            A check failed, or the board is not idle; the message says which and what to do.
        """
        self.session.command(ArmMessage(0))
        self._wait_for_state(State.ARMED)

    def stop(self) -> None:
        """Switch the motors off at once, in any state; an arm in the air falls.

        Raises
        ------
        LinkError
            The board did not answer.
        """
        self._forget_target()
        self.session.command(StopMessage(0))
        self._wait_for_state(State.IDLE, State.FAULT)

    def control(self, axes: Axes = ALL_AXES, front_V: float = 0.0, back_V: float = 0.0) -> None:
        """Close the on-board loops, where the arm is now: nothing moves until a setpoint says so.

        Parameters
        ----------
        axes : Axes
            Axes to close; travel needs pitch. ``Axes(0)`` is open loop.
        front_V, back_V : float
            Voltages for the axes that are not closed [V].

        Raises
        ------
        CommandRefused
            Not armed, or a value out of range.
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
        """Stay where the arm is now: makes its present position the setpoint."""
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
        """Send a setpoint; what is not given stays as it was.

        Parameters
        ----------
        elevation_deg, travel_deg : float or None
            Targets [deg].
        pitch_deg : float or None
            Target [deg]; used only while travel is not closed.
        lead_s : float
            Device time from now in which the board ramps there, within its slew limits [s]; at most 0.5.

        Raises
        ------
        SetpointError
            A target lies outside the limits in force on the board, or its loops are not closed, so that
            nothing would follow; nothing was sent.
        """
        before = self._target if self._target is not None else self._target_here()
        given = {"elevation": elevation_deg, "pitch": pitch_deg, "travel": travel_deg}
        targets_deg = {axis: value for axis, value in given.items() if value is not None}
        check_setpoint(targets_deg, self.params)
        if not 0.0 <= lead_s <= MOST_LEAD_S:
            raise SetpointError(f"a lead of {lead_s:g} s is too long", f"give 0 to {MOST_LEAD_S:g} s")
        state = self.session.state
        if state not in _FOLLOWING:
            name = state.name.lower() if state is not None else "not heard yet"
            raise SetpointError(
                f"the board is {name}, and does not follow setpoints", "call take_off() first, or control()"
            )
        apply_tick = self.session.device_tick() + round(lead_s / TICK_S)
        targets_rad = {f"{axis}_rad": float(np.radians(value)) for axis, value in targets_deg.items()}
        self._target = replace(before, apply_tick=apply_tick & 0xFFFFFFFF, **targets_rad)
        self._send_target()

    def setpoint_limits_deg(self) -> dict[str, tuple[float, float]]:
        """Return the setpoints that the board takes, as its parameters say: least and most of ``elevation``,
        ``pitch`` and ``travel``.
        """
        bounds = setpoint_bounds(self.params)
        return {axis: (bound.least_deg, bound.most_deg) for axis, bound in bounds.items()}

    def take_off(
        self, elevation_deg: float = 0.0, *, axes: Axes = ALL_AXES, timeout_s: float = 20.0
    ) -> Sample:
        """Arm if idle, close the loops, climb, and wait until it is there.

        Parameters
        ----------
        elevation_deg : float
            Where to [deg].
        axes : Axes
            Axes to close.
        timeout_s : float
            Longest climb in device time [s].

        Returns
        -------
        Sample
            Of the moment at which the elevation had stayed within 2 degrees for 0.3 s.

        Raises
        ------
        SetpointError
            The elevation lies outside the limits in force on the board; nothing was armed.
        CommandRefused
            A pre-flight check failed.
        FlightAborted
            A fault switched the motors off.
        WaitTimeout
            It did not get there in time.
        """
        check_setpoint({"elevation": elevation_deg}, self.params)
        if self.state is State.IDLE:
            self.arm()
        self.control(axes)
        self.setpoint(elevation_deg=elevation_deg)
        near_since_s: list[float] = []

        def there_or_off(sample: Sample) -> bool:
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
        """Descend under control, then motors off.

        Parameters
        ----------
        wait : bool
            Return when the motors are off; otherwise at once.
        timeout_s : float or None
            Longest wait in device time [s]; None: the board's ``landing_timeout_s`` and some more.

        Raises
        ------
        FlightAborted
            A fault switched the motors off before the table was reached.
        WaitTimeout
            It takes too long.
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
