"""Residual analysis: whether innovations of the final model are white, or predicted by states and inputs.

If a model is right, its innovations are white and uncorrelated with everything that came before, in closed
loop too. Each of many simple functions of state, input and time is tested as a regressor of the innovations;
what is significant is structure that a better model could predict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.evaluate.dependence_functions import dependence_functions
from heli_lab.diagnose.evaluate.kicks import Kicks, kicks
from heli_lab.diagnose.search import (
    ScoredCandidate,
    ScoreStatistics,
    Screening,
    coefficient_std,
    score_of,
    spline_candidates,
)
from heli_lab.estimation import BLOCK_s, DisturbanceModel, InnovationsModel
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
    """Test of one function of states and inputs as a regressor of the innovations.

    Parameters
    ----------
    what : str
        ``CHANNEL on QUANTITY``.
    log_likelihood_gain : float
        Log-likelihood ratio of the model with the regressor over the model without it, nats.
    penalty : float
        Gain above which the regressor is significant, nats.
    """

    what: str
    log_likelihood_gain: float
    penalty: float


@dataclass(frozen=True)
class ResidualAnalysis:
    """Disturbances and innovations of the final model.

    Parameters
    ----------
    disturbances : DisturbanceModel
        Estimated disturbance torques about each axis.
    gains : ndarray (3,)
        Log-likelihood ratio of the disturbances about each axis over no disturbance there, nats.
    autocorrelation : ndarray (l, 3)
        Autocorrelation of the innovations of each axis at the lags `lags_s`.
    lags_s : tuple of float
        40 ms to half a second.
    bound : float
        Three standard deviations of the autocorrelation of white noise.
    measurements : int
        Number of innovations of all axes.
    dependences : tuple of Dependence
        Significant regressors of the innovations, the strongest first; empty if the innovations are white.
    kicks : Mapping[str, Kicks]
        Kicks by axis; empty if there are none.
    thrust_gains : ndarray (g,)
        Log-likelihood ratio of each random variation of the thrust over none, nats; empty if the model has
        none.
    """

    disturbances: DisturbanceModel
    gains: Floats
    autocorrelation: Floats
    lags_s: tuple[float, ...]
    bound: float
    measurements: int
    dependences: tuple[Dependence, ...]
    kicks: Mapping[str, Kicks] = field(default_factory=dict)
    thrust_gains: Floats = field(default_factory=lambda: np.zeros(0))

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
    """Test the innovations of a model.

    Parameters
    ----------
    screenings : sequence of Screening
        Scores about the model on the fitted flights, whose disturbances are reported, and, if there are any,
        on the held-out flights. Their memory is released.
    """
    first = screenings[0]
    significant = [
        dependence
        for dependence in dependences(screenings)
        if dependence.log_likelihood_gain > dependence.penalty
    ]
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
    """Gain, in nats, that the best of all regressors with so many `coefficients` rarely reaches on white
    innovations.
    """
    return thresholds.DEPENDENCE_NATS + thresholds.DEPENDENCE_NATS_PER_COEFFICIENT * coefficients


def disturbance_gains(screening: Screening) -> Floats:
    """Return the log-likelihood ratio of the disturbances about each axis over no disturbance there, nats,
    shape (3,).
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
    """Return the log-likelihood ratio of each gain's random variation over none, nats, shape (g,)."""
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
    """Compute the autocorrelation of the innovations of all flights.

    Returns
    -------
    ndarray (lags, 3)
            Autocorrelation at `_WHITE_LAGS`, by measured axis.
    float
            Three standard errors of the autocorrelation of white innovations.
    """
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

    Parameters
    ----------
    screenings : sequence of Screening
        Scores about the model, one per set of flights.

    Returns
    -------
    list of Dependence
        All tests, the largest gain first.
    """
    linearised_flights = [
        linear for screening in screenings for linear in screening.filtered.linearised_flights
    ]
    candidates = [
        candidate
        for candidate in spline_candidates(linearised_flights, _TEST_SPLINES)
        if not candidate.dependence[0].startswith("measurement")
    ]
    functions = dependence_functions(linearised_flights)
    tests = [_Test(" on ".join(candidate.dependence), coefficient_std(candidate)) for candidate in candidates]
    tests += [
        _Test(f"torque.{axis} on {name}", np.full(curves[0].shape[1], std_Nm))
        for name, curves in functions.items()
        for axis, std_Nm in zip(AXES, _TORQUE_STD_Nm, strict=True)
    ]
    statistics_by_screening = []
    first = 0
    for screening in screenings:
        last = first + len(screening.filtered.linearised_flights)
        own_functions = {name: curves[first:last] for name, curves in functions.items()}
        statistics_by_screening.append(
            [*screening.spline_information(candidates), *_function_statistics(screening, own_functions)]
        )
        first = last
    result = [
        _dependence(test, statistics)
        for test, *statistics in zip(tests, *statistics_by_screening, strict=True)
    ]
    return sorted(result, key=lambda dependence: -dependence.log_likelihood_gain)


class _Test(NamedTuple):
    """Name of a test and the prior standard deviations of its coefficients, shape (g,)."""

    name: str
    prior_std: Floats


def _dependence(test: _Test, statistics: Sequence[ScoreStatistics]) -> Dependence:
    """Carry out a test whose `statistics` are those of each set of flights."""
    information = np.sum([part.information for part in statistics], axis=0)
    score = np.sum([part.score for part in statistics], axis=0)
    gain = score_of(information, score, test.prior_std).log_likelihood_gain
    is_near_rest = test.name.endswith("near rest") or _on_own_rate(test.name)
    near_rest_nats = thresholds.NEAR_REST_NATS if is_near_rest else 0.0
    return Dependence(test.name, gain, penalty(len(test.prior_std)) + near_rest_nats)


def _function_statistics(
    screening: Screening, functions: Mapping[str, list[Floats]]
) -> list[ScoreStatistics]:
    """Return the score statistics of a torque about each axis in turn, for each of the `functions`."""
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


def _on_own_rate(what: str) -> bool:
    """Whether a curve about an axis is one of the axis' own rate, which may bend near rest."""
    channel, _, quantity = what.partition(" on ")
    return quantity == f"{channel.rpartition('.')[2]}_rate"


def correlates(splines: Sequence[ScoredCandidate]) -> list[str]:
    """Name the dependences with the best scores.

    Parameters
    ----------
    splines : sequence of ScoredCandidate
        Spline terms, the best score first.

    Returns
    -------
    list of str
        ``CHANNEL on QUANTITY``, the best first.
    """
    best = splines[0].log_likelihood_gain if splines else 0.0
    min_gain = max(thresholds.CORRELATE_SHARE * best, thresholds.CHANCE_NATS)
    return [
        " on ".join(spline.candidate.dependence)
        for spline in splines[:_MAX_CORRELATES]
        if spline.log_likelihood_gain > min_gain
    ]
