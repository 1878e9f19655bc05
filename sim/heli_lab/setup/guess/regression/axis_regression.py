"""Regress each axis' acceleration on the signal that drives it: gains, signs and lags."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit, regress_acceleration
from heli_lab.setup.guess.regression.assignment import ColumnAssignment, free_rows
from heli_lab.setup.guess.regression.reference import Reference
from heli_lab.setup.guess.regression.scales import AXES
from heli_lab.setup.guess.regression.signals import Signals, delay, filtered_signal, lagged

NO_LIMITS: Final = (-math.inf, math.inf)
"""Limits of the voltages if no command is beyond what the amplifier gives."""


def axis_regressions(
    signals: Signals,
    assignment: ColumnAssignment,
    reference: Reference,
    rad: Mapping[str, float] | None = None,
    bias: float = 0.0,
    limits: tuple[float, float] = NO_LIMITS,
) -> dict[str, RegressionFit]:
    """Regress each axis' acceleration on its cause, at the lag with the highest likelihood.

    The cause of elevation is the sum of the voltages, that of pitch is their difference, and that of travel
    is pitch.
    """
    total, difference = sum_and_difference(signals, assignment, bias, limits)
    pitch = signals.raw[assignment.pitch]
    causes = {"elevation": total, "pitch": difference, "travel": pitch}
    if rad is not None:
        pitch_rad = rad["pitch"] * pitch
        mean = float(total.mean())
        causes["elevation"] = total * np.cos(pitch_rad)
        # A sum that was logged without its bias has a small mean, which is no measure of the thrust.
        if not assignment.summed or abs(mean) > float(total.std()):
            relative_thrust = total / max(abs(mean), 1e-12) if mean else np.ones(total.size)
            causes["travel"] = np.sin(pitch_rad) / rad["pitch"] * np.clip(relative_thrust, 0.0, 2.0)
    columns = {"elevation": assignment.elevation, "pitch": assignment.pitch, "travel": assignment.travel}
    low_passed = {axis: filtered_signal(cause).value for axis, cause in causes.items()}
    fits = {
        axis: _fit_at_best_lag(signals, columns[axis], axis, low_passed[axis], reference) for axis in AXES
    }
    if responds_without_lag(fits["pitch"].lag_s):
        nats = _no_rotor_lag_nats(signals, columns["pitch"], difference, reference)
        fits["pitch"] = replace(fits["pitch"], no_rotor_lag_nats=nats)
    return fits


def responds_without_lag(lag_s: float) -> bool:
    """Whether pitch follows the voltages after a lag, `lag_s` [s], that only rotors without a lag have."""
    return 0.0 <= round(lag_s, 3) < thresholds.PLAUSIBLE_LAGS_S[0]


def _no_rotor_lag_nats(signals: Signals, column: str, difference: Floats, reference: Reference) -> float:
    """Compare rotors without a lag with rotors that lag while the logged voltages are too late. Shapes:
    `difference` (n,).

    A lag of the rotors and late voltages can cancel on average: pitch then follows the voltages without a
    delay in both cases. But lagging rotors also smooth the voltages, which distinguishes the two.
    """
    pitch = filtered_signal(signals.raw[column], thresholds.ROTOR_LAG_CUTOFF_Hz)
    axis_terms = (pitch.value - pitch.value.mean(), pitch.rate)
    stiffness = reference.stiffness.get("pitch", (0.0, 0.1))

    def highest_nats(voltage: Floats, delays_s: Floats) -> float:
        """Evidence that this voltage drives pitch, at the best of several delays [nats]."""
        cause = filtered_signal(voltage, thresholds.ROTOR_LAG_CUTOFF_Hz).value
        fits = (
            regress_acceleration(
                pitch.acceleration, axis_terms, delay(cause, delay_s), stiffness, signals.inner
            )
            for delay_s in delays_s
        )
        return max(fit.log_likelihood_ratio for fit in fits)

    with_lag = max(
        highest_nats(lagged(difference, lag_s), np.arange(-1.6 * lag_s, 0.0, thresholds.SAMPLE_STEP_s))
        for lag_s in thresholds.ROTOR_LAGS_s
    )
    return highest_nats(difference, np.zeros(1)) - with_lag


def sum_and_difference(
    signals: Signals,
    assignment: ColumnAssignment,
    bias: float = 0.0,
    limits: tuple[float, float] = NO_LIMITS,
) -> tuple[Floats, Floats]:
    """Compute the sum and the difference of the voltages that the motors received. Returns shape
    `voltage_sum, voltage_difference` (n,).
    """
    first, second = voltages(signals, assignment)
    total, difference = (first + bias, second) if assignment.summed else (first + second, first - second)
    if limits == NO_LIMITS:
        return total, difference
    front = np.clip(0.5 * (total + difference), *limits)
    back = np.clip(0.5 * (total - difference), *limits)
    return front + back, front - back


def voltages(signals: Signals, assignment: ColumnAssignment) -> tuple[Floats, Floats]:
    """Return both voltage columns with their signs corrected, shape (n,) each, in the order of the
    assignment: front and back, or sum and difference.
    """
    return (
        assignment.polarity[0] * signals.raw[assignment.voltages[0]],
        assignment.polarity[1] * signals.raw[assignment.voltages[1]],
    )


def _fit_at_best_lag(
    signals: Signals, column: str, axis: str, cause: Floats, reference: Reference
) -> RegressionFit:
    """Regress the acceleration of an axis on its cause at each lag of `LAGS_S`; return the most likely fit.
    Shapes: `cause` (n,).
    """
    angle = signals.filtered[column]
    rows = free_rows(signals, column) if axis == "elevation" else signals.inner
    # No torque depends on the travel angle.
    deflection = angle.value * 0.0 if axis == "travel" else angle.value - angle.value.mean()
    stiffness = reference.stiffness.get(axis, (0.0, 0.1))
    fits = []
    for lag_s in np.round(np.arange(*thresholds.LAGS_S), 3) + 0.0:
        fit = regress_acceleration(
            angle.acceleration, (deflection, angle.rate), delay(cause, float(lag_s)), stiffness, rows
        )
        fits.append(RegressionFit(fit.log_likelihood_ratio, fit.gain, float(lag_s)))
    best = max(fits, key=lambda fit: fit.log_likelihood_ratio)
    possible_s = [
        fit.lag_s
        for fit in fits
        if best.log_likelihood_ratio - fit.log_likelihood_ratio < thresholds.DECISIVE_NATS
    ]
    return replace(best, lag_range_s=(min(possible_s), max(possible_s)))
