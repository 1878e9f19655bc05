"""Uncertainty of a rig's parameters: the filter of a twin treats their errors as unknown constants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.estimation import DisturbanceModel, InnovationsModel, LinearisedFlight, estimate
from heli_lab.estimation.estimate import gauss_newton_step
from heli_lab.identify import Record
from heli_lab.identify.flight_model import RigParameters, filter_record, model_functions

SUPPLY_STD: Final = 0.03
"""Standard deviation of the supply voltage between days, as a share: a supply set by hand, amplifiers that are
warm or cold. By judgement. The first seconds of a flight show the supply to a percent, so this number hardly
matters. Smaller: another day's supply contradicts the rig. Larger: a flight needs longer to settle."""


@dataclass(frozen=True)
class ParameterUncertainty:
    """Covariance of the errors of a rig's parameters.

    Parameters
    ----------
    names : tuple of str
        Parameters of the model.
    covariance : ndarray (n, n)
        Covariance of their errors, SI.
    supply_std : float
        Standard deviation of the share by which the supply of a flight differs.
    """

    names: tuple[str, ...]
    covariance: Floats
    supply_std: float

    def directions(self, free: Sequence[str]) -> Floats:
        """Return independent errors of one standard deviation each: amounts of the parameters `free`, and of
        the supply in the last row, shape (free + 1, errors).
        """
        variance, vectors = np.linalg.eigh(self.covariance)
        amounts = vectors * np.sqrt(np.maximum(variance, 0.0))
        rows = [free.index(name) for name in self.names]
        count = len(rows)
        result = np.zeros((len(free) + 1, count + 1))
        result[rows, :count] = amounts
        result[-1, count] = self.supply_std
        return result[:, np.any(result != 0.0, axis=0)]


EXACT: Final = ParameterUncertainty((), np.zeros((0, 0)), 0.0)
"""Parameters without an error."""


def learn_uncertainty(
    model: Model, rig: Rig, records: Sequence[Record]
) -> tuple[DisturbanceModel, ParameterUncertainty]:
    """Estimate the disturbances in nominal flights, and how uncertain these flights leave the rig's parameters.

    The parameters keep the rig's values; encoder zeros and constant torques are estimated per flight. The
    tolerances of the rig file are what is known beforehand.
    """
    every = RigParameters(model, rig, records)
    values = dict(zip((q.name for q in model.parameters), model.parameter_values(rig), strict=True))
    shared = [parameter.quantity for parameter in every.free if parameter.record is None]
    fixed = {name: float(values[name]) for name in shared}
    vector = RigParameters(model, rig, records, fixed)
    references = [filter_record(record) for record in records]
    found = estimate(vector, references, model_functions(model, vector.quantities), vector.start)
    theta = np.concatenate(([fixed[name] for name in shared], found.theta))
    functions = model_functions(model, every.quantities)
    linearised = [
        LinearisedFlight(reference, functions, every.parameters(theta, index))
        for index, reference in enumerate(references)
    ]
    filtered = InnovationsModel(linearised, every.columns, len(theta))
    innovations = filtered.innovations_by_flight(found.disturbances)
    _, covariance, _ = gauss_newton_step(every, theta, innovations)
    count = len(shared)
    uncertainty = ParameterUncertainty(tuple(shared), covariance[:count, :count], SUPPLY_STD)
    return found.disturbances, uncertainty
