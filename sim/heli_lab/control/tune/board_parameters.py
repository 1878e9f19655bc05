"""Parameters and limits of the board that follow from a rig and from the gains of a design."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.declaration import PARAMS
from heli_sim.errors import PlantError
from heli_sim.rig import Rig
from heli_sim.rig.board import encoder_parameters
from heli_sim.rig.encoders import direction_is_known

from heli_lab.control.tune.loops import CascadeGains

MOTOR_MAX_V: Final = 10.0
"""Largest voltage of a motor in flight, even if the supply gives more [V]."""
_PARAMETERS: Final = {spec.name: spec for spec in PARAMS}


def check_lift(rig: Rig, hover_V: float) -> None:
    """Raise a PlantError if the rig's motors cannot hold it at `hover_V`, the sum above the dead zone [V]."""
    if hover_V >= lift_max_V(rig):
        raise PlantError(
            f"rig '{rig.name}' hovers at {0.5 * hover_V + rig['dead_zone'].value:.1f} V per motor, "
            f"but its motors get at most {_motor_max_V(rig):.1f} V",
            "check its masses, thrust_gain and supply",
        )


def rig_parameters(rig: Rig) -> dict[str, float]:
    """Return the parameters of the board that follow from the rig alone.

    Counts per revolution are included only for encoders whose direction the rig file states. The sign of the
    others depends on their wiring, and is stored on the board, so that a file of gains must not change it.
    """
    encoders = zip(encoder_parameters(rig).items(), direction_is_known(rig), strict=True)
    counts_per_rev = {name: value for (name, value), is_known in encoders if is_known}
    supply_V = rig["supply"].value
    return counts_per_rev | {
        "elevation_rest_deg": rig["elevation_min"].value,
        "supply_V": supply_V,
        "motor_min_V": -supply_V if rig["reverse_thrust"].value > 0.0 else 0.0,
        "motor_max_V": _motor_max_V(rig),
        "dead_zone_V": rig["dead_zone"].value,
    }


def law_parameters(law: CascadeGains) -> dict[str, float]:
    """Convert the gains and filters of a law to parameters of the board, in its units."""
    values: dict[str, float] = {}
    for axis, pid in (("elevation", law.elevation), ("pitch", law.pitch), ("travel", law.travel)):
        for name, gain in (("kp", pid.kp), ("ki", pid.ki), ("kd", pid.kd)):
            # The board takes V per degree, and for travel degrees per degree.
            values[f"{axis}_{name}"] = gain if axis == "travel" else float(np.radians(gain))
        values[f"{axis}_filter_Hz"] = pid.filter_Hz
    return values


def travel_motion_deg(gain: float) -> float:
    """Return the tilt from which on the board expects travel to move [deg].

    On a rig with the travel gain `gain` [1/s^2], this tilt gives the same acceleration as the default tilt on
    the default rig.
    """
    default_acceleration = _PARAMETERS["travel_motion_deg"].default * _PARAMETERS["travel_gain"].default
    return max(default_acceleration / gain, _PARAMETERS["travel_motion_deg"].min)


def largest_differential_V(rig: Rig, hover_V: float) -> float:
    """Compute the largest difference of the voltages at which their sum still holds the arm [V].

    Beyond the hover voltage, one rotor stops and the other lifts the arm. Beyond the reserve of the stronger
    motor, the arm sinks.
    """
    return max(min(hover_V, lift_max_V(rig) - hover_V), 0.1 * hover_V)


def lift_max_V(rig: Rig) -> float:
    """Largest sum of both voltages above the dead zone [V]."""
    return 2.0 * (_motor_max_V(rig) - rig["dead_zone"].value)


def _motor_max_V(rig: Rig) -> float:
    """Largest voltage of a motor [V]: the supply, but at most `MOTOR_MAX_V`."""
    return min(rig["supply"].value, MOTOR_MAX_V)
