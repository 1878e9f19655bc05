"""The residual as generalised torque: what would have to act on each axis for the model to be right.

Each axis gets a first-order Gauss-Markov disturbance torque. A Rauch-Tung-Striebel smoother (`kalman.py`)
estimates its course over each window, expectation-maximisation its variance. After Kristensen, Madsen and
Jorgensen (2004), who find the deficient equation by the variance of its process noise, and then what the
smoothed disturbance depends on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.diagnose.kalman import StateSpace, filter_outputs, smooth
from heli_lab.diagnose.linearisation import Linearisation, stack_steps
from heli_lab.diagnose.noise_model import initial_state_std
from heli_lab.identify.functions import Floats

_CORRELATION_TIME_s: Final = 0.5
"""Long enough to average quantisation, short enough to follow the arm's motion. Set by judgement: screening
only takes peaks of the spectrum from the estimate, and figures show it."""
_EM_ITERATIONS: Final = 5
"""Updates of the variance; each is one pass of filter and smoother."""
_START_Nm: Final = 0.02
"""Standard deviation that the iterations start from: that of a gust that plainly shows."""
_LEAST_VARIANCE_N2m2: Final = 1e-12
"""Keeps the smoother's covariances regular where an axis lacks nothing."""
_QUANTISATION_VARIANCE: Final = 0.5
"""Variance that quantisation leaves in the mean residual of a 10 ms step, in units of a sample's."""


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
        Standard deviation of the torque itself, as the iterations estimated it.
    """

    t_s: Floats
    value_Nm: Floats
    std_Nm: Floats
    sigma_Nm: Floats


def estimate_disturbance(linearisation: Linearisation) -> DisturbanceTorque:
    """Estimate the torque that a prediction lacks, in the middle of each step."""
    variance_N2m2 = np.full(3, _START_Nm**2)
    value = variance = np.zeros((linearisation.rows, 3))
    for _ in range(_EM_ITERATIONS):
        value, variance = _smoothed(linearisation, np.sqrt(variance_N2m2))
        variance_N2m2 = np.maximum((value**2 + variance).mean(axis=0), _LEAST_VARIANCE_N2m2)
    return DisturbanceTorque(linearisation.trajectory.t_s, value, np.sqrt(variance), np.sqrt(variance_N2m2))


def _smoothed(linearisation: Linearisation, sigma_Nm: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of the torques in each step, given a window's whole residual."""

    def stacked(rows: Floats) -> Floats:
        return stack_steps([linearisation], [rows])[:, :, 0]

    nx = linearisation.Phi.shape[1]
    measured = np.zeros((linearisation.rows, 3, nx + 3))
    measured[:, :, :nx] = linearisation.C / linearisation.record.sigma_rad[:, None]
    alive = np.arange(int(linearisation.steps.max()))[:, None] < linearisation.steps[None, :]
    system = StateSpace.with_disturbance(
        stacked(linearisation.Phi),
        stacked(linearisation.Gamma @ linearisation.rates_by_torque),
        stacked(measured),
        alive,
        rho=float(np.exp(-linearisation.trajectory.step_s / _CORRELATION_TIME_s)),
        sigma=sigma_Nm,
        state_std=initial_state_std(nx),
        measurement_variance=_QUANTISATION_VARIANCE,
    )
    residual = stacked(linearisation.residual[:, :, None])
    mean, covariance = smooth(system, filter_outputs(system, residual, keep=True))
    order = np.arange(nx, nx + 3)
    value = linearisation.unstack_windows(mean[:, :, nx:, 0])
    variance = linearisation.unstack_windows(covariance[:, :, order, order])
    return value, np.maximum(variance, 0.0)
