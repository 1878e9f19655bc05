"""The residual as generalised torque: what would have to act on each axis for the model to be right.

A smoother over each window (Rauch, Tung and Striebel) with a state for the torque about each axis that drifts
to zero within `MEMORY_s`; its size is estimated from the flight (expectation-maximisation). After Kristensen,
Madsen and Jorgensen (2004), who look for the faulty equation by the size of its process noise and then for
what the drifting term depends on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.diagnose.linearisation import Linearisation
from heli_lab.identify.functions import Floats

MEMORY_s: Final = 0.5
_ROUNDS: Final = 5
_START_Nm: Final = 0.02
_NOISE: Final = 0.5
"""Variance of a step's mean residual that rounding leaves, in units of the rounding's variance."""
FREE_ANGLE_rad: Final = 0.02
FREE_RATE_rad_s: Final = 0.3


@dataclass(frozen=True)
class DisturbanceTorque:
    """Torque that a fit's prediction of a flight lacks.

    Parameters
    ----------
    t_s : ndarray (n,)
        Times since the flight's first sample.
    value_Nm : ndarray (n, 3)
        Estimate about elevation, pitch and travel.
    std_Nm : ndarray (n, 3)
        Its standard error.
    sigma_Nm : ndarray (3,)
        Root mean square of the torque itself, the estimate's error taken out.
    """

    t_s: Floats
    value_Nm: Floats
    std_Nm: Floats
    sigma_Nm: Floats


def estimate_disturbance(tangent: Linearisation) -> DisturbanceTorque:
    """Estimate the torque that a prediction lacks.

    Parameters
    ----------
    tangent : Linearisation
        The prediction with its linear system.

    Returns
    -------
    DisturbanceTorque
        Estimate in the middle of each step.
    """
    size = np.full(3, _START_Nm**2)
    value = variance = np.zeros((tangent.rows, 3))
    for _ in range(_ROUNDS):
        value, variance = _smooth(tangent, size)
        size = np.maximum((value**2 + variance).mean(axis=0), 1e-12)
    return DisturbanceTorque(tangent.path.t_s, value, np.sqrt(variance), np.sqrt(size))


def _smooth(tangent: Linearisation, size: Floats) -> tuple[Floats, Floats]:
    nx = tangent.by_torque.shape[1]
    count, longest = len(tangent.steps), int(tangent.steps.max())
    keep = float(np.exp(-tangent.path.step_s / MEMORY_s))
    order = nx + 3
    noise = np.zeros((order, order))
    noise[nx:, nx:] = np.diag((1 - keep**2) * size)
    see = tangent.see / tangent.record.sigma_rad[:, None]
    mean = np.zeros((count, order))
    spread = np.zeros((count, order, order))
    spread[:, range(3), range(3)] = FREE_ANGLE_rad**2
    spread[:, range(3, nx), range(3, nx)] = FREE_RATE_rad_s**2
    spread[:, range(nx, order), range(nx, order)] = size
    kept: list[tuple[Floats, Floats, Floats, Floats, Floats]] = []
    for k in range(longest):
        alive = tangent.steps > k
        rows = np.where(alive, tangent.first + k, 0)
        evaluation = np.zeros((count, 3, order))
        evaluation[:, :, :nx] = see[rows]
        cross = spread @ evaluation.transpose(0, 2, 1)
        inner = evaluation @ cross + _NOISE * np.eye(3)
        gain = np.linalg.solve(inner, cross.transpose(0, 2, 1)).transpose(0, 2, 1)
        gain *= alive[:, None, None]
        error = tangent.residual[rows] - np.einsum("wij,wj->wi", evaluation, mean)
        mean = mean + np.einsum("wij,wj->wi", gain, error)
        spread = spread - gain @ cross.transpose(0, 2, 1)
        over = np.zeros((count, order, order))
        over[:, :nx, :nx] = tangent.over[rows]
        over[:, :nx, nx:] = tangent.push[rows] @ tangent.by_torque[rows]
        over[:, range(nx, order), range(nx, order)] = keep
        ahead = np.einsum("wij,wj->wi", over, mean)
        spread_ahead = over @ spread @ over.transpose(0, 2, 1) + noise
        kept.append((mean, spread, over, ahead, spread_ahead))
        mean, spread = ahead, spread_ahead
    value = np.zeros((tangent.rows, 3))
    variance = np.zeros((tangent.rows, 3))
    later_mean, later_spread = mean, spread
    for k in range(longest - 1, -1, -1):
        mean, spread, over, ahead, spread_ahead = kept[k]
        last = (tangent.steps == k + 1)[:, None]
        back = np.linalg.solve(spread_ahead, over @ spread).transpose(0, 2, 1)
        smoothed = mean + np.einsum("wij,wj->wi", back, later_mean - ahead)
        smoothed_spread = spread + back @ (later_spread - spread_ahead) @ back.transpose(0, 2, 1)
        later_mean = np.where(last, mean, smoothed)
        later_spread = np.where(last[:, :, None], spread, smoothed_spread)
        here = np.flatnonzero(tangent.steps > k)
        place = tangent.first[here] + k
        value[place] = later_mean[here, nx:]
        variance[place] = later_spread[here][:, range(nx, order), range(nx, order)]
    return value, np.maximum(variance, 0.0)
