"""Things that a rig may have and that are on nobody's list: the right answer to them is `unexplained`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.blind.mujoco_rig import STEP_S, Hidden, Moment


class Draught(Hidden):
    """A jet of air across a sector of the room pushes the arm along."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._where_rad = rng.uniform(-0.3, 0.3)

    def torque(self, at: Moment) -> None:
        off = (at.angles_rad[2] - self._where_rad) / 0.12
        at.torque_Nm[2] += self.size * np.exp(-0.5 * off**2)


class PitchDragQuadratic(Hidden):
    def torque(self, at: Moment) -> None:
        rate = at.rates_rad_s[1]
        at.torque_Nm[1] -= self.size * rate * abs(rate)


class StiffBearing(Hidden):
    """The travel bearing runs stiffer the higher the arm is."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[2] -= self.size * max(0.0, 1.0 + at.angles_rad[0] / 0.2) * at.rates_rad_s[2]


class CableTwist(Hidden):
    """A cable that twists with travel's motion turns the short arm."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] += self.size * at.rates_rad_s[2]


class Slosh(Hidden):
    """A weight that swings on a thread below the long arm."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._swing_rad, self._rate_rad_s = 0.0, 0.0
        self._natural_rad_s = 2.0 * np.pi * rng.uniform(0.8, 1.4)

    def torque(self, at: Moment) -> None:
        drive = self._natural_rad_s**2 * (at.rates_rad_s[2] * 0.2 - self._swing_rad)
        self._rate_rad_s += STEP_S * (drive - 0.3 * self._rate_rad_s)
        self._swing_rad += STEP_S * self._rate_rad_s
        at.torque_Nm[2] += self.size * (self._swing_rad - at.rates_rad_s[2] * 0.2)


class BumpyPitch(Hidden):
    """The short arm prefers some angles: magnets, or a bearing with flats."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] -= self.size * np.sin(18.0 * at.angles_rad[1])


class WanderingThrust(Hidden):
    """The thrust of both rotors wanders slowly, as with a draughty supply of air."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._rng, self._gain = np.random.default_rng(rng.integers(1 << 30)), 0.0

    def thrust(self, at: Moment) -> None:
        keep = np.exp(-STEP_S / 4.0)
        self._gain = keep * self._gain + self.size * np.sqrt(1.0 - keep**2) * self._rng.standard_normal()
        at.thrust_N = at.thrust_N * (1.0 + self._gain)


class WakeOnTravel(Hidden):
    """The wake of a travelling rig: thrust depends on the speed of travel's square."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N * (1.0 + self.size * at.rates_rad_s[2] ** 2)


OFF_LIST: dict[str, tuple[Callable[[float, np.random.Generator], Hidden], float]] = {
    "draught": (Draught, 0.06),
    "pitch_drag_quadratic": (PitchDragQuadratic, 0.06),
    "stiff_bearing": (StiffBearing, 0.08),
    "cable_twist": (CableTwist, 0.03),
    "slosh": (Slosh, 1.0),
    "bumpy_pitch": (BumpyPitch, 0.02),
    "wandering_thrust": (WanderingThrust, 0.04),
    "wake_on_travel": (WakeOnTravel, 0.4),
}
