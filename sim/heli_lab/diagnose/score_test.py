"""What a candidate has left to explain once everything that the fitted model can adapt has adapted.

A candidate is columns: its effect on the predicted angles for each unit of its parameters. The windows'
initial states and the model's free parameters are fitted beside it, so that only what they cannot imitate
counts. Sums of products are kept for each window and axis, so that a score under any weights of the axes is
a handful of small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.diagnose.linearisation import Linearisation
from heli_lab.identify import Fit
from heli_lab.identify.functions import Floats
from heli_lab.identify.residual_noise import floored_mean_square

_ROUNDS: Final = 4
"""Updates of the axes' variances in a score."""


@dataclass(frozen=True)
class ScoreResult:
    """What columns would change, to first order.

    Parameters
    ----------
    gain : float
        Drop of sum over axes of rows/2 log(mean square): the logarithm of a likelihood ratio if the steps'
        errors were independent.
    size : ndarray (g,)
        Coefficient of each column.
    std : ndarray (g,)
        Standard error of each if the steps' errors were independent.
    variance : ndarray (3,)
        Mean square of each axis' residual, in units of the rounding's variance, that would be left.
    free : ndarray (f,)
        Change of the model's free parameters that goes with it.
    """

    gain: float
    size: Floats
    std: Floats
    variance: Floats
    free: Floats


class ScoreTest:
    """A fit's residuals on its flights, with all that the model can adapt taken out.

    Parameters
    ----------
    fit : Fit
        The fit.
    """

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        problem = fit.problem
        self.tangents = tuple(Linearisation(fit, index) for index in range(len(problem.records)))
        self.prior: Floats = problem.prior_std**-2.0
        self._off: Floats = fit.theta - problem.prior_mean
        self.rows = sum(tangent.rows for tangent in self.tangents)
        self.weights: Floats = np.concatenate(fit.weights)
        self._sigma_rad = problem.records[0].sigma_rad
        self._tie = np.concatenate((np.zeros(6), problem.state_std**-2.0))
        count = len(problem.free)
        self._known: list[Floats] = []
        blocks = []
        for index, tangent in enumerate(self.tangents):
            own = np.zeros((tangent.rows, 3, count))
            own[:, :, problem.columns[index]] = tangent.free()
            every = np.concatenate((tangent.initial(), own, tangent.residual[:, :, None]), axis=2)
            known = tangent.by_window(every)
            self._known.append(np.ascontiguousarray(known.transpose(0, 1, 3, 2)))
            blocks.append(self._known[-1] @ known)
        self._gram = np.concatenate(blocks)
        self.nothing = self._solve(self._gram, np.zeros(0))

    def score(self, columns: Sequence[Floats], prior_std: Floats | None = None) -> ScoreResult:
        """Score columns beside everything that adapts.

        Parameters
        ----------
        columns : sequence of ndarray (n, 3, g)
            For each flight, as `Linearisation.answer` gives them.
        prior_std : ndarray (g,), optional
            Standard deviation of each coefficient about 0; none known where not given.

        Returns
        -------
        ScoreResult
            What they would gain.
        """
        return self.score_each(columns, [columns[0].shape[2]], None if prior_std is None else [prior_std])[0]

    def score_each(
        self, columns: Sequence[Floats], sizes: Sequence[int], priors: Sequence[Floats] | None = None
    ) -> list[ScoreResult]:
        """Score several candidates, each for itself.

        Parameters
        ----------
        columns : sequence of ndarray (n, 3, s)
            For each flight the columns of all candidates side by side.
        sizes : sequence of int
            Number of columns of each.
        priors : sequence of ndarray, optional
            For each candidate, standard deviation of each coefficient about 0.

        Returns
        -------
        list of Answer
            What each would gain.
        """
        padded = [t.by_window(c) for t, c in zip(self.tangents, columns, strict=True)]
        beside = np.concatenate([known @ one for known, one in zip(self._known, padded, strict=True)])
        order = self._gram.shape[2]
        answers = []
        low = 0
        for number, g in enumerate(sizes):
            part = slice(low, low + g)
            own = np.concatenate([c[..., part].transpose(0, 1, 3, 2) @ c[..., part] for c in padded])
            normal_matrix = np.empty((len(self._gram), 3, order + g, order + g))
            normal_matrix[:, :, : order - 1, : order - 1] = self._gram[:, :, :-1, :-1]
            # Order: initial states, free parameters, columns, residual.
            cross = beside[..., part]
            normal_matrix[:, :, : order - 1, order - 1 : -1] = cross[:, :, :-1]
            normal_matrix[:, :, order - 1 : -1, : order - 1] = cross[:, :, :-1].transpose(0, 1, 3, 2)
            normal_matrix[:, :, order - 1 : -1, order - 1 : -1] = own
            normal_matrix[:, :, -1, order - 1 : -1] = cross[:, :, -1]
            normal_matrix[:, :, order - 1 : -1, -1] = cross[:, :, -1]
            normal_matrix[:, :, -1, : order - 1] = self._gram[:, :, -1, :-1]
            normal_matrix[:, :, : order - 1, -1] = self._gram[:, :, :-1, -1]
            normal_matrix[:, :, -1, -1] = self._gram[:, :, -1, -1]
            answers.append(
                self._solve(normal_matrix, np.zeros(g) if priors is None else priors[number] ** -2.0)
            )
            low += g
        return answers

    def _solve(self, normal_matrix: Floats, column_prior: Floats) -> ScoreResult:
        nx, count = self.fit.problem.state_count, len(self.prior)
        prior = np.concatenate((self.prior, column_prior))
        pull = np.concatenate((-self.prior * self._off, np.zeros(len(column_prior))))
        variance = np.einsum("waii,w->ai", normal_matrix[:, :, -1:, -1:], self.weights)[:, 0] / self.rows
        scale = floored_mean_square(variance, self._sigma_rad)
        # Columns in units of their own size: frequencies and masses side by side stay well conditioned.
        unit = np.sqrt(np.maximum(np.einsum("waii->i", normal_matrix[:, :, nx:-1, nx:-1]) + prior, 1e-30))
        diagonal = np.arange(nx)
        for _ in range(_ROUNDS):
            normal = np.einsum("wa,waij->wij", self.weights[:, None] / scale, normal_matrix)
            state = normal[:, :nx, :nx] + np.diag(self._tie)
            state[:, diagonal, diagonal] += 1e-12 * state[:, diagonal, diagonal].max(axis=1, keepdims=True)
            follow = np.linalg.solve(state, normal[:, :nx, nx:])
            rest = (normal[:, nx:, nx:] - normal[:, :nx, nx:].transpose(0, 2, 1) @ follow).sum(axis=0)
            matrix = (rest[:-1, :-1] + np.diag(prior)) / np.outer(unit, unit)
            inverse = np.linalg.pinv(matrix, rcond=1e-12, hermitian=True) / np.outer(unit, unit)
            theta = inverse @ (rest[:-1, -1] + pull)
            states = follow[:, :, -1] - follow[:, :, :-1] @ theta
            moved = np.broadcast_to(-theta, (len(states), len(theta)))
            every = np.concatenate((-states, moved, np.ones((len(states), 1))), axis=1)
            after = np.matmul(normal_matrix, every[:, None, :, None])[..., 0]
            square = np.einsum("wi,wai->wa", every, after)
            variance = np.maximum((self.weights @ square) / self.rows, 0.0)
            scale = floored_mean_square(variance, self._sigma_rad)
        off = self._off + theta[:count]
        likelihood = float((np.log(scale) + variance / scale).sum())
        cost = 0.5 * (self.rows * likelihood + float(off @ (self.prior * off)))
        base = self.nothing.gain if hasattr(self, "nothing") else 0.0
        std = np.sqrt(np.maximum(np.diag(inverse)[count:], 0.0))
        return ScoreResult(-cost - base, theta[count:], std, variance, theta[:count])
