"""Convert parameters of the board to gains in the units of the loop analysis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from heli_lab.control.tune.loops import CascadeGains, Pid


def cascade_gains_of(parameters: Mapping[str, float]) -> CascadeGains:
    """Convert parameters of the board to gains in V/rad and rad/rad.

    Parameters
    ----------
    parameters : Mapping of str to float
        Values by name, in the units of the board: kp, ki, kd and filter_Hz of each axis, and optionally
        pitch_hold_ff.
    """

    def pid(axis: str, scale: float) -> Pid:
        """Return the gains of an axis, multiplied by a factor between the units."""
        kp, ki, kd = (parameters[f"{axis}_{name}"] * scale for name in ("kp", "ki", "kd"))
        return Pid(kp, ki, kd, parameters[f"{axis}_filter_Hz"])

    per_rad = 180.0 / np.pi
    elevation, pitch, travel = pid("elevation", per_rad), pid("pitch", per_rad), pid("travel", 1.0)
    return CascadeGains(elevation, pitch, travel, parameters.get("pitch_hold_ff", 0.0) * per_rad)
