"""Spline terms of a fit as curves in units for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.diagnose.spline_term import KNOTS, QUANTITIES, SplineTerm, bspline_basis
from heli_lab.diagnose.words import SHOWN, channel_in_words, quantity_in_words
from heli_lab.estimation import Estimate

_DRAWN: Final = 200
"""Points that a curve is drawn with."""


@dataclass(frozen=True)
class SplineCurve:
    """A torque, a share of the thrust or an angle as a curve of one quantity.

    Parameters
    ----------
    channel : str
        Where it acts, such as ``torque.pitch``.
    on : str
        The quantity that it depends on, such as ``elevation``.
    place, value, std : ndarray (n,)
        The quantity over its range in the flights fitted, the curve about its mean, and its standard error.
    place_unit, value_unit : str
        Their units: degrees, mN m, per cent.
    """

    channel: str
    on: str
    place: Floats
    value: Floats
    std: Floats
    place_unit: str
    value_unit: str

    @property
    def what(self) -> str:
        """The curve in words with its range and its values."""
        where = f"{channel_in_words(self.channel)} by {quantity_in_words(self.on)}"
        return (
            f"{where}, seen from {self.place[0]:.3g} to {self.place[-1]:.3g} {self.place_unit}: "
            f"{self.value.min():.2g} to {self.value.max():.2g} {self.value_unit}"
        )


def spline_curve_of(effect: SplineTerm, estimate: Estimate) -> SplineCurve:
    """Evaluate a spline term with the coefficients of an estimate."""
    low, step = effect.values[f"{effect.name}_low"], effect.values[f"{effect.name}_step"]
    place = np.linspace(low, low + step * (KNOTS - 3), _DRAWN)
    weights = bspline_basis(place, low, step)
    # A constant torque, thrust or angle is a parameter of the rig: only what varies is the curve's own.
    weights -= weights.mean(axis=0)
    names = list(estimate.parameter_vector.names)
    columns = [names.index(f"{effect.name}_{i}") for i in range(KNOTS)]
    covariance = estimate.covariance[np.ix_(columns, columns)]
    variance = np.einsum("ni,ij,nj->n", weights, covariance, weights)
    unit = next(q.unit for q in effect.parameters if q.name == f"{effect.name}_0")
    on_unit = QUANTITIES[effect.on][1]
    factor, value_unit = SHOWN.get(unit, (1.0, unit))
    on_factor, place_unit = SHOWN.get(on_unit, (1.0, on_unit))
    return SplineCurve(
        effect.channel,
        effect.on,
        on_factor * place,
        factor * (weights @ estimate.theta[columns]),
        factor * np.sqrt(np.maximum(variance, 0.0)),
        place_unit,
        value_unit,
    )
