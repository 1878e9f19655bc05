"""Residual analysis: tests whether a better model could predict the innovations of the final model.

Innovations are one-step prediction errors. If a model is right, they are white and uncorrelated with all
earlier states and inputs, in closed loop too. Many simple functions of state, input and time are tested as
regressors of the innovations. A significant regressor is structure that the model lacks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.explain import thresholds
from heli_lab.explain.evaluate.dependence_functions import dependence_functions
from heli_lab.explain.evaluate.kicks import Kicks, kicks
from heli_lab.explain.evaluate.open_loop import open_loop_squares
from heli_lab.explain.search.candidate import Candidate, ScoredCandidate
from heli_lab.explain.search.regressors import spline_candidates
from heli_lab.explain.search.score_test import ScoreStatistics, score_of
from heli_lab.explain.search.screening import Screening, coefficient_std
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import InnovationsModel
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.threads import batches

_MAX_CORRELATES: Final = 4
"""Longest list that a report shows."""
_TORQUE_STD_Nm: Final = (0.1, 0.03, 0.05)
"""Prior standard deviation of the coefficients about each axis: wide, of the size of the rigs' frictions."""
_TEST_SPLINES: Final = 99
"""A number above those of a model's own spline terms, so that parameter names differ."""
_NO_TORQUE_Nm: Final = 2e-5
_NO_GAIN: Final = 1e-6
"""Practically zero; covariances stay regular."""
_WHITE_LAGS: Final = (1, 2, 5, 12)
"""Lags at which the autocorrelation of the innovations is reported, in steps of 40 ms: up to half a
second."""


@dataclass(frozen=True)
class Dependence:
    """Test of one function of states and inputs as a regressor of the innovations."""

    what: str  # ``CHANNEL on QUANTITY``
    log_likelihood_gain: float
    """Log-likelihood ratio of the model with the regressor over the model without it, nats."""
    penalty: float  # Gain above which the regressor is significant, nats
    change_counts: float = math.inf
    """Root mean square change of the 2 s open-loop prediction by the regressor, encoder counts, on the axis
    where it is largest; only for significant regressors."""

    @property
    def is_significant(self) -> bool:
        """Whether the gain exceeds the penalty."""
        return self.log_likelihood_gain > self.penalty

    @property
    def matters(self) -> bool:
        """Whether the regressor changes the prediction as much as an effect must that is named."""
        return self.change_counts >= thresholds.MATTERS_COUNTS


@dataclass(frozen=True)
class ResidualAnalysis:
    """Disturbances and innovations of the final model."""

    disturbances: DisturbanceModel  # Estimated disturbance torques about each axis
    gains: Floats
    """(3,): Log-likelihood ratio of the disturbances about each axis over no disturbance there, nats."""
    autocorrelation: Floats  # (l, 3): Autocorrelation of the innovations of each axis at the lags `lags_s`
    lags_s: tuple[float, ...]  # 40 ms to half a second
    bound: float  # Three standard deviations of the autocorrelation of white noise
    measurements: int  # Number of innovations of all axes
    dependences: tuple[Dependence, ...]
    """Significant regressors of the innovations; empty if the innovations are white. Regressors that matter
    come first, and the strongest of them before the others."""
    kicks: Mapping[str, Kicks] = field(default_factory=dict)  # Kicks by axis; empty if there are none
    thrust_gains: Floats = field(default_factory=lambda: np.zeros(0))
    """(g,): Log-likelihood ratio of each random variation of the thrust over none, nats; empty if the model
    has none."""

    @property
    def predictable_share(self) -> float:
        """Share of the innovations' variance that the strongest dependence predicts, 0 to 1."""
        gain = self.dependences[0].log_likelihood_gain if self.dependences else 0.0
        return 1.0 - math.exp(-2.0 * gain / self.measurements)

    @property
    def axis(self) -> str:
        """The axis with the most significant disturbances."""
        return AXES[int(np.argmax(self.gains))]


def residual_analysis(screenings: Sequence[Screening]) -> ResidualAnalysis:
    """Test the innovations of a model."""
    first = screenings[0]
    significant = sorted(
        (dependence for dependence in dependences(screenings) if dependence.is_significant),
        key=lambda dependence: (not dependence.matters, -dependence.log_likelihood_gain),
    )
    autocorrelation, bound = _autocorrelation(first)
    result = ResidualAnalysis(
        disturbances=first.estimate.disturbances,
        gains=disturbance_gains(first),
        autocorrelation=autocorrelation,
        lags_s=tuple(lag * BLOCK_s for lag in _WHITE_LAGS),
        bound=bound,
        measurements=sum(screening.measurements for screening in screenings),
        dependences=tuple(significant[:_MAX_CORRELATES]),
        kicks=kicks(first.filtered, first.estimate.disturbances),
        thrust_gains=gain_ratios(first),
    )
    for screening in screenings:
        screening.release()
    return result


def penalty(coefficients: int) -> float:
    """Return the gain that the best regressor rarely reaches if the innovations are white, nats.

    `coefficients` is the number of coefficients of a regressor.
    """
    return thresholds.DEPENDENCE_NATS + thresholds.DEPENDENCE_NATS_PER_COEFFICIENT * coefficients


def disturbance_gains(screening: Screening) -> Floats:
    """Return how much more likely the flights are with disturbances about an axis than without, in nats.

    The shape is (3,): a log-likelihood ratio for each axis.
    """
    disturbances = screening.estimate.disturbances
    calm_axes = [
        replace(
            disturbances,
            fast_std=np.where(is_axis, _NO_TORQUE_Nm, disturbances.fast_std),
            slow_std=np.where(is_axis, _NO_TORQUE_Nm, disturbances.slow_std),
        )
        for is_axis in np.eye(3, dtype=bool)
    ]
    return _ratios_over(screening.filtered, disturbances, calm_axes)


def gain_ratios(screening: Screening) -> Floats:
    """Return how much more likely the flights are if a gain varies at random than if it does not, in nats.

    The shape is (g,): a log-likelihood ratio for each random variation of the thrust.
    """
    disturbances = screening.estimate.disturbances
    gains = disturbances.gains
    without_one_gain = [
        replace(disturbances, gains=(*gains[:i], replace(gains[i], std=_NO_GAIN), *gains[i + 1 :]))
        for i in range(len(gains))
    ]
    return _ratios_over(screening.filtered, disturbances, without_one_gain)


def _ratios_over(
    filtered: InnovationsModel, disturbances: DisturbanceModel, others: Sequence[DisturbanceModel]
) -> Floats:
    """Return the log-likelihood ratios of the disturbances over each of some `others`, nats."""
    if not others:
        return np.zeros(0)
    residuals = filtered.perturbed_residual()
    log_likelihoods = filtered.log_likelihoods([disturbances, *others], residuals).sum(axis=1)
    ratios: Floats = log_likelihoods[0] - log_likelihoods[1:]
    return ratios


def _autocorrelation(screening: Screening) -> tuple[Floats, float]:
    """Compute the autocorrelation of the innovations of all flights. Returns shape (lags, 3)."""
    innovations = screening.filtered.innovations(screening.estimate.disturbances)
    innovation = np.concatenate([flight[:, 0] for flight in innovations.flights]).reshape(-1, 3)
    variance = np.maximum((innovation**2).mean(axis=0), 1e-12)
    correlations = [
        (innovation[lag:] * innovation[:-lag]).mean(axis=0) / variance
        for lag in _WHITE_LAGS
        if lag < len(innovation)
    ]
    return np.array(correlations), float(3.0 / np.sqrt(len(innovation)))


def dependences(screenings: Sequence[Screening]) -> list[Dependence]:
    """Test functions of states and inputs as regressors of the innovations of all flights.

    The coefficients of a function are the same in all flights; free parameters are projected out of each.
    """
    linearised_flights = [
        linear for screening in screenings for linear in screening.filtered.linearised_flights
    ]
    splines = [
        candidate
        for candidate in spline_candidates(linearised_flights, _TEST_SPLINES)
        if not candidate.dependence[0].startswith("measurement")
    ]
    functions = dependence_functions(linearised_flights)
    tests = [_Test(" on ".join(spline.dependence), coefficient_std(spline), spline) for spline in splines]
    tests += [
        _Test(f"torque.{axis} on {name}", np.full(curves[0].shape[1], std_Nm), curves)
        for name, curves in functions.items()
        for axis, std_Nm in zip(AXES, _TORQUE_STD_Nm, strict=True)
    ]
    # One list per set of flights, in the order of the tests.
    statistics_by_screening = []
    first = 0
    for screening in screenings:
        # `functions` has the curves of all flights, one set of flights after the other.
        flights = slice(first, first + len(screening.filtered.linearised_flights))
        curves_by_name = {name: curves[flights] for name, curves in functions.items()}
        statistics_by_screening.append(
            [*screening.spline_information(splines), *_function_statistics(screening, curves_by_name)]
        )
        first = flights.stop
    result = [
        _dependence(test, statistics, screenings)
        for test, *statistics in zip(tests, *statistics_by_screening, strict=True)
    ]
    return sorted(result, key=lambda dependence: -dependence.log_likelihood_gain)


class _Test(NamedTuple):
    """A test of one function of states and inputs."""

    name: str  # ``CHANNEL on QUANTITY``
    prior_std: Floats  # (g,): Prior standard deviations of its coefficients
    source: Candidate | list[Floats]  # (n, g): Spline term, or the curves of a torque in each flight


def _dependence(
    test: _Test, statistics: Sequence[ScoreStatistics], screenings: Sequence[Screening]
) -> Dependence:
    """Carry out a test with one coefficient vector for all flights; `statistics` has one entry per set."""
    information = np.sum([of_set.information for of_set in statistics], axis=0)
    score = np.sum([of_set.score for of_set in statistics], axis=0)
    gain, coefficients, _ = score_of(information, score, test.prior_std)
    is_near_rest = test.name.endswith("near rest") or _is_of_own_rate(test.name)
    near_rest_nats = thresholds.NEAR_REST_NATS if is_near_rest else 0.0
    result = Dependence(test.name, gain, penalty(len(test.prior_std)) + near_rest_nats)
    if not result.is_significant:
        return result
    return replace(result, change_counts=_change_counts(test, coefficients, screenings))


def _change_counts(test: _Test, coefficients: Floats, screenings: Sequence[Screening]) -> float:
    """Return the change of the open-loop prediction by a regressor, encoder counts.

    It is the root mean square over the set of flights, and on the axis, where it is largest.
    """
    changes, flight = [], 0
    for screening in screenings:
        squares, rows = np.zeros(len(AXES)), 0
        for regressors in screening.regressors:
            linear = regressors.linear
            if isinstance(test.source, Candidate):
                rates = regressors.spline_signals(test.source).rates @ coefficients
            else:
                axis = AXES.index(test.name.partition(" ")[0].rpartition(".")[2])
                torque_Nm = test.source[flight] @ coefficients
                rates = linear.steps.by_disturbance[:, :, axis] * torque_Nm[:, None]
            of_flight, flight_rows = open_loop_squares(linear, rates)
            squares, rows, flight = squares + of_flight, rows + flight_rows, flight + 1
        changes.append(np.sqrt(squares / max(rows, 1)).max())
    return float(max(changes))


def _function_statistics(
    screening: Screening, functions: Mapping[str, list[Floats]]
) -> list[ScoreStatistics]:
    """Return the score statistics of each function as a torque about elevation, pitch and travel.

    `functions` has the curves of each flight, shape (n, s), by name. The order is that of the functions, and
    of the axes for each function.
    """
    result: list[ScoreStatistics] = []
    for batch in batches(functions.values(), lambda curves: curves[0].shape[1], screening.batch):
        sizes = [curves[0].shape[1] for curves in batch]
        torques_Nm = [np.hstack(flight_curves) for flight_curves in zip(*batch, strict=True)]
        statistics_by_axis = [
            screening.projected(
                screening.filtered.disturbance_regressors(screening.estimate.disturbances, axis, torques_Nm),
                sizes,
            )
            for axis in range(len(AXES))
        ]
        for function_statistics in zip(*statistics_by_axis, strict=True):
            result.extend(function_statistics)
    return result


def _is_of_own_rate(dependence: str) -> bool:
    """Whether a dependence is that of a torque about an axis on the rate of the same axis.

    Such a curve may imitate a resting encoder, which repeats its count.
    """
    channel, _, quantity = dependence.partition(" on ")
    return quantity == f"{channel.rpartition('.')[2]}_rate"


def correlates(splines: Sequence[ScoredCandidate]) -> list[str]:
    """Name the dependences with the best scores."""
    best = splines[0].log_likelihood_gain if splines else 0.0
    min_gain = max(thresholds.CORRELATE_SHARE * best, thresholds.CHANCE_NATS)
    return [
        " on ".join(spline.candidate.dependence)
        for spline in splines[:_MAX_CORRELATES]
        if spline.log_likelihood_gain > min_gain
    ]
