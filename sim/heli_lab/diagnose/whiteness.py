"""Whiteness test: is the residual coloured process noise, or is it unmodelled dynamics?

Under the coloured-noise model (`noise_model.py`) the innovations of a disturbance are white and uncorrelated
with past states and inputs, also in closed loop; those of unmodelled dynamics are not. Each of many simple
functions of states and inputs is tested as a regressor of the innovations. A gust, besides, acts about one
axis alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.parts import AXES
from scipy.signal import lfilter

from heli_lab.diagnose.candidate import Regressors, spline_candidates
from heli_lab.diagnose.linearisation import Linearisation
from heli_lab.diagnose.noise_model import DisturbanceFit
from heli_lab.diagnose.spline_term import quantity_values
from heli_lab.identify.functions import Floats

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
_NO_TORQUE_Nm: Final = 1e-5
"""As good as none, while covariances stay regular: the lower bound of the estimates."""
_SPLINE_NUMBER: Final = 99
"""Above the number of any spline term of a model, so that their parameters' names differ."""
_PENALTY: Final = 18.0
_PENALTY_EACH: Final = 0.5
"""Log-likelihood ratio, nats, that a dependence must gain, and more of it for each coefficient. Came as 24
and 1, lowered when the filter took blocks of 40 ms (2026-11). Of 130 tests with 8 coefficients the best
exceeds 14 in 5 % of cases by theory, on white innovations; the rest allows for disturbances that are not
Gauss-Markov. Lower: gusts become `unexplained`. Higher: unmodelled dynamics pass for gusts."""


@dataclass(frozen=True)
class Dependence:
    """A regressor of the innovations.

    Parameters
    ----------
    what : str
        ``CHANNEL on QUANTITY``.
    log_likelihood_gain : float
        Log-likelihood ratio of the model with it over the coloured-noise model alone, nats.
    coefficients : int
        Number of its coefficients.
    penalty : float
        Gain from which on it is significant, nats.
    """

    what: str
    log_likelihood_gain: float
    coefficients: int
    penalty: float


def penalty(coefficients: int) -> float:
    """Set the gain, in nats, that the best of all dependences of so many `coefficients` rarely reaches on
    white innovations.
    """
    return _PENALTY + _PENALTY_EACH * coefficients


def best_single_axis(disturbance: DisturbanceFit) -> tuple[str, float, float]:
    """Compare a disturbance about one axis alone with disturbances about all three, and with none.

    Parameters
    ----------
    disturbance : DisturbanceFit
        Disturbances about all axes.

    Returns
    -------
    axis : str
        The axis of largest likelihood.
    loss : float
        Log-likelihood ratio of all three over it alone, nats.
    gain : float
        Log-likelihood ratio of it alone over none, nats.
    """
    model, innovations_filter = disturbance.model, disturbance.innovations_filter
    none = innovations_filter.log_likelihood(np.full(3, _NO_TORQUE_Nm), model.correlation_time_s)[0]
    alone = [
        innovations_filter.log_likelihood(
            np.where(np.arange(3) == axis, model.sigma_Nm, _NO_TORQUE_Nm), model.correlation_time_s
        )[0]
        for axis in range(3)
    ]
    best = int(np.argmax(alone))
    return AXES[best], model.log_likelihood - alone[best], alone[best] - none


def score_dependences(disturbance: DisturbanceFit) -> list[Dependence]:
    """Test the innovations of a `disturbance`, the null hypothesis, against simple functions of states and
    inputs; all of them, the largest gain first.
    """
    linearisations = disturbance.innovations_filter.linearisations
    names: list[tuple[str, int]] = []
    signals: list[list[Floats]] = [[] for _ in linearisations]
    makers = [Regressors(linearisation) for linearisation in linearisations]
    for candidate in spline_candidates(linearisations, _SPLINE_NUMBER):
        if candidate.id.startswith("spline:measurement"):
            continue
        names.append((" on ".join(candidate.id.split(":")[1:]), len(candidate.linear_parameters)))
        for place, maker in zip(signals, makers, strict=True):
            place.append(maker.signals(candidate)[0])
    for what, curves in _functions(linearisations).items():
        for axis, name in enumerate(AXES):
            names.append((f"torque.{name} on {what}", curves[0].shape[1]))
            for place, linearisation, curve in zip(signals, linearisations, curves, strict=True):
                place.append(linearisation.rates_by_torque[:, :, axis : axis + 1] * curve[:, None, :])
    regressors = [
        linearisation.response(np.concatenate(place, axis=2))
        for linearisation, place in zip(linearisations, signals, strict=True)
    ]
    sizes = [size for _, size in names]
    gains = disturbance.innovations_filter.score(disturbance.model, regressors, sizes)
    found = [
        Dependence(what, gain, size, penalty(size)) for (what, size), gain in zip(names, gains, strict=True)
    ]
    return sorted(found, key=lambda one: -one.log_likelihood_gain)


def _functions(linearisations: Sequence[Linearisation]) -> dict[str, list[Floats]]:
    """Products of two quantities, past thrusts, and rates near rest: (n, s) for each flight."""
    model = linearisations[0].fit.problem.model
    quantities = [quantity_values(model, linearisation.trajectory) for linearisation in linearisations]
    centre, scale = {}, {}
    for name in _PRODUCTS:
        together = np.concatenate([one[name] for one in quantities])
        centre[name], scale[name] = together.mean(), together.std() + 1e-12
    every = [{n: (one[n] - centre[n]) / scale[n] for n in _PRODUCTS} for one in quantities]
    found = {}
    for one, other in itertools.combinations(_PRODUCTS, 2):
        found[f"{one} times {other}"] = [(at[one] * at[other])[:, None] for at in every]
    step_s = linearisations[0].trajectory.step_s
    for name in _THRUSTS:
        found[f"past {name}"] = [_past(at[name], step_s) for at in every]
    for name in _RATES:
        rates = [one[name] / scale[name] for one in quantities]
        found[f"{name} near rest"] = [
            np.column_stack([np.tanh(r / 0.1 / w) * np.exp(-((r / w) ** 2)) for w in _REST_WIDTHS])
            for r in rates
        ]
    return found


def _past(signal: Floats, step_s: float) -> Floats:
    columns = []
    for time_s in _LOWPASS_s:
        rho = np.exp(-step_s / time_s)
        smooth, _ = lfilter([1.0 - rho], [1.0, -rho], signal, zi=[signal[0] * rho])
        columns.append(smooth - signal)
    for width in _PLAY_WIDTHS:
        follows = np.empty_like(signal)
        place = signal[0]
        for i, value in enumerate(signal):
            place = min(max(place, value - width / 2.0), value + width / 2.0)
            follows[i] = place
        columns.append(follows - signal)
    return np.column_stack(columns)
