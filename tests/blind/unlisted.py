"""Things that a rig may have and that are on nobody's list: the right answer to them is `unexplained`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from heli_sim.rig import Rig

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
    """Size: mass in kg, taken from the counterweight, that swings on a thread where that is."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._thread_m = 9.81 / (2.0 * np.pi * rng.uniform(0.8, 1.4)) ** 2

    def hung(self, rig: Rig) -> str:
        damping = 0.05 * self.size * self._thread_m**2
        return f"""
        <body name="bob" pos="{-rig["L_b"].value} 0 {-rig["L_theta"].value}">
          <joint name="swing_across" axis="1 0 0" damping="{damping}"/>
          <joint name="swing_along" axis="0 1 0" damping="{damping}"/>
          <inertial pos="0 0 {-self._thread_m}" mass="{self.size}" diaginertia="1e-9 1e-9 1e-9"/>
        </body>"""

    def configure(self, model: Any) -> None:
        model.body_mass[model.body("counterweight").id] -= self.size


class BumpyPitch(Hidden):
    """The short arm prefers some angles: magnets, or a bearing with flats."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] -= self.size * np.sin(18.0 * at.angles_rad[1])


class WanderingThrust(Hidden):
    """The front rotor's thrust wanders slowly, as with brushes that burn.

    With both rotors alike it would be a random torque about elevation by another name.
    """

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._gain = 0.0

    def thrust(self, at: Moment) -> None:
        keep = np.exp(-STEP_S / 4.0)
        self._gain = keep * self._gain + self.size * np.sqrt(1.0 - keep**2) * self.chance.standard_normal()
        at.thrust_N = at.thrust_N * np.array([1.0 + self._gain, 1.0])


class WakeOnTravel(Hidden):
    """The wake of a travelling rig: thrust depends on the speed of travel's square."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N * (1.0 + self.size * at.rates_rad_s[2] ** 2)


class HystereticThrust(Hidden):
    """Size: play in V between the voltage and the thrust, which follows it up and down on two curves."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._follows_V = np.zeros(2)

    def volts(self, at: Moment) -> None:
        half_V = self.size / 2.0
        self._follows_V = np.clip(self._follows_V, at.volts_V - half_V, at.volts_V + half_V)
        at.volts_V = np.where(at.volts_V > 0.0, self._follows_V, 0.0)


class CrossCoupling(Hidden):
    """Each rotor drives air over the other: a share of one's thrust is added to the other's."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N + self.size * at.thrust_N[::-1]


class StickSlip(Hidden):
    """Size: torque in N m by which the travel bearing holds more at rest than in motion."""

    def during(self, at: Moment, model: Any) -> None:
        speed = at.rates_rad_s[2] / 0.05
        model.dof_frictionloss[model.joint("travel").dofadr[0]] = self.size * np.exp(-(speed**2))


OFF_LIST: dict[str, tuple[Callable[[float, np.random.Generator], Hidden], float]] = {
    "draught": (Draught, 0.06),
    "pitch_drag_quadratic": (PitchDragQuadratic, 0.06),
    "stiff_bearing": (StiffBearing, 0.08),
    "cable_twist": (CableTwist, 0.03),
    "slosh": (Slosh, 0.2),
    "bumpy_pitch": (BumpyPitch, 0.02),
    "wandering_thrust": (WanderingThrust, 0.04),
    "wake_on_travel": (WakeOnTravel, 0.4),
}

MORE_OFF_LIST: dict[str, tuple[Callable[[float, np.random.Generator], Hidden], float]] = {
    "hysteretic_thrust": (HystereticThrust, 0.3),
    "cross_coupling": (CrossCoupling, 0.2),
    "stick_slip": (StickSlip, 0.06),
}
"""More of them; a list of its own, so that the cases of the others keep their seeds."""


class TwiceAround(Hidden):
    """A post that is no circle: the elevation's cable pulls up and down twice a revolution."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._where_rad = rng.uniform(-0.4, 0.4)

    def torque(self, at: Moment) -> None:
        at.torque_Nm[0] += self.size * np.sin(2.0 * (at.angles_rad[2] - self._where_rad))


class PitchByElevation(Hidden):
    """A cable along the long arm turns the short one as the long one rises."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] += self.size * at.angles_rad[0]


class LiftByTravel(Hidden):
    """The arm is a wing: it lifts with the speed of travel, and sinks backwards."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[0] += self.size * at.rates_rad_s[2]


class TravelByElevation(Hidden):
    """A twisted arm: what rises goes around."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[2] += self.size * at.angles_rad[0]


class PitchByTravel(Hidden):
    """A cable from the ceiling turns the short arm by where the long one stands."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._where_rad = rng.uniform(-0.5, 0.5)

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] += self.size * np.sin(at.angles_rad[2] - self._where_rad)


class TravelByPitchRate(Hidden):
    """Short arm and post geared by a cable: a turn of the one drags the other."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[2] += self.size * at.rates_rad_s[1]


class SinkByPitch(Hidden):
    """Wakes that meet the post: lift is lost with the square of pitch."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[0] -= self.size * at.angles_rad[1] ** 2


class ThrustByPlace(Hidden):
    """A wall on one side of the room: thrust depends on where the arm is."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._where_rad = rng.uniform(-0.4, 0.4)

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N * (1.0 + self.size * np.sin(at.angles_rad[2] - self._where_rad))


DISTURBED: dict[str, tuple[Callable[[float, np.random.Generator], Hidden], float]] = {
    "elevation_by_twice_travel": (TwiceAround, 0.06),
    "pitch_by_elevation": (PitchByElevation, 0.1),
    "elevation_by_travel_rate": (LiftByTravel, 0.2),
    "travel_by_elevation": (TravelByElevation, 0.2),
    "pitch_by_travel": (PitchByTravel, 0.03),
    "travel_by_pitch_rate": (TravelByPitchRate, 0.12),
    "elevation_by_pitch_squared": (SinkByPitch, 2.0),
    "thrust_by_travel": (ThrustByPlace, 0.12),
    "draught": (Draught, 0.08),
    "stiff_bearing": (StiffBearing, 0.25),
    "bumpy_pitch": (BumpyPitch, 0.02),
    "wake_on_travel": (WakeOnTravel, 0.8),
    "hysteretic_thrust": (HystereticThrust, 0.2),
}
"""What is hidden in weather, at sizes for a draughty room.

Left out are what weather itself is (a thrust that wanders) and what has states of its own in MuJoCo (slosh).
"""
