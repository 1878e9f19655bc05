"""Compares the angles at rest on the table before the take-off with those after the landing.

The arm rests on the same table before and after a flight, so that an encoder that lost counts in between
shows another angle. Travel turns freely: its angle at rest proves nothing. While an arm moves by itself
without voltage, because it floats or swings, its angles prove nothing either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from heli_host.board.samples import Sample, Samples
from heli_host.data.arrays import Floats
from heli_host.declaration import Channel, State
from heli_host.link.telemetry import Ticks

ANGLE_SHIFTED: Final = "angle_shifted"
"""Beginning of the outcome of a flight after which an axis shows another angle at rest than before."""
MAX_SHIFT_DEG: Final = 1.0
"""Largest difference of an angle at rest [deg]. Healthy flights with each effect of the catalogue at its
typical size differ by at most 0.9 degrees (`python -m tests.fly.rest_angles`). A lower bound would accuse
them. With a higher one, an encoder could shift all angles of a flight."""
_FIRST_LOOK_TICKS: Final = 200
_SETTLED_TICKS: Final = 2000
"""Stretch in which an angle must stay to be settled; more than half a swing of the short arm."""
_SETTLED_DEG: Final = 0.5
_LONGEST_TICKS: Final = 15000
_TURNED_SHARE: Final = 0.25
"""Share of the shift by which a free short arm turns at least after the motors are off."""
_HOVER_TICKS: Final = (4000, 5500)
"""Ticks after the beginning of the flight between which the tilt of the hover is measured. Earlier, the loop
of travel has not found it; later, more encoders have failed already."""
_HOVER_DEG: Final = 2.0
"""Largest tilt of a landing beyond that of the hover that the same torque explains [deg]. Lower: a rig with
dry friction is accused. Higher: an encoder that is shifted by less passes."""
_IN_THE_AIR: Final = (State.CLOSED_LOOP, State.STREAMED, State.OPEN_LOOP)
_STILL_COUNTS: Final = 1.5
"""Largest change of a still angle. Less: an encoder between two counts seems to move."""


class HoverTilt:
    """Mean pitch of a hover some seconds after the take-off began."""

    # A constant torque about travel, such as that of a cable, makes the arm hover with a tilt. Called in the
    # session's reading thread.

    def __init__(self, count_deg: float) -> None:
        self.mean_deg = math.nan
        self._count_deg = count_deg
        self._start_tick: int | None = None
        self._counts: list[NDArray[np.int32]] = []

    def take(self, ticks: Ticks) -> None:
        """Process new samples."""
        if not math.isnan(self.mean_deg) or not len(ticks):
            return
        newest_tick = int(ticks.tick[-1])
        if self._start_tick is None:
            if ticks.raw[-1, Channel.STATE] in _IN_THE_AIR:
                self._start_tick = newest_tick
            return
        flown_ticks = (newest_tick - self._start_tick) & 0xFFFFFFFF
        if flown_ticks >= _HOVER_TICKS[0]:
            self._counts.append(ticks.raw[:, Channel.PITCH_COUNT])
        if flown_ticks >= _HOVER_TICKS[1]:
            self.mean_deg = float(np.concatenate(self._counts).mean()) * self._count_deg
            self._counts.clear()


@dataclass(frozen=True)
class RestAngles:
    """Angles at rest before a take-off."""

    elevation_deg: float  # Elevation [deg]
    pitch_deg: float  # Pitch [deg]; nan if the short arm was moving
    pitch_count_deg: float  # Angle of a count of the pitch encoder [deg]
    hover: HoverTilt  # Tilt of the hover after the take-off

    @classmethod
    def of(cls, newest: Sample, samples: Samples, pitch_count_deg: float) -> Self:
        """Read the angles from the last samples before the motors are armed."""
        # `samples`: About two seconds; fewer right after the connection, if pitch does not change.
        span_deg = float(np.ptp(np.degrees(samples.pitch_rad))) if len(samples) else 0.0
        is_still = span_deg <= _STILL_COUNTS * pitch_count_deg
        pitch_deg = newest.pitch_deg if is_still else math.nan
        return cls(newest.elevation_deg, pitch_deg, pitch_count_deg, HoverTilt(pitch_count_deg))

    def shift_after(self, samples: Samples) -> str | None:
        """Compare with the angles in the samples since the landing; return a text about a shift, empty if
        there is none, None while the arm has not settled.
        """
        if len(samples) < _FIRST_LOOK_TICKS:
            return None
        pitch_deg = self._settled_pitch_deg(np.degrees(samples.pitch_rad))
        elevation_deg = self._settled_elevation_deg(np.degrees(samples.elevation_rad))
        if pitch_deg is None or elevation_deg is None:
            return None
        if self._is_held(float(np.degrees(samples.pitch_rad[0])), pitch_deg):
            pitch_deg = self.pitch_deg  # friction explains the tilt, so that it does not count as a shift
        before_and_after_deg = {
            "elevation": (self.elevation_deg, elevation_deg),
            "pitch": (self.pitch_deg, pitch_deg),  # nan if pitch was not known before: no shift
        }
        shift_texts = {
            axis: f"{axis} at rest was {before_deg:.1f} degrees before the take-off and is {after_deg:.1f} "
            f"after the landing, a difference of {after_deg - before_deg:.1f}"
            for axis, (before_deg, after_deg) in before_and_after_deg.items()
            if abs(after_deg - before_deg) > MAX_SHIFT_DEG
        }
        if not shift_texts:
            return ""
        return (
            f"{ANGLE_SHIFTED}: {', '.join(shift_texts.values())} (allowed: {MAX_SHIFT_DEG:g}); do not use "
            f"the angles of this flight: check plug and cable of the {' and '.join(shift_texts)} encoder, "
            "let the arm rest, then zero it"
        )

    def _is_held(self, landed_deg: float, rest_deg: float) -> bool:
        """Whether dry friction may hold the short arm at rest in the tilt of the hover."""
        # A free arm turns from the tilt of the landing to its rest. One that stays may be held by friction,
        # or its encoder is shifted; then its tilt is beyond that of the hover after the take-off.
        stayed = abs(rest_deg - landed_deg) < _TURNED_SHARE * abs(rest_deg - self.pitch_deg)
        least_deg, most_deg = sorted((0.0, self.hover.mean_deg))
        return stayed and least_deg - _HOVER_DEG <= landed_deg <= most_deg + _HOVER_DEG

    def _settled_elevation_deg(self, elevation_deg: Floats) -> float | None:
        """Return elevation on the table [deg]; None while it may change."""
        # A touchdown takes the arm for landed up to 1.5 degrees above its rest, and the arm may then sink, or
        # float up without voltage.
        first_deg = elevation_deg[:_FIRST_LOOK_TICKS]
        nearest_deg = float(first_deg[np.argmin(np.abs(first_deg - self.elevation_deg))])
        if nearest_deg - self.elevation_deg <= MAX_SHIFT_DEG:
            return nearest_deg
        if len(elevation_deg) < _SETTLED_TICKS:
            return None
        # An arm that has moved by itself was not on the table.
        is_settled = np.ptp(elevation_deg[:_SETTLED_TICKS]) <= _SETTLED_DEG
        return nearest_deg if is_settled else self.elevation_deg

    def _settled_pitch_deg(self, pitch_deg: Floats) -> float | None:
        """Return pitch at rest [deg]; None while the short arm swings or drifts."""
        if math.isnan(self.pitch_deg):
            return self.pitch_deg
        first_look_deg = pitch_deg[-_FIRST_LOOK_TICKS:]
        if self._is_near(first_look_deg) and self._is_still(first_look_deg):
            return float(first_look_deg[-1])
        if len(pitch_deg) < _SETTLED_TICKS:
            return None
        # The longer look also notices a short arm that returns slowly, by less than 0.1 degrees per second.
        long_look_deg = pitch_deg[-_SETTLED_TICKS:]
        if self._is_near(long_look_deg) or self._is_still(long_look_deg):
            return float(np.mean(long_look_deg))
        if len(pitch_deg) < _LONGEST_TICKS:
            return None
        # The arm still swings. Its middle counts as rest only if the whole swing is too far from the earlier
        # rest.
        swing_deg = pitch_deg[-2 * _SETTLED_TICKS :]
        middle_deg, amplitude_deg = float(np.mean(swing_deg)), 0.5 * float(np.ptp(swing_deg))
        is_shifted = abs(middle_deg - self.pitch_deg) > amplitude_deg + MAX_SHIFT_DEG
        return middle_deg if is_shifted else self.pitch_deg

    def _is_still(self, pitch_deg: Floats) -> bool:
        """Return whether pitch changes by no more than the noise of its encoder."""
        return bool(np.ptp(pitch_deg) <= _STILL_COUNTS * self.pitch_count_deg)

    def _is_near(self, pitch_deg: Floats) -> bool:
        return bool(np.max(np.abs(pitch_deg - self.pitch_deg)) <= MAX_SHIFT_DEG)
