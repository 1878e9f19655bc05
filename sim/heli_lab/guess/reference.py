"""What the baseline model of a rig says of how it moves: scales to hold units against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError


@dataclass(frozen=True)
class Reference:
    """Linearised at hover.

    Parameters
    ----------
    stiffness : Mapping[str, tuple]
        Of elevation and pitch: acceleration for a deflection, mean and standard deviation, 1/s2.
    gain : Mapping[str, float]
        Elevation's acceleration for the sum of the voltages, rad/s2/V; pitch's for their difference, the
        same; travel's for the pitch, 1/s2.
    hover_V : float
        Sum of the voltages at hover.
    rest_deg, rest_tolerance_deg : float
        Elevation on the table.
    counts : Mapping[str, float]
        Counts of a turn, by axis.
    supply_V : float
        Full supply.
    """

    stiffness: Mapping[str, tuple[float, float]]
    gain: Mapping[str, float]
    hover_V: float
    rest_deg: float
    rest_tolerance_deg: float
    counts: Mapping[str, float]
    supply_V: float


def reference_of(rig: Rig) -> Reference:
    """Linearise the baseline model of a rig.

    Raises
    ------
    IdentifyError
        When the rig cannot hover.
    """
    model = MultibodyModel()
    try:
        at = trim(model, rig)
    except PlantError as error:
        raise IdentifyError(f"rig {rig.name} says nothing of units: {error.cause}", error.remedy) from error
    first = derivatives(model, rig, at.state, at.volts_V)
    # Measured pitch swings with -0.3 to -1.4 1/s2 where the rig file says 0.
    stiffness = {
        axis: (float(first.A[row, place]), float(max(1.0, 0.5 * abs(first.A[row, place]))))
        for axis, row, place in (("elevation", 3, 0), ("pitch", 4, 1))
    }
    counts = rig["encoder_counts"].value
    return Reference(
        stiffness,
        {
            "elevation": float(np.mean(first.B[3])),
            "pitch": float(0.5 * (first.B[4, 0] - first.B[4, 1])),
            "travel": float(first.A[5, 1]),
        },
        float(at.volts_V.sum()),
        rig["elevation_min"].value,
        rig["elevation_min"].tolerance,
        {
            "elevation": counts,
            "pitch": counts,
            "travel": counts * rig["encoder_travel_ratio"].value,
        },
        rig["supply"].value,
    )
