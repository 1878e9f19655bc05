"""Rigs and their parameters as text for people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from heli_host.errors import printable

if TYPE_CHECKING:
    from heli_sim.rig import Number, Rig


@dataclass(frozen=True)
class RigFindings:
    """Results that follow from all parameters of a rig together."""

    phrases: tuple[str, ...]
    """Inertias, voltages at hover, and parameters that no rig on a table has; one phrase each."""
    can_fly: bool
    """Whether the rig's supply is sufficient for a hover, and its arm comes down without voltage."""


_ELEVATION_RATE: Final = 3
"""Index of the derivative of the elevation rate among those of the states."""
_TOUCHDOWN_deg: Final = 1.5
"""Height above the table up to which the board takes an arm for landed [deg], as in supervisor.cpp."""
_MAX_FLOAT_deg: Final = 7.0
"""Greatest height of a floating arm that can land [deg]. The fall of the landing carries it onto the table.
In flights of the paper's rig with heavier counterweights, all landed at 6.5, one of two at 8.3, and none at
10.3 degrees."""


def rig_findings(rig: Rig) -> RigFindings:
    """Derive inertias, hover voltage and implausible parameters of a `rig`."""
    from heli_sim.errors import PlantError
    from heli_sim.model import MultibodyModel
    from heli_sim.model.linear import trim
    from heli_sim.rig.inertia import inertias_kg_m2
    from heli_sim.rig.plausible import beyond_a_table

    can_fly = True
    values = {name: number.value for name, number in rig.items()}
    inertias = inertias_kg_m2(values)
    phrases = [
        f"{len(rig)} numbers",
        ", ".join(f"{name} {value:.4g}" for name, value in inertias.items()) + " kg m2",
    ]
    try:
        front_V, back_V = trim(MultibodyModel(), rig).volts_V
        phrases.append(f"hovers at {front_V:.2f} and {back_V:.2f} V")
        if max(front_V, back_V) > rig["supply"].value:
            phrases.append(f"more than its supply of {rig['supply'].value:g} V: it cannot fly")
            can_fly = False
    except PlantError as error:
        phrases.append(f"does not hover: {error}")
        can_fly = False
    floating_deg = floating_elevation_deg(rig)
    above_deg = floating_deg - rig["elevation_min"].value
    if above_deg > _TOUCHDOWN_deg:
        phrases.append(
            f"floats without voltage at {floating_deg:.1f} degrees, {above_deg:.1f} above its table"
            + (": it may rise after a landing" if above_deg <= _MAX_FLOAT_deg else ": it cannot land")
        )
        can_fly = can_fly and above_deg <= _MAX_FLOAT_deg
    return RigFindings((*phrases, *beyond_a_table(values)), can_fly)


def floating_elevation_deg(rig: Rig) -> float:
    """Return the elevation at which the arm of a `rig` comes to rest without voltage [deg]: that of its
    table, or a higher one if its counterweight lifts it.
    """
    import numpy as np

    from heli_sim.model import MultibodyModel
    from heli_sim.model.linear import derivatives

    model = MultibodyModel()
    state = np.zeros(len(model.states))
    elevations_deg = np.linspace(rig["elevation_min"].value, rig["elevation_max"].value, 101)
    for elevation_deg in elevations_deg:
        state[0] = np.radians(elevation_deg)
        if derivatives(model, rig, state, [0.0, 0.0]).rates[_ELEVATION_RATE] <= 0.0:
            return float(elevation_deg)
    return float(elevations_deg[-1])


def half_width(number: Number) -> str:
    """Write the tolerance of a `number`."""
    return f"{number.tolerance:g}" if number.tolerance else "exact"


def with_tolerance(number: Number | None) -> str:
    """Write a `number` with its tolerance; a dash for none."""
    if number is None:
        return "-"
    return f"{number.value:g} (tolerance {number.tolerance:g})" if number.tolerance else f"{number.value:g}"


def signed(tolerances: float) -> str:
    """Write a difference in `tolerances`, with a star if it is above one."""
    if math.isinf(tolerances):
        return "no tolerance"
    return f"{tolerances:+.1f}{' *' if abs(tolerances) > 1.0 else ''}"


def plain(text: str) -> str:
    """Escape a `text` from another source, so that a terminal prints it unchanged."""
    from rich.markup import escape

    return escape(printable(text))
