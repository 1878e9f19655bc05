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
_ABRUPT_s: Final = 0.01


def thrust_N(volts_V: ca.SX, gain_N_per_V: ca.SX, dead_zone_V: ca.SX, reverse: ca.SX | float = 0.0) -> ca.SX:
    """Thrust of rotors against voltage, shape of `volts_V`: F = k (V - V_0) above V_0 and none below (31).

    The paper fits the straight line above the dead zone only. Rotors that may be driven backwards push down
    with a share of it beyond the dead zone at negative voltage.

    Parameters
    ----------
    volts_V : casadi.SX
        Voltages, any shape.
    gain_N_per_V : casadi.SX
        k, newtons for each volt above the dead zone.
    dead_zone_V : casadi.SX
        V_0, volts.
    reverse : casadi.SX or float
        Share of its thrust that a rotor gives at reversed voltage; 0 where the drivers do not reverse.
    """
    forward_V = ca.fmax(volts_V - dead_zone_V, 0.0)
    backward_V = ca.fmax(-volts_V - dead_zone_V, 0.0)
    return gain_N_per_V * (forward_V - reverse * backward_V)


def friction_torque_Nm(rates_rad_s: ca.SX, parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Viscous friction of the three bearings, R = -f rate (12), (17), (21), shape (3, 1).

    `rates_rad_s` holds the rates of elevation, pitch and travel, shape (3, 1). The coefficients in
    `parameter` are friction_elevation, friction_pitch and friction_travel in N m s/rad.
    """
    coefficients = ca.vertcat(
        parameter["friction_elevation"], parameter["friction_pitch"], parameter["friction_travel"]
    )
    return -coefficients * rates_rad_s


def rotor_climb_m_s(state: Mapping[str, ca.SX], parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Speed of the front and the back rotor along its thrust axis, shape (2, 1), positive when it climbs.

    It depends on the angles and rates in `state`, and on L_a, L_h and L_theta in m in `parameter`. It follows
    from virtual work: thrust times climb is the power that the thrust gives to the axes.
    """
    c, s = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
    c_pitch, s_pitch = ca.cos(state["pitch_rad"]), ca.sin(state["pitch_rad"])
    travel = state["travel_rate_rad_s"]
    both = (
        parameter["L_a"] * c_pitch * state["elevation_rate_rad_s"]
        + (parameter["L_a"] * c + parameter["L_theta"] * s) * s_pitch * travel
    )
    apart = parameter["L_h"] * (state["pitch_rate_rad_s"] - s * travel)
    return ca.vertcat(both + apart, both - apart)


def rotor_height_m(state: Mapping[str, ca.SX], parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Height of the centres of the front and the back rotor above the elevation axis, shape (2, 1), from the
    angles in `state` and L_a, L_h and L_theta [m] in `parameter`.
    """
    c, s = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
    middle = parameter["L_a"] * s - parameter["L_theta"] * c
    beside = parameter["L_h"] * ca.sin(state["pitch_rad"]) * c
    return ca.vertcat(middle + beside, middle - beside)


def upright_torque_Nm(state: Mapping[str, ca.SX], torque_Nm: ca.SX) -> ca.SX:
    """Torque about the three axes, shape (3, 1), of a torque `torque_Nm` [N m] about the upright of the short
    arm, from the angles in `state`.
    """
    pitch, elevation = state["pitch_rad"], state["elevation_rad"]
    return torque_Nm * ca.vertcat(-ca.sin(pitch), 0, ca.cos(pitch) * ca.cos(elevation))


def smooth_step(time_s: ca.SX, moment_s: ca.SX) -> ca.SX:
    """Unit step at `moment_s` [s] as a function of the time `time_s` [s], smoothed over about 20 ms so that
    it has a derivative by the moment.
    """
    return 0.5 * (1 + ca.tanh((time_s - moment_s) / _ABRUPT_s))


def on_axis(axis: str, value: ca.SX) -> ca.SX:
    """Vector of shape (3, 1) with a scalar `value` at the place of an `axis`, elevation, pitch or travel, and
    0 otherwise.
    """
    return ca.vertcat(*(value if axis == name else ca.SX(0) for name in AXES))
