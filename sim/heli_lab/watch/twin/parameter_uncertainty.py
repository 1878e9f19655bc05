"""Uncertainty of a rig's parameters: the filter of a twin treats their errors as unknown constants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

SUPPLY_STD: Final = 0.03
"""Standard deviation of the supply voltage between days, as a share: a supply set by hand, amplifiers that
are warm or cold. By judgement. The first seconds of a flight show the supply to a percent, so this number
hardly matters. Smaller: another day's supply contradicts the rig. Larger: a flight needs longer to
settle."""


@dataclass(frozen=True)
class ParameterUncertainty:
    """Covariance of the errors of a rig's parameters, and the voltages for which these hold."""

    names: tuple[str, ...]  # Parameters of the model
    covariance: Floats  # (n, n): Covariance of their errors, SI
    supply_std: float  # Standard deviation of the share by which the supply of a flight differs
    low_V: Floats  # low_V, high_V: (2,): Voltages of both rotors between which the parameters hold [V]
    high_V: Floats

    def outside_V(self, volts_V: Floats) -> Floats:
        """Return by how much `volts_V`, shape (2,), are outside the range for which the parameters hold [V],
        shape (2,).
        """
        return np.maximum(self.low_V - volts_V, 0.0) + np.maximum(volts_V - self.high_V, 0.0)

    def directions(self, free: Sequence[str]) -> Floats:
        """Return independent errors of one standard deviation each: amounts of the parameters `free`, and of
        the supply in the last row, shape (free + 1, errors).
        """
        variance, vectors = np.linalg.eigh(self.covariance)
        amounts = vectors * np.sqrt(np.maximum(variance, 0.0))
        rows = [free.index(name) for name in self.names]
        count = len(rows)
        directions = np.zeros((len(free) + 1, count + 1))
        directions[rows, :count] = amounts
        directions[-1, count] = self.supply_std
        return directions[:, np.any(directions != 0.0, axis=0)]


EXACT: Final = ParameterUncertainty((), np.zeros((0, 0)), 0.0, np.full(2, -np.inf), np.full(2, np.inf))
"""Parameters without an error, for all voltages."""
