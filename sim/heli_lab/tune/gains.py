"""From the board's parameters to gains in the units of the loops' analysis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from heli_lab.tune.loops import CascadeGains, Pid


def cascade_gains_of(parameters: Mapping[str, float]) -> CascadeGains:
    """Gains in V/rad and rad/rad, as the analysis of loops takes them, of `parameters` in declared units: kp,
    ki, kd and the filter of each axis, and maybe pitch_hold_ff.
    """

    def pid(axis: str, per: float) -> Pid:
        kp, ki, kd = (parameters[f"{axis}_{name}"] * per for name in ("kp", "ki", "kd"))
        return Pid(kp, ki, kd, parameters[f"{axis}_filter_Hz"])

    per_rad = 180.0 / np.pi
    return CascadeGains(
        pid("elevation", per_rad),
        pid("pitch", per_rad),
        pid("travel", 1.0),
        parameters.get("pitch_hold_ff", 0.0) * per_rad,
    )
