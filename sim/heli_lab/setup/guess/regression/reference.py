"""Gains and stiffnesses of a rig's baseline model at hover; they decide between units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import derivatives, trim
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig
from heli_sim.rig.encoders import counts_per_turn

from heli_lab.errors import IdentifyError

_MIN_STIFFNESS_STD: Final = 1.0
"""Smallest standard deviation of a stiffness [1/s^2]. Measured rigs have a pitch stiffness of -0.3 to -1.4,
and their rig files state 0."""


@dataclass(frozen=True)
class Reference:
    """Gains and stiffnesses of a rig, linearised at hover."""

    stiffness: Mapping[str, tuple[float, float]]
    """By axis, elevation and pitch: acceleration per deflection, mean and standard deviation [1/s^2]."""
    gain: Mapping[str, float]
    """By axis: elevation acceleration per sum of the voltages and pitch acceleration per their difference
    [rad/s^2/V], travel acceleration per pitch [1/s^2]."""
    hover_V: float  # Sum of the voltages at hover [V]
    rest_deg: float  # rest_deg, rest_tolerance_deg: Elevation on the table, and its tolerance [deg]
    rest_tolerance_deg: float
    counts: Mapping[str, float]  # Encoder counts per turn, by axis
    supply_V: float  # Largest voltage of a motor [V]
    reverses: bool = False  # Whether a rotor gives thrust at reversed voltage
    travel_rad_s2: float = 0.0
    """travel_rad_s2, travel_std_rad_s2: Constant acceleration of travel at level pitch, and its standard
    deviation [rad/s^2]; both 0 if the rig file states no torque."""
    travel_std_rad_s2: float = 0.0


def reference_of(rig: Rig) -> Reference:
    """Linearise the baseline model of a rig at hover.

    Rows and columns of the matrices: elevation, pitch and travel are the states 0 to 2, their rates 3 to 5;
    the inputs are the front and the back voltage.
    """
    model = MultibodyModel()
    try:
        hover = trim(model, rig)
    except PlantError as error:
        raise IdentifyError(
            f"units cannot be checked with rig {rig.name}: {error.cause}", error.remedy
        ) from error
    linear = derivatives(model, rig, hover.state, hover.volts_V)
    mean_stiffness = {"elevation": float(linear.A[3, 0]), "pitch": float(linear.A[4, 1])}
    stiffness = {
        axis: (mean, max(_MIN_STIFFNESS_STD, 0.5 * abs(mean))) for axis, mean in mean_stiffness.items()
    }
    torque, friction = rig["torque_travel"], rig["friction_travel"].value
    # Acceleration per torque, 1 / inertia: A[5, 5] is minus friction over inertia.
    per_torque = float(-linear.A[5, 5]) / friction if friction > 0.0 and torque.value else 0.0
    # An error of the pitch zero also accelerates travel. Its whole tolerance is one standard deviation here,
    # because programs set the zero wherever the short arm hangs; otherwise the tolerance is two.
    zero_error_rad_s2 = float(linear.A[5, 1]) * np.radians(rig["offset_pitch"].tolerance)
    torque_error_rad_s2 = per_torque * 0.5 * torque.tolerance
    std_rad_s2 = float(np.hypot(torque_error_rad_s2, zero_error_rad_s2)) if per_torque else 0.0
    return Reference(
        stiffness=stiffness,
        gain={
            "elevation": float(np.mean(linear.B[3])),
            "pitch": float(0.5 * (linear.B[4, 0] - linear.B[4, 1])),
            "travel": float(linear.A[5, 1]),
        },
        hover_V=float(hover.volts_V.sum()),
        rest_deg=rig["elevation_min"].value,
        rest_tolerance_deg=rig["elevation_min"].tolerance,
        counts=dict(zip(AXES, counts_per_turn(rig).tolist(), strict=True)),
        supply_V=rig["supply"].value,
        reverses=rig["reverse_thrust"].value != 0.0,
        travel_rad_s2=per_torque * torque.value,
        travel_std_rad_s2=std_rad_s2,
    )
