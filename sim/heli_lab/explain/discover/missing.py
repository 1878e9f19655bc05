"""The torque or angle that a model lacks without one of its causes, and the contribution of that cause.

`missing_torque.py` and `missing_angle.py` compute it; `without_cause.py` decides which of the two is missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from heli_host.data.arrays import Floats

from heli_lab.explain.discover.curve_quantities import explained_share

TIME: Final = "time of the flight"
"""Quantity over which a term is drawn if it follows no single quantity."""


@dataclass(frozen=True)
class MissingTerm:
    """Torque about one axis, or error of one encoder, that a model lacks without one of its causes.

    The arrays have one row per measurement of the filter for a torque, and one row per point of a curve for
    an angle. All values are in display units. The mean of a torque is subtracted, because every model has a
    constant torque as a parameter.
    """

    id: str  # The cause: an effect's id, or ``spline:CHANNEL:QUANTITY``
    what: str  # what, unit: ``torque`` in mN m, or ``angle`` in degrees
    unit: str
    axis: str  # ``elevation``, ``pitch`` or ``travel``
    on: str
    """on, on_unit: Quantity that the cause depends on, in words, and its display unit; `TIME` if the cause
    depends on several quantities."""
    on_unit: str
    quantity: Floats  # (n,): Values of the quantity
    missing: Floats
    """missing, std: (n,): Torque or angle that the model lacks without the cause, and its standard error."""
    std: Floats
    remaining: Floats  # (n,): Torque or angle that the model lacks with the cause
    contribution: Floats  # (n,): Torque or angle by the equation of the cause

    @property
    def is_spline(self) -> bool:
        """Whether the cause is a spline term, not an effect of the catalogue."""
        return self.id.startswith("spline:")

    @property
    def share(self) -> float:
        """Share of the variance of `missing` that `contribution` explains, at most 1."""
        return explained_share(self.missing, self.contribution)
