"""Kicks: short torques at single instants, which no cause explains and no gust of constant strength gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.diagnose.thresholds import KICK_STD_ERRORS
from heli_lab.estimation import (
    AuxiliaryResiduals,
    DisturbanceModel,
    InnovationsModel,
    auxiliary_residuals,
)

_MAX_KICKS: Final = 30
"""Kicks that are sought in all flights together; each takes one pass of the smoother."""
_MAD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

_Error = list[list[tuple[Floats, Floats]]]


@dataclass(frozen=True)
class Kicks:
    """Kicks about one axis in all fitted flights.

    Parameters
    ----------
    count : int
        How many.
    largest_Nms : float
        Largest angular impulse, a torque times its duration, without its sign.
    """

    count: int
    largest_Nms: float


def kicks(
    filtered: InnovationsModel, disturbances: DisturbanceModel, error: _Error | None = None
) -> dict[str, Kicks]:
    """Count the kicks about each axis: torques at single instants that the disturbances do not explain. Axes
    without kicks are left out.

    The most significant impulse is subtracted before the next one is sought, because it also raises the
    statistics of instants close to it.

    Parameters
    ----------
    filtered : InnovationsModel
        The final model along the flights.
    disturbances : DisturbanceModel
        Sizes and correlation times of the random torques.
    error : list, optional
        As in `auxiliary_residuals`.
    """
    error = filtered.perturbed_residual() if error is None else error
    sizes_Nms: dict[str, list[float]] = {}
    for _ in range(_MAX_KICKS):
        residuals = auxiliary_residuals(filtered, disturbances, error)
        heights = [_heights(residual) for residual in residuals]
        flight = int(np.argmax([height.max(initial=0.0) for height in heights]))
        instant, axis = np.unravel_index(int(heights[flight].argmax()), heights[flight].shape)
        if heights[flight][instant, axis] < KICK_STD_ERRORS:
            break
        torque_Nm = float(residuals[flight].impulse.size[instant, axis])
        step_s = filtered.linearised_flights[flight].reference.step_s
        sizes_Nms.setdefault(AXES[axis], []).append(abs(torque_Nm) * step_s)
        error = with_impulse(filtered, error, flight, int(instant), int(axis), torque_Nm)
    return {axis: Kicks(len(sizes), max(sizes)) for axis, sizes in sizes_Nms.items()}


def with_impulse(
    filtered: InnovationsModel, error: _Error, flight: int, place: int, axis: int, torque_Nm: float
) -> _Error:
    """Return the `error` of a model that has one more torque about an axis, in the first step of a
    measurement interval.

    Parameters
    ----------
    flight, place, axis : int
        Number of the flight, of the interval among all of the flight, and of the axis.
    """
    changed = [list(windows) for windows in error]
    for number, blocks in enumerate(filtered.linearised_flights[flight].blocks):
        if place < len(blocks.rows):
            drive, measured = changed[flight][number]
            added = drive.copy()
            added[place, :, 0] += blocks.part_input[0, place, :, axis] * torque_Nm
            changed[flight][number] = added, measured
            break
        place -= len(blocks.rows)
    return changed


def _heights(residual: AuxiliaryResiduals) -> Floats:
    """Absolute statistics of impulses, (k, 3), in robust standard errors: kicks inflate the estimated gusts,
    and statistics are too small then.
    """
    statistic = residual.impulse.t_statistic
    scale = _MAD * np.median(np.abs(statistic - np.median(statistic, axis=0)), axis=0)
    result: Floats = np.abs(statistic) / np.clip(scale, 1e-6, 1.0)
    return result
