"""Limits of a board for a plan, computed from its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from heli_host.arrays import Floats
from heli_host.board.setpoints import setpoint_bounds
from heli_host.declaration import AXES, PARAMS, Axis
from heli_host.errors import PlanError
from heli_host.fly.segments import Segment

_TABLE_MARGIN_DEG = 2.0


@dataclass(frozen=True)
class Limits:
    """Limits of a board for a plan."""

    low_deg: Floats  # low_deg, high_deg: (axes,): Bounds of the setpoints of elevation, pitch and travel
    high_deg: Floats
    low_names: tuple[str, ...]  # low_names, high_names: Source of each bound, for messages
    high_names: tuple[str, ...]
    slew_deg_s: Floats  # (axes,): Fastest change of each setpoint
    excitation_max_V: float  # excitation_max_V, excitation_max_s: Bounds of an excitation
    excitation_max_s: float
    rest_deg: float  # Elevation on the table

    @staticmethod
    def of(parameters: Mapping[str, float] | None = None) -> Limits:
        """Return the limits that parameters set."""
        values = {spec.name: spec.default for spec in PARAMS}
        values.update(parameters or {})
        bounds = setpoint_bounds(values)
        low_deg = np.array([bounds[axis].least_deg for axis in AXES])
        low_deg[Axis.ELEVATION] = values["elevation_rest_deg"] + _TABLE_MARGIN_DEG
        low_names = [bounds[axis].least_name for axis in AXES]
        low_names[Axis.ELEVATION] = f"elevation_rest_deg + {_TABLE_MARGIN_DEG:g}"
        return Limits(
            low_deg=low_deg,
            high_deg=np.array([bounds[axis].most_deg for axis in AXES]),
            low_names=tuple(low_names),
            high_names=tuple(bounds[axis].most_name for axis in AXES),
            slew_deg_s=np.array([values[f"{axis}_slew_deg_s"] for axis in AXES]),
            excitation_max_V=values["excitation_max_V"],
            excitation_max_s=values["excitation_max_s"],
            rest_deg=values["elevation_rest_deg"],
        )


def check_motion(segment: Segment, at_deg: Floats, limits: Limits) -> None:
    """Refuse a segment that the board would refuse, or could not follow. Shapes: `at_deg` (axes,)."""
    motion = segment.motion(at_deg)
    # Rounding errors of a path that just touches a limit are no violation.
    rounding_deg = 1e-9
    for index, axis in enumerate(AXES):
        key = segment.limit_keys[index]
        low, high = limits.low_deg[index], limits.high_deg[index]
        if motion.high_deg[index] > high + rounding_deg:
            raise PlanError(
                f"{segment.where}: {key} takes {axis} to {motion.high_deg[index]:g} degrees",
                f"stay at or below {high:g} ({limits.high_names[index]})",
            )
        if motion.low_deg[index] < low - rounding_deg:
            raise PlanError(
                f"{segment.where}: {key} takes {axis} to {motion.low_deg[index]:g} degrees",
                f"stay at or above {low:g} ({limits.low_names[index]})",
            )
        rate_deg_s = motion.rate_deg_s[index]
        if rate_deg_s > limits.slew_deg_s[index] * (1.0 + 1e-9):
            raise PlanError(
                f"{segment.where}: {segment.rate_key} moves {axis} by {rate_deg_s:.4g} degrees per second",
                f"the board's {axis}_slew_deg_s is {limits.slew_deg_s[index]:g}; lower the rate, or "
                "raise that parameter",
            )
    excitation = segment.excitation
    if excitation is None:
        return
    for key, value in (("front_V", excitation.front_V), ("back_V", excitation.back_V)):
        if abs(value) > limits.excitation_max_V:
            raise PlanError(
                f"{segment.where}: {key} is {value:g}",
                f"keep it within {limits.excitation_max_V:g} (excitation_max_V)",
            )
    if excitation.duration_s > limits.excitation_max_s:
        raise PlanError(
            f"{segment.where}: duration_s is {excitation.duration_s:g}",
            f"keep it within {limits.excitation_max_s:g} (excitation_max_s)",
        )
