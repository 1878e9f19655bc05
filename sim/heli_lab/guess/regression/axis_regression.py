"""Regress each axis' acceleration on the signal that drives it: gains, signs and lags."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats

from heli_lab.guess import thresholds
from heli_lab.guess.regression.assignment import ColumnAssignment, RegressionFit, explain, free_rows
from heli_lab.guess.regression.reference import Reference
from heli_lab.guess.regression.scales import AXES
from heli_lab.guess.regression.signals import Signals, delay, filtered_signal


def axis_regressions(
    signals: Signals,
    assignment: ColumnAssignment,
    reference: Reference,
    rad: Mapping[str, float] | None = None,
    bias: float = 0.0,
    limit: float = math.inf,
) -> dict[str, RegressionFit]:
    """Regress each axis' acceleration on its cause, at the lag with the highest likelihood.

    Parameters
    ----------
    rad : Mapping[str, float], optional
        Radians per unit of each angle, if known: the causes then include the sines and cosines of pitch.
    bias : float
        Bias that the logged sum of the voltages lacks, in the unit of the sum.
    limit : float
        Largest voltage of a motor, in the unit of the columns; larger commands did not act.
    """
    total, difference = sum_and_difference(signals, assignment, bias, limit)
    pitch = signals.raw[assignment.pitch]
    causes = {"elevation": total, "pitch": difference, "travel": pitch}
    if rad is not None:
        lean = rad["pitch"] * pitch
        share = total / max(abs(float(total.mean())), 1e-12) if float(total.mean()) else np.ones(total.size)
        causes["elevation"] = total * np.cos(lean)
        if not assignment.summed or abs(float(total.mean())) > float(total.std()):
            causes["travel"] = np.sin(lean) / rad["pitch"] * np.clip(share, 0.0, 2.0)
    columns = {"elevation": assignment.elevation, "pitch": assignment.pitch, "travel": assignment.travel}
    low = {axis: filtered_signal(cause).value for axis, cause in causes.items()}
    return {axis: _best(signals, columns[axis], axis, low[axis], reference) for axis in AXES}


def sum_and_difference(
    signals: Signals, assignment: ColumnAssignment, bias: float = 0.0, limit: float = math.inf
) -> tuple[Floats, Floats]:
    """Return sum and difference of the motors' voltages.

    Parameters
    ----------
    bias : float
        Bias that the logged sum lacks, in the unit of the sum.
    limit : float
        Largest voltage of a motor, in the unit of the columns.
    """
    first, second = voltages(signals, assignment)
    total, difference = (first + bias, second) if assignment.summed else (first + second, first - second)
    if math.isinf(limit):
        return total, difference
    front = np.clip(0.5 * (total + difference), -limit, limit)
    back = np.clip(0.5 * (total - difference), -limit, limit)
    return front + back, front - back


def voltages(signals: Signals, assignment: ColumnAssignment) -> tuple[Floats, Floats]:
    """Return both voltages, each with its polarity applied."""
    return (
        assignment.polarity[0] * signals.raw[assignment.voltages[0]],
        assignment.polarity[1] * signals.raw[assignment.voltages[1]],
    )


def _best(signals: Signals, column: str, axis: str, cause: Floats, reference: Reference) -> RegressionFit:
    signal = signals.filtered[column]
    rows = free_rows(signals, column) if axis == "elevation" else signals.inner
    rest = signal.value * 0.0 if axis == "travel" else signal.value - signal.value.mean()
    stiffness = reference.stiffness.get(axis, (0.0, 0.1))
    fits = []
    for lag_s in np.arange(*thresholds.LAGS_S):
        explained = explain(
            signal.acceleration, (rest, signal.rate), delay(cause, float(lag_s)), stiffness, rows
        )
        fits.append(RegressionFit(explained.log_likelihood_ratio, explained.gain, float(lag_s)))
    return max(fits, key=lambda fit: fit.log_likelihood_ratio)


@dataclass(frozen=True)
class RestElevation:
    """Elevation at the beginning of a flight, where the arm may rest on its table.

    Parameters
    ----------
    deg : float or None
        Elevation at rest [deg], with its sign; None if the flight does not begin at rest.
    median_deg : float
        Median of the elevation in the flight [deg].
    lowest : bool
        Whether the flight begins at its lowest elevation.
    """

    deg: float | None
    median_deg: float
    lowest: bool


def rest_elevation(signals: Signals, column: str, deg: float) -> RestElevation:
    """Find the rest at the beginning of the elevation `column`; `deg` is its unit in degrees, with sign."""
    elevation = deg * signals.raw[column]
    # An unsigned counter that starts below 0 has an offset of one turn.
    elevation = elevation - 360.0 * np.round(np.median(elevation) / 360.0)
    rows = round(thresholds.REST_DURATION_S / thresholds.SAMPLE_STEP_s)
    begin = elevation[:rows]
    typical = float(np.median(elevation))
    start = float(np.median(begin))
    still = float(np.ptp(begin)) < 0.5 and abs(typical - start) > 5.0
    lowest = start < float(elevation.min()) + 3.0
    return RestElevation(start if still else None, typical, lowest)
