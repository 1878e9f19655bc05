"""Test whether the voltages explain a flight: compare its motion with the fit's free run, window by window.

A parabola is subtracted from both in each window, because initial states and constant torques give a parabola
with any voltages. The remaining motion of a rig resembles the free run, even if the model's gain is wrong.
The remaining motion of mere noise does not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.errors import NotExcited
from heli_lab.fit.identify.results.check import Trace
from heli_lab.fit.identify.thresholds import MIN_MOTION, REST_COUNTS, UNEXPLAINED


def unexplained_shares(flight: Trace) -> tuple[Floats, Floats]:
    """Measure the share of a flight's motion that its free run does not explain, and the size of the motion.
    Returns shape `shares` (3,), `motion` (3,).
    """
    # Sums over all windows, after the parabolas are subtracted.
    cross_sum, measured_sum, predicted_sum = (np.zeros(len(AXES)) for _ in range(3))
    for window in flight.windows:
        t = np.linspace(-1.0, 1.0, window.stop - window.start)
        # Orthonormal basis of all parabolas, shape (rows, 3).
        parabolas, _ = np.linalg.qr(np.column_stack((np.ones_like(t), t, t**2)))
        measured, predicted = (
            angles[window] - parabolas @ (parabolas.T @ angles[window])
            for angles in (flight.measured_rad, flight.predicted_rad)
        )
        cross_sum += np.sum(measured * predicted, axis=0)
        measured_sum += np.sum(measured**2, axis=0)
        predicted_sum += np.sum(predicted**2, axis=0)
    correlation = cross_sum / np.sqrt(np.maximum(measured_sum * predicted_sum, np.finfo(float).tiny))
    # A free run that diverged to nan explains nothing.
    correlation = np.clip(np.nan_to_num(correlation), 0.0, 1.0)
    return np.sqrt(1.0 - correlation**2), np.sqrt(measured_sum / len(flight.t_s)) / flight.sigma_rad


def unexcited_axes(flights: Sequence[Trace]) -> dict[str, float]:
    """Find the axes whose free runs show nothing about the model.

    Within each window, such an axis rests, or follows a parabola to within its encoder's quantisation. Any
    model predicts that.
    """
    motion = np.array([unexplained_shares(flight)[1] for flight in flights])
    range_rad = np.array([np.ptp(flight.measured_rad, axis=0) for flight in flights])
    count_rad = np.array([flight.sigma_rad for flight in flights]) * np.sqrt(12.0)
    range_rad[range_rad < (REST_COUNTS + 0.5) * count_rad] = 0.0
    is_unexcited = np.all(motion <= MIN_MOTION, axis=0)
    largest_deg = np.rad2deg(range_rad.max(axis=0))
    return {axis: float(largest_deg[i]) for i, axis in enumerate(AXES) if is_unexcited[i]}


def refuse_unexplained(flight: Trace) -> None:
    """Refuse a flight whose motion does not resemble the free run on any axis."""
    shares, motion = unexplained_shares(flight)
    moving = motion > MIN_MOTION
    if not moving.any():
        return
    best = int(np.argmin(np.where(moving, shares, np.inf)))
    if shares[best] > UNEXPLAINED:
        raise NotExcited(
            f"{flight.label}: the voltages do not explain the motion: they leave {100 * shares[best]:.0f} % "
            f"of {AXES[best]}, the best axis, unexplained (in a real flight at most "
            f"{100 * UNEXPLAINED:.0f} %)",
            "check that angles and voltages are of one flight of this rig (or fit it with --skip-sign-check)",
        )
