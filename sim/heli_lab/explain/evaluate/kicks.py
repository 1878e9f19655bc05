"""Counts kicks: torques at single instants that are too large for the estimated disturbances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.explain.thresholds import KICK_STD_ERRORS
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import AuxiliaryResiduals, FlightErrors, InnovationsModel, auxiliary_residuals

_MAX_KICKS: Final = 30
"""Kicks that are sought in all flights together; each takes one pass of the smoother."""
_STD_PER_MAD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class Kicks:
    """Kicks about one axis in all fitted flights."""

    count: int  # Number of kicks
    largest_Nms: float  # Largest angular impulse, a torque times its duration, without its sign


def kicks(
    filtered: InnovationsModel, disturbances: DisturbanceModel, error: FlightErrors | None = None
) -> dict[str, Kicks]:
    """Count the kicks about each axis; axes without kicks are left out.

    The most significant impulse is subtracted before the next one is sought, because it also raises the
    statistics of instants close to it.
    """
    error = filtered.perturbed_residual() if error is None else error
    impulses_Nms: dict[str, list[float]] = {}
    for _ in range(_MAX_KICKS):
        residuals = auxiliary_residuals(filtered, disturbances, error)
        statistics = [_robust_statistics(residual) for residual in residuals]
        flight = int(np.argmax([statistic.max(initial=0.0) for statistic in statistics]))
        interval, axis = np.unravel_index(int(statistics[flight].argmax()), statistics[flight].shape)
        if statistics[flight][interval, axis] < KICK_STD_ERRORS:
            break
        torque_Nm = float(residuals[flight].impulse.size[interval, axis])
        step_s = filtered.linearised_flights[flight].reference.step_s
        impulses_Nms.setdefault(AXES[axis], []).append(abs(torque_Nm) * step_s)
        error = with_impulse(filtered, error, flight, int(interval), int(axis), torque_Nm)
    return {axis: Kicks(len(sizes), max(sizes)) for axis, sizes in impulses_Nms.items()}


def with_impulse(
    filtered: InnovationsModel, error: FlightErrors, flight: int, interval: int, axis: int, torque_Nm: float
) -> FlightErrors:
    """Return the `error` of a model with one more impulse, so that the next one can be sought.

    The torque acts in the first step of a measurement interval.
    """
    changed = [list(windows) for windows in error]
    for number, blocks in enumerate(filtered.linearised_flights[flight].blocks):
        if interval < len(blocks.rows):
            drive, measured = changed[flight][number]
            drive = drive.copy()
            drive[interval, :, 0] += blocks.part_input[0, interval, :, axis] * torque_Nm
            changed[flight][number] = drive, measured
            break
        interval -= len(blocks.rows)
    return changed


def _robust_statistics(residual: AuxiliaryResiduals) -> Floats:
    """Return absolute t statistics of impulses, (k, 3), over their robust standard deviation.

    Kicks inflate the estimated disturbances, so that the statistics themselves are too small.
    """
    statistic = residual.impulse.t_statistic
    scale = _STD_PER_MAD * np.median(np.abs(statistic - np.median(statistic, axis=0)), axis=0)
    result: Floats = np.abs(statistic) / np.clip(scale, 1e-6, 1.0)
    return result
