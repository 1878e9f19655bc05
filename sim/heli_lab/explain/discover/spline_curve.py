"""Estimated spline terms as curves in display units."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.explain.search.hypothesis import Cause
from heli_lab.explain.search.splines import KNOTS, QUANTITIES, SplineTerm, bspline_basis
from heli_lab.explain.wording import channel_in_words, display_unit, quantity_in_words
from heli_lab.fit.estimator import Estimate

_CURVE_POINTS: Final = 200
"""Points of a drawn curve."""


@dataclass(frozen=True)
class SplineCurve:
    """A torque, a share of the thrust or an angle as a curve over one quantity."""

    channel: str  # Channel on which it acts, such as ``torque.pitch``
    on: str  # Quantity that it depends on, such as ``elevation``
    quantity: Floats
    """quantity, value, std: (n,): The quantity over its range in the fitted flights, the curve less its mean,
    and its standard error."""
    value: Floats
    std: Floats
    quantity_unit: str  # quantity_unit, value_unit: Display units: degrees, mN m, per cent
    value_unit: str

    @property
    def what(self) -> str:
        """Sentence with the range of the quantity and of the values."""
        dependence = f"{channel_in_words(self.channel)} by {quantity_in_words(self.on)}"
        return (
            f"{dependence}, covered from {self.quantity[0]:.3g} to {self.quantity[-1]:.3g} "
            f"{self.quantity_unit}: "
            f"{self.value.min():.2g} to {self.value.max():.2g} {self.value_unit}"
        )


def _spline_curve(effect: SplineTerm, estimate: Estimate) -> SplineCurve:
    """Evaluate a spline term over the range of its quantity, with the coefficients of an `estimate`."""
    low, step = effect.knots
    quantity = np.linspace(low, low + step * (KNOTS - 3), _CURVE_POINTS)
    basis = bspline_basis(quantity, low, step)
    # A constant torque, thrust or angle is a parameter of the rig already, so the curve has no mean.
    basis -= basis.mean(axis=0)
    names = list(estimate.parameter_vector.names)
    columns = [names.index(f"{effect.name}_{i}") for i in range(KNOTS)]
    covariance = estimate.covariance[np.ix_(columns, columns)]
    variance = np.einsum("ni,ij,nj->n", basis, covariance, basis)
    unit = next(q.unit for q in effect.parameters if q.name == f"{effect.name}_0")
    factor, value_unit = display_unit(unit)
    quantity_factor, quantity_unit = display_unit(QUANTITIES[effect.on][1])
    return SplineCurve(
        channel=effect.channel,
        on=effect.on,
        quantity=quantity_factor * quantity,
        value=factor * (basis @ estimate.theta[columns]),
        std=factor * np.sqrt(np.maximum(variance, 0.0)),
        quantity_unit=quantity_unit,
        value_unit=value_unit,
    )


def spline_curves_of(causes: Iterable[Cause], estimate: Estimate) -> list[SplineCurve]:
    """Evaluate those of the `causes` in the model of an `estimate` that are spline terms, in their order."""
    effects = (cause.candidate.effect for cause in causes)
    return [_spline_curve(effect, estimate) for effect in effects if isinstance(effect, SplineTerm)]
