"""Screening: score tests of all candidates about one estimate, effects on their grids, and spline terms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.effects.spec import EffectSpec

from heli_lab.diagnose.search.candidate import Candidate, Scored
from heli_lab.diagnose.search.effect_grids import EffectGrids
from heli_lab.diagnose.search.regressors import ChangeFunctions, Regressors, spline_candidates
from heli_lab.diagnose.search.splines import KNOTS, SplineTerm
from heli_lab.diagnose.thresholds import MIN_MARGIN
from heli_lab.estimation import Estimate
from heli_lab.estimation.arrowhead import solve_arrowhead
from heli_lab.threads import default_thread_count, parallel_map

_BATCH_NUMBERS: Final = 1_250_000
"""Floating-point numbers of the regressors that a thread filters together, 10 MB: 32 regressors of a flight
of one minute. Memory and time depend on it, the result does not."""
_BISECTIONS: Final = 6
"""How often the distance of a grid is halved about its best point: to a sixty-fourth."""
_DIFFERENCE_STD: Final = 0.5
"""Prior standard deviation of the coefficient of a regressor that is the effect at a given size."""


Score = tuple[float, Floats, Floats]
"""Result of a score test: gain in nats, coefficients, standard errors of the coefficients."""


class Screening:
    """Score tests of candidates: the gain of the log-likelihood if a candidate were added to a model, to
    first order, with all free parameters refitted and the disturbances unchanged.

    Parameters
    ----------
    estimate : Estimate
        The model, estimated on the flights.

    Attributes
    ----------
    filtered : InnovationsModel
        The model linearised along the flights.
    regressors : tuple of Regressors
        For each flight, the source of the candidates' signals.
    seconds : float
        Length of the longest flight [s].
    batch : int
        Number of regressors that are filtered together, one flight after the other.
    measurements : int
        Number of innovations of all flights.
    """

    def __init__(self, estimate: Estimate) -> None:
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
        # On a long flight, a single batch needs more memory than that.
        self.threads = default_thread_count() if batch >= KNOTS else 1
        self._innovations = innovations = filtered.innovations(disturbances)
        parameter_vector = estimate.parameter_vector
        self.measurements = sum(len(flight) for flight in innovations.flights)
        self._arrowhead = (
            innovations.information() + np.diag(parameter_vector.std**-2.0),
            innovations.per_flight,
        )
        offset = parameter_vector.std**-2.0 * (estimate.theta - parameter_vector.mean)
        # Innovations after a refit of the free parameters, to first order.
        self._error = innovations.after(self._solved(innovations.score() - offset))

    def release(self) -> None:
        """Free the memory of cached signals, 0.2 GB for ten minutes of flight; they are computed
        again when needed.
        """
        for linear, maker in zip(self.filtered.linearised_flights, self.regressors, strict=True):
            linear.release()
            maker.release()

    def effects(self, kinds: Iterable[EffectSpec]) -> list[Scored]:
        """Score the effects `kinds`, each at the best point of its grid, the highest score first."""
        grids = [(kind, self._grids.candidates(kind)) for kind in {kind.id: kind for kind in kinds}.values()]
        scores = iter(self.score([candidate for _, candidates in grids for candidate in candidates]))
        scored_grids = [(kind, candidates, [next(scores) for _ in candidates]) for kind, candidates in grids]
        best = parallel_map(lambda grid: _best_on_grid(self, *grid), scored_grids, self.threads)
        possible = [scored for scored in best if scored is not None]
        return sorted(possible, key=lambda scored: -scored.log_likelihood_gain)

    def splines(self, number: int = 0) -> list[Scored]:
        """Score all spline terms, the highest score first; `number` distinguishes spline terms of
        one model.
        """
        candidates = spline_candidates(self.filtered.linearised_flights, number)
        self._prepare(candidates)
        scored_terms = [
            Scored(candidate, *score, 1)
            for candidate, score in zip(candidates, self.score(candidates), strict=True)
        ]
        return sorted(scored_terms, key=lambda scored: -scored.log_likelihood_gain)

    def score(self, candidates: Sequence[Candidate]) -> list[Score]:
        """Score each of the `candidates` by itself, in their order."""
        groups: list[list[Candidate]] = []
        width = self.batch
        for candidate in candidates:
            size = max(1, len(candidate.linear_parameters))
            if width + size > self.batch:
                groups.append([])
                width = 0
            groups[-1].append(candidate)
            width += size
        return [score for scores in parallel_map(self._score_group, groups, self.threads) for score in scores]

    def score_signals(
        self, signals: Iterable[tuple[Floats, Floats | None]], sizes: Sequence[int], priors: Sequence[Floats]
    ) -> list[Score]:
        """Score candidates by the signals of their regressors.

        Parameters
        ----------
        signals : iterable of (ndarray, ndarray or None)
            For each flight, changes of the rates, (n, states, s), and of the measured angles, (n, 3, s) or
            None, by the regressors of all candidates along the last axis.
        sizes : sequence of int
            Number of regressors of each candidate.
        priors : sequence of ndarray (g,)
            Prior standard deviations of each candidate's coefficients about 0.
        """
        return [
            score_of(*part, std) for part, std in zip(self.information(signals, sizes), priors, strict=True)
        ]

    def information(
        self, signals: Iterable[tuple[Floats, Floats | None]], sizes: Sequence[int]
    ) -> list[tuple[Floats, Floats]]:
        """Fisher information and score of each candidate's coefficients over all flights, with the free
        parameters projected out.

        Parameters
        ----------
        signals, sizes
            As in `score_signals`.

        Returns
        -------
        list of (ndarray (g, g), ndarray (g,))
            Information and score of each candidate.
        """
        return self.projected(self.filtered.regressors(self.estimate.disturbances, signals), sizes)

    def projected(self, regressors: Iterable[Floats], sizes: Sequence[int]) -> list[tuple[Floats, Floats]]:
        """Compute Fisher information and score from derivatives of the innovations.

        Parameters
        ----------
        regressors : iterable of ndarray (m, s)
            For each flight, derivatives of the innovations to the coefficients of all candidates.
        sizes : sequence of int
            Number of regressors of each candidate.

        Returns
        -------
        list of (ndarray (g, g), ndarray (g,))
            Fisher information and score of each candidate, with the free parameters projected out.
        """
        parts = [slice(high - size, high) for size, high in zip(sizes, np.cumsum(sizes), strict=True)]
        width = sum(sizes)
        # Blocks of the information: each candidate alone, and between free parameters and candidates.
        own = [np.zeros((size, size)) for size in sizes]
        cross = np.zeros((self._innovations.size, width))
        score, free_score = np.zeros(width), np.zeros(self._innovations.size)
        for candidates, flight, columns, error in zip(
            regressors, self._innovations.flights, self._innovations.columns, self._error, strict=True
        ):
            free = flight[:, 1:]
            cross[columns] += free.T @ candidates
            free_score[columns] += free.T @ error
            score += candidates.T @ error
            for number, part in enumerate(parts):
                own[number] += candidates[:, part].T @ candidates[:, part]
        # Change of the free parameters per unit of each coefficient.
        response = self._solved(cross)
        score -= response.T @ free_score
        results = []
        for total, part in zip(own, parts, strict=True):
            information = total - cross[:, part].T @ response[:, part]
            results.append((0.5 * (information + information.T), score[part]))
        return results

    def _solved(self, right: Floats) -> Floats:
        """Solution of the normal equations of the free parameters for a right-hand side."""
        return solve_arrowhead(self._arrowhead[0], right, self._arrowhead[1])

    def spline_information(self, candidates: Sequence[Candidate]) -> list[tuple[Floats, Floats]]:
        """Compute Fisher information and score of each of the spline terms `candidates`, as
        `information` does.
        """
        self._prepare(candidates)
        group_size = self.batch // KNOTS
        groups = [candidates[low : low + group_size] for low in range(0, len(candidates), group_size)]
        return [
            information
            for group_information in parallel_map(self._spline_group, groups, self.threads)
            for information in group_information
        ]

    def _prepare(self, candidates: Iterable[Candidate]) -> None:
        """Compute what spline terms of a channel share before threads need it."""
        first: dict[str, SplineTerm] = {}
        for candidate in candidates:
            if isinstance(candidate.effect, SplineTerm):
                first.setdefault(candidate.effect.channel, candidate.effect)
        parallel_map(
            lambda term: [maker.influence(term) for maker in self.regressors],
            list(first.values()),
            self.threads,
        )

    def _spline_group(self, group: Sequence[Candidate]) -> list[tuple[Floats, Floats]]:
        signals = (signals_of(maker, group) for maker in self.regressors)
        return self.information(signals, [len(candidate.linear_parameters) for candidate in group])

    def _score_group(self, candidates: Sequence[Candidate]) -> list[Score]:
        sizes = [max(1, len(candidate.linear_parameters)) for candidate in candidates]
        signals = (signals_of(maker, candidates) for maker in self.regressors)
        return self.score_signals(signals, sizes, [coefficient_std(candidate) for candidate in candidates])


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
    return float(0.5 * score @ coefficients), coefficients, std


def signals_of(maker: Regressors, candidates: Sequence[Candidate]) -> tuple[Floats, Floats | None]:
    """Signals of `candidates` in the flight of a `maker`, one candidate after the other along the last axis.

    Returns
    -------
    rates : ndarray (n, states, s)
        Changes of the rates.
    angles : ndarray (n, 3, s) or None
        Changes of the measured angles; None if no candidate changes them.
    """
    pairs = [maker.signals(candidate) for candidate in candidates]
    if len(pairs) == 1:
        return pairs[0]
    rates = np.concatenate([candidate_rates for candidate_rates, _ in pairs], axis=2)
    if all(candidate_angles is None for _, candidate_angles in pairs):
        return rates, None
    parts = []
    for candidate_rates, candidate_angles in pairs:
        unchanged = np.zeros((len(rates), 3, candidate_rates.shape[2]))
        parts.append(unchanged if candidate_angles is None else candidate_angles)
    return rates, np.concatenate(parts, axis=2)


def coefficient_std(candidate: Candidate) -> Floats:
    """Prior standard deviations of a candidate's coefficients about 0, shape (g,)."""
    if not candidate.linear_parameters:
        return np.array([_DIFFERENCE_STD])
    return np.array([candidate.effect.priors[name].std for name in candidate.linear_parameters])


def _possible(candidate: Candidate, coefficients: Floats) -> bool:
    """Whether the priors allow the signs of the coefficients that a score test estimates."""
    for name, change in zip(candidate.linear_parameters, coefficients, strict=False):
        prior = candidate.effect.priors[name]
        if prior.low >= 0.0 and change + candidate.effect.values[name] <= 0.0:
            return False
    return bool(candidate.linear_parameters) or float(coefficients[0]) > 0.0


def _best_on_grid(
    screening: Screening, kind: EffectSpec, candidates: Sequence[Candidate], scores: Sequence[Score]
) -> Scored | None:
    """The best point of an effect's grid, refined; None if the priors forbid the signs at all points."""
    allowed = [
        (gain, number)
        for number, (candidate, (gain, coefficients, _)) in enumerate(zip(candidates, scores, strict=True))
        if _possible(candidate, coefficients)
    ]
    if not allowed:
        return None
    _, best_number = max(allowed)
    best = Scored(candidates[best_number], *scores[best_number], len(candidates))
    if best.candidate.grid and len(candidates) > 1 and best.log_likelihood_gain > 0.5 * MIN_MARGIN:
        best = _refined(screening, kind, candidates, best)
    return best


def _refined(screening: Screening, kind: EffectSpec, candidates: Sequence[Candidate], best: Scored) -> Scored:
    """Halve the grid's distance about its best point, in parameters with three values and more."""
    for name in best.candidate.grid:
        flight = best.candidate.effect.flight
        values = sorted({tried.grid[name] for tried in candidates if tried.effect.flight == flight})
        prior = kind.priors.get(name)
        if len(values) < 3 or prior is None:
            continue
        gaps = np.diff(values)
        place = int(np.argmin(np.abs(np.array(values) - best.candidate.grid[name])))
        step = float(gaps[min(place, len(gaps) - 1)])
        if name.endswith("Hz"):
            step = 0.25 / screening.seconds
        for _ in range(_BISECTIONS):
            step *= 0.5
            candidate = best.candidate
            neighbours = [
                Candidate(
                    candidate.id,
                    replace(candidate.effect, values={**candidate.effect.values, name: value}),
                    candidate.linear_parameters,
                    {**candidate.grid, name: value},
                )
                for value in (candidate.grid[name] - step, candidate.grid[name] + step)
                if prior.low <= value <= prior.high
            ]
            best = replace(best, tried=best.tried + len(neighbours))
            for other, (gain, coefficients, std) in zip(neighbours, screening.score(neighbours), strict=True):
                if gain > best.log_likelihood_gain and _possible(other, coefficients):
                    best = Scored(other, gain, coefficients, std, best.tried)
    return best
