"""Step metrics of a flight with given gains: take-off, a step of travel and back, sines.

Overshoot and settling time are those of `control.step_info`, with a band of half a degree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.flight import Flight

Floats = npt.NDArray[np.float64]

BAND_DEG: Final = 0.5
STEP_DEG: Final = 15.0


@dataclass(frozen=True)
class Phases:
    """When a flight did what, on its own time axis, s.

    Parameters
    ----------
    take_off_s, step_s, back_s, sine_s, end_s : float
        Beginning of the take-off, of the step of travel, of the step back, of the sines; end of the sines.
    """

    take_off_s: float
    step_s: float
    back_s: float
    sine_s: float
    end_s: float


@dataclass(frozen=True)
class StepMetrics:
    """Performance of a set of gains in flight.

    Parameters
    ----------
    outcome : str
        ``completed``, or what ended the flight.
    take_off_s : float
        Settling time of the take-off: until elevation stays within half a degree of level; infinite if it
        never does.
    overshoot_percent : float
        Of the travel step, the worse of both ways.
    settling_time_s : float
        From the step until travel stays within half a degree of its setpoint, the worse of both ways.
    travel_rms_deg, elevation_rms_deg : float
        Tracking error along the sines.
    pitch_max_deg : float
        Largest absolute pitch.
    """

    outcome: str
    take_off_s: float
    overshoot_percent: float
    settling_time_s: float
    travel_rms_deg: float
    elevation_rms_deg: float
    pitch_max_deg: float


def step_metrics(
    flight: Flight, path_deg: Callable[[Floats], Floats], phases: Phases, outcome: str
) -> StepMetrics:
    """Measure a flight; infinite where it did not get so far.

    Parameters
    ----------
    path_deg : callable
        From times on the flight's axis, (n,), to elevation, pitch and travel that were asked for, (n, 3).
    outcome : str
        How it ended.
    """
    t_s, angles_deg = flight.t_s, np.rad2deg(flight.angles_rad)
    elevation, pitch, travel = angles_deg.T
    rise, there = _between(t_s, phases.take_off_s, phases.step_s), _between(t_s, phases.step_s, phases.back_s)
    back, sine = _between(t_s, phases.back_s, phases.sine_s), _between(t_s, phases.sine_s, phases.end_s)
    error_deg = angles_deg[sine] - path_deg(t_s[sine])
    beyond = max(_most(travel[there] - STEP_DEG), _most(-travel[back]))
    settling_time_s = max(
        _last_outside_s(t_s[there] - phases.step_s, travel[there] - STEP_DEG),
        _last_outside_s(t_s[back] - phases.back_s, travel[back]),
    )
    return StepMetrics(
        outcome=outcome,
        take_off_s=_last_outside_s(t_s[rise] - phases.take_off_s, elevation[rise]),
        overshoot_percent=100.0 * max(beyond, 0.0) / STEP_DEG,
        settling_time_s=settling_time_s,
        travel_rms_deg=_rms(error_deg[:, 2]),
        elevation_rms_deg=_rms(error_deg[:, 0]),
        pitch_max_deg=float(np.abs(pitch).max(initial=0.0)),
    )


def _between(t_s: Floats, start_s: float, stop_s: float) -> npt.NDArray[np.bool_]:
    return (t_s >= start_s) & (t_s < stop_s)


def _most(values: Floats) -> float:
    return float(values.max()) if values.size else float("inf")


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("inf")


def _last_outside_s(t_s: Floats, error_deg: Floats) -> float:
    outside = np.flatnonzero(np.abs(error_deg) > BAND_DEG)
    if t_s.size == 0 or (outside.size and outside[-1] >= t_s.size - 2):
        return float("inf")
    return float(t_s[outside[-1] + 1]) if outside.size else 0.0
