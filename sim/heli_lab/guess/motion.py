"""How the axes answer their causes, once columns have roles: gains, signs and lags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats

from heli_lab.guess import thresholds
from heli_lab.guess.reference import Reference
from heli_lab.guess.roles import ColumnAssignment, RegressionFit, explain, free_rows
from heli_lab.guess.scales import AXES
from heli_lab.guess.signals import Signals, filtered_signal, late


def answers(
    signals: Signals,
    roles: ColumnAssignment,
    reference: Reference,
    rad: Mapping[str, float] | None = None,
    bias: float = 0.0,
) -> dict[str, RegressionFit]:
    """Explain each axis by its cause at the lag at which that does best.

    Parameters
    ----------
    rad : Mapping[str, float], optional
        Radians in one of each angle's unit, where they are known: causes then count as at large angles.
    bias : float
        What a sum was logged without, in its unit.
    """
    first, second = voltages(signals, roles)
    total, difference = (first + bias, second) if roles.summed else (first + second, first - second)
    pitch = signals.raw[roles.pitch]
    causes = {"elevation": total, "pitch": difference, "travel": pitch}
    if rad is not None:
        lean = rad["pitch"] * pitch
        share = total / max(abs(float(total.mean())), 1e-12) if float(total.mean()) else np.ones(total.size)
        causes["elevation"] = total * np.cos(lean)
        if not roles.summed or abs(float(total.mean())) > float(total.std()):
            causes["travel"] = np.sin(lean) / rad["pitch"] * np.clip(share, 0.0, 2.0)
    columns = {"elevation": roles.elevation, "pitch": roles.pitch, "travel": roles.travel}
    low = {axis: filtered_signal(cause).value for axis, cause in causes.items()}
    return {axis: _best(signals, columns[axis], axis, low[axis], reference) for axis in AXES}


def voltages(signals: Signals, roles: ColumnAssignment) -> tuple[Floats, Floats]:
    """Both voltages, with their polarity."""
    return (
        roles.polarity[0] * signals.raw[roles.voltages[0]],
        roles.polarity[1] * signals.raw[roles.voltages[1]],
    )


def _best(signals: Signals, column: str, axis: str, cause: Floats, reference: Reference) -> RegressionFit:
    signal = signals.filtered[column]
    rows = free_rows(signals, column) if axis == "elevation" else signals.inner
    rest = signal.value * 0.0 if axis == "travel" else signal.value - signal.value.mean()
    stiffness = reference.stiffness.get(axis, (0.0, 0.1))
    tried = []
    for lag_s in np.arange(*thresholds.LAGS_S):
        explained = explain(
            signal.acceleration, (rest, signal.rate), late(cause, float(lag_s)), stiffness, rows
        )
        tried.append(RegressionFit(explained.nats, explained.gain, float(lag_s)))
    return max(tried, key=lambda each: each.nats)


@dataclass(frozen=True)
class Rest:
    """How a flight begins.

    Parameters
    ----------
    deg : float or None
        Elevation at rest, deg, with its sign; None where the flight does not begin at rest.
    usual_deg : float
        Median of the elevation.
    lowest : bool
        Whether rest is where the elevation is lowest.
    """

    deg: float | None
    usual_deg: float
    lowest: bool


def rest_of(signals: Signals, column: str, deg: float) -> Rest:
    """Look at how the elevation, `column`, begins, `deg` being the signed degrees in one of its unit."""
    elevation = deg * signals.raw[column]
    # A counter without a sign, or of a turn, is a whole turn off where it begins below 0.
    elevation = elevation - 360.0 * np.round(np.median(elevation) / 360.0)
    rows = round(thresholds.REST_S / thresholds.STEP_S)
    begin = elevation[:rows]
    usual = float(np.median(elevation))
    start = float(np.median(begin))
    still = float(np.ptp(begin)) < 0.5 and abs(usual - start) > 5.0
    lowest = start < float(elevation.min()) + 3.0
    return Rest(start if still else None, usual, lowest)
