"""Residual analysis: whether innovations of the final model are white, or predicted by states and inputs.

If a model is right, its innovations are white and uncorrelated with everything that came before, in closed
loop too. Each of many simple functions of state, input and time is tested as a regressor of the innovations;
what is significant is structure that a better model could predict.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.evaluate.kicks import Kicks, kicks
from heli_lab.diagnose.search import (
    Scored,
    Screening,
    coefficient_std,
    quantity_values,
    score_of,
    spline_candidates,
)
from heli_lab.estimation import BLOCK_s, DisturbanceModel, InnovationsModel, LinearisedFlight

_MAX_CORRELATES: Final = 4
"""Longest list that a report shows."""
_PRODUCTS: Final = (
    "elevation",
    "pitch",
    "travel",
    "elevation_rate",
    "pitch_rate",
    "travel_rate",
    "thrust",
    "thrust_difference",
)
_RATES: Final = ("elevation_rate", "pitch_rate", "travel_rate")
_THRUSTS: Final = ("thrust", "thrust_difference")
_LOWPASS_s: Final = (0.05, 0.2, 1.0)
"""Time constants of first-order lags of the thrust: those of rotors, of inflow, of warming motors."""
_PLAY_WIDTHS: Final = (0.1, 0.3, 1.0)
"""Widths of a play (hysteresis), in standard deviations of the thrust."""
_REST_WIDTHS: Final = (0.05, 0.2)
"""Rates up to which an axis is nearly at rest, in standard deviations: there dry friction acts."""
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
    gains, thrust_gains = disturbance_gains(first), gain_ratios(first)
    short = kicks(first.filtered, first.estimate.disturbances)
    for screening in screenings:
        screening.release()
    return ResidualAnalysis(
        first.estimate.disturbances,
        gains,
        autocorrelation,
        tuple(lag * BLOCK_s for lag in _WHITE_LAGS),
        bound,
        sum(screening.measurements for screening in screenings),
        tuple(significant[:_MAX_CORRELATES]),
        short,
        thrust_gains,
    )


def penalty(coefficients: int) -> float:
    """Gain, in nats, that the best of all regressors with so many `coefficients` rarely reaches on white
    innovations.
    """
    return thresholds.DEPENDENCE_NATS + thresholds.DEPENDENCE_NATS_PER_COEFFICIENT * coefficients


def disturbance_gains(screening: Screening) -> Floats:
    """Log-likelihood ratio of the disturbances about each axis over no disturbance there, nats,
    shape (3,).
    """
    disturbances, filtered = screening.estimate.disturbances, screening.filtered
    less = [
        replace(
            disturbances,
            fast_std=np.where(gone, _NO_TORQUE_Nm, disturbances.fast_std),
            slow_std=np.where(gone, _NO_TORQUE_Nm, disturbances.slow_std),
        )
        for gone in np.eye(3, dtype=bool)
    ]
    return _ratios(filtered, disturbances, less)


def gain_ratios(screening: Screening) -> Floats:
    """Log-likelihood ratio of each gain's random variation over none, nats, shape (g,)."""
    disturbances = screening.estimate.disturbances
    gains = disturbances.gains
    less = [
        replace(disturbances, gains=(*gains[:i], replace(gains[i], std=_NO_GAIN), *gains[i + 1 :]))
        for i in range(len(gains))
    ]
    return _ratios(screening.filtered, disturbances, less)


def _ratios(
    filtered: InnovationsModel, disturbances: DisturbanceModel, others: Sequence[DisturbanceModel]
) -> Floats:
    """Log-likelihood ratios of the disturbances over each of some `others`, nats."""
    if not others:
        return np.zeros(0)
    values = filtered.log_likelihoods([disturbances, *others], filtered.perturbed_residual()).sum(axis=1)
    result: Floats = values[0] - values[1:]
    return result


def _autocorrelation(screening: Screening) -> tuple[Floats, float]:
    """Autocorrelation of the innovations, shape (lags, 3), and its bound of three standard errors for white
    noise.
    """
    innovations = screening.filtered.innovations(screening.estimate.disturbances)
    value = np.concatenate([flight[:, 0] for flight in innovations.flights]).reshape(-1, 3)
    variance = np.maximum((value**2).mean(axis=0), 1e-12)
    correlations = [
        (value[lag:] * value[:-lag]).mean(axis=0) / variance for lag in _WHITE_LAGS if lag < len(value)
    ]
    return np.array(correlations), float(3.0 / np.sqrt(len(value)))


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
        if not candidate.id.startswith("spline:measurement")
    ]
    names = [
        (" on ".join(candidate.id.split(":")[1:]), len(candidate.linear_parameters))
        for candidate in candidates
    ]
    priors = [coefficient_std(candidate) for candidate in candidates]
    # For each set of flights, information and score of each test, in the order of `names`.
    parts = [screening.spline_information(candidates) for screening in screenings]
    functions = _functions(linearised_flights)
    for what, curves in functions.items():
        for axis, name in enumerate(AXES):
            size = curves[0].shape[1]
            names.append((f"torque.{name} on {what}", size))
            priors.append(np.full(size, _TORQUE_STD_Nm[axis]))
    first = 0
    for screening, part in zip(screenings, parts, strict=True):
        last = first + len(screening.filtered.linearised_flights)
        in_flights = {name: curves[first:last] for name, curves in functions.items()}
        part.extend(_function_information(screening, in_flights))
        first = last
    result = []
    for (what, size), std, *by_set in zip(names, priors, *parts, strict=True):
        information, score = (np.sum(values, axis=0) for values in zip(*by_set, strict=True))
        gain, _, _ = score_of(information, score, std)
        at_rest_nats = thresholds.NEAR_REST_NATS if what.endswith("near rest") or _on_own_rate(what) else 0.0
        result.append(Dependence(what, gain, penalty(size) + at_rest_nats))
    return sorted(result, key=lambda dependence: -dependence.log_likelihood_gain)


def _function_information(
    screening: Screening, functions: Mapping[str, list[Floats]]
) -> list[tuple[Floats, Floats]]:
    """Fisher information and score of a torque about each axis in turn, for each of the `functions`."""
    result = []
    for group in _groups(functions, screening.batch):
        sizes = [curves[0].shape[1] for curves in group]
        torques_Nm = [np.hstack(of_flight) for of_flight in zip(*group, strict=True)]
        by_axis = [
            screening.projected(
                screening.filtered.disturbance_regressors(screening.estimate.disturbances, axis, torques_Nm),
                sizes,
            )
            for axis in range(len(AXES))
        ]
        result += [part for of_function in zip(*by_axis, strict=True) for part in of_function]
    return result


def _groups(functions: Mapping[str, list[Floats]], batch: int) -> Iterator[list[list[Floats]]]:
    """Functions in their order, in groups of at most `batch` regressors about an axis."""
    group: list[list[Floats]] = []
    for curves in functions.values():
        if group and sum(curve[0].shape[1] for curve in [*group, curves]) > batch:
            yield group
            group = []
        group.append(curves)
    yield group


def _on_own_rate(what: str) -> bool:
    """Whether a curve about an axis is one of the axis' own rate, which may bend near rest."""
    channel, _, quantity = what.partition(" on ")
    return quantity == f"{channel.rpartition('.')[2]}_rate"


def correlates(splines: Sequence[Scored]) -> list[str]:
    """Name the dependences with the best scores.

    Parameters
    ----------
    splines : sequence of Scored
        Spline terms, the best score first.

    Returns
    -------
    list of str
        ``CHANNEL on QUANTITY``, the best first.
    """
    best = splines[0].log_likelihood_gain if splines else 0.0
    least = max(thresholds.CORRELATE_SHARE * best, thresholds.CHANCE_NATS)
    return [
        " on ".join(spline.candidate.id.split(":")[1:])
        for spline in splines[:_MAX_CORRELATES]
        if spline.log_likelihood_gain > least
    ]


def _functions(linearised_flights: Sequence[LinearisedFlight]) -> dict[str, list[Floats]]:
    """Quantities, products of two, past thrusts, and rates near rest: (n, s) for each flight, by name."""
    quantities = [quantity_values(linear.model.source, linear.trajectory) for linear in linearised_flights]
    centre, scale = {}, {}
    for name in _PRODUCTS:
        together = np.concatenate([values[name] for values in quantities])
        centre[name], scale[name] = together.mean(), together.std() + 1e-12
    standardised = [{n: (values[n] - centre[n]) / scale[n] for n in _PRODUCTS} for values in quantities]
    functions = {name: [at[name][:, None] for at in standardised] for name in _PRODUCTS}
    for first, other in itertools.combinations(_PRODUCTS, 2):
        functions[f"{first} times {other}"] = [(at[first] * at[other])[:, None] for at in standardised]
    step_s = linearised_flights[0].trajectory.step_s
    for name in _THRUSTS:
        functions[f"past {name}"] = [_past(at[name], step_s) for at in standardised]
    for name in _RATES:
        rates = [values[name] / scale[name] for values in quantities]
        functions[f"{name} near rest"] = [
            np.column_stack([np.tanh(r / 0.1 / w) * np.exp(-((r / w) ** 2)) for w in _REST_WIDTHS])
            for r in rates
        ]
    return functions


def _past(signal: Floats, step_s: float) -> Floats:
    """What lags and plays would change in a signal: shape (n, s)."""
    values = signal.tolist()
    followed = [_lowpass(values, math.exp(-step_s / time_s)) for time_s in _LOWPASS_s]
    followed += [_play(values, width) for width in _PLAY_WIDTHS]
    result: Floats = np.column_stack(followed) - signal[:, None]
    return result


def _lowpass(values: Sequence[float], memory: float) -> list[float]:
    """A first-order lag with the autocorrelation `memory` over a step, at rest at first."""

    def step(place: float, value: float) -> float:
        return place + (1.0 - memory) * (value - place)

    return list(itertools.accumulate(values, step))


def _play(values: Sequence[float], width: float) -> list[float]:
    """What follows the values within half a `width` on either side."""

    def step(place: float, value: float) -> float:
        return min(max(place, value - width / 2.0), value + width / 2.0)

    return list(itertools.accumulate(values, step))
