"""What the final model leaves: weather, or torques that states and inputs foretell.

Where a model is right its innovations are white and uncorrelated with all that came before, in closed loop
too. Each of many simple functions of state, input and time is tested as a regressor of the innovations; what
passes is structure that a model could foretell.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.diagnose.candidate import spline_candidates
from heli_lab.diagnose.screening import Scored, Screening, coefficient_std, score_of
from heli_lab.diagnose.spline_term import quantity_values
from heli_lab.diagnose.thresholds import CORRELATE_MIN, CORRELATE_SHARE
from heli_lab.estimation import BLOCK_s, DisturbanceModel, LinearisedFlight

_MAX_CORRELATES: Final = 4
"""Length of a list for people."""
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
"""Rates up to which an axis is nearly at rest, in standard deviations: where dry friction acts."""
_NEAR_REST: Final = 20.0
"""What a function of a rate near rest, and a curve of an axis' own rate, must gain more, nats: an encoder at
rest repeats its count, and the filter takes that for a pull towards rest (22 nats in two of ten field cases
without any; 19 and 31 in two of 26 blind cases whose dry friction was found, 2026-11). Lower:
weather becomes `unexplained`. Higher: axes that stick are missed, unless the catalogue has their friction."""
_TORQUE_STD_Nm: Final = (0.1, 0.03, 0.05)
"""Prior standard deviation of the coefficients about each axis: wide, of the size of the rigs' frictions."""
_PENALTY: Final = 10.0
_PENALTY_EACH: Final = 2.0
"""Log-likelihood ratio, nats, that a dependence must gain, and more of it for each coefficient. The best of
130 tests on white innovations exceeds 6.3 nats with one coefficient and 14 with 8 in 5 % of cases, by theory;
6 more with one and 12 more with 8 are for weather that is not Gauss-Markov, and for what is a little wrong of
a cause found (19 nats with 6 in a field case, 2026-11). Lower: weather becomes `unexplained`. Higher:
unmodelled dynamics pass for weather; a law on no list in strong weather of a field case has 18 nats."""
_TEST_SPLINES: Final = 99
"""Above the number of any spline term of a model, so that their parameters' names differ."""
_NO_TORQUE_Nm: Final = 2e-5
"""As good as none, while covariances stay regular."""
_WHITE_LAGS: Final = (1, 2, 5, 12)
"""Lags of 40 ms at which the innovations' autocorrelation is told: 40 ms to half a second."""


@dataclass(frozen=True)
class Dependence:
    """A regressor of the innovations.

    Parameters
    ----------
    what : str
        ``CHANNEL on QUANTITY``.
    log_likelihood_gain : float
        Log-likelihood ratio of the model with it over that without, nats.
    coefficients : int
        Number of its coefficients.
    penalty : float
        Gain from which on it is significant, nats.
    """

    what: str
    log_likelihood_gain: float
    coefficients: int
    penalty: float


@dataclass(frozen=True)
class ResidualAnalysis:
    """What the final model leaves.

    Parameters
    ----------
    disturbances : DisturbanceModel
        Torques by chance about each axis.
    gains : ndarray (3,)
        Log-likelihood ratio of each axis' weather over none about that axis, nats.
    autocorrelation : ndarray (l, 3)
        Of the innovations of each axis at the lags `lags_s`.
    lags_s : tuple of float
        Those lags.
    bound : float
        Three standard deviations of the autocorrelation of white noise.
    measurements : int
        Innovations of all axes.
    dependences : tuple of Dependence
        What foretells the innovations significantly, strongest first; empty where they are white.
    """

    disturbances: DisturbanceModel
    gains: Floats
    autocorrelation: Floats
    lags_s: tuple[float, ...]
    bound: float
    measurements: int
    dependences: tuple[Dependence, ...]

    @property
    def share_foretold(self) -> float:
        """Share of the innovations' variance that the strongest dependence foretells."""
        gain = self.dependences[0].log_likelihood_gain if self.dependences else 0.0
        return 1.0 - math.exp(-2.0 * gain / self.measurements)

    @property
    def axis(self) -> str:
        """The axis whose weather is most significant."""
        return AXES[int(np.argmax(self.gains))]


def residual_analysis(screenings: Sequence[Screening]) -> ResidualAnalysis:
    """Describe what a model leaves, by `screenings` of the flights fitted and of those held out, which then
    give back what they keep: weather of the former, what foretells the innovations of all.
    """
    first = screenings[0]
    significant = [
        dependence
        for dependence in dependences(screenings)
        if dependence.log_likelihood_gain > dependence.penalty
    ]
    autocorrelation, bound = _autocorrelation(first)
    gains = weather_gains(first)
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
    )


def penalty(coefficients: int) -> float:
    """Set the gain, in nats, that the best of all dependences of so many `coefficients` rarely reaches on
    white innovations.
    """
    return _PENALTY + _PENALTY_EACH * coefficients


def weather_gains(screening: Screening) -> Floats:
    """Log-likelihood ratio of each axis' weather over none about that axis, nats, shape (3,)."""
    disturbances, filtered = screening.estimate.disturbances, screening.filtered
    less = [
        DisturbanceModel(
            np.where(gone, _NO_TORQUE_Nm, disturbances.fast_std),
            disturbances.correlation_time_s,
            np.where(gone, _NO_TORQUE_Nm, disturbances.slow_std),
            disturbances.quantisation,
        )
        for gone in np.eye(3, dtype=bool)
    ]
    error = filtered.perturbed_residual(np.zeros(filtered.size))
    values = filtered.log_likelihoods([disturbances, *less], error).sum(axis=1)
    result: Floats = values[0] - values[1:]
    return result


def _autocorrelation(screening: Screening) -> tuple[Floats, float]:
    innovations = screening.filtered.innovations_by_flight(screening.estimate.disturbances)
    value = np.concatenate([flight[:, 0] for flight in innovations.flights]).reshape(-1, 3)
    variance = np.maximum((value**2).mean(axis=0), 1e-12)
    correlations = [
        (value[lag:] * value[:-lag]).mean(axis=0) / variance for lag in _WHITE_LAGS if lag < len(value)
    ]
    return np.array(correlations), float(3.0 / np.sqrt(len(value)))


def dependences(screenings: Sequence[Screening]) -> list[Dependence]:
    """Test the innovations of all flights against functions of states and inputs, the largest gain first.

    The functions have the same coefficients in all flights, with everything else refitted in each.
    """
    linearised_flights = [
        linear for each_screening in screenings for linear in each_screening.filtered.linearised_flights
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
    parts = [each_screening.spline_information(candidates) for each_screening in screenings]
    functions = _functions(linearised_flights)
    for what, curves in functions.items():
        for axis, name in enumerate(AXES):
            size = curves[0].shape[1]
            names.append((f"torque.{name} on {what}", size))
            priors.append(np.full(size, _TORQUE_STD_Nm[axis]))
    first = 0
    for number, screening in enumerate(screenings):
        flight_linears = screening.filtered.linearised_flights
        flights = range(first, first + len(flight_linears))
        for group in _groups(functions, screening.batch):
            sizes = [curves[0].shape[1] for curves in group]
            torques_Nm = [np.hstack([curves[place] for curves in group]) for place in flights]
            by_axis = [
                screening.projected(
                    screening.filtered.disturbance_regressors(
                        screening.estimate.disturbances, axis, torques_Nm
                    ),
                    sizes,
                )
                for axis in range(len(AXES))
            ]
            parts[number] += [parts_by_axis[k] for k in range(len(group)) for parts_by_axis in by_axis]
        first += len(flight_linears)
    result = []
    for (what, size), std, *each in zip(names, priors, *parts, strict=True):
        information = np.sum([information_ for information_, _ in each], axis=0)
        gain, _, _ = score_of(information, np.sum([score_ for _, score_ in each], axis=0), std)
        more = _NEAR_REST if what.endswith("near rest") or _on_own_rate(what) else 0.0
        result.append(Dependence(what, gain, size, penalty(size) + more))
    return sorted(result, key=lambda dependence: -dependence.log_likelihood_gain)


def _groups(functions: Mapping[str, list[Floats]], batch: int) -> Iterator[list[list[Floats]]]:
    """Functions in their order, as many at once as make `batch` regressors about an axis."""
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
    """Name the quantities on which the missing part depends by the scores of the spline terms `splines`, best
    first, as ``CHANNEL on QUANTITY``.
    """
    best = splines[0].log_likelihood_gain if splines else 0.0
    least = max(CORRELATE_SHARE * best, CORRELATE_MIN)
    return [
        " on ".join(spline.candidate.id.split(":")[1:])
        for spline in splines[:_MAX_CORRELATES]
        if spline.log_likelihood_gain > least
    ]


def _functions(linearised_flights: Sequence[LinearisedFlight]) -> dict[str, list[Floats]]:
    """Quantities, products of two, past thrusts, and rates near rest: (n, s) for each flight."""
    quantities = [quantity_values(linear.model.source, linear.trajectory) for linear in linearised_flights]
    centre, scale = {}, {}
    for name in _PRODUCTS:
        together = np.concatenate([values[name] for values in quantities])
        centre[name], scale[name] = together.mean(), together.std() + 1e-12
    every = [{n: (values[n] - centre[n]) / scale[n] for n in _PRODUCTS} for values in quantities]
    functions = {name: [at[name][:, None] for at in every] for name in _PRODUCTS}
    for first, other in itertools.combinations(_PRODUCTS, 2):
        functions[f"{first} times {other}"] = [(at[first] * at[other])[:, None] for at in every]
    step_s = linearised_flights[0].trajectory.step_s
    for name in _THRUSTS:
        functions[f"past {name}"] = [_past(at[name], step_s) for at in every]
    for name in _RATES:
        rates = [values[name] / scale[name] for values in quantities]
        functions[f"{name} near rest"] = [
            np.column_stack([np.tanh(r / 0.1 / w) * np.exp(-((r / w) ** 2)) for w in _REST_WIDTHS])
            for r in rates
        ]
    return functions


def _past(signal: Floats, step_s: float) -> Floats:
    columns = []
    for time_s in _LOWPASS_s:
        rho = math.exp(-step_s / time_s)
        smooth, place = np.empty_like(signal), float(signal[0])
        for i, value in enumerate(signal.tolist()):
            place += (1.0 - rho) * (value - place)
            smooth[i] = place
        columns.append(smooth - signal)
    for width in _PLAY_WIDTHS:
        follows = np.empty_like(signal)
        place = signal[0]
        for i, value in enumerate(signal):
            place = min(max(place, value - width / 2.0), value + width / 2.0)
            follows[i] = place
        columns.append(follows - signal)
    return np.column_stack(columns)
