"""Screening: ranks all effects and spline terms by how much each would improve an estimated model.

A score test predicts the improvement without a refit, to first order, so that hundreds of candidates can be
compared. Effects with parameters that do not enter linearly, such as a frequency or the moment of
an event, are scored at the points of a grid, and then between them.

A concentrated score is the gain of a candidate if the disturbances were estimated again with it.
A score holds the disturbances of the model without the candidate. Where they stand in for a missing effect,
its own score is low. A slip of 30 mm that gains 320 nats had a score of 8, and a spring that gains 500 nats
had a score of 5. The likelihood of the candidate and of the disturbances is therefore maximised in
turn, with all other parameters held.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effect import AXES
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.rig import Prior

from heli_lab.explain.candidates import (
    KNOTS,
    Candidate,
    CandidateSignals,
    ChangeFunctions,
    Regressors,
    ScoredCandidate,
    SplineTerm,
    effect_candidates,
    spline_candidates,
)
from heli_lab.explain.thresholds import CHANCE_NATS, MIN_MARGIN, SIGNIFICANT_STD_ERRORS
from heli_lab.fit.estimator import Estimate, estimate_disturbances
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import (
    AuxiliaryResiduals,
    FlightErrors,
    InnovationsModel,
    ModelErrors,
    SmoothedDisturbances,
    auxiliary_residuals,
    smoothed_disturbances,
)
from heli_lab.fit.normal_equations import invert_arrowhead, solve_arrowhead
from heli_lab.fit.parameters import ValueAndStd
from heli_lab.threads import batches, default_thread_count, parallel_map


class Score(NamedTuple):
    """Result of a score test."""

    log_likelihood_gain: float  # Expected gain, nats
    coefficients: Floats  # coefficients, std: (g,): Coefficients of the regressors, and their standard errors
    std: Floats


class ScoreStatistics(NamedTuple):
    """Fisher information and score of a candidate's coefficients, from which a score test follows."""

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


_MAX_PEAKS: Final = 4
"""Frequencies that are tried on each axis. Fewer: a periodic torque is missed in large disturbances. More:
time."""
_MIN_Hz, _MAX_Hz = 0.03, 12.0
"""Range of the frequencies. Below, a period is longer than half a minute of flight; above, the arm hardly
moves."""
_DEFAULT_Hz: Final = 0.5
"""Frequency that is tried if the spectrum has no peak."""
_PADDING: Final = 4
"""Points of a spectrum for each frequency that a flight distinguishes."""
_NEIGHBOURS: Final = 10
"""Frequencies on either side of a peak whose median standardises the peak. Fewer: a peak, which is four
frequencies wide, raises this median itself. More: the slope of the spectrum makes false peaks."""


def peak_frequencies_Hz(impulse_scores: Sequence[Floats], step_s: float) -> tuple[float, ...]:
    """Return the frequencies at which a periodic torque is most significant, the most significant first.
    Shapes: `impulse_scores` (k,).
    """
    # The score of a periodic torque is the Fourier transform of the scores of an impulse at every instant.
    # Disturbances and quantisation alone give this transform a smooth spectrum, which the median of
    # neighbouring frequencies estimates. A peak counts by its ratio to that median.
    point_count = _PADDING * max(map(len, impulse_scores))
    windowed = [(score - score.mean()) * np.hanning(len(score)) for score in impulse_scores]
    # Powers are added, not amplitudes, because the phase may differ from flight to flight.
    power = np.sum([np.abs(np.fft.rfft(score, point_count)) ** 2 for score in windowed], axis=0)
    power /= np.maximum(_local_median(power), np.finfo(float).tiny)
    frequency_Hz = np.fft.rfftfreq(point_count, step_s)
    power[(frequency_Hz < _MIN_Hz) | (frequency_Hz > _MAX_Hz)] = 0.0
    peaks = 1 + np.flatnonzero((power[:-2] <= power[1:-1]) & (power[1:-1] > power[2:]))
    highest = peaks[np.argsort(-power[peaks], kind="stable")][:_MAX_PEAKS]
    return tuple(map(float, frequency_Hz[highest])) or (_DEFAULT_Hz,)


def _local_median(power: Floats) -> Floats:
    """Return the median of a spectrum over the neighbouring frequencies of each of its points, shape (k,)."""
    reach = _PADDING * _NEIGHBOURS
    padded = np.pad(power, reach, mode="reflect")
    neighbours = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)[:, ::_PADDING]
    return np.asarray(np.median(neighbours, axis=1))


_JUMP_WINDOW_s: Final = 1.0
"""Time before and after a moment over which torques are averaged to find a jump: longer than a step response
of the filter, shorter than slow disturbances."""
_MAX_JUMPS: Final = 3
"""Moments of jumps that are added to a grid. Fewer: the smaller of two steps is missed. More: time."""
_MAX_GRID: Final = 16
"""Points of a parameter's grid before the neighbourhood of the best point is refined."""
_SIZE_SHARES: Final = (0.2, 0.6, 1.2)
"""Shares of the typical size at which an effect with states or a delay is tried, because it is not linear in
its size."""


class _EventTimes(NamedTuple):
    """Label and duration [s] of a flight, and the moments at which an event may have happened [s]."""

    label: str
    duration_s: float
    moments_s: tuple[float, ...]


@dataclass
class EffectGrids:
    """Lays out the grid of an effect over flights, with points where the missing torque suggests them."""

    filtered: InnovationsModel  # The present model along the flights
    disturbances: DisturbanceModel  # Its disturbances, as which the torques that it lacks are smoothed
    seconds: float  # Duration of the longest flight

    def candidates(self, kind: EffectSpec) -> list[Candidate]:
        """Return the points of the grid of an effect, at several sizes if it is not linear in its size."""
        frequency = next((q.name for q in kind.parameters if q.unit == "Hz" and q.name in kind.grid), None)
        if frequency is not None:
            candidates = self._at_peak_frequencies(kind, frequency)
        elif kind.full("at_s") in kind.grid:
            candidates = self._at_event_times(kind)
        else:
            candidates = effect_candidates(_coarsened(kind, self.seconds, ()), self.seconds)
        return _at_several_sizes(kind, candidates) if kind.states or kind.delay else candidates

    def _at_peak_frequencies(self, kind: EffectSpec, frequency: str) -> list[Candidate]:
        """Return a periodic effect at its most significant values of its parameter `frequency`."""
        peaks_Hz = self._peak_frequencies_Hz(kind.acts_on.rpartition(".")[2])
        numbers = tuple(
            replace(number, grid=peaks_Hz) if kind.full(number.name) == frequency else number
            for number in kind.numbers
        )
        return effect_candidates(replace(kind, numbers=numbers), self.seconds)

    def _at_event_times(self, kind: EffectSpec) -> list[Candidate]:
        """Return an event in each flight, at times of a coarse grid and at times that the flight suggests."""
        candidates = []
        for flight in self._event_times:
            grid = _coarsened(kind, flight.duration_s, flight.moments_s)
            candidates += [
                replace(candidate, effect=replace(candidate.effect, flight=flight.label))
                for candidate in effect_candidates(grid, flight.duration_s)
            ]
        return candidates

    @cached_property
    def _smoothed(self) -> list[SmoothedDisturbances]:
        """Smoothed disturbance torques of each flight."""
        return smoothed_disturbances(self.filtered, self.disturbances)

    @cached_property
    def _event_times(self) -> list[_EventTimes]:
        """Moments at which an event may have happened, for each flight."""
        # These are jumps of the smoothed torques, and the instant at which a lasting change of a torque would
        # be most significant, by its auxiliary residual (de Jong and Penzer 1998).
        event_times = []
        for flight, (t_s, torque_Nm, _), residual in zip(
            self.filtered.linearised_flights, self._smoothed, self._auxiliary_residuals, strict=True
        ):
            level_s, _ = residual.largest_level()
            jumps_s = [
                jump_s for jump_s in _jump_times_s(t_s, torque_Nm) if abs(jump_s - level_s) > _JUMP_WINDOW_s
            ]
            label, duration_s = flight.reference.record.label, float(flight.trajectory.t_s[-1])
            event_times.append(_EventTimes(label, duration_s, (*jumps_s, level_s)))
        return event_times

    @cached_property
    def _auxiliary_residuals(self) -> list[AuxiliaryResiduals]:
        """Scores of a shock at every instant of each flight."""
        return auxiliary_residuals(self.filtered, self.disturbances)

    def _peak_frequencies_Hz(self, axis: str) -> tuple[float, ...]:
        """Return the frequencies at which a periodic torque about an axis is most significant."""
        index, residuals = AXES.index(axis), self._auxiliary_residuals
        step_s = float(np.median(np.diff(residuals[0].t_s)))
        return peak_frequencies_Hz([flight.impulse.score[:, index] for flight in residuals], step_s)


def _jump_times_s(t_s: Floats, torque_Nm: Floats) -> tuple[float, ...]:
    """Return the times at which smoothed torques (m, 3) jump most [s]: at most `_MAX_JUMPS`, over all
    axes.
    """
    # A jump is the difference between the mean torques after and before a time. A grid needs these times,
    # because a disturbance with a correlation time of seconds hides a step from a score one second away.
    width = max(1, round(_JUMP_WINDOW_s / float(np.median(np.diff(t_s)))))
    if len(t_s) < 4 * width:
        return ()  # too short for the means before and after a time
    sums = np.vstack((np.zeros(3), np.cumsum(torque_Nm, axis=0)))
    moving_mean_Nm = (sums[width:] - sums[:-width]) / width
    # Row i is the jump at row i + width of the torques.
    jump_Nm = np.abs(moving_mean_Nm[width:] - moving_mean_Nm[:-width])
    standardised_jump = (jump_Nm / (jump_Nm.std(axis=0) + 1e-12)).max(axis=1)
    jumps_s = []
    for _ in range(_MAX_JUMPS):
        largest = int(np.argmax(standardised_jump))
        jumps_s.append(float(t_s[largest + width]))
        # Windows that overlap with this jump show it too: exclude them.
        standardised_jump[max(0, largest - 2 * width) : largest + 2 * width] = -1.0
    return tuple(jumps_s)


def _coarsened(kind: EffectSpec, duration_s: float, moments_s: tuple[float, ...]) -> EffectSpec:
    """Return an effect whose grid has at most about `_MAX_GRID` points per parameter."""
    # The times `moments_s` are added to the grid of an event's moment. A coarse grid is enough, because
    # values near the best point are tried after the score tests.
    grid_values = kind.grid_values(duration_s)

    def coarse_grid(parameter: str) -> tuple[float, ...]:
        values = grid_values[kind.full(parameter)]
        coarse = values[:: math.ceil(len(values) / _MAX_GRID)]
        return tuple(sorted({*coarse, *moments_s})) if parameter == "at_s" else coarse

    parameters = tuple(
        parameter if parameter.grid is None else replace(parameter, grid=coarse_grid(parameter.name))
        for parameter in kind.numbers
    )
    return replace(kind, numbers=parameters)


def _at_several_sizes(kind: EffectSpec, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return each candidate at several shares of the effect's typical size."""
    sized = []
    for candidate in candidates:
        for share in _SIZE_SHARES:
            sizes = {name: share * kind.typical[name] for name in kind.size}
            effect = kind.make({**candidate.effect.values, **sizes})
            sized.append(Candidate(candidate.id, effect, (), candidate.grid))
    return sized


_BISECTIONS: Final = 6
"""How often the distance between two grid points is halved about the best point: to a sixty-fourth."""
_MIN_REFINED_POINTS: Final = 3
"""Grid values from which on a parameter is also searched between them."""
_SPECTRAL_RESOLUTION_SHARE: Final = 0.25
"""First step of a frequency, as a share of the resolution of a spectrum, which is 1 / duration."""
_MIN_REFINED_NATS: Final = 0.5 * MIN_MARGIN
"""Score below which the neighbourhood of a grid's best point is not searched."""


@dataclass(frozen=True)
class GridSearch:
    """Search for the point of an effect's grid that has the highest score."""

    score: Callable[[Sequence[Candidate]], list[Score]]  # Scores candidates, each by itself, in their order
    seconds: float  # Length of the longest flight [s], which limits how well frequencies are distinguished

    def best_point(
        self, kind: EffectSpec, candidates: Sequence[Candidate], scores: Sequence[Score]
    ) -> ScoredCandidate | None:
        """Return the best point of an effect's grid, or a better one between its points; None if no sign is
        allowed.
        """
        allowed = [
            index
            for index, (candidate, score) in enumerate(zip(candidates, scores, strict=True))
            if _signs_are_allowed(candidate, score.coefficients)
        ]
        if not allowed:
            return None
        # If several points have the same score, the last one counts.
        best_index = max(allowed, key=lambda index: (scores[index].log_likelihood_gain, index))
        best = ScoredCandidate(candidates[best_index], *scores[best_index], grid_points=len(candidates))
        has_neighbours = bool(best.candidate.grid) and len(candidates) > 1
        if has_neighbours and best.log_likelihood_gain > _MIN_REFINED_NATS:
            best = self._refine(kind, candidates, best)
        return best

    def _refine(
        self, kind: EffectSpec, candidates: Sequence[Candidate], best: ScoredCandidate
    ) -> ScoredCandidate:
        """Search between the points of a grid for a higher score, one parameter after the other."""
        for name in best.candidate.grid:
            prior = kind.priors.get(name)
            flight = best.candidate.effect.flight
            values = sorted(
                {candidate.grid[name] for candidate in candidates if candidate.effect.flight == flight}
            )
            if prior is None or len(values) < _MIN_REFINED_POINTS:
                continue  # without bounds, or a choice of few values
            distance = _grid_distance(values, best.candidate.grid[name])
            if name.endswith("Hz"):
                distance = _SPECTRAL_RESOLUTION_SHARE / self.seconds
            best = self._bisect(best, name, distance, prior)
        return best

    def _bisect(self, best: ScoredCandidate, name: str, distance: float, prior: Prior) -> ScoredCandidate:
        """Search the neighbourhood of `best` along the parameter `name`, and return the best point."""
        # Both neighbours are scored at half the `distance`, then at a quarter, and so on. The search moves to
        # a neighbour that has a higher score. Values outside of the bounds of the prior are left out.
        for _ in range(_BISECTIONS):
            distance *= 0.5
            value = best.candidate.grid[name]
            neighbours = [
                _with_grid_value(best.candidate, name, neighbour_value)
                for neighbour_value in (value - distance, value + distance)
                if prior.low <= neighbour_value <= prior.high
            ]
            best = replace(best, grid_points=best.grid_points + len(neighbours))
            for neighbour, score in zip(neighbours, self.score(neighbours), strict=True):
                is_better = score.log_likelihood_gain > best.log_likelihood_gain
                if is_better and _signs_are_allowed(neighbour, score.coefficients):
                    best = ScoredCandidate(neighbour, *score, grid_points=best.grid_points)
        return best


def _signs_are_allowed(candidate: Candidate, coefficients: Floats) -> bool:
    """Whether the priors allow the signs of the coefficients that a score test estimates."""
    # Without linear parameters, the only coefficient scales an effect of the right sign: it must be positive.
    if not candidate.linear_parameters:
        return float(coefficients[0]) > 0.0
    for name, change in zip(candidate.linear_parameters, coefficients, strict=True):
        prior = candidate.effect.priors[name]
        if prior.low >= 0.0 and change + candidate.effect.values[name] <= 0.0:
            return False
    return True


def _grid_distance(sorted_values: Sequence[float], value: float) -> float:
    """Return the distance from the grid point closest to `value` to the next higher grid point."""
    # The last point has no higher neighbour: its distance is that to the point before.
    distances = np.diff(sorted_values)
    closest = int(np.argmin(np.abs(np.array(sorted_values) - value)))
    return float(distances[min(closest, len(distances) - 1)])


def _with_grid_value(candidate: Candidate, name: str, value: float) -> Candidate:
    """Return a candidate with another value of the grid parameter `name`."""
    effect = replace(candidate.effect, values={**candidate.effect.values, name: value})
    return replace(candidate, effect=effect, grid={**candidate.grid, name: value})


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


class _GaussNewtonStep(NamedTuple):
    """The free parameters and the innovations after one Gauss-Newton step from an estimate."""

    stepped: Floats  # (f,): The free parameters
    error: list[Floats]  # Whitened innovations of each flight, (m,)
    held_back: Floats
    """(f,): Score of the free parameters that the fit on other flights holds back; 0 without that fit."""


class Screening:
    """Score tests of candidates about one estimated model."""

    # A score test predicts the gain of the log-likelihood if a candidate were added to the model. The
    # prediction is of first order. All free parameters count as refitted, and the disturbances as unchanged.
    # `prior` is the fit on other flights; None: the prior of the rig. The pull of that fit on the score is
    # subtracted, because an error that its uncertainty explains is no missing effect. A conflict with the
    # prior of the rig does count as evidence.

    def __init__(self, estimate: Estimate, prior: NormalDistribution | None = None) -> None:
        self.estimate = estimate
        self.filtered = filtered = estimate.filtered()
        disturbances = estimate.disturbances
        functions = ChangeFunctions(filtered.linearised_flights[0].model.source)
        self.regressors = tuple(Regressors(linear, functions) for linear in filtered.linearised_flights)
        self.seconds = max(float(model.trajectory.t_s[-1]) for model in filtered.linearised_flights)
        self._grids = EffectGrids(filtered, disturbances, self.seconds)
        rows = max(model.rows for model in filtered.linearised_flights)
        # Regressors that a thread filters together. A spline has `KNOTS`; if these exceed its memory, as on a
        # long flight, only one thread runs.
        batch = _BATCH_NUMBERS // (rows * filtered.linearised_flights[0].states)
        self.batch = max(KNOTS, batch)
        self.threads = default_thread_count() if batch >= KNOTS else 1
        self._innovations = innovations = filtered.innovations(disturbances)
        parameter_vector = estimate.parameter_vector
        self.measurements = sum(len(flight) for flight in innovations.flights)
        of_rig = NormalDistribution(parameter_vector.mean, np.diag(parameter_vector.std**-2.0))
        mean, precision = prior or of_rig
        # Arrowhead matrix of the normal equations of the free parameters, and the columns of each flight.
        self._normal_matrix, self._per_flight = innovations.information() + precision, innovations.per_flight
        change = self._solve(innovations.score() - precision @ (estimate.theta - mean))
        self._step = _GaussNewtonStep(
            stepped=estimate.theta + change,
            error=innovations.after(change),
            held_back=np.zeros_like(change)
            if prior is None
            else precision @ (estimate.theta + change - mean),
        )

    def estimates(self) -> dict[str, ValueAndStd]:
        """Return the most likely value of each free parameter with its standard error, given the prior."""
        std = np.sqrt(np.diag(invert_arrowhead(self._normal_matrix, self._per_flight)))
        estimates = map(ValueAndStd, self._step.stepped.tolist(), std.tolist())
        return dict(zip(self.estimate.parameter_vector.names, estimates, strict=True))

    def release(self) -> None:
        """Free the memory of cached signals, 0.2 GB for ten minutes of flight."""
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
        """Score all spline terms, the highest score first."""
        candidates = spline_candidates(self.filtered.linearised_flights, number)
        self._precompute_influences(candidates)
        scores = self.score(candidates)
        return _by_gain(
            ScoredCandidate(candidate, *score, grid_points=1)
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

    def information(self, signals: Iterable[CandidateSignals], sizes: Sequence[int]) -> list[ScoreStatistics]:
        """Compute Fisher information and score of each candidate's coefficients over all flights. `signals`
        has one entry per flight, and `sizes` the number of coefficients of each candidate.
        """
        return self.projected(self.filtered.regressors(self.estimate.disturbances, signals), sizes)

    def projected(self, regressors: Iterable[Floats], sizes: Sequence[int]) -> list[ScoreStatistics]:
        """Compute Fisher information and score from derivatives of the innovations. Shapes: `regressors` (m,
        s).
        """
        # The free parameters are projected out (partitioned regression, Frisch-Waugh): with X the regressors
        # of a candidate and Z those of the free parameters, the information is X'X - X'Z (Z'Z)^-1 Z'X. The
        # priors of the rig are evidence: what they hold back counts for a candidate. Without it, a spring of
        # elevation that raises L_theta by 10 standard deviations of its prior was not worth a refit
        # (2026-11). The estimate of other flights is no such evidence, because its covariance is of first
        # order: on a flight after a hover, a right model then had a missing effect of 15 nats (2026-11).
        candidate_columns = [
            slice(stop - size, stop) for size, stop in zip(sizes, np.cumsum(sizes), strict=True)
        ]
        parameter_count, regressor_count = self._innovations.size, sum(sizes)
        information_by_candidate = [np.zeros((size, size)) for size in sizes]  # X'X
        score = np.zeros(regressor_count)  # X'e
        cross_information = np.zeros((parameter_count, regressor_count))  # Z'X
        for flight_regressors, innovations, parameter_columns, error in zip(
            regressors, self._innovations.flights, self._innovations.columns, self._step.error, strict=True
        ):
            derivatives = innovations[:, 1:]  # By the free parameters; column 0 has the innovations
            cross_information[parameter_columns] += derivatives.T @ flight_regressors
            score += flight_regressors.T @ error
            for number, columns in enumerate(candidate_columns):
                candidate_regressors = flight_regressors[:, columns]
                information_by_candidate[number] += candidate_regressors.T @ candidate_regressors
        projection = self._solve(cross_information)  # (Z'Z)^-1 Z'X
        score -= projection.T @ self._step.held_back
        statistics = []
        for information, columns in zip(information_by_candidate, candidate_columns, strict=True):
            projected = information - cross_information[:, columns].T @ projection[:, columns]
            statistics.append(ScoreStatistics(0.5 * (projected + projected.T), score[columns]))
        return statistics

    def _solve(self, right: Floats) -> Floats:
        """Solve the normal equations of the free parameters for a right-hand side, (parameters, ...)."""
        return solve_arrowhead(self._normal_matrix, right, self._per_flight)

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


_ITERATIONS: Final = 2
"""Turns of coefficient and disturbances: the second changes the coefficient by less than its error."""

_MIN_NATS: Final = 0.5 * SIGNIFICANT_STD_ERRORS**2
"""Score of a size of two standard errors. From it on, an effect of the whole flight is scored again with its
own disturbances. A spring with a score of 4.8 nats gained 504 nats (2026-11). Lower: time, 0.05 s per
candidate. Higher: effects are missed that the disturbances stand in for."""


def with_concentrated_scores(
    screening: Screening,
    worth_a_refit: Callable[[Sequence[ScoredCandidate]], Sequence[ScoredCandidate]],
    screened: Sequence[ScoredCandidate],
) -> list[ScoredCandidate]:
    """Replace the scores of effects that happen at a moment, if the plain score would not lead to a refit."""
    shortlist_ids = {scored.candidate.id for scored in worth_a_refit(screened)}
    low_scores = [
        scored
        for scored in screened
        if scored.candidate.effect.moment
        and scored.log_likelihood_gain > CHANCE_NATS
        and scored.candidate.id not in shortlist_ids
    ]
    if not low_scores:
        return list(screened)
    concentrated = {scored.candidate.id: scored for scored in concentrated_scores(screening, low_scores)}
    result = [concentrated.get(scored.candidate.id, scored) for scored in screened]
    return sorted(result, key=lambda scored: -scored.log_likelihood_gain)


def hidden_in_disturbances(
    screening: Screening,
    worth_a_refit: Callable[[Sequence[ScoredCandidate]], Sequence[ScoredCandidate]],
    low_scores: Sequence[ScoredCandidate],
) -> list[ScoredCandidate]:
    """Find effects that are worth a refit only if the disturbances are estimated again with them."""
    possible = [scored for scored in low_scores if scored.log_likelihood_gain > _MIN_NATS]
    if not possible:
        return []
    concentrated = concentrated_scores(screening, possible)
    return list(worth_a_refit(sorted(concentrated, key=lambda scored: -scored.log_likelihood_gain)))


def concentrated_scores(screening: Screening, screened: Sequence[ScoredCandidate]) -> list[ScoredCandidate]:
    """Score each candidate with its own estimate of the disturbances; never less than its plain score."""
    filtered, start = screening.filtered, screening.estimate.disturbances
    residuals = filtered.perturbed_residual()
    disturbances = estimate_disturbances(filtered, residuals, start)
    log_likelihood = float(filtered.log_likelihoods([disturbances], residuals).sum())
    return [
        _concentrated_score(screening, scored, residuals, disturbances, log_likelihood) for scored in screened
    ]


def _concentrated_score(
    screening: Screening,
    scored: ScoredCandidate,
    residuals: FlightErrors,
    disturbances: DisturbanceModel,
    log_likelihood: float,
) -> ScoredCandidate:
    """Maximise the likelihood of a candidate's coefficients and of the disturbances in turn."""
    # `residuals`, `disturbances` and `log_likelihood` are those of the model without the candidate.
    filtered = screening.filtered
    signals = [signals_of(flight, [scored.candidate]) for flight in screening.regressors]
    prior_std = coefficient_std(scored.candidate)
    coefficients = scored.coefficients
    for _ in range(_ITERATIONS):
        remaining = _residuals_after(screening, residuals, signals, coefficients)
        disturbances = estimate_disturbances(filtered, remaining, disturbances)
        innovations = filtered.innovations(disturbances)
        information, score = np.diag(prior_std**-2.0), np.zeros(len(prior_std))
        flight_regressors = filtered.regressors(disturbances, signals)
        for regressors, flight_innovations in zip(flight_regressors, innovations.flights, strict=True):
            information += regressors.T @ regressors
            score += regressors.T @ flight_innovations[:, 0]  # The other columns have derivatives
        coefficients = np.asarray(np.linalg.solve(information, score), float)
    remaining = _residuals_after(screening, residuals, signals, coefficients)
    likelihood_with = float(filtered.log_likelihoods([disturbances], remaining).sum())
    gain = likelihood_with - log_likelihood - 0.5 * float(np.sum((coefficients / prior_std) ** 2))
    if gain <= scored.log_likelihood_gain:
        return scored
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    return replace(scored, log_likelihood_gain=gain, coefficients=coefficients, std=std)


def _residuals_after(
    screening: Screening,
    residuals: FlightErrors,
    signals: Sequence[CandidateSignals],
    coefficients: Floats,
) -> FlightErrors:
    """Return the residuals that remain if a candidate with these coefficients, (g,), is in the model."""
    # `residuals` are those without it. `signals` are its changes of the rates, (n, states, g), and of the
    # measured angles, (n, 3, g). Signs are those of `InnovationsModel.regressors`: the candidate adds to the
    # drive, and is subtracted from the measured angles.
    result: list[list[ModelErrors]] = []
    flights = screening.filtered.linearised_flights
    for flight, flight_residuals, (rates, angles) in zip(flights, residuals, signals, strict=True):
        windows = []
        drives = flight.over_blocks(rates)
        for blocks, added_drive, (drive, measured) in zip(
            flight.blocks, drives, flight_residuals, strict=True
        ):
            added_angle = 0.0 if angles is None else (angles[blocks.rows] @ coefficients)[:, :, None]
            new_drive = drive + (added_drive @ coefficients)[:, :, None]
            windows.append(ModelErrors(new_drive, measured - added_angle))
        result.append(windows)
    return result
