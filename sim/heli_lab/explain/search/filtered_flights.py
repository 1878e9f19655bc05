"""Filters the states of flights with a baseline; all candidates are compared along these trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.fit.estimator import Estimate, estimate
from heli_lab.fit.flight_model import GAINS, RigParameters, filter_record, model_functions
from heli_lab.fit.innovations import refiltered
from heli_lab.fit.records import Record
from heli_lab.fit.reference_trajectory import ReferenceTrajectory

_FILTER_PASSES: Final = 2
"""How often the reference trajectory is filtered again with the baseline's own estimate. After the second
time it moves by less than a hundredth of the quantisation (simulated and field flights, 2026-11)."""


@dataclass(frozen=True)
class FilteredFlights:
    """Flights with filtered states, and the baseline that was estimated to filter them."""

    references: tuple[ReferenceTrajectory, ...]  # Filtered states of each flight
    baseline: Estimate  # Estimate of the baseline on these flights

    def with_thrust_noise(self, model: Model, rig: Rig, records: Sequence[Record]) -> FilteredFlights:
        """Estimate the baseline again with a thrust that varies at random; the filtered states are
        unchanged.
        """
        vector = RigParameters(model, rig, records)
        functions = model_functions(model, vector.quantities)
        start = self.baseline.disturbances.with_gains(len(GAINS))
        baseline = estimate(vector, self.references, functions, self.baseline.theta, start)
        return FilteredFlights(self.references, baseline)


def filter_with_baseline(model: Model, rig: Rig, records: Sequence[Record]) -> FilteredFlights:
    """Estimate a baseline on some flights, and filter their states with it.

    Estimation and filtering alternate, because each needs the result of the other.
    """
    references = tuple(filter_record(record) for record in records)
    parameter_vector = RigParameters(model, rig, records)
    functions = model_functions(model, parameter_vector.quantities)
    disturbances, theta = None, parameter_vector.start
    for _ in range(_FILTER_PASSES):
        estimate_ = estimate(parameter_vector, references, functions, theta, disturbances)
        disturbances, theta = estimate_.disturbances, estimate_.theta
        references = tuple(refiltered(estimate_.filtered(), disturbances))
    return FilteredFlights(references, estimate_)
