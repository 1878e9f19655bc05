"""Test whether the voltages explain a flight: compare its motion with the fit's free run, window by window.

A parabola is subtracted from both: initial states and constant torques make one of any voltages. The rest
of a rig's motion follows its voltages, also under a model that is wrong by a factor; noise follows nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.errors import NotExcited
from heli_lab.identify.results.check import Trace
from heli_lab.identify.thresholds import MIN_MOTION, UNEXPLAINED


def unexplained_shares(flight: Trace) -> tuple[Floats, Floats]:
    """Share of a flight's motion that its free run does not explain, and the size of the motion.

    Returns
    -------
    ndarray (3,)
        Share of each axis' motion that no multiple of the free run explains, rms: 0 for the same shape, 1 for
        shapes that have nothing in common.
    ndarray (3,)
        The motion itself, rms, in standard deviations of the quantisation.
    """
    # Sums of products over all windows, without the parabolas.
    cross, measured, predicted = (np.zeros(len(AXES)) for _ in range(3))
    for window in flight.windows:
        t = np.linspace(-1.0, 1.0, window.stop - window.start)
        parabolas, _ = np.linalg.qr(np.column_stack((np.ones_like(t), t, t**2)))
        residuals = [
            angles[window] - parabolas @ (parabolas.T @ angles[window])
            for angles in (flight.measured_rad, flight.predicted_rad)
        ]
        cross += np.sum(residuals[0] * residuals[1], axis=0)
        measured += np.sum(residuals[0] ** 2, axis=0)
        predicted += np.sum(residuals[1] ** 2, axis=0)
    correlation = cross / np.sqrt(np.maximum(measured * predicted, np.finfo(float).tiny))
    # A free run that diverged to nan explains nothing.
    correlation = np.clip(np.nan_to_num(correlation), 0.0, 1.0)
    return np.sqrt(1.0 - correlation**2), np.sqrt(measured / len(flight.t_s)) / flight.sigma_rad


def axes_at_rest(flights: Sequence[Trace]) -> list[str]:
    """Axes that no flight moves by more than its encoder's quantisation: they show nothing about a model."""
    motion = np.array([unexplained_shares(flight)[1] for flight in flights])
    return [axis for axis, rests in zip(AXES, np.all(motion <= MIN_MOTION, axis=0), strict=True) if rests]


def refuse_unexplained(flight: Trace) -> None:
    """Refuse a flight if the free run resembles its motion about no axis.

    Raises
    ------
    NotExcited
        When more than `UNEXPLAINED` is unexplained on each axis that moves.
    """
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
