"""Limits of a rig's parameters: what calculation tolerates, and what fits on a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from heli_sim.errors import RigError
from heli_sim.rig.schema import ENCODER_COUNTS, RIG_QUANTITIES

LARGEST: Final[Mapping[str, float]] = {
    "kg": 1e4,
    "m": 1e3,
    "m2": 1e4,
    "m/s2": 1e3,
    "kg/m3": 1e4,
    "N": 1e6,
    "N/V": 1e4,
    "N m": 1e6,
    "N m s/rad": 1e6,
    "V": 1e4,
    "s": 1e4,
    "1/s": 1e6,
    "deg": 1e5,
    "count": 1e8,
    "1": 1e4,
}
"""Largest value and tolerance that a rig file may state, by unit: a thousand times a laboratory's and more.
Above, products of rig parameters overflow; a smaller limit would refuse experiments on purpose."""
LARGEST_OF_OTHER_UNITS: Final = 1e9
SMALLEST: Final = 1e-9
"""Smallest size of a number that is not 0, in its unit: below, quotients overflow."""

TABLE_TOP: Final[Mapping[str, tuple[float, float]]] = {
    # A motor with its propeller: from 10 g of a toy's to 2 kg; two of them are lifted.
    "M_f": (0.01, 2.0),
    "M_b": (0.01, 2.0),
    # Whatever one person lifts onto a table.
    "M_w": (0.02, 20.0),
    "M_h": (0.0, 5.0),
    "M_l": (0.0, 10.0),
    # An arm that turns in a room: the shipped rigs have 0.46 m and 0.66 m.
    "L_a": (0.1, 3.0),
    "L_b": (0.02, 3.0),
    "L_x": (-1.5, 1.5),
    "L_h": (0.03, 1.0),
    # Heights of bearings.
    "L_phi": (-0.3, 0.3),
    "L_theta": (-0.3, 0.3),
    # Sea level to 5 km.
    "g": (9.7, 9.9),
    "air_density": (0.6, 1.5),
    # Enough thrust for 10 g at 24 V; at most that of a 30 cm propeller.
    "thrust_gain": (0.005, 10.0),
    "dead_zone": (0.0, 6.0),
    "supply": (2.0, 60.0),
    **dict.fromkeys(ENCODER_COUNTS, (50.0, 100_000.0)),
}
"""Range of a rig that stands on a table, in the unit of rig files. Outside, a unit or a decimal point is most
often wrong: 64 for 64 cm. A wider range misses that; a narrower one refuses real rigs."""


def check_size(where: str, name: str, value: float, tolerance: float, unit: str) -> None:
    """Refuse a parameter that is too large or too small to calculate with."""
    largest = LARGEST.get(unit, LARGEST_OF_OTHER_UNITS)
    for what, size in (("value", value), ("tolerance", tolerance)):
        if abs(size) > largest or 0.0 < abs(size) < SMALLEST:
            raise RigError(
                f"{where}: {name} has the {what} {size:g} {unit}",
                f"give 0 or a size from {SMALLEST:g} to {largest:g} {unit}",
            )


def beyond_a_table(values: Mapping[str, float]) -> list[str]:
    """List those of a rig's `values`, in the units of rig files, that no table-top rig has, one line each."""
    units = {quantity.name: quantity.unit for quantity in RIG_QUANTITIES}
    return [
        f"{name} = {values[name]:g} {units[name]} is outside {low:g} to {high:g} {units[name]}, "
        "the range of a table-top rig"
        for name, (low, high) in TABLE_TOP.items()
        if not low <= values[name] <= high
    ]
