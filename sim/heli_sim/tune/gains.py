"""Gains that were published: Table 6 of the paper, as parameter sets of the board."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from heli_sim.errors import OptionError
from heli_sim.tune.loops import Law, Pid

PAPER_SETS: Final = ("printed", "corrected")

# (34) is three bare PIDs on the error, in degrees and volts. What the board adds to them is set aside: no
# feed-forward but the setpoint's rate (which makes the derivative one of the error), no dead zone, and limits
# that only the supply sets. (34) does not filter its derivative; 20 Hz is the least that 4096 counts allow.
_BARE: Final[Mapping[str, float]] = {
    "dead_zone_V": 0.0,
    "hover_V": 0.0,
    "hover_slope": 0.0,
    "elevation_rate_ff": 1.0,
    "elevation_acceleration_ff": 0.0,
    "pitch_hold_ff": 0.0,
    "travel_rate_ff": 1.0,
    "travel_acceleration_ff": 0.0,
    "elevation_integral_max_V": 20.0,
    "pitch_integral_max_V": 20.0,
    "travel_integral_max_deg": 45.0,
    "elevation_filter_Hz": 20.0,
    "pitch_filter_Hz": 20.0,
    "travel_filter_Hz": 20.0,
    "pitch_setpoint_max_deg": 30.0,
    "differential_max_V": 12.0,
    "pitch_slew_deg_s": 1000.0,
}
_PITCH: Final = {"pitch_kp": 0.66, "pitch_ki": 3.0, "pitch_kd": 0.1}
_ELEVATION: Final = {"elevation_kp": 0.5, "elevation_ki": 1.0, "elevation_kd": 0.1}
_TRAVEL: Final[Mapping[str, Mapping[str, float]]] = {
    "printed": {"travel_kp": 0.13, "travel_ki": 0.7, "travel_kd": 1.462},
    "corrected": {"travel_kp": 0.7, "travel_ki": 0.13, "travel_kd": 1.462},
}


def paper_gains(which: str) -> dict[str, float]:
    """Table 6 as parameters of the board.

    Errors count in degrees and outputs in volts; travel's output is the pitch setpoint in degrees.

    Parameters
    ----------
    which : str
        ``printed``, or ``corrected``: with P and I of the travel row exchanged.

    Returns
    -------
    dict of str to float
        By declared name, in declared units.

    Raises
    ------
    OptionError
        When there is no such set.
    """
    if which not in _TRAVEL:
        raise OptionError(f"Table 6 comes {' or '.join(PAPER_SETS)}, not '{which}'")
    return {**_BARE, **_ELEVATION, **_PITCH, **_TRAVEL[which]}


def law_of(parameters: Mapping[str, float]) -> Law:
    """Gains of a parameter set, as the analysis of loops takes them.

    Parameters
    ----------
    parameters : Mapping of str to float
        Holds kp, ki, kd and the filter of each axis, and maybe pitch_hold_ff, in declared units.

    Returns
    -------
    Law
        The gains in V/rad and rad/rad.
    """

    def pid(axis: str, per: float) -> Pid:
        kp, ki, kd = (parameters[f"{axis}_{name}"] * per for name in ("kp", "ki", "kd"))
        return Pid(kp, ki, kd, parameters[f"{axis}_filter_Hz"])

    per_rad = 180.0 / np.pi
    return Law(
        pid("elevation", per_rad),
        pid("pitch", per_rad),
        pid("travel", 1.0),
        parameters.get("pitch_hold_ff", 0.0) * per_rad,
    )
