"""Finds the quantity over which a contribution of a cause can be drawn as a curve."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.search.splines import QUANTITIES, SplineTerm, bspline_basis, knot_span, quantity_values
from heli_lab.explain.thresholds import CURVE_SHARE
from heli_lab.fit.linearised_flight import LinearisedFlight

_LAGS_s: Final = (0.03, 0.06, 0.1, 0.15)
"""Time constants of lags that measure how fast a thrust changes: those of rotors."""
_THRUST_CHANGE: Final = "change of "
"""Beginning of the names of quantities that state how fast a thrust changes."""


def quantities_and_thrust_changes(linear: LinearisedFlight) -> dict[str, Floats]:
    """Return the quantities that a torque may depend on, shape (n,) each, in SI units by name.

    These are the quantities of spline terms, and the change of the thrusts within a time, on which lags and
    delays depend. The change is the difference between a thrust and the same thrust behind a first-order lag.
    """
    values = quantity_values(linear.model.source, linear.trajectory)
    for name, time_constant_s in itertools.product(("thrust", "thrust_difference"), _LAGS_s):
        lagged_N = _first_order_lag(values[name], linear.trajectory.step_s / time_constant_s)
        values[f"{_THRUST_CHANGE}{name} within {time_constant_s:g} s"] = values[name] - lagged_N
    return values


def quantity_unit(name: str) -> str:
    """Return the SI unit of the quantity `name` of `quantities_and_thrust_changes`."""
    return "N" if name.startswith(_THRUST_CHANGE) else QUANTITIES[name][1]


def best_quantity(
    quantities_by_flight: Sequence[Mapping[str, Floats]], contribution: Floats, cause: Candidate
) -> str | None:
    """Return the name of the quantity of which a contribution is nearly a function. Shapes: `contribution`
    (n of all flights,).
    """
    if isinstance(cause.effect, SplineTerm):
        return cause.effect.on
    shares = {
        name: _share_of_curve(over_all_flights(quantities_by_flight, name), contribution)
        for name in quantities_by_flight[0]
    }
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] >= CURVE_SHARE else None


def over_all_flights(quantities_by_flight: Sequence[Mapping[str, Floats]], name: str) -> Floats:
    """Return the quantity `name` of all flights, one after the other, from `quantities_by_flight`."""
    return np.concatenate([quantities[name] for quantities in quantities_by_flight])


def explained_share(values: Floats, fitted: Floats) -> float:
    """Return the share of the variance of `values` (n,) that `fitted` (n,) explains, at most 1 (R2)."""
    variance = max(float(np.var(values)), 1e-300)  # no division by zero for constant values
    return 1.0 - float(np.var(values - fitted)) / variance


def _share_of_curve(quantity: Floats, contribution: Floats) -> float:
    """Return the share of a contribution (n,) that a spline curve over one quantity (n,) explains."""
    basis = bspline_basis(quantity, *knot_span(quantity))
    coefficients = np.linalg.lstsq(basis, contribution, rcond=None)[0]
    return explained_share(contribution, basis @ coefficients)


def _first_order_lag(values: Floats, step_share: float) -> Floats:
    """Return values (n,) behind a first-order lag whose output starts at the first value.

    `step_share` is the sampling interval divided by the time constant.
    """
    # Without scipy.signal, whose import takes longer than this loop for an hour of flight.
    gain = -math.expm1(-step_share)
    lagged = itertools.accumulate(values.tolist(), lambda output, value: output + gain * (value - output))
    return np.fromiter(lagged, float)
