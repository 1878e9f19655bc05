"""Screening: score tests of every candidate about one estimate, on their grids, and of spline terms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.effects.kind import EffectKind
from heli_sim.model.parts import AXES

from heli_lab.diagnose.candidate import (
    Candidate,
    ChangeFunctions,
    Regressors,
    effect_candidates,
    spline_candidates,
)
from heli_lab.diagnose.spline_term import KNOTS, SplineTerm
from heli_lab.estimation import Estimate
from heli_lab.estimation.arrowhead import solve_arrowhead
from heli_lab.threads import default_thread_count, parallel_map

_BATCH_NUMBERS: Final = 1_250_000
"""Numbers of the regressors that a thread filters at once, 10 MB: 32 regressors of a flight of a minute. The
result does not depend on it, memory and time do."""
_JUMP_s: Final = 1.0
"""Time before and after a moment over which torques are averaged to see them jump there: longer than a step
response of the filter, shorter than what drifts."""
_JUMPS: Final = 3
"""Moments of jumps that are tried beside the grid. Fewer: of two steps the smaller is missed. More: time."""
_PEAKS: Final = 4
"""Frequencies that are tried on each axis: the highest peaks of the missing torque's spectrum. Fewer: a
periodic torque beside larger disturbances is lost. More: time."""
_MIN_Hz, _MAX_Hz = 0.03, 12.0
"""Below, a period is longer than half a minute of flight; above, the arm hardly moves."""
_MAX_GRID: Final = 16
"""Points of one parameter's grid, before the best one's neighbourhood is refined."""
_BISECTIONS: Final = 6
"""Times that the grid's distance is halved about the best point: to a sixty-fourth."""
_WORTH_REFINING: Final = 3.0
"""Score, nats, from which on the grid about it is refined: half of what an effect needs to be refitted."""
_SIZES: Final = (0.2, 0.6, 1.2)
"""Shares of the typical size at which an effect with states of its own is tried: it is not linear in it."""
_DIFFERENCE_STD: Final = 0.5
"""Prior standard deviation of the coefficient of a regressor that is the effect at such a size."""


Score = tuple[float, Floats, Floats]
"""Gain of a score test, coefficients and their standard errors."""


@dataclass(frozen=True)
class Scored:
    """A candidate at the best of the `tried` points of its grid.

    Parameters
    ----------
    log_likelihood_gain : float
        Gain that the score test promises, nats, all other parameters refitted and the weather as it is.
    coefficients, std : ndarray (g,)
        Of its regressors, and their standard errors.
    """

    candidate: Candidate
    log_likelihood_gain: float
    coefficients: Floats
    std: Floats
    tried: int


class Screening:
    """Scores candidates about an `estimate`.

    Parameters
    ----------
    threads : int, optional
        Threads that score candidates; `default_thread_count` where not given. The scores do not depend on
        it.
    """

    def __init__(self, estimate: Estimate, threads: int | None = None) -> None:
        self.estimate = estimate
        self.filtered = filtered = estimate.filtered()
        disturbances = estimate.disturbances
        functions = ChangeFunctions(filtered.linearised_flights[0].model.source)
        self.regressors = tuple(Regressors(linear, functions) for linear in filtered.linearised_flights)
        self.seconds = max(float(model.trajectory.t_s[-1]) for model in filtered.linearised_flights)
        rows = max(model.rows for model in filtered.linearised_flights)
        threads = default_thread_count() if threads is None else threads
        batch = _BATCH_NUMBERS // (rows * filtered.linearised_flights[0].states)
        self.batch = max(KNOTS, batch)
        """Regressors that are filtered together, one flight after the other."""
        # Of a long flight one such batch needs more memory than that already.
        self.threads = threads if batch >= KNOTS else 1
        self._innovations = innovations = filtered.innovations_by_flight(disturbances)
        parameter_vector = estimate.parameter_vector
        self.measurements = sum(len(flight) for flight in innovations.flights)
        self._bordered = (
            innovations.information() + np.diag(parameter_vector.std**-2.0),
            innovations.per_flight,
        )
        offset = parameter_vector.std**-2.0 * (estimate.theta - parameter_vector.mean)
        self._error = innovations.after(self._solved(innovations.score() - offset))

    def release(self) -> None:
        """Give back what scoring keeps: 0.2 GB of ten minutes; it is made again when asked for."""
        for linear, maker in zip(self.filtered.linearised_flights, self.regressors, strict=True):
            linear.release()
            maker.release()

    def effects(self, kinds: Iterable[EffectKind]) -> list[Scored]:
        """Score effects of the catalogue, each at the best point of its grid, the highest score first."""
        places = {kind.id: (kind, self._places(kind)) for kind in kinds}
        flat = [candidate for _, candidates in places.values() for candidate in candidates]
        scores = iter(self.score(flat))
        scored = [(kind, some, [next(scores) for _ in some]) for kind, some in places.values()]
        scored_ = parallel_map(lambda arguments: self._best(*arguments), scored, self.threads)
        return sorted(
            (scored_effect for scored_effect in scored_ if scored_effect is not None),
            key=lambda scored_effect: -scored_effect.log_likelihood_gain,
        )

    def splines(self, number: int = 0) -> list[Scored]:
        """Score every spline term, the highest score first; `number` distinguishes those of one model."""
        candidates = spline_candidates(self.filtered.linearised_flights, number)
        self._prepare(candidates)
        scored_ = [
            Scored(candidate, *score, 1)
            for candidate, score in zip(candidates, self.score(candidates), strict=True)
        ]
        return sorted(scored_, key=lambda scored_spline: -scored_spline.log_likelihood_gain)

    def score(self, candidates: Sequence[Candidate]) -> list[Score]:
        """Gain [nats], coefficients and their standard errors of each candidate by itself."""
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
        """Gain, coefficients and their standard errors of regressors that are given.

        Parameters
        ----------
        signals : iterable of (ndarray, ndarray or None)
            For each flight the change of the rates, (n, states, s), and of the measured angles, (n, 3, s),
            all candidates side by side.
        sizes : sequence of int
            Regressors of each candidate.
        priors : sequence of ndarray
            Standard deviations of each candidate's coefficients about 0.
        """
        return [
            score_of(*part, std) for part, std in zip(self.information(signals, sizes), priors, strict=True)
        ]

    def information(
        self, signals: Iterable[tuple[Floats, Floats | None]], sizes: Sequence[int]
    ) -> list[tuple[Floats, Floats]]:
        """Fisher information and score of the coefficients of regressors, the free parameters projected out;
        those of several flights add up.

        Parameters
        ----------
        signals : iterable of (ndarray, ndarray or None)
            As in `score_signals`.
        sizes : sequence of int
            Regressors of each candidate.
        """
        return self.projected(self.filtered.regressors(self.estimate.disturbances, signals), sizes)

    def projected(self, regressors: Iterable[Floats], sizes: Sequence[int]) -> list[tuple[Floats, Floats]]:
        """The same of what `regressors` take off each flight's innovations, shape (m, s) for each in
        turn, all candidates side by side, `sizes` of them each.
        """
        parts = [slice(high - size, high) for size, high in zip(sizes, np.cumsum(sizes), strict=True)]
        width = sum(sizes)
        raw = [np.zeros((size, size)) for size in sizes]
        score, own_score = np.zeros(width), np.zeros(self._innovations.size)
        mixed = np.zeros((self._innovations.size, width))
        for only, nuisance, columns, error in zip(
            regressors, self._innovations.flights, self._innovations.columns, self._error, strict=True
        ):
            mixed[columns] += nuisance[:, 1:].T @ only
            own_score[columns] += nuisance[:, 1:].T @ error
            score += only.T @ error
            for number, part in enumerate(parts):
                raw[number] += only[:, part].T @ only[:, part]
        fitted = self._solved(mixed)
        score -= fitted.T @ own_score
        results = []
        for total, part in zip(raw, parts, strict=True):
            information = total - mixed[:, part].T @ fitted[:, part]
            results.append((0.5 * (information + information.T), score[part]))
        return results

    def _solved(self, right: Floats) -> Floats:
        """Moves of the free parameters that the `right` side of their normal equations asks for."""
        return solve_arrowhead(self._bordered[0], right, self._bordered[1])

    def spline_information(self, candidates: Sequence[Candidate]) -> list[tuple[Floats, Floats]]:
        """The same of spline terms."""
        self._prepare(candidates)
        every = self.batch // KNOTS
        groups = [candidates[low : low + every] for low in range(0, len(candidates), every)]
        return [
            information
            for group_information in parallel_map(self._spline_group, groups, self.threads)
            for information in group_information
        ]

    def _prepare(self, candidates: Iterable[Candidate]) -> None:
        """Make what spline terms of a channel share, by the first of them whichever thread scores first."""
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

    def _best(
        self, kind: EffectKind, candidates: Sequence[Candidate], scores: Sequence[Score]
    ) -> Scored | None:
        tried = len(candidates)
        allowed = [
            (gain, number)
            for number, (candidate, (gain, coefficients, _)) in enumerate(
                zip(candidates, scores, strict=True)
            )
            if _possible(candidate, coefficients)
        ]
        if not allowed:
            return None
        best = Scored(candidates[max(allowed)[1]], *scores[max(allowed)[1]], tried)
        if best.candidate.grid and len(candidates) > 1 and best.log_likelihood_gain > _WORTH_REFINING:
            best = self._refined(kind, candidates, best)
        return best

    def _places(self, kind: EffectKind) -> list[Candidate]:
        frequency = next((q.name for q in kind.parameters if q.unit == "Hz" and q.name in kind.grid), None)
        if frequency is not None:
            axis = kind.acts_on.rpartition(".")[2]
            candidates = effect_candidates(
                replace(
                    kind,
                    numbers=tuple(
                        replace(number, grid=self._peaks(axis))
                        if kind.full(number.what) == frequency
                        else number
                        for number in kind.numbers
                    ),
                ),
                self.seconds,
            )
        else:
            candidates = effect_candidates(_thinned(kind, self.seconds, self._jumps), self.seconds)
        if kind.states or kind.delay:
            candidates = [
                Candidate(candidate.id, kind.make(_scaled(kind, candidate, share)), (), candidate.grid)
                for candidate in candidates
                for share in _SIZES
            ]
        return candidates

    def _refined(self, kind: EffectKind, candidates: Sequence[Candidate], best: Scored) -> Scored:
        """Halve the grid's distance about its best point, in parameters of three values and more."""
        for name in best.candidate.grid:
            values = sorted({tried.grid[name] for tried in candidates})
            prior = kind.priors.get(name)
            if len(values) < 3 or prior is None:
                continue
            gaps = np.diff(values)
            place = int(np.argmin(np.abs(np.array(values) - best.candidate.grid[name])))
            step = float(gaps[min(place, len(gaps) - 1)])
            if name.endswith("Hz"):
                step = 0.25 / self.seconds
            for _ in range(_BISECTIONS):
                step *= 0.5
                candidate = best.candidate
                warm_start = [
                    Candidate(
                        candidate.id,
                        kind.make({**candidate.effect.values, name: value}),
                        candidate.linear_parameters,
                        {**candidate.grid, name: value},
                    )
                    for value in (candidate.grid[name] - step, candidate.grid[name] + step)
                    if prior.low <= value <= prior.high
                ]
                best = replace(best, tried=best.tried + len(warm_start))
                for other, (gain, coefficients, std) in zip(warm_start, self.score(warm_start), strict=True):
                    if gain > best.log_likelihood_gain and _possible(other, coefficients):
                        best = Scored(other, gain, coefficients, std, best.tried)
        return best

    @cached_property
    def _smoothed(self) -> tuple[Floats, Floats]:
        """Times in the first flight, (m,), and torques there that weather stands for, (m, 3)."""
        t_s, torque_Nm, _ = self.filtered.smoothed_disturbances(
            self.estimate.disturbances, np.zeros(len(self.estimate.theta))
        )[0]
        return t_s, torque_Nm

    @cached_property
    def _jumps(self) -> tuple[float, ...]:
        """Moments at which the mean of those torques changes most, of all axes: weather with a memory of
        seconds hides a step from a score that is taken a second beside it.
        """
        t_s, torque_Nm = self._smoothed
        width = max(1, round(_JUMP_s / float(np.median(np.diff(t_s)))))
        if len(t_s) < 4 * width:
            return ()
        sums = np.vstack((np.zeros(3), np.cumsum(torque_Nm, axis=0)))
        means = (sums[width:] - sums[:-width]) / width
        jump = np.abs(means[width:] - means[:-width])
        height = (jump / (jump.std(axis=0) + 1e-12)).max(axis=1)
        jumps = []
        for _ in range(_JUMPS):
            top = int(np.argmax(height))
            jumps.append(float(t_s[top + width]))
            height[max(0, top - 2 * width) : top + 2 * width] = -1.0
        return tuple(jumps)

    def _peaks(self, axis: str) -> tuple[float, ...]:
        """Frequencies of the highest peaks of the torque's spectrum about an axis that weather stands for."""
        index = AXES.index(axis)
        t_s, torque_Nm = self._smoothed
        value = torque_Nm[:, index]
        step_s = float(np.median(np.diff(t_s)))
        frequency_Hz = np.fft.rfftfreq(4 * len(value), step_s)
        power = np.abs(np.fft.rfft((value - value.mean()) * np.hanning(len(value)), 4 * len(value)))
        # White noise through the weather's memory falls with frequency: a peak is measured against that.
        power *= np.hypot(
            1.0, 2 * np.pi * frequency_Hz * self.estimate.disturbances.correlation_time_s[index]
        )
        power[(frequency_Hz < _MIN_Hz) | (frequency_Hz > _MAX_Hz)] = 0.0
        top = [i for i in range(1, len(power) - 1) if power[i] >= power[i - 1] and power[i] > power[i + 1]]
        top.sort(key=lambda i: -power[i])
        return tuple(float(frequency_Hz[i]) for i in top[:_PEAKS]) or (0.5,)


def score_of(information: Floats, score: Floats, prior_std: Floats) -> Score:
    """Gain, coefficients and standard errors of a score test with normal priors about 0.

    Parameters
    ----------
    information : ndarray (g, g)
        Fisher information of the coefficients.
    score : ndarray (g,)
        Derivatives of the log-likelihood.
    prior_std : ndarray (g,)
        Standard deviations of the priors.
    """
    covariance = np.linalg.pinv(information + np.diag(prior_std**-2.0), hermitian=True)
    coefficients = covariance @ score
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return float(0.5 * score @ coefficients), coefficients, std


def signals_of(maker: Regressors, candidates: Sequence[Candidate]) -> tuple[Floats, Floats | None]:
    """Changes of rates and measured angles by candidates in one flight, side by side."""
    pairs = [maker.signals(candidate) for candidate in candidates]
    if len(pairs) == 1:
        return pairs[0]
    rates = np.concatenate([rates_ for rates_, _ in pairs], axis=2)
    if all(angles_ is None for _, angles_ in pairs):
        return rates, None
    shape = len(rates), 3
    return rates, np.concatenate(
        [np.zeros((*shape, r.shape[2])) if angles_ is None else angles_ for r, angles_ in pairs], axis=2
    )


def coefficient_std(candidate: Candidate) -> Floats:
    """Prior standard deviations of a candidate's coefficients about 0, shape (g,)."""
    if not candidate.linear_parameters:
        return np.array([_DIFFERENCE_STD])
    return np.array([candidate.effect.priors[name].std for name in candidate.linear_parameters])


def _thinned(kind: EffectKind, seconds: float, jumps: tuple[float, ...]) -> EffectKind:
    """The effect with coarser grids, and with `jumps` in that of a moment: the neighbourhood of the best
    point is refined later.
    """
    scan = kind.grid_values(seconds)

    def thin(what: str) -> tuple[float, ...]:
        values = scan[kind.full(what)]
        thinned = values[:: -(-len(values) // _MAX_GRID)]
        return tuple(sorted({*thinned, *jumps})) if what == "at_s" else thinned

    numbers = tuple(
        number if number.grid is None else replace(number, grid=thin(number.what)) for number in kind.numbers
    )
    return replace(kind, numbers=numbers)


def _scaled(kind: EffectKind, candidate: Candidate, share: float) -> Mapping[str, float]:
    return {
        **candidate.effect.values,
        **{name: share * kind.typical[name] for name in kind.size},
    }


def _possible(candidate: Candidate, coefficients: Floats) -> bool:
    """Whether the coefficients that a score estimates have signs that their priors allow."""
    for name, change in zip(candidate.linear_parameters, coefficients, strict=False):
        prior = candidate.effect.priors[name]
        if prior.low >= 0.0 and change + candidate.effect.values[name] <= 0.0:
            return False
    return bool(candidate.linear_parameters) or float(coefficients[0]) > 0.0
