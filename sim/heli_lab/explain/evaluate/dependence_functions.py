"""Functions of states and inputs that the residual analysis tests as regressors of the innovations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.explain.search.splines import quantity_values
from heli_lab.fit.linearised_flight import LinearisedFlight

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


def dependence_functions(linearised_flights: Sequence[LinearisedFlight]) -> dict[str, list[Floats]]:
    """Return test functions along each flight, shape (n, s), by name.

    They are standardised quantities, products of two of them, past thrusts, and rates near rest.
    """
    # Each list has one entry per flight.
    quantities = [quantity_values(linear.model.source, linear.trajectory) for linear in linearised_flights]
    scales = {name: _scale([values[name] for values in quantities]) for name in _PRODUCTS}
    standardised = [
        {name: (values[name] - scale.mean) / scale.std for name, scale in scales.items()}
        for values in quantities
    ]
    step_s = linearised_flights[0].trajectory.step_s
    functions = {name: [values[name][:, None] for values in standardised] for name in _PRODUCTS}
    for first, second in itertools.combinations(_PRODUCTS, 2):
        products = [(values[first] * values[second])[:, None] for values in standardised]
        functions[f"{first} times {second}"] = products
    for name in _THRUSTS:
        functions[f"past {name}"] = [_memory_curves(values[name], step_s) for values in standardised]
    for name in _RATES:
        # Divided by the standard deviation, and not centred: rest is where the rate is 0.
        rates = [values[name] / scales[name].std for values in quantities]
        functions[f"{name} near rest"] = [_near_rest_curves(rate) for rate in rates]
    return functions


class _Scale(NamedTuple):
    """Mean and standard deviation of a quantity over all flights."""

    mean: float
    std: float


def _scale(values_by_flight: Sequence[Floats]) -> _Scale:
    """Compute mean and standard deviation of a quantity, (n,) per flight; the latter is never 0."""
    all_values = np.concatenate(values_by_flight)
    return _Scale(all_values.mean(), all_values.std() + 1e-12)


def _near_rest_curves(rate: Floats) -> Floats:
    """Return curves of a scaled rate (n,) that look like dry friction near rest, shape (n, widths).

    Each curve has the sign of the rate, and vanishes far from rest.
    """
    return np.column_stack(
        [np.tanh(rate / 0.1 / width) * np.exp(-((rate / width) ** 2)) for width in _REST_WIDTHS]
    )


def _memory_curves(signal: Floats, step_s: float) -> Floats:
    """Return how first-order lags and plays would change a signal (n,), shape (n, s).

    A column is the signal behind a lag or play, less the signal.
    """
    values = signal.tolist()
    outputs = [_low_pass(values, math.exp(-step_s / time_s)) for time_s in _LOWPASS_s]
    outputs += [_play(values, width) for width in _PLAY_WIDTHS]
    changes: Floats = np.column_stack(outputs) - signal[:, None]
    return changes


def _low_pass(values: Sequence[float], pole: float) -> list[float]:
    """Return values behind a first-order lag with the given pole, which starts at rest."""

    def next_output(output: float, value: float) -> float:
        return output + (1.0 - pole) * (value - output)

    return list(itertools.accumulate(values, next_output))


def _play(values: Sequence[float], width: float) -> list[float]:
    """Return values behind a play (backlash) of a given `width`.

    The output moves only when the value reaches an edge of the gap.
    """

    def next_output(output: float, value: float) -> float:
        return min(max(output, value - width / 2.0), value + width / 2.0)

    return list(itertools.accumulate(values, next_output))
