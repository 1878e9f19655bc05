"""Building blocks of control laws: a limit, and the conversion to motor voltages."""

from __future__ import annotations

from typing import Any

import casadi as ca

BLEND_V = 0.05
"""Lift voltage over which the dead zone is blended in [V]."""


def saturated(value: Any, least: Any, most: Any) -> Any:
    """Limit a `value` to the range from `least` to `most`; each is an SX or a number, in the same unit."""
    return ca.fmin(ca.fmax(value, least), most)


def motor_volts(collective_V: Any, differential_V: Any, dead_zone_V: Any = 1.0) -> tuple[Any, Any]:
    """Convert collective and differential into motor voltages, with the rotors' dead zone (paper, eqs. 31 and
    32).

    Pitch has priority, as in the board's own mixer: if a rotor would have to push down, the collective is
    raised.

    Parameters
    ----------
    collective_V : SX or float
        Front plus back, above the dead zones [V].
    differential_V : SX or float
        Front minus back [V].
    dead_zone_V : SX or float
        Voltage below which a rotor gives no thrust [V].

    Returns
    -------
    tuple of SX
        Front and back voltage [V].
    """
    tilt_V = differential_V / 2
    level_V = ca.fmax(collective_V / 2, ca.fabs(tilt_V))

    def motor(lift_V: Any) -> Any:
        """Add the dead zone to the voltage that lifts."""
        # Near 0 it is added gradually, so that noise does not switch a rotor without lift on and off.
        return ca.fmin(lift_V + dead_zone_V, lift_V * (1.0 + dead_zone_V / BLEND_V))

    return motor(level_V + tilt_V), motor(level_V - tilt_V)
