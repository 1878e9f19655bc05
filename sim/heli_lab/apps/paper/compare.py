"""Compare models by their open-loop errors on a flight, with the parameters of the rig file and without a
fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.fit.identify.estimation_problem import Problem
from heli_lab.fit.identify.record import prepare
from heli_lab.fit.identify.results import check
from heli_lab.fit.identify.shooting import solve


@dataclass(frozen=True)
class ModelError:
    """Error of open-loop simulations of a model on a flight."""

    model: str  # Name of the model
    rms_deg: dict[str, float]
    """RMS error of each axis, by its name [deg]; the initial state of each window is fitted."""
    normalised: float
    """RMS error of all axes in standard deviations of the quantisation; 1 is the smallest possible value."""


def model_errors(models: Sequence[Model], rig: Rig, flight: Flight) -> list[ModelError]:
    """Simulate a flight open loop with each model, in windows of 2 s."""
    record = prepare(flight, rig)
    errors = []
    for model in models:
        error = check(solve(Problem(model, rig, [record], free=[])))
        errors.append(ModelError(model.name, error.rms_deg, error.normalised))
    return errors
