"""Score test of candidate regressors, with the nuisance parameters projected out.

A candidate is a set of regressors: its effect on the predicted angles for each unit of its coefficients. The
nuisance parameters, the windows' initial states and the model's free parameters, are estimated beside it, so
that only what they cannot imitate counts. Normal equations are kept for each window and axis: a score under
any weights of the axes is a Schur complement of small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from heli_lab.diagnose.linearisation import Linearisation
from heli_lab.identify import Fit
from heli_lab.identify.functions import Floats
from heli_lab.identify.residual_noise import floored_mean_square
from heli_lab.identify.schur import eliminate
from heli_lab.identify.thresholds import SINGULAR_GUARD

_REWEIGHTINGS: Final = 4
"""Updates of the axes' variances in a score; they have settled by then, set by judgement."""


@dataclass(frozen=True)
class ScoreResult:
    """What regressors would change, to first order.

    Parameters
    ----------
    log_likelihood_gain : float
        Log-likelihood ratio over the fit without them, nats, as if the steps' errors were independent: the
        drop of the sum over axes of rows/2 log(mean square), and of the prior penalty.
    coefficients : ndarray (g,)
        Estimated coefficient of each regressor.
    std : ndarray (g,)
        Standard error of each if the steps' errors were independent.
    variance : ndarray (3,)
        Mean square of each axis' residual that would be left, in units of the quantisation's variance.
    """

    log_likelihood_gain: float
    coefficients: Floats
    std: Floats
    variance: Floats


class ScoreTest:
    """The null hypothesis: a fit's residuals on its flights, and their normal equations."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        problem = fit.problem
        self.linearisations = tuple(Linearisation(fit, index) for index in range(len(problem.records)))
        self._prior_precision: Floats = problem.prior_std**-2.0
        self._prior_offset: Floats = fit.theta - problem.prior_mean
        self.rows = sum(one.rows for one in self.linearisations)
        self.weights: Floats = np.concatenate(fit.weights)
        self._sigma_rad = problem.records[0].sigma_rad
        self._state_prior = np.concatenate((np.zeros(6), problem.state_std**-2.0))
        count = len(problem.free)
        self._sensitivities: list[Floats] = []
        blocks = []
        for index, linearisation in enumerate(self.linearisations):
            own = np.zeros((linearisation.rows, 3, count))
            own[:, :, problem.columns[index]] = linearisation.parameter_response()
            every = np.concatenate(
                (linearisation.initial_state_response(), own, linearisation.residual[:, :, None]), axis=2
            )
            stacked = linearisation.stack_windows(every)
            self._sensitivities.append(np.ascontiguousarray(stacked.transpose(0, 1, 3, 2)))
            blocks.append(self._sensitivities[-1] @ stacked)
        self._normal_matrix = np.concatenate(blocks)
        """Products of initial states, free parameters and residual, (windows, 3, n, n)."""
        self._null_log_likelihood = self._solve(self._normal_matrix, np.zeros(0)).log_likelihood_gain

    def score(self, regressors: Sequence[Floats], prior_std: Floats | None = None) -> ScoreResult:
        """Score one candidate of `regressors`, for each flight of shape (n, 3, g), as
        `Linearisation.response` gives them; its coefficients have a prior about 0 where `prior_std`, shape
        (g,), is given.
        """
        priors = None if prior_std is None else [prior_std]
        return self.score_each(regressors, [regressors[0].shape[2]], priors)[0]

    def score_each(
        self, regressors: Sequence[Floats], sizes: Sequence[int], priors: Sequence[Floats] | None = None
    ) -> list[ScoreResult]:
        """Score several candidates, each for itself.

        Parameters
        ----------
        regressors : sequence of ndarray (n, 3, s)
            For each flight those of all candidates side by side.
        sizes : sequence of int
            Number of regressors of each.
        priors : sequence of ndarray, optional
            For each candidate, standard deviation of each coefficient about 0.
        """
        padded = [one.stack_windows(c) for one, c in zip(self.linearisations, regressors, strict=True)]
        products = np.concatenate([of @ one for of, one in zip(self._sensitivities, padded, strict=True)])
        order = self._normal_matrix.shape[2]
        results = []
        low = 0
        for number, g in enumerate(sizes):
            part = slice(low, low + g)
            own = np.concatenate([c[..., part].transpose(0, 1, 3, 2) @ c[..., part] for c in padded])
            normal_matrix = np.empty((len(self._normal_matrix), 3, order + g, order + g))
            normal_matrix[:, :, : order - 1, : order - 1] = self._normal_matrix[:, :, :-1, :-1]
            # Order: initial states, free parameters, regressors, residual.
            cross = products[..., part]
            normal_matrix[:, :, : order - 1, order - 1 : -1] = cross[:, :, :-1]
            normal_matrix[:, :, order - 1 : -1, : order - 1] = cross[:, :, :-1].transpose(0, 1, 3, 2)
            normal_matrix[:, :, order - 1 : -1, order - 1 : -1] = own
            normal_matrix[:, :, -1, order - 1 : -1] = cross[:, :, -1]
            normal_matrix[:, :, order - 1 : -1, -1] = cross[:, :, -1]
            normal_matrix[:, :, -1, : order - 1] = self._normal_matrix[:, :, -1, :-1]
            normal_matrix[:, :, : order - 1, -1] = self._normal_matrix[:, :, :-1, -1]
            normal_matrix[:, :, -1, -1] = self._normal_matrix[:, :, -1, -1]
            prior_precision = np.zeros(g) if priors is None else priors[number] ** -2.0
            one = self._solve(normal_matrix, prior_precision)
            gain = one.log_likelihood_gain - self._null_log_likelihood
            results.append(replace(one, log_likelihood_gain=gain))
            low += g
        return results

    def _solve(self, normal_matrix: Floats, coefficient_precision: Floats) -> ScoreResult:
        """Estimate everything by reweighted least squares; the gain is the log-likelihood itself."""
        nx, count = self.fit.problem.state_count, len(self._prior_precision)
        prior = np.concatenate((self._prior_precision, coefficient_precision))
        pull = np.concatenate(
            (-self._prior_precision * self._prior_offset, np.zeros(len(coefficient_precision)))
        )
        variance = np.einsum("waii,w->ai", normal_matrix[:, :, -1:, -1:], self.weights)[:, 0] / self.rows
        scale = floored_mean_square(variance, self._sigma_rad)
        # Columns in units of their own size: frequencies and masses side by side stay well conditioned.
        unit = np.sqrt(np.maximum(np.einsum("waii->i", normal_matrix[:, :, nx:-1, nx:-1]) + prior, 1e-30))
        diagonal = np.arange(nx)
        for _ in range(_REWEIGHTINGS):
            normal = np.einsum("wa,waij->wij", self.weights[:, None] / scale, normal_matrix)
            normal[:, diagonal, diagonal] += self._state_prior
            schur, follow = eliminate(normal, nx, SINGULAR_GUARD)
            rest = schur.sum(axis=0)
            matrix = (rest[:-1, :-1] + np.diag(prior)) / np.outer(unit, unit)
            covariance = np.linalg.pinv(matrix, rcond=1e-12, hermitian=True) / np.outer(unit, unit)
            theta = covariance @ (rest[:-1, -1] + pull)
            states = follow[:, :, -1] - follow[:, :, :-1] @ theta
            moved = np.broadcast_to(-theta, (len(states), len(theta)))
            every = np.concatenate((-states, moved, np.ones((len(states), 1))), axis=1)
            after = np.matmul(normal_matrix, every[:, None, :, None])[..., 0]
            square = np.einsum("wi,wai->wa", every, after)
            variance = np.maximum((self.weights @ square) / self.rows, 0.0)
            scale = floored_mean_square(variance, self._sigma_rad)
        offset = self._prior_offset + theta[:count]
        neg2_log_likelihood = self.rows * float((np.log(scale) + variance / scale).sum())
        neg2_log_likelihood += float(offset @ (self._prior_precision * offset))
        std = np.sqrt(np.maximum(np.diag(covariance)[count:], 0.0))
        return ScoreResult(-0.5 * neg2_log_likelihood, theta[count:], std, variance)
