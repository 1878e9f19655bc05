"""Tells a torque that wanders by chance from something that is missing: chance depends on nothing before it.

Innovations of the filter of `noise_model.py` are what could not be foreseen. Where only chance is missing, no
signal made of states, voltages and their past foretells them, also in a closed loop; where something is
missing that is on no list, one of many simple dependences does. A gust also pushes about one axis alone.
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
from heli_lab.diagnose.noise_model import DisturbanceModel, InnovationsFilter
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
_PAST_s: Final = (0.05, 0.2, 1.0)
_PLAYS: Final = (0.1, 0.3, 1.0)
"""Widths of a play, in standard deviations of the thrust."""
_AT_REST: Final = (0.05, 0.2)
"""Rates up to which an axis is nearly at rest, in standard deviations."""
_NONE_Nm: Final = 1e-5
_OTHER: Final = 99
"""Number of these patterns, so that none is called like one in the model."""
_PRICE: Final = 18.0
_PRICE_EACH: Final = 0.5


@dataclass(frozen=True)
class Dependence:
    """Something that foretells what a random torque would leave to chance.

    Parameters
    ----------
    what : str
        ``CHANNEL on QUANTITY``.
    gain : float
        Logarithm of the likelihood ratio that it adds to a random torque's.
    numbers : int
        How many it takes.
    penalty : float
        What it has to gain to be more than chance.
    """

    what: str
    gain: float
    numbers: int
    penalty: float


def penalty(numbers: int) -> float:
    """Set the gain that the best of all dependences rarely reaches where nothing but chance is missing.

    Parameters
    ----------
    numbers : int
        How many numbers it takes.

    Returns
    -------
    float
        Logarithm of a likelihood ratio.
    """
    return _PRICE + _PRICE_EACH * numbers


def one_axis(
    innovations_filter: InnovationsFilter, disturbance: DisturbanceModel
) -> tuple[str, float, float]:
    """Ask whether a random torque about one axis does as well as about all three.

    Parameters
    ----------
    innovations_filter : InnovationsFilter
        The filter.
    disturbance : DisturbanceModel
        Random torques about all axes.

    Returns
    -------
    axis : str
        The best one.
    lost : float
        Logarithm of the likelihood ratio that it loses against all three.
    gained : float
        The same that it has over none.
    """
    none = innovations_filter.likelihood(np.full(3, _NONE_Nm), disturbance.correlation_time_s)[0]
    alone = [
        innovations_filter.likelihood(
            np.where(np.arange(3) == axis, disturbance.sigma_Nm, _NONE_Nm), disturbance.correlation_time_s
        )[0]
        for axis in range(3)
    ]
    best = int(np.argmax(alone))
    return AXES[best], disturbance.likelihood - alone[best], alone[best] - none


def dependences(innovations_filter: InnovationsFilter, disturbance: DisturbanceModel) -> list[Dependence]:
    """Score simple dependences beside the random torques.

    Parameters
    ----------
    innovations_filter : InnovationsFilter
        The filter.
    disturbance : DisturbanceModel
        Random torques.

    Returns
    -------
    list of Dependence
        The largest gain first.
    """
    tangents = innovations_filter.tangents
    names: list[tuple[str, int]] = []
    signals: list[list[Floats]] = [[] for _ in tangents]
    makers = [Regressors(tangent) for tangent in tangents]
    for candidate in spline_candidates(tangents, _OTHER):
        if candidate.id.startswith("pattern:measurement"):
            continue
        names.append((" on ".join(candidate.id.split(":")[1:]), len(candidate.size)))
        for place, maker in zip(signals, makers, strict=True):
            place.append(maker.signals(candidate)[0])
    for what, curves in _simple(tangents).items():
        for axis, name in enumerate(AXES):
            names.append((f"torque.{name} on {what}", curves[0].shape[1]))
            for place, tangent, curve in zip(signals, tangents, curves, strict=True):
                place.append(tangent.by_torque[:, :, axis : axis + 1] * curve[:, None, :])
    columns = [t.answer(np.concatenate(place, axis=2)) for t, place in zip(tangents, signals, strict=True)]
    sizes = [size for _, size in names]
    gains = innovations_filter.gains(disturbance, columns, sizes)
    found = [
        Dependence(what, gain, size, penalty(size)) for (what, size), gain in zip(names, gains, strict=True)
    ]
    return sorted(found, key=lambda one: -one.gain)


def _simple(tangents: Sequence[Linearisation]) -> dict[str, list[Floats]]:
    """Products of two quantities, past thrusts, and rates near rest: (n, s) for each flight."""
    model = tangents[0].fit.problem.model
    quantities = [quantity_values(model, tangent.path) for tangent in tangents]
    centre, scale = {}, {}
    for name in _PRODUCTS:
        together = np.concatenate([one[name] for one in quantities])
        centre[name], scale[name] = together.mean(), together.std() + 1e-12
    every = [{n: (one[n] - centre[n]) / scale[n] for n in _PRODUCTS} for one in quantities]
    found = {}
    for one, other in itertools.combinations(_PRODUCTS, 2):
        found[f"{one} times {other}"] = [(at[one] * at[other])[:, None] for at in every]
    step_s = tangents[0].path.step_s
    for name in _THRUSTS:
        found[f"past {name}"] = [_past(at[name], step_s) for at in every]
    for name in _RATES:
        rates = [one[name] / scale[name] for one in quantities]
        found[f"{name} near rest"] = [
            np.column_stack([np.tanh(r / 0.1 / w) * np.exp(-((r / w) ** 2)) for w in _AT_REST]) for r in rates
        ]
    return found


def _past(signal: Floats, step_s: float) -> Floats:
    columns = []
    for time_s in _PAST_s:
        keep = np.exp(-step_s / time_s)
        smooth, _ = lfilter([1.0 - keep], [1.0, -keep], signal, zi=[signal[0] * keep])
        columns.append(smooth - signal)
    for width in _PLAYS:
        follows = np.empty_like(signal)
        place = signal[0]
        for i, value in enumerate(signal):
            place = min(max(place, value - width / 2.0), value + width / 2.0)
            follows[i] = place
        columns.append(follows - signal)
    return np.column_stack(columns)
