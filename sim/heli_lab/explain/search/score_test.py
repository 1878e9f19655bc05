"""Score test: predicts from first and second derivatives how much new coefficients would improve a model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from heli_host.arrays import Floats


class Score(NamedTuple):
    """Result of a score test.

    Parameters
    ----------
    log_likelihood_gain : float
        Expected gain, nats.
    coefficients, std : ndarray (g,)
        Coefficients of the regressors, and their standard errors.
    """

    log_likelihood_gain: float
    coefficients: Floats
    std: Floats


class ScoreStatistics(NamedTuple):
    """Fisher information and score of a candidate's coefficients, from which a score test follows.

    The free parameters of the model are projected out of both.

    Parameters
    ----------
    information : ndarray (g, g)
        Fisher information.
    score : ndarray (g,)
        Derivative of the log-likelihood by the coefficients, where these are 0.
    """

    information: Floats
    score: Floats


def score_of(information: Floats, score: Floats, prior_std: Floats) -> Score:
    """Carry out a score test with normal priors about 0.

    Parameters
    ----------
    information : ndarray (g, g)
        Fisher information of the coefficients.
    score : ndarray (g,)
        Derivatives of the log-likelihood to the coefficients.
    prior_std : ndarray (g,)
        Prior standard deviations of the coefficients.

    Returns
    -------
    Score
        Gain in nats, coefficients and their standard errors.
    """
    covariance = np.linalg.pinv(information + np.diag(prior_std**-2.0), hermitian=True)
    coefficients = covariance @ score
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Score(float(0.5 * score @ coefficients), coefficients, std)
