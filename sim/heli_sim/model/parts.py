"""Parts that every model of the rig shares."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca


def thrust_N(volts_V: ca.SX, gain_N_per_V: ca.SX, dead_zone_V: ca.SX, reverse: ca.SX | float = 0.0) -> ca.SX:
    """Thrust of rotors against voltage, F = k (V - V_0) above V_0 and none below (31).

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

    Returns
    -------
    casadi.SX
        Thrust in N, shape of `volts_V`.
    """
    forward_V = ca.fmax(volts_V - dead_zone_V, 0.0)
    backward_V = ca.fmax(-volts_V - dead_zone_V, 0.0)
    return gain_N_per_V * (forward_V - reverse * backward_V)


def friction_torque_Nm(rates_rad_s: ca.SX, parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Viscous friction of the three bearings, R = -f rate (12), (17), (21).

    Parameters
    ----------
    rates_rad_s : casadi.SX
        Rates of elevation, pitch and travel, shape (3, 1).
    parameter : Mapping[str, casadi.SX]
        Holds friction_elevation, friction_pitch and friction_travel in N m s/rad.

    Returns
    -------
    casadi.SX
        Torques in N m, shape (3, 1).
    """
    coefficients = ca.vertcat(
        parameter["friction_elevation"], parameter["friction_pitch"], parameter["friction_travel"]
    )
    return -coefficients * rates_rad_s
