"""The flying part of a helicopter: arm, close the loops, and move the setpoint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from numbers import Real
from operator import or_
from typing import Final

import numpy as np

from heli_host.board.rest_check import RestAngles
from heli_host.board.samples import Sample
from heli_host.board.setpoints import check_setpoint, setpoint_bounds
from heli_host.board.telemetry import Telemetry
from heli_host.declaration import ArmMessage, Axes, ControlMessage, SetpointMessage, State, StopMessage
from heli_host.errors import FlightAborted, SetpointError, fault_text
from heli_host.link.clock import TICK_S
from heli_host.link.telemetry import Ticks

ALL_AXES: Final = reduce(or_, Axes)
LEAD_S: Final = 0.04
MAX_LEAD_S: Final = 0.5
MOTORS_OFF: Final = (State.IDLE, State.FAULT)

_CLIMB_SPARE_S = 20.0
"""Time for which a climb may lag behind its setpoint [s]; the shipped rigs need less than 3 s."""
_REST_S = 0.5
_REACHED_DEG = 2.0
_REACHED_FOR_S = 0.3
_FOLLOWING = (State.CLOSED_LOOP, State.HOLD)
"""States in which a setpoint has an effect: fresh ones end the hold."""


class Flying:
    """Commands of a flight under the board's own control loops.

    Attributes: `axes`, whose loops were closed last; `at_rest`, the angles before the take-off; `target`, the
    last setpoint.
    """

    def __init__(self, telemetry: Telemetry, *, keep_alive: bool) -> None:
        self.telemetry = telemetry
        self.session = telemetry.session
        self.params = telemetry.params
        self.axes = ALL_AXES
        self.at_rest: RestAngles | None = None
        self.target: SetpointMessage | None = None
        self._keep_alive = keep_alive
        self.session.subscribe_ticks(self._take_hover)

    @property
    def keep_alive(self) -> bool:
        """Whether the last setpoint is repeated ten times per second."""
        return self._keep_alive

    @keep_alive.setter
    def keep_alive(self, on: bool) -> None:
        self._keep_alive = on
        self.session.keep_alive(self.target if on else None)

    def arm(self) -> None:
        """Let the board run its checks and enable the motor drivers, and remember the angles at rest."""
        pitch_count_deg = 360.0 / abs(self.params["pitch_counts_per_rev"])
        samples = self.telemetry.samples(_REST_S)
        at_rest = RestAngles.of(self.telemetry.latest, samples, pitch_count_deg)
        self.session.command(ArmMessage(0))
        self.at_rest = at_rest
        self.session.wait_for_state(State.ARMED)

    def stop(self) -> None:
        """Switch both motors off immediately, and wait until telemetry shows it."""
        self.forget_target()
        self.session.command(StopMessage(0))
        self.session.wait_for_state(*MOTORS_OFF)

    def control(self, axes: Axes = ALL_AXES, front_V: float = 0.0, back_V: float = 0.0) -> None:
        """Close the loops of `axes` at the arm's present position, or drive the motors in open loop."""
        was_flying = self.session.state is State.CLOSED_LOOP
        self.session.command(ControlMessage(0, int(axes), front_V, back_V))
        self.axes = axes
        if not axes:
            self.forget_target()
            self.session.wait_for_state(State.OPEN_LOOP)
            return
        if self.target is None or not was_flying:
            self.target = self._target_here()
        self._send_target()
        self.session.wait_for_state(State.CLOSED_LOOP)

    def hold(self) -> None:
        """Make the arm's present position the setpoint, within the setpoints that the board accepts."""
        self.target = self._target_here()
        self._send_target()

    def setpoint(self, targets_deg: dict[str, float], lead_s: float = LEAD_S) -> None:
        """Send a setpoint [deg] of some axes, to be reached `lead_s` from now; the other axes keep theirs."""
        previous = self.target if self.target is not None else self._target_here()
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
        self.target = replace(previous, apply_tick=apply_tick & 0xFFFFFFFF, **targets_rad)
        self._send_target()

    def setpoint_limits_deg(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest setpoint of each axis that the board accepts [deg]."""
        bounds = setpoint_bounds(self.params)
        return {axis: (bound.least_deg, bound.most_deg) for axis, bound in bounds.items()}

    def climb(
        self, elevation_deg: float, arm: Callable[[], None], axes: Axes, timeout_s: float | None
    ) -> Sample:
        """Call `arm` if the board is idle, close the loops, climb, and wait until the arm is there."""
        check_setpoint({"elevation": elevation_deg}, self.params)
        if self.telemetry.latest.state is State.IDLE:
            arm()
        self.control(axes)
        self.setpoint({"elevation": elevation_deg})
        near_since_s: list[float] = []

        def there_or_off(sample: Sample) -> bool:
            """Whether the arm has stayed at its target for a while, or the motors are off."""
            if abs(sample.elevation_deg - elevation_deg) > _REACHED_DEG:
                near_since_s.clear()
            elif not near_since_s:
                near_since_s.append(sample.t_s)
            stayed = bool(near_since_s) and sample.t_s - near_since_s[0] >= _REACHED_FOR_S
            return stayed or sample.state in MOTORS_OFF

        if timeout_s is None:
            climb_deg = abs(elevation_deg - self.telemetry.latest.elevation_deg)
            timeout_s = climb_deg / self.params["elevation_slew_deg_s"] + _CLIMB_SPARE_S
        sample = self.telemetry.wait_until(there_or_off, timeout_s)
        if sample.state is State.FAULT:
            raise FlightAborted(f"the board switched the motors off: {fault_text(sample.fault)}")
        return sample

    def forget_target(self) -> None:
        """Send no setpoints any more."""
        self.target = None
        self.session.keep_alive(None)

    def _target_here(self) -> SetpointMessage:
        """Return a setpoint at the present angles, within the limits, with level pitch."""
        sample, limits = self.telemetry.latest, self.setpoint_limits_deg()

        def within(axis: str, angle_deg: float) -> float:
            return float(np.radians(np.clip(angle_deg, *limits[axis])))

        tick = self.session.device_tick() & 0xFFFFFFFF
        elevation_rad = within("elevation", sample.elevation_deg)
        return SetpointMessage(tick, elevation_rad, 0.0, within("travel", sample.travel_deg))

    def _send_target(self) -> None:
        if self.target is not None:
            self.session.stream(self.target)
            self.session.keep_alive(self.target if self._keep_alive else None)

    def _take_hover(self, ticks: Ticks) -> None:
        """Measure the tilt of the hover in the session's reading thread."""
        at_rest = self.at_rest
        if at_rest is not None:
            at_rest.hover.take(ticks)
