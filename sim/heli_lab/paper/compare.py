"""How far each model is from a flight when nothing is fitted: free runs with the rig file's own numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from heli_host.flight import Flight
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.identify.check import check
from heli_lab.identify.problem import Problem
from heli_lab.identify.record import prepare
from heli_lab.identify.solve import solve


@dataclass(frozen=True)
class Distance:
    """A model against a flight.

    Parameters
    ----------
    model : str
        Name of the model.
    rms_deg : dict of float
        Root mean square error of free runs, for elevation, pitch and travel; each begins at the state that
        suits it best.
    normalised : float
        Of all axes, in standard deviations of the quantisation: 1 when nothing else is left.
    """

    model: str
    rms_deg: dict[str, float]
    normalised: float


def distances(models: Sequence[Model], rig: Rig, flight: Flight, window_s: float = 2.0) -> list[Distance]:
    """Predict a flight freely with each model, window by window of `window_s`; an IdentifyError when no part
    of it is free.
    """
    record = prepare(flight, rig)
    out = []
    for model in models:
        checked = check(solve(Problem(model, rig, [record], free=[], window_s=window_s)))
        out.append(Distance(model.name, checked.rms_deg, checked.normalised))
    return out
