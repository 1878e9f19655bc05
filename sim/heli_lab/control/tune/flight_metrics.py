"""Measure the performance of gains in a test flight: take-off, a travel step and back, sines.

Overshoot and settling time are those of `heli_host.data.response`, relative to the planned path.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_host.data.flight import Flight
from heli_host.data.response import count_rad, rms, step_metrics

from heli_lab.control.tune.design import TRAVEL_STEP_DEG


@dataclass(frozen=True)
class Phases:
    """Times of the phases of a test flight, on the flight's time axis [s]."""

    take_off_s: float
    """take_off_s, step_s, back_s, sine_s, end_s: Beginning of the take-off, of the travel step, of the step
    back and of the sines; end of the sines."""
    step_s: float
    back_s: float
    sine_s: float
    end_s: float


@dataclass(frozen=True)
class FlightMetrics:
    """Performance of a set of gains in a test flight."""

    outcome: str  # ``completed``, or the reason why the flight ended
    take_off_s: float  # Settling time of the take-off; infinite if it never settles
    overshoot_percent: float  # Overshoot of the travel step, the larger one of both directions
    settling_time_s: float
    """Settling time of the travel step, the longer one of both directions; infinite if it never settles."""
    travel_rms_deg: float  # travel_rms_deg, elevation_rms_deg: RMS tracking error along the sines
    elevation_rms_deg: float
    pitch_max_deg: float  # Largest absolute pitch


def flight_metrics(
    flight: Flight, path_deg: Callable[[Floats], Floats], phases: Phases, outcome: str
) -> FlightMetrics:
    """Measure a test flight; metrics of phases that it did not reach are infinite."""
    t_s, angles_deg = flight.t_s, np.rad2deg(flight.angles_rad)
    elevation, pitch, travel = angles_deg.T
    in_take_off = _rows_between(t_s, phases.take_off_s, phases.step_s)
    in_step = _rows_between(t_s, phases.step_s, phases.back_s)
    in_step_back = _rows_between(t_s, phases.back_s, phases.sine_s)
    in_sines = _rows_between(t_s, phases.sine_s, phases.end_s)
    error_deg = angles_deg[in_sines] - path_deg(t_s[in_sines])
    elevation_count_deg, _, travel_count_deg = np.rad2deg(count_rad(flight)).tolist()
    steps = [
        step_metrics(t_s[in_step] - phases.step_s, travel[in_step], 0.0, TRAVEL_STEP_DEG, travel_count_deg),
        step_metrics(
            t_s[in_step_back] - phases.back_s, travel[in_step_back], TRAVEL_STEP_DEG, 0.0, travel_count_deg
        ),
    ]
    start_deg = float(elevation[in_take_off][0]) if in_take_off.any() else 0.0
    since_take_off_s = t_s[in_take_off] - phases.take_off_s
    take_off = step_metrics(since_take_off_s, elevation[in_take_off], start_deg, 0.0, elevation_count_deg)
    return FlightMetrics(
        outcome=outcome,
        take_off_s=_nan_to_infinite(take_off.settling_s),
        overshoot_percent=max(_nan_to_infinite(metrics.overshoot_percent) for metrics in steps),
        settling_time_s=max(_nan_to_infinite(metrics.settling_s) for metrics in steps),
        travel_rms_deg=_nan_to_infinite(rms(error_deg[:, 2])),
        elevation_rms_deg=_nan_to_infinite(rms(error_deg[:, 0])),
        pitch_max_deg=float(np.abs(pitch).max(initial=0.0)),
    )


def _rows_between(t_s: Floats, start_s: float, stop_s: float) -> Booleans:
    """Select the rows whose times `t_s`, shape (n,), are from `start_s` to before `stop_s`."""
    return (t_s >= start_s) & (t_s < stop_s)


def _nan_to_infinite(value: float) -> float:
    """Return infinity for nan, which stands for a result that was not reached."""
    return math.inf if math.isnan(value) else value
