"""Flights as students log them in Simulink: matrices without names, with rates, setpoints, without a bias."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight

BIAS_V = 7.3
DEG = 180.0 / math.pi


def state_rows(flight: Flight, per_rad: float = 1.0) -> list[Floats]:
    """Travel, pitch and elevation, each with its rate behind it, as a `To File` block has them."""
    rows = []
    for axis in ("travel", "pitch", "elevation"):
        angle = getattr(flight, f"{axis}_rad") * per_rad
        rows += [angle, _rate(angle, flight.step_s)]
    return rows


def setpoint_rows(flight: Flight, per_rad: float = 1.0) -> list[Floats]:
    """Steps of pitch about where it will be, and of elevation."""
    rows = round(1.5 / flight.step_s)
    held = np.minimum(np.arange(len(flight)) // rows * rows + rows // 2, len(flight) - 1)
    steps = np.where(np.arange(len(flight)) > len(flight) // 3, 5.0 / DEG, 0.0)
    return [flight.pitch_rad[held] * per_rad, steps * per_rad]


def voltage_rows(flight: Flight, bias_V: float = 0.0) -> list[Floats]:
    """Difference and sum, the sum less its bias."""
    return [flight.front_V - flight.back_V, flight.front_V + flight.back_V - bias_V]


def write_mat(path: Path, t_s: Floats, rows: list[Floats]) -> Path:
    """One matrix `ans`, a row a signal, the times first."""
    from scipy.io import savemat

    savemat(path, {"ans": np.array([t_s, *rows])})
    return path


def _rate(angle: Floats, step_s: float) -> Floats:
    weights = np.exp(-np.arange(0.0, 0.1, step_s) / 0.02)
    raw: Floats = np.convolve(np.gradient(angle, step_s), weights / weights.sum())
    return raw[: angle.size]
