"""Equations that all models of the rig share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import casadi as ca
from heli_host.declaration import AXES

__all__ = [
    "AXES",
    "friction_torque_Nm",
    "on_axis",
    "rotor_climb_m_s",
    "rotor_height_m",
    "smooth_step",
    "thrust_N",
    "upright_torque_Nm",
]
_STEP_WIDTH_s: Final = 0.01


def thrust_N(volts_V: ca.SX, gain_N_per_V: ca.SX, dead_zone_V: ca.SX, reverse: ca.SX | float = 0.0) -> ca.SX:
    """Return the thrust of rotors at given voltages: F = k (V - V_0) above V_0, otherwise 0 (equation 31).

    The paper measured only positive voltages. A rotor that can be driven backwards gives, beyond the dead
    zone, a share of this thrust in the opposite direction.
    """
    forward_V = ca.fmax(volts_V - dead_zone_V, 0.0)
    backward_V = ca.fmax(-volts_V - dead_zone_V, 0.0)
    return gain_N_per_V * (forward_V - reverse * backward_V)


def friction_torque_Nm(rates_rad_s: ca.SX, parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Return the viscous friction of the three bearings, R = -f rate, shape (3, 1): equations 12, 17, 21.

    `rates_rad_s` holds the rates of elevation, pitch and travel, shape (3, 1). The coefficients in
    `parameter` are friction_elevation, friction_pitch and friction_travel in N m s/rad.
    """
    coefficients = ca.vertcat(
        parameter["friction_elevation"], parameter["friction_pitch"], parameter["friction_travel"]
    )
    return -coefficients * rates_rad_s


def rotor_climb_m_s(state: Mapping[str, ca.SX], parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Return the speed of the front and the back rotor along the thrust axis, shape (2, 1).

    The speed is positive if the rotor climbs. It depends on the angles and rates in `state`, and on L_a, L_h
    and L_theta in `parameter` [m]. It follows from virtual work: thrust times climb is the power that the
    thrust gives to the axes.
    """
    cos_elevation, sin_elevation = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
    cos_pitch, sin_pitch = ca.cos(state["pitch_rad"]), ca.sin(state["pitch_rad"])
    travel_rad_s = state["travel_rate_rad_s"]
    mean_m_s = (
        parameter["L_a"] * cos_pitch * state["elevation_rate_rad_s"]
        + (parameter["L_a"] * cos_elevation + parameter["L_theta"] * sin_elevation) * sin_pitch * travel_rad_s
    )
    difference_m_s = parameter["L_h"] * (state["pitch_rate_rad_s"] - sin_elevation * travel_rad_s)
    return ca.vertcat(mean_m_s + difference_m_s, mean_m_s - difference_m_s)


def rotor_height_m(state: Mapping[str, ca.SX], parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Return the height of the front and the back rotor above the elevation axis, shape (2, 1).

    It depends on the angles in `state`, and on L_a, L_h and L_theta in `parameter` [m].
    """
    # Cosine and sine of the elevation.
    c, s = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
    mean_m = parameter["L_a"] * s - parameter["L_theta"] * c
    difference_m = parameter["L_h"] * ca.sin(state["pitch_rad"]) * c
    return ca.vertcat(mean_m + difference_m, mean_m - difference_m)


def upright_torque_Nm(state: Mapping[str, ca.SX], torque_Nm: ca.SX) -> ca.SX:
    """Convert a torque about the thrust direction of the short arm to torques about the axes, shape (3,
    1).
    """
    pitch, elevation = state["pitch_rad"], state["elevation_rad"]
    return torque_Nm * ca.vertcat(-ca.sin(pitch), 0, ca.cos(pitch) * ca.cos(elevation))


def smooth_step(time_s: ca.SX, moment_s: ca.SX) -> ca.SX:
    """Return 0 before and 1 after `moment_s` as a function of `time_s` [s], smoothed over about 20 ms.

    The smoothing gives the step a derivative by the moment, which a fit needs.
    """
    return 0.5 * (1 + ca.tanh((time_s - moment_s) / _STEP_WIDTH_s))


def on_axis(axis: str, value: ca.SX) -> ca.SX:
    """Return a vector over the axes, shape (3, 1), with `value` for one `axis` and 0 for the others."""
    return ca.vertcat(*(value if axis == name else ca.SX(0) for name in AXES))
