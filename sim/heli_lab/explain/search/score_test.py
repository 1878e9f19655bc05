"""Score test: predicts from first and second derivatives how much new coefficients would improve a model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from heli_host.data.arrays import Floats


class Score(NamedTuple):
    """Result of a score test."""

    log_likelihood_gain: float  # Expected gain, nats
    coefficients: Floats  # coefficients, std: (g,): Coefficients of the regressors, and their standard errors
    std: Floats


class ScoreStatistics(NamedTuple):
    """Fisher information and score of a candidate's coefficients, from which a score test follows.

    The free parameters of the model are projected out of both.
    """

    information: Floats  # (g, g): Fisher information
    score: Floats  # (g,): Derivative of the log-likelihood by the coefficients, where these are 0


def score_of(information: Floats, score: Floats, prior_std: Floats) -> Score:
    """Carry out a score test with normal priors about 0. Shapes: `information` (g, g), `score` (g,),
    `prior_std` (g,).
    """
    covariance = np.linalg.pinv(information + np.diag(prior_std**-2.0), hermitian=True)
    coefficients = covariance @ score
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Score(float(0.5 * score @ coefficients), coefficients, std)
