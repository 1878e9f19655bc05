"""Describes the content of a rig file: quantities with units, inertias that follow, plausible limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Final

from heli_sim.errors import RigError


@dataclass(frozen=True)
class Quantity:
    """Name, unit and meaning of a number.

    Parameters
    ----------
    name : str
        Name, as in the rig file or the state vector.
    unit : str
        Unit, spelled as in the rig file (``kg``, ``N m s/rad``); ``1`` for none.
    meaning : str
        One line in words.
    """

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Prior:
    """Knowledge of a parameter before a flight: a normal distribution within bounds.

    Parameters
    ----------
    mean : float
        Most likely value, in the number's unit.
    std : float
        Standard deviation.
    low, high : float
        Bounds.
    """

    mean: float
    std: float
    low: float = -inf
    high: float = inf


STATED_INERTIAS: Final[tuple[Quantity, ...]] = (
    Quantity("J_theta", "kg m2", "moment of inertia about the elevation axis, arm level"),
    Quantity("J_phi", "kg m2", "moment of inertia about the pitch axis"),
    Quantity("J_psi", "kg m2", "moment of inertia about the travel axis, arm level"),
)
"""A rig file may state these too. No model uses them: they are compared with the masses and lengths."""


def inertias_kg_m2(values: Mapping[str, float]) -> dict[str, float]:
    """Moments of inertia J_theta, J_phi and J_psi of the point masses at level, elevation and pitch 0."""
    v = values
    rotors_kg, short_arm_kg = v["M_f"] + v["M_b"], v["M_f"] + v["M_b"] + v["M_h"]
    # Squared distances from the axes: across the long arm, along it, and below the axes.
    across_kg_m2 = rotors_kg * v["L_h"] ** 2
    along_kg_m2 = short_arm_kg * v["L_a"] ** 2 + v["M_l"] * v["L_x"] ** 2 + v["M_w"] * v["L_b"] ** 2
    below_kg_m2 = short_arm_kg * (v["L_theta"] + v["L_phi"]) ** 2 + (v["M_l"] + v["M_w"]) * v["L_theta"] ** 2
    return {
        "J_theta": along_kg_m2 + below_kg_m2,
        "J_phi": across_kg_m2 + short_arm_kg * v["L_phi"] ** 2,
        "J_psi": along_kg_m2 + across_kg_m2,
    }


def inertia_range_kg_m2(
    values: Mapping[str, float], tolerances: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Smallest and largest J_theta, J_phi and J_psi of all arrangements within the tolerances. Each inertia
    grows with each mass and each length, so that the extremes are at the ends of the tolerances.
    """
    names = [name for name in values if name.startswith(("M_", "L_"))]
    lowest = inertias_kg_m2({name: max(abs(values[name]) - tolerances[name], 0.0) for name in names})
    highest = inertias_kg_m2({name: abs(values[name]) + tolerances[name] for name in names})
    return {name: (lowest[name], highest[name]) for name in lowest}


RIG_QUANTITIES: Final[tuple[Quantity, ...]] = (
    Quantity("M_f", "kg", "front rotor: motor and propeller"),
    Quantity("M_b", "kg", "back rotor: motor and propeller"),
    Quantity("M_w", "kg", "counterweight"),
    Quantity("M_h", "kg", "short arm"),
    Quantity("M_l", "kg", "long arm"),
    Quantity("L_a", "m", "elevation axis to pitch axis"),
    Quantity("L_b", "m", "elevation axis to counterweight"),
    Quantity("L_h", "m", "pitch axis to the centre of a propeller"),
    Quantity("L_phi", "m", "pitch axis down to the short arm"),
    Quantity("L_theta", "m", "elevation axis down to the long arm"),
    Quantity("L_x", "m", "elevation axis to the centre of the long arm"),
    Quantity("g", "m/s2", "gravity"),
    Quantity("thrust_gain", "N/V", "thrust of one rotor for each volt above the dead zone"),
    Quantity("dead_zone", "V", "voltage below which a rotor gives no thrust"),
    Quantity("friction_elevation", "N m s/rad", "viscous friction of the elevation axis"),
    Quantity("friction_pitch", "N m s/rad", "viscous friction of the pitch axis"),
    Quantity("friction_travel", "N m s/rad", "viscous friction of the travel axis"),
    Quantity("reverse_thrust", "1", "share of its thrust that a rotor gives at reversed voltage"),
    Quantity("torque_elevation", "N m", "constant torque about the elevation axis, such as a cable's pull"),
    Quantity("torque_pitch", "N m", "constant torque about the pitch axis, such as a cable's pull"),
    Quantity("torque_travel", "N m", "constant torque about the travel axis, such as a cable's pull"),
    Quantity("offset_elevation", "deg", "what the elevation's encoder shows when the long arm is level"),
    Quantity("offset_pitch", "deg", "what the pitch's encoder shows when the short arm is level"),
    Quantity("air_density", "kg/m3", "density of the air"),
    Quantity("drag_area_arm", "m2", "drag coefficient times area that travel always drives through the air"),
    Quantity("drag_area_body", "m2", "drag coefficient times area that pitch turns into the travel's way"),
    Quantity("elevation_min", "deg", "elevation when the arm rests on the table"),
    Quantity("elevation_max", "deg", "upper stop of the elevation"),
    Quantity("pitch_max", "deg", "stops of the pitch, both ways"),
    Quantity("travel_max", "deg", "travel at which the cables are taut, both ways"),
    Quantity("table_damping", "1/s", "rate at which pitch and travel motion dies while resting on the table"),
    Quantity("supply", "V", "supply of the motor drivers"),
    Quantity("driver_dead_band", "1", "part of the duty that the drivers swallow near 0 and near full"),
    Quantity("encoder_counts_elevation", "count", "counts of the elevation's encoder for one revolution, x4"),
    Quantity("encoder_counts_pitch", "count", "counts of the pitch's encoder for one revolution, x4"),
    Quantity("encoder_counts_travel", "count", "counts of the travel's encoder for one revolution, x4"),
    Quantity(
        "encoder_direction_elevation", "1", "1: this encoder counts up with elevation, -1: down, 0: not known"
    ),
    Quantity("encoder_direction_pitch", "1", "1: this encoder counts up with pitch, -1: down, 0: not known"),
    Quantity(
        "encoder_direction_travel", "1", "1: this encoder counts up with travel, -1: down, 0: not known"
    ),
)
ENCODER_COUNTS: Final = ("encoder_counts_elevation", "encoder_counts_pitch", "encoder_counts_travel")
ENCODER_DIRECTIONS: Final = (
    *("encoder_direction_elevation", "encoder_direction_pitch", "encoder_direction_travel"),
)
COMMON_COUNTS: Final = Quantity(
    "encoder_counts", "count", "counts of each encoder that has no entry of its own, for one revolution, x4"
)
"""Short form of `ENCODER_COUNTS`, which older rig files use too: `load_rig` writes it out per encoder."""
TRAVEL_RATIO: Final = Quantity(
    "encoder_travel_ratio", "1", "older rig files only: counts of the travel's encoder over encoder_counts"
)


@dataclass(frozen=True)
class Unstated:
    """Default of a parameter that a rig file does not state."""

    value: float  # Assumed value if the rig file does not state one, in the quantity's unit
    tolerance: float  # Half width of the interval that holds it with about 95 % confidence
    source: str  # Reason for value and tolerance


UNSTATED: Final[Mapping[str, Unstated]] = {
    "reverse_thrust": Unstated(0.0, 0.0, "not stated: the drivers are taken not to reverse"),
    "torque_elevation": Unstated(0.0, 0.05, "not stated: cables pull by no more than 5 g at 1 m"),
    "torque_pitch": Unstated(0.0, 0.02, "not stated: cables pull by no more than 2 g at 1 m"),
    "torque_travel": Unstated(0.0, 0.1, "not stated: cables pull by no more than 10 g at 1 m"),
    "offset_elevation": Unstated(0.0, 0.1, "not stated: encoders are zeroed to a count of 0.09 deg"),
    "offset_pitch": Unstated(0.0, 0.1, "not stated: encoders are zeroed to a count of 0.09 deg"),
    **dict.fromkeys(ENCODER_DIRECTIONS, Unstated(0.0, 0.0, "not stated: it depends on the wiring")),
}


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
