"""The control law a second time: slow, in double precision, from the paper's equations (32)-(34).

Angles in degrees and gains as Table 6 prints them, so that no conversion is shared with the C++.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

TICK_S = 0.001
ELEVATION, PITCH, TRAVEL = 1, 2, 4


def bound(value: float, most: float) -> float:
    return max(-most, min(most, value))


@dataclass
class Loop:
    kp: float
    ki: float
    kd: float
    integral_max: float
    integral: float = 0.0

    def wanted(self, error: float, rate: float) -> float:
        return self.kp * error + self.integral - self.kd * rate

    def learn(self, error: float, excess: float) -> None:
        if error * excess <= 0:
            self.integral = bound(self.integral + self.ki * error * TICK_S, self.integral_max)


@dataclass
class ReferenceLaw:
    """One instance flies one flight; `parameters` by their declared names, in declared units."""

    parameters: Mapping[str, float]
    axes: int | None = None
    jumps: dict[str, float] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)
    elevation: Loop = field(init=False)
    pitch: Loop = field(init=False)
    travel: Loop = field(init=False)

    def __post_init__(self) -> None:
        self._restart(ELEVATION | PITCH | TRAVEL)

    def _restart(self, closing: int) -> None:
        p = self.parameters
        loops = ((ELEVATION, "elevation", "V"), (PITCH, "pitch", "V"), (TRAVEL, "travel", "deg"))
        for bit, axis, unit in loops:
            if closing & bit:
                most = p[f"{axis}_integral_max_{unit}"]
                setattr(self, axis, Loop(p[f"{axis}_kp"], p[f"{axis}_ki"], p[f"{axis}_kd"], most))

    def _without_jump(self, name: str, fresh: float, changed: bool) -> float:
        keep = math.exp(-TICK_S / self.parameters["bumpless_s"])
        self.jumps[name] = self.last.get(name, 0.0) - fresh if changed else self.jumps.get(name, 0.0) * keep
        return fresh + self.jumps[name]

    def _lift(self, motor_V: float) -> float:
        zone = self.parameters["dead_zone_V"]
        return math.copysign(max(abs(motor_V) - zone, 0.0), motor_V)

    def _motor(self, lift_V: float) -> float:
        p = self.parameters
        motor_V = lift_V + p["dead_zone_V"] * bound(lift_V / 0.05, 1.0)
        return max(p["motor_min_V"], min(p["motor_max_V"], motor_V))

    def update(
        self,
        angle_deg: tuple[float, float, float],
        rate_deg_s: tuple[float, float, float],
        setpoint_deg: tuple[float, float, float],
        setpoint_rate_deg_s: tuple[float, float, float],
        setpoint_acceleration_deg_s2: tuple[float, float, float],
        axes: int,
        open_V: tuple[float, float],
        excitation_V: tuple[float, float],
    ) -> tuple[float, float, float]:
        """One tick; returns front and back voltage and the pitch setpoint in degrees."""
        p = self.parameters
        changed = 7 if self.axes is None else axes ^ self.axes
        self.axes = axes
        if axes & (ELEVATION | PITCH) == 0:
            return self._open(changed, open_V, excitation_V, setpoint_deg[1])
        self._restart(axes & changed)
        if axes & changed & PITCH:
            self.last["pitch_setpoint"] = angle_deg[1]

        fresh = (
            p["travel_acceleration_ff"] * setpoint_acceleration_deg_s2[2]
            + self.travel.wanted(
                setpoint_deg[2] - angle_deg[2],
                rate_deg_s[2] - p["travel_rate_ff"] * setpoint_rate_deg_s[2],
            )
            if axes & TRAVEL
            else setpoint_deg[1]
        )
        wanted = self._without_jump("pitch_setpoint", fresh, bool(changed & (TRAVEL | PITCH)))
        limited = bound(wanted, p["pitch_setpoint_max_deg"])
        before = self.last.get("pitch_setpoint", 0.0)
        pitch_setpoint = before + bound(limited - before, p["pitch_slew_deg_s"] * TICK_S)
        self.last["pitch_setpoint"] = pitch_setpoint

        lifts = [self._lift(v) for v in open_V]
        elevation_error = setpoint_deg[0] - angle_deg[0]
        pitch_error = pitch_setpoint - angle_deg[1]
        braked_deg_s = rate_deg_s[0] - p["elevation_rate_ff"] * setpoint_rate_deg_s[0]
        feed_forward_V = (
            p["hover_V"]
            + p["hover_slope"] * setpoint_deg[0]
            + p["elevation_acceleration_ff"] * setpoint_acceleration_deg_s2[0]
        )
        closed_V = feed_forward_V + self.elevation.wanted(elevation_error, braked_deg_s)
        plus = closed_V if axes & ELEVATION else sum(lifts)
        minus = (
            p["pitch_hold_ff"] * pitch_setpoint + self.pitch.wanted(pitch_error, rate_deg_s[1])
            if axes & PITCH
            else lifts[0] - lifts[1]
        )
        plus = self._without_jump("plus", plus, bool(changed & ELEVATION))
        minus = self._without_jump("minus", minus, bool(changed & PITCH))

        extra_plus = excitation_V[0] + excitation_V[1]
        extra_minus = excitation_V[0] - excitation_V[1]
        least, most = self._lift(p["motor_min_V"]), self._lift(p["motor_max_V"])
        acted_minus = bound(minus + extra_minus, min(most - least, p["differential_max_V"]))
        acted_plus = max(2 * least + abs(acted_minus), min(2 * most - abs(acted_minus), plus + extra_plus))
        self.last["plus"] = acted_plus - extra_plus
        self.last["minus"] = acted_minus - extra_minus

        excess_minus = minus + extra_minus - acted_minus
        if axes & ELEVATION:
            self.elevation.learn(elevation_error, plus + extra_plus - acted_plus)
        if axes & PITCH:
            self.pitch.learn(pitch_error, excess_minus)
        if axes & TRAVEL:
            excess = wanted - pitch_setpoint
            self.travel.learn(setpoint_deg[2] - angle_deg[2], excess if excess != 0 else excess_minus)
        front = self._motor((acted_plus + acted_minus) / 2)
        back = self._motor((acted_plus - acted_minus) / 2)
        self.last["front"], self.last["back"] = front, back
        return front, back, pitch_setpoint

    def _open(
        self, changed: int, open_V: tuple[float, float], excitation_V: tuple[float, float], pitch_deg: float
    ) -> tuple[float, float, float]:
        p = self.parameters
        acted = []
        for name, volts, extra in zip(("front", "back"), open_V, excitation_V, strict=True):
            self.last[name] = self._without_jump(name, volts, changed != 0)
            acted.append(max(p["motor_min_V"], min(p["motor_max_V"], self.last[name] + extra)))
        lifts = [self._lift(self.last["front"]), self._lift(self.last["back"])]
        self.last["plus"], self.last["minus"] = sum(lifts), lifts[0] - lifts[1]
        return acted[0], acted[1], pitch_deg
