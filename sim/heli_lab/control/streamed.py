"""A control law that runs on the host and streams voltages over the link."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.declaration import AXES, LAW_INPUTS
from heli_host.link.clock import TICK_S


class _RateFilter:
    """Estimates the rate of a signal by two low-pass filters in series, as in firmware/core/control."""

    def __init__(self, cutoff_Hz: float) -> None:
        self.cutoff_Hz = cutoff_Hz
        # Outputs of the two filters; None before the first value.
        self.first_output: float | None = None
        self.second_output = 0.0

    def __call__(self, value: float, dt_s: float) -> float:
        """Return the rate [1/s] after the next value, `dt_s` [s] after the last one."""
        if self.first_output is None:
            self.first_output = self.second_output = value
        smoothing = 1.0 - math.exp(-2.0 * math.pi * self.cutoff_Hz * dt_s)
        self.first_output += smoothing * (value - self.first_output)
        step = smoothing * (self.first_output - self.second_output)
        self.second_output += step
        return step / dt_s


class _Shaper:
    """Moves a setpoint to its target within limits of rate and acceleration, as on the board."""

    def __init__(self, rate_rad_s: float, acceleration_rad_s2: float) -> None:
        self.rate_rad_s, self.acceleration_rad_s2 = rate_rad_s, acceleration_rad_s2
        self.angle_rad: float | None = None
        self.present_rad_s = 0.0

    def __call__(self, target_rad: float, measured_rad: float, dt_s: float) -> float:
        """Return the setpoint [rad] after `dt_s` [s]; the first one starts at the measured angle."""
        if self.angle_rad is None:
            self.angle_rad = measured_rad
        remaining_rad = target_rad - self.angle_rad
        step_rad_s = self.acceleration_rad_s2 * dt_s
        # Largest rate from which the setpoint can still stop at the target. Braking begins half a step early,
        # so that it ends at the target and not behind.
        braking_rad_s = math.sqrt(2.0 * self.acceleration_rad_s2 * abs(remaining_rad) + (step_rad_s / 2) ** 2)
        fastest_rad_s = min(self.rate_rad_s, braking_rad_s - step_rad_s / 2, abs(remaining_rad) / dt_s)
        change_rad_s = math.copysign(fastest_rad_s, remaining_rad) - self.present_rad_s
        self.present_rad_s += min(max(change_rad_s, -step_rad_s), step_rad_s)
        self.angle_rad += self.present_rad_s * dt_s
        return self.angle_rad


class Streamed:
    """A law as a controller for `heli_host.Heli.run_controller`."""

    # The board has no setpoints while voltages are streamed. The setpoints are therefore those given to
    # `follow`, shaped here as the board would. The number of steps of the law depends on the times of the
    # samples: a law of 1 kHz that is called at 200 Hz takes five steps per call, with the same inputs.

    def __init__(self, runner: Callable[[Floats], Floats], dt_s: float, params: Mapping[str, float]) -> None:
        self._runner = runner
        self._dt_s = dt_s
        self._angle_filter = {axis: _RateFilter(params[f"{axis}_filter_Hz"]) for axis in AXES}
        self._setpoint_filter = {axis: _RateFilter(params[f"{axis}_filter_Hz"]) for axis in AXES}
        self._setpoint_rate_filter = {axis: _RateFilter(params[f"{axis}_filter_Hz"]) for axis in AXES}
        self._shaper = {
            axis: _Shaper(
                math.radians(params[f"{axis}_slew_deg_s"]),
                math.radians(params[f"{axis}_acceleration_deg_s2"]),
            )
            for axis in ("elevation", "travel")
        }
        self._target_rad = dict.fromkeys(AXES, 0.0)
        self._tick: int | None = None
        self.setpoints_rad: Mapping[str, float] = dict.fromkeys(AXES, 0.0)

    def follow(self, **target_rad: float) -> None:
        """Set the targets of the setpoints."""
        self._target_rad.update(target_rad)

    def __call__(self, sample: Any) -> tuple[float, float]:
        """Return the voltages of the front and the back motor [V]."""
        elapsed_s = self._dt_s if self._tick is None else (sample.tick - self._tick) * TICK_S
        self._tick = sample.tick
        values: dict[str, float] = {}
        for axis in AXES:
            angle_rad, setpoint_rad = getattr(sample, f"{axis}_rad"), self._target_rad[axis]
            shaper = self._shaper.get(axis)
            if shaper is not None:
                setpoint_rad = shaper(setpoint_rad, angle_rad, elapsed_s)
            setpoint_rad_s = self._setpoint_filter[axis](setpoint_rad, elapsed_s)
            values[f"{axis}_rad"] = angle_rad
            values[f"{axis}_rad_s"] = self._angle_filter[axis](angle_rad, elapsed_s)
            values[f"{axis}_setpoint_rad"] = setpoint_rad
            values[f"{axis}_setpoint_rad_s"] = setpoint_rad_s
            values[f"{axis}_setpoint_rad_s2"] = self._setpoint_rate_filter[axis](setpoint_rad_s, elapsed_s)
        values["front_V"], values["back_V"] = sample.front_V, sample.back_V
        inputs = np.array([values[name] for name in LAW_INPUTS])
        for _ in range(max(1, round(elapsed_s / self._dt_s))):
            outputs = self._runner(inputs)
        self.setpoints_rad = dict(zip(AXES, (float(value) for value in outputs[2:5]), strict=True))
        return float(outputs[0]), float(outputs[1])
