"""Screening: ranks all effects and spline terms by how much each would improve an estimated model.

A score test predicts the improvement without a refit, to first order, so that hundreds of candidates can be
compared.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effects.spec import EffectSpec

from heli_lab.explain.search.candidate import Candidate, ScoredCandidate
from heli_lab.explain.search.effect_grids import EffectGrids
from heli_lab.explain.search.grid_search import GridSearch
from heli_lab.explain.search.regressors import (
    CandidateSignals,
    ChangeFunctions,
    Regressors,
    spline_candidates,
)
from heli_lab.explain.search.score_test import Score, ScoreStatistics, score_of
from heli_lab.explain.search.splines import KNOTS, SplineTerm
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.normal_equations import solve_arrowhead
from heli_lab.threads import batches, default_thread_count, parallel_map

_BATCH_NUMBERS: Final = 1_250_000
"""Floating-point numbers of the regressors that a thread filters together, 10 MB: 32 regressors of a flight
of one minute. Memory and time depend on it, the result does not."""
_DIFFERENCE_STD: Final = 0.5
"""Prior standard deviation of the only coefficient of an effect that is not linear in its size: it scales the
effect, which is tried at several sizes."""


class NormalDistribution(NamedTuple):
    """Mean, shape (f,), and inverse covariance, shape (f, f), of normally distributed parameters."""

    mean: Floats
    precision: Floats


class Screening:
    """Score tests of candidates about one estimated model.

    A score test predicts the gain of the log-likelihood if a candidate were added to the model. The
    prediction is of first order. All free parameters count as refitted, and the disturbances as unchanged.
    """

    def __init__(self, estimate: Estimate, prior: NormalDistribution | None = None) -> None:
        self.estimate = estimate
        self.filtered = filtered = estimate.filtered()
        disturbances = estimate.disturbances
        functions = ChangeFunctions(filtered.linearised_flights[0].model.source)
        self.regressors = tuple(Regressors(linear, functions) for linear in filtered.linearised_flights)
        self.seconds = max(float(model.trajectory.t_s[-1]) for model in filtered.linearised_flights)
        self._grids = EffectGrids(filtered, disturbances, self.seconds)
        rows = max(model.rows for model in filtered.linearised_flights)
        batch = _BATCH_NUMBERS // (rows * filtered.linearised_flights[0].states)
        self.batch = max(KNOTS, batch)
        # On a long flight, even the smallest batch exceeds the memory of one thread.
        self.threads = default_thread_count() if batch >= KNOTS else 1
        self._innovations = innovations = filtered.innovations(disturbances)
        parameter_vector = estimate.parameter_vector
        self.measurements = sum(len(flight) for flight in innovations.flights)
        if prior is None:
            prior = NormalDistribution(parameter_vector.mean, np.diag(parameter_vector.std**-2.0))
        # Normal equations of the free parameters: (parameters, parameters), and the columns of each flight.
        self._normal_equations = (innovations.information() + prior.precision, innovations.per_flight)
        prior_score = prior.precision @ (estimate.theta - prior.mean)
        # Whitened innovations of each flight after a Gauss-Newton step of the free parameters, (m,).
        self._error = innovations.after(self._solve(innovations.score() - prior_score))

    def release(self) -> None:
        """Free the memory of cached signals, 0.2 GB for ten minutes of flight.

        They are computed again when they are needed.
        """
        for linear, regressors in zip(self.filtered.linearised_flights, self.regressors, strict=True):
            linear.release()
            regressors.release()

    def effects(self, kinds: Iterable[EffectSpec]) -> list[ScoredCandidate]:
        """Score the effects `kinds`, each at the best point of its grid, the highest score first."""
        unique_kinds = {kind.id: kind for kind in kinds}.values()
        grids = [(kind, self._grids.candidates(kind)) for kind in unique_kinds]
        # The points of all grids are scored together, because batches across grids save time.
        scores = iter(self.score([candidate for _, candidates in grids for candidate in candidates]))
        scored_grids = [(kind, grid, list(itertools.islice(scores, len(grid)))) for kind, grid in grids]
        search = GridSearch(self.score, self.seconds)
        best_points = parallel_map(
            lambda kind_grid_scores: search.best_point(*kind_grid_scores), scored_grids, self.threads
        )
        return _by_gain(scored for scored in best_points if scored is not None)

    def splines(self, number: int = 0) -> list[ScoredCandidate]:
        """Score all spline terms, the highest score first.

        `number` distinguishes spline terms of one model.
        """
        candidates = spline_candidates(self.filtered.linearised_flights, number)
        self._precompute_influences(candidates)
        scores = self.score(candidates)
        return _by_gain(
            ScoredCandidate(candidate, *score, tried=1)
            for candidate, score in zip(candidates, scores, strict=True)
        )

    def score(self, candidates: Sequence[Candidate]) -> list[Score]:
        """Score each of the `candidates` by itself, in their order."""
        return [
            score_of(*candidate_statistics, coefficient_std(candidate))
            for candidate_statistics, candidate in zip(self.statistics(candidates), candidates, strict=True)
        ]

    def _statistics(self, candidates: Sequence[Candidate]) -> list[ScoreStatistics]:
        """Return the score statistics of candidates, which are filtered together."""
        signals = (signals_of(flight, candidates) for flight in self.regressors)
        return self.information(signals, list(map(_regressor_count, candidates)))

    def information(
        self, signals: Iterable[tuple[Floats, Floats | None]], sizes: Sequence[int]
    ) -> list[ScoreStatistics]:
        """Compute Fisher information and score of each candidate's coefficients over all flights. Shapes:
        `signals` (ndarray, ndarray or None).
        """
        return self.projected(self.filtered.regressors(self.estimate.disturbances, signals), sizes)

    def projected(self, regressors: Iterable[Floats], sizes: Sequence[int]) -> list[ScoreStatistics]:
        """Compute Fisher information and score from derivatives of the innovations. Shapes: `regressors` (m,
        s).

        The free parameters are projected out (partitioned regression, Frisch-Waugh): with X the regressors
        of a candidate and Z those of the free parameters, the information is X'X - X'Z (Z'Z)^-1 Z'X.
        """
        candidate_columns = [
            slice(stop - size, stop) for size, stop in zip(sizes, np.cumsum(sizes), strict=True)
        ]
        parameter_count, regressor_count = self._innovations.size, sum(sizes)
        information_by_candidate = [np.zeros((size, size)) for size in sizes]  # X'X
        score = np.zeros(regressor_count)  # X'e
        parameter_score = np.zeros(parameter_count)  # Z'e
        cross_information = np.zeros((parameter_count, regressor_count))  # Z'X
        for flight_regressors, innovations, parameter_columns, error in zip(
            regressors, self._innovations.flights, self._innovations.columns, self._error, strict=True
        ):
            derivatives = innovations[:, 1:]
            cross_information[parameter_columns] += derivatives.T @ flight_regressors
            parameter_score[parameter_columns] += derivatives.T @ error
            score += flight_regressors.T @ error
            for number, columns in enumerate(candidate_columns):
                candidate_regressors = flight_regressors[:, columns]
                information_by_candidate[number] += candidate_regressors.T @ candidate_regressors
        projection = self._solve(cross_information)  # (Z'Z)^-1 Z'X
        score -= projection.T @ parameter_score
        statistics = []
        for information, columns in zip(information_by_candidate, candidate_columns, strict=True):
            projected = information - cross_information[:, columns].T @ projection[:, columns]
            statistics.append(ScoreStatistics(0.5 * (projected + projected.T), score[columns]))
        return statistics

    def _solve(self, right: Floats) -> Floats:
        """Solve the normal equations of the free parameters for a right-hand side, (parameters, ...)."""
        matrix, per_flight = self._normal_equations
        return solve_arrowhead(matrix, right, per_flight)

    def statistics(self, candidates: Sequence[Candidate]) -> list[ScoreStatistics]:
        """Compute Fisher information and score of each of the `candidates`, as `information` does."""
        candidate_batches = batches(candidates, _regressor_count, self.batch)
        return list(
            itertools.chain.from_iterable(parallel_map(self._statistics, candidate_batches, self.threads))
        )

    def spline_information(self, candidates: Sequence[Candidate]) -> list[ScoreStatistics]:
        """Compute Fisher information and score of each of the spline terms `candidates`."""
        self._precompute_influences(candidates)
        return self.statistics(candidates)

    def _precompute_influences(self, candidates: Iterable[Candidate]) -> None:
        """Compute the influence of each channel of spline terms once, before threads share it."""
        term_of_channel: dict[str, SplineTerm] = {}
        for candidate in candidates:
            if isinstance(candidate.effect, SplineTerm):
                term_of_channel.setdefault(candidate.effect.channel, candidate.effect)
        parallel_map(
            lambda term: [flight.influence(term) for flight in self.regressors],
            list(term_of_channel.values()),
            self.threads,
        )


def signals_of(flight: Regressors, candidates: Sequence[Candidate]) -> CandidateSignals:
    """Return the signals of several `candidates` in a `flight`, one after the other along the last axis."""
    all_signals = [flight.signals(candidate) for candidate in candidates]
    if len(all_signals) == 1:
        return all_signals[0]
    all_rates = np.concatenate([rates for rates, _ in all_signals], axis=2)
    if all(angles is None for _, angles in all_signals):
        return CandidateSignals(all_rates, None)
    all_angles = [
        np.zeros((len(rates), 3, rates.shape[2])) if angles is None else angles
        for rates, angles in all_signals
    ]
    return CandidateSignals(all_rates, np.concatenate(all_angles, axis=2))


def _regressor_count(candidate: Candidate) -> int:
    """Return the number of regressors of a candidate: one per linear parameter, at least one."""
    return max(1, len(candidate.linear_parameters))


def _by_gain(scored: Iterable[ScoredCandidate]) -> list[ScoredCandidate]:
    """Sort candidates by their gain, the highest first."""
    return sorted(scored, key=lambda candidate: -candidate.log_likelihood_gain)


def coefficient_std(candidate: Candidate) -> Floats:
    """Return the prior standard deviations of a candidate's coefficients about 0, shape (g,)."""
    if not candidate.linear_parameters:
        return np.array([_DIFFERENCE_STD])
    return np.array([candidate.effect.priors[name].std for name in candidate.linear_parameters])
