"""The flying part of a helicopter: arm, close the loops, and move the setpoint within its limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from numbers import Real
from operator import or_
from typing import Final

import numpy as np

from heli_host.board.rest_check import RestAngles
from heli_host.board.samples import Sample, Samples
from heli_host.board.telemetry import Telemetry
from heli_host.declaration import (
    SETPOINT_MARGIN_DEG,
    ArmMessage,
    Axes,
    ControlMessage,
    Fault,
    SetpointMessage,
    State,
    StopMessage,
)
from heli_host.errors import CommandRefused, FlightAborted, SetpointError, fault_text
from heli_host.link.clock import TICK_S
from heli_host.link.engine import UNNUMBERED
from heli_host.link.telemetry import Ticks


@dataclass(frozen=True)
class Bounds:
    """Bounds of one axis' setpoint, both included."""

    least_deg: float  # least_deg, most_deg: The bounds [deg]
    most_deg: float
    least_name: str  # least_name, most_name: The parameters that they come from, for messages
    most_name: str


def setpoint_bounds(parameters: Mapping[str, float]) -> dict[str, Bounds]:
    """Return what the board takes, by its `parameters`."""
    margin_deg = SETPOINT_MARGIN_DEG
    inside_deg = {name: parameters[name] - margin_deg[name] for name in margin_deg}
    inside_name = {name: f"{name} - {margin_deg[name]:g}" for name in margin_deg}
    pitch_deg = parameters["pitch_setpoint_max_deg"]
    travel_deg, travel_name = inside_deg["travel_max_deg"], inside_name["travel_max_deg"]
    return {
        "elevation": Bounds(
            inside_deg["elevation_rest_deg"],
            inside_deg["elevation_max_deg"],
            inside_name["elevation_rest_deg"],
            inside_name["elevation_max_deg"],
        ),
        "pitch": Bounds(-pitch_deg, pitch_deg, "-pitch_setpoint_max_deg", "pitch_setpoint_max_deg"),
        "travel": Bounds(-travel_deg, travel_deg, f"-({travel_name})", travel_name),
    }


def check_setpoint(targets_deg: Mapping[str, float], parameters: Mapping[str, float]) -> None:
    """Refuse targets that the board would refuse."""
    bounds = setpoint_bounds(parameters)
    for axis, value_deg in targets_deg.items():
        _check_number(f"{axis} setpoint", value_deg, "degrees")
        least_deg, most_deg = bounds[axis].least_deg, bounds[axis].most_deg
        if not least_deg <= value_deg <= most_deg:
            raise SetpointError(
                f"{axis} setpoint of {value_deg:g} degrees is outside the board's limits",
                f"give {least_deg:g} to {most_deg:g} degrees",
            )


def check_voltages(front_V: float, back_V: float, parameters: Mapping[str, float]) -> None:
    """Refuse `front_V` and `back_V` unless the board takes both by its `parameters`: SetpointError."""
    for motor, value_V in (("front", front_V), ("back", back_V)):
        _check_number(f"{motor} voltage", value_V, "volts")
    least_V, most_V = parameters["motor_min_V"], parameters["motor_max_V"]
    if not (least_V <= front_V <= most_V and least_V <= back_V <= most_V):
        raise SetpointError(
            f"voltages {front_V:g} and {back_V:g} V are outside the board's limits",
            f"give {least_V:g} to {most_V:g} V, or set motor_min_V and motor_max_V",
        )


def _check_number(name: str, value: object, unit: str) -> None:
    """Refuse a value that is not a number, such as a text: SetpointError."""
    if not isinstance(value, Real):
        raise SetpointError(f"the {name} is {value!r}, not a number", f"give a number of {unit}, such as 3.0")


ALL_AXES: Final = reduce(or_, Axes)
LEAD_S: Final = 0.04
MAX_LEAD_S: Final = 0.5
MOTORS_OFF: Final = (State.IDLE, State.FAULT)

_CLIMB_SPARE_S = 20.0
"""Time for which a climb may lag behind its setpoint [s]; the shipped rigs need less than 3 s."""
_REST_S = 2.0
"""Length of the look at the angles before the take-off [s]. In half a second, a short arm that drifts at
0.2 deg/s, because nothing brings it back to a rest, turns by one count only."""
_STILL_S = 0.5
_STILL_RETRY_S = 0.05
"""Time for which arming is tried while an axis moves, and the pause between two tries [s]. A single count of
a short arm that drifts slowly looks like 3 deg/s, which is the limit, for a few ticks."""
_REACHED_DEG = 2.0
_REACHED_FOR_S = 0.3
_FOLLOWING = (State.CLOSED_LOOP, State.HOLD)
"""States in which a setpoint has an effect: fresh ones end the hold."""


class Flying:
    """Commands of a flight under the board's own control loops."""

    # Attributes: `axes`, whose loops were closed last; `at_rest`, the angles before the take-off; `target`,
    # the last setpoint.

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
        """Remember the angles at rest, and let the board run its checks and enable the motor drivers."""
        pitch_count_deg = 360.0 / abs(self.params["pitch_counts_per_rev"])
        at_rest = RestAngles.of(self.telemetry.latest, self._samples_at_rest(), pitch_count_deg)
        self._arm_when_still()
        self.at_rest = at_rest
        self.session.wait_for_state(State.ARMED)

    def _arm_when_still(self) -> None:
        """Send the command; again for a moment if the board refuses it because an axis moves."""
        end_tick = self.telemetry.latest.tick + _STILL_S / TICK_S
        while True:
            try:
                self.session.command(ArmMessage(UNNUMBERED))
                return
            except CommandRefused as refused:
                if refused.fault is not Fault.MOVING or self.telemetry.latest.tick >= end_tick:
                    raise
            self.session.wait(_STILL_RETRY_S)

    def _samples_at_rest(self) -> Samples:
        """Return the samples before the take-off; wait for some more if pitch changes, as it may drift."""
        samples = self.telemetry.samples(_REST_S)
        missing_s = _REST_S - len(samples) * TICK_S
        if missing_s > 0.0 and len(samples) and np.ptp(samples.pitch_rad) > 0.0:
            self.session.wait(missing_s)
            samples = self.telemetry.samples(_REST_S)
        return samples

    def stop(self) -> None:
        """Switch both motors off immediately, and wait until telemetry shows it."""
        self.forget_target()
        self.session.command(StopMessage(UNNUMBERED))
        self.session.wait_for_state(*MOTORS_OFF)

    def control(self, axes: Axes = ALL_AXES, front_V: float = 0.0, back_V: float = 0.0) -> None:
        """Close the loops of `axes` at the arm's present position, or drive the motors in open loop."""
        was_flying = self.session.state is State.CLOSED_LOOP
        self.session.command(ControlMessage(UNNUMBERED, int(axes), front_V, back_V))
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
        self.session.check()
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
        self, elevation_deg: float, enable_motors: Callable[[], None], axes: Axes, timeout_s: float | None
    ) -> Sample:
        """Call `enable_motors` if the board is idle, close the loops, climb, and wait until the arm has
        reached the elevation.
        """
        check_setpoint({"elevation": elevation_deg}, self.params)
        if self.telemetry.latest.state is State.IDLE:
            enable_motors()
        self.control(axes)
        self.setpoint({"elevation": elevation_deg})
        near_since_s: float | None = None

        def is_there_or_off(sample: Sample) -> bool:
            """Whether the arm has stayed at its target for a while, or the motors are off."""
            nonlocal near_since_s
            if abs(sample.elevation_deg - elevation_deg) > _REACHED_DEG:
                near_since_s = None
            elif near_since_s is None:
                near_since_s = sample.t_s
            has_stayed = near_since_s is not None and sample.t_s - near_since_s >= _REACHED_FOR_S
            return has_stayed or sample.state in MOTORS_OFF

        if timeout_s is None:
            climb_deg = abs(elevation_deg - self.telemetry.latest.elevation_deg)
            timeout_s = climb_deg / self.params["elevation_slew_deg_s"] + _CLIMB_SPARE_S
        sample = self.telemetry.wait_until(is_there_or_off, timeout_s)
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
        return SetpointMessage(
            apply_tick=tick,
            elevation_rad=elevation_rad,
            pitch_rad=0.0,
            travel_rad=within("travel", sample.travel_deg),
        )

    def _send_target(self) -> None:
        if self.target is not None:
            self.session.stream(self.target)
            self.session.keep_alive(self.target if self._keep_alive else None)

    def _take_hover(self, ticks: Ticks) -> None:
        """Measure the tilt of the hover in the session's reading thread."""
        at_rest = self.at_rest
        if at_rest is not None:
            at_rest.hover.take(ticks)
