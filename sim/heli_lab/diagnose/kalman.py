"""Kalman filter (innovations form) and Rauch-Tung-Striebel smoother for many windows of one linear system.

``x[k+1] = Phi[k] x[k] + w[k]``, ``y[k] = C[k] x[k] + v[k]``, with white ``w`` of covariance `Q`, white ``v``
of covariance `R`, and ``x[0]`` of mean 0 and covariance `P0`. The noises and `P0` are the same in every
window. See Harvey (1989), section 3.2 (filter, prediction error decomposition) and 3.6 (smoother).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from heli_lab.identify.functions import Floats

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class StateSpace:
    """A time-varying linear system, over windows of unequal length.

    Parameters
    ----------
    Phi : ndarray (k, w, n, n)
        Transition over each step of each window. After a window's end: the identity.
    C : ndarray (k, w, m, n)
        Measurement matrix. After a window's end: zero.
    Q : ndarray (n, n)
        Covariance of the process noise of a step.
    R : ndarray (m, m)
        Covariance of the measurement noise.
    P0 : ndarray (n, n)
        Covariance of the state at a window's start.
    alive : ndarray (k, w) of bool
        Which steps are within their window.
    """

    Phi: Floats
    C: Floats
    Q: Floats
    R: Floats
    P0: Floats
    alive: Bools

    @classmethod
    def with_disturbance(
        cls,
        Phi: Floats,
        Gamma: Floats,
        C: Floats,
        alive: Bools,
        *,
        rho: float,
        sigma: Floats,
        state_std: Floats,
        measurement_variance: float,
    ) -> Self:
        """Append first-order Gauss-Markov disturbances ``d[k+1] = rho d[k] + e[k]`` that act through `Gamma`:
        a model of order n + d, the disturbances last.

        Parameters
        ----------
        Phi : ndarray (k, w, n, n)
            Transition of the state alone; whatever after a window's end.
        Gamma : ndarray (k, w, n, d)
            What a disturbance of 1 over a step adds to the state.
        C : ndarray (k, w, m, n + d)
            Measurement matrix of state and disturbance. Zero after a window's end.
        alive : ndarray (k, w) of bool
            Which steps are within their window.
        rho : float
            Correlation of a disturbance from one step to the next, from 0 to below 1.
        sigma : ndarray (d,)
            Stationary standard deviation of each disturbance.
        state_std : ndarray (n,)
            Standard deviation of the state at a window's start.
        measurement_variance : float
            Variance of the white noise on each output.
        """
        n, d = Gamma.shape[-2:]
        order = n + d
        transition = np.zeros((*alive.shape, order, order))
        transition[..., :n, :n] = np.where(alive[..., None, None], Phi, np.eye(n))
        transition[..., :n, n:] = Gamma * alive[..., None, None]
        transition[..., range(n, order), range(n, order)] = rho
        noise = np.zeros((order, order))
        noise[n:, n:] = np.diag((1.0 - rho**2) * sigma**2)
        start = np.diag(np.concatenate((state_std, sigma)) ** 2)
        return cls(transition, C, noise, measurement_variance * np.eye(C.shape[-2]), start, alive)


@dataclass(frozen=True)
class Innovations:
    """Outputs of a filter.

    Parameters
    ----------
    value : ndarray (k, w, m, s)
        Innovations in their own standard deviations: white of variance 1 under the model.
    log_determinant : float
        Sum of log det of the innovations' covariances over all steps within windows. With a single column,
        -2 log likelihood is this plus the sum of squares, but for the constant.
    mean, covariance : ndarray (k, w, n, s), (k, w, n, n) or None
        Filtered state of each step, for `smooth`; None where they were not kept.
    """

    value: Floats
    log_determinant: float
    mean: Floats | None = None
    covariance: Floats | None = None


def filter_outputs(system: StateSpace, outputs: Floats, *, keep: bool = False) -> Innovations:
    """Run the Kalman filter over columns of `outputs`, shape (k, w, m, s), which share its gains; outputs and
    innovations are zero after a window's end. With `keep` the filtered states are kept for `smooth`.

    Filtering is linear in the outputs: regressors are filtered as the measurement is, and their innovations
    are the regressors of the measurement's.
    """
    steps, windows, _, columns = outputs.shape
    order = system.Q.shape[0]
    mean = np.zeros((windows, order, columns))
    P = np.broadcast_to(system.P0, (windows, order, order)).copy()
    value = np.empty_like(outputs)
    log_determinant = 0.0
    means = np.empty((steps, *mean.shape)) if keep else None
    covariances = np.empty((steps, *P.shape)) if keep else None
    for k in range(steps):
        C, Phi = system.C[k], system.Phi[k]
        cross = P @ C.transpose(0, 2, 1)
        root = np.linalg.cholesky(C @ cross + system.R)
        whiten = np.linalg.inv(root)
        value[k] = whiten @ (outputs[k] - C @ mean)
        gain = cross @ whiten.transpose(0, 2, 1)
        diagonal = np.diagonal(root, axis1=1, axis2=2)[system.alive[k]]
        log_determinant += 2.0 * float(np.log(diagonal).sum())
        mean = mean + gain @ value[k]
        P = P - gain @ gain.transpose(0, 2, 1)
        if means is not None and covariances is not None:
            means[k], covariances[k] = mean, P
        mean = Phi @ mean
        P = Phi @ P @ Phi.transpose(0, 2, 1) + system.Q
    return Innovations(value, log_determinant, means, covariances)


def smooth(system: StateSpace, filtered: Innovations) -> tuple[Floats, Floats]:
    """Run the Rauch-Tung-Striebel smoother backwards over a filter's states.

    Parameters
    ----------
    filtered : Innovations
        Of `filter_outputs` with ``keep=True``.

    Returns
    -------
    mean : ndarray (k, w, n, s)
        State given all outputs of its window; of no meaning after a window's end.
    covariance : ndarray (k, w, n, n)
        Its covariance.
    """
    assert filtered.mean is not None and filtered.covariance is not None
    means, covariances = filtered.mean.copy(), filtered.covariance.copy()
    for k in range(len(means) - 2, -1, -1):
        Phi, P = system.Phi[k], covariances[k]
        ahead = Phi @ P @ Phi.transpose(0, 2, 1) + system.Q
        gain = np.linalg.solve(ahead, Phi @ P).transpose(0, 2, 1)
        means[k] += gain @ (means[k + 1] - Phi @ means[k])
        covariances[k] += gain @ (covariances[k + 1] - ahead) @ gain.transpose(0, 2, 1)
    return means, covariances
