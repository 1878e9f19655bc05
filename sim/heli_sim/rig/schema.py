"""Content of a rig file: name, unit and meaning of every parameter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from heli_sim.rig.quantity import Quantity

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
