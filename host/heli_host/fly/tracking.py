"""Decision whether a flight followed its setpoints: `completed` or `not_tracked`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from heli_host.declaration import AXES, CHANNELS, Channel, State
from heli_host.fly.route import Number, Piece, PlanTable
from heli_host.link.channels import ENCODERS, numbers
from heli_host.link.clock import TICK_S
from heli_host.link.telemetry import Ticks

NOT_TRACKED: Final = "not_tracked"
"""Beginning of the outcome of a flight that was completed, but with too large tracking errors."""

_BOUND: Final = Number(0.1, 3600.0)
_LONGEST: Final = Number(0.1, 3600.0)
_SETPOINTS: Final = tuple(Channel[f"{axis.upper()}_SETPOINT"] for axis in AXES)


@dataclass(frozen=True)
class Tolerance:
    """Greatest tracking error of each axis, and for how long it may be larger."""

    # The error is the angle minus the setpoint that the control law used in that tick. Every shipped rig,
    # with its own gains, stays below 0.3, 1.5 and 9 degrees for 2 s in every built-in plan.

    elevation_deg: float = 3.0  # elevation_deg, pitch_deg, travel_deg: Greatest tracking error [deg]
    pitch_deg: float = 15.0
    travel_deg: float = 15.0
    for_s: float = 2.0  # Longest time for which the error may be larger [s]

    @staticmethod
    def read(values: Mapping[str, Any], where: str) -> Tolerance:
        """Read the table ``[tolerance]`` of a plan."""
        default = Tolerance()
        bounds = {f"{axis}_deg": _BOUND for axis in AXES} | {"for_s": _LONGEST}
        table = PlanTable(values, where, bounds)
        return Tolerance(
            **{key: table.number(key, spec, getattr(default, key)) for key, spec in bounds.items()}
        )

    @staticmethod
    def widest(tolerances: Sequence[Tolerance]) -> Tolerance:
        """Return the widest tolerance of several plans."""
        return Tolerance(
            *(
                max(getattr(tolerance, key) for tolerance in tolerances)
                for key in Tolerance.__dataclass_fields__
            )
        )


@dataclass
class TrackingMonitor:
    """Monitors the tracking errors during a flight; used in the session's reading thread."""

    tolerance: Tolerance
    rad_per_count: NDArray[np.float64]  # (axes,): Angle of a count of each encoder
    axes: tuple[str, ...]  # Axes that are closed
    longest_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(AXES)))
    """(axes,): Longest time for which an axis was beyond its bound without a break."""
    worst_deg: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(AXES)))
    """(axes,): Largest following error in such a time, degrees."""

    def __post_init__(self) -> None:
        self._unreached = ""
        self._beyond_since_tick = np.full(len(AXES), -1, np.int64)
        self._peak_deg = np.zeros(len(AXES))
        # A row of raw numbers times this matrix is angle minus setpoint, shape (channels, axes).
        self._deg_per_raw = np.zeros((len(Channel), len(AXES)))
        for index, (encoder, setpoint) in enumerate(zip(ENCODERS, _SETPOINTS, strict=True)):
            self._deg_per_raw[encoder, index] = np.degrees(self.rad_per_count[index])
            self._deg_per_raw[setpoint, index] = -np.degrees(CHANNELS[setpoint].scale)
        self._bound_deg = np.array([getattr(self.tolerance, f"{axis}_deg") for axis in AXES])

    def take(self, ticks: Ticks, first_tick: int) -> None:
        """Process new samples."""
        if not len(ticks):
            return
        error_deg = np.abs(ticks.raw @ self._deg_per_raw)  # (n, axes)
        is_beyond = error_deg > self._bound_deg
        if not is_beyond.any():
            self._beyond_since_tick[:] = -1
            return
        tick = ticks.tick.astype(np.int64)
        is_flown = (numbers(ticks.raw, Channel.STATE) == State.CLOSED_LOOP) & (tick >= first_tick)
        is_beyond &= is_flown[:, None]
        for index, axis in enumerate(AXES):
            if axis in self.axes:
                self._update_axis(index, tick, error_deg[:, index], is_beyond[:, index])

    def take_end(self, ticks: Ticks, end_tick: int, piece: Piece, is_last: bool) -> None:
        """Compare the end of a piece of the route with what the plan demands there."""
        # The board limits the rate of its setpoints, and the error above is that from the limited setpoint. A
        # step that is too short for this rate ends far from its target without such an error.
        # `is_last`: Whether the route ends here. Then the arm must have arrived at the target of a step.
        # Otherwise the board's setpoint must be there, or the arm.
        tick = ticks.tick.astype(np.int64)
        row = min(int(np.searchsorted(tick, end_tick & 0xFFFFFFFF)), len(tick) - 1)
        raw = ticks.raw[row]
        # The rates of all other segments are checked before the flight.
        if self._unreached or piece.name != "step" or raw[Channel.STATE] != State.CLOSED_LOOP:
            return
        for index, axis in enumerate(AXES):
            # The loop of travel makes the setpoint of pitch.
            if axis not in self.axes or (axis == "pitch" and "travel" in self.axes):
                continue
            setpoint_deg = np.degrees(CHANNELS[_SETPOINTS[index]].scale) * raw[_SETPOINTS[index]]
            error_deg = float(self._deg_per_raw[:, index] @ raw)
            angle_deg = setpoint_deg + error_deg
            demanded_deg = float(piece.end_deg[index])
            distance_deg = abs(angle_deg - demanded_deg)
            if not is_last:
                distance_deg = min(distance_deg, abs(setpoint_deg - demanded_deg))
            if distance_deg > self._bound_deg[index]:
                self._unreached = (
                    f"{NOT_TRACKED}: {axis} was at {angle_deg:.1f} degrees when its {piece.name} to "
                    f"{demanded_deg:g} ended (allowed: {self._bound_deg[index]:g} from it); give the segment "
                    f"more time, because the board moves the setpoint by at most {axis}_slew_deg_s"
                )
                return

    def _update_axis(
        self,
        index: int,
        tick: NDArray[np.int64],
        error_deg: NDArray[np.float64],
        is_beyond: NDArray[np.bool_],
    ) -> None:
        """Update the time for which the error of axis `index` has been beyond its tolerance, and the longest
        such time with its largest error. `is_beyond` states it for each tick, (n,).
        """
        # Rows at which `is_beyond` changes; they divide the samples into stretches.
        edges = np.flatnonzero(np.diff(is_beyond)) + 1
        for first, stop in zip((0, *edges), (*edges, len(tick)), strict=True):
            if not is_beyond[first]:
                self._beyond_since_tick[index] = -1
                continue
            if self._beyond_since_tick[index] < 0:
                self._beyond_since_tick[index], self._peak_deg[index] = tick[first], 0.0
            self._peak_deg[index] = max(self._peak_deg[index], float(error_deg[first:stop].max()))
            duration_s = float(tick[stop - 1] - self._beyond_since_tick[index] + 1) * TICK_S
            if duration_s > self.longest_s[index]:
                self.longest_s[index], self.worst_deg[index] = duration_s, self._peak_deg[index]

    def verdict(self) -> str:
        """Return one line with the axis that was not tracked, its error and the fix; empty if all were."""
        for index, axis in enumerate(AXES):
            if self.longest_s[index] > self.tolerance.for_s:
                worst_deg, duration_s = self.worst_deg[index], self.longest_s[index]
                tolerance_text = f"{self._bound_deg[index]:g} for {self.tolerance.for_s:g} s"
                return (
                    f"{NOT_TRACKED}: {axis} was up to {worst_deg:.1f} degrees from its setpoint for "
                    f"{duration_s:.1f} s (allowed: {tolerance_text}); tune the gains for this rig, or widen "
                    "[tolerance] of the plan"
                )
        return self._unreached
