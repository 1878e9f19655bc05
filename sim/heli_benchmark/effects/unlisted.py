"""Effects that the catalogue does not list: the right verdict is `unexplained`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from heli_sim.rig import Rig

from heli_benchmark.engine.plant import STEP_S, HiddenEffect, Moment


class Draught(HiddenEffect):
    """A jet of air pushes the arm in a sector of the room; `size` is the torque in N m."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._jet_rad = rng.uniform(-0.3, 0.3)

    def torque(self, at: Moment) -> None:
        # The jet has the shape of a normal distribution with a standard deviation of 0.12 rad.
        distance_std = (at.angles_rad[2] - self._jet_rad) / 0.12
        at.torque_Nm[2] += self.size * np.exp(-0.5 * distance_std**2)


class PitchDragQuadratic(HiddenEffect):
    """Air drag of the pitch axis; `size` is the torque in N m at 1 rad/s."""

    def torque(self, at: Moment) -> None:
        rate = at.rates_rad_s[1]
        at.torque_Nm[1] -= self.size * rate * abs(rate)


class StiffBearing(HiddenEffect):
    """Friction of travel increases with elevation; `size` is the friction in N m s of the level arm."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[2] -= self.size * max(0.0, 1.0 + at.angles_rad[0] / 0.2) * at.rates_rad_s[2]


class CableTwist(HiddenEffect):
    """A cable that twists with travel turns the short arm; `size` is the torque in N m at 1 rad/s."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] += self.size * at.rates_rad_s[2]


class Slosh(HiddenEffect):
    """A part of the counterweight, `size` in kg, swings on a thread."""

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


class BumpyPitch(HiddenEffect):
    """The short arm prefers some angles, as with magnets; `size` is the torque in N m."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] -= self.size * np.sin(18.0 * at.angles_rad[1])


class WanderingThrust(HiddenEffect):
    """The thrust of the front rotor varies slowly, as with worn brushes; `size` is its relative deviation.

    If both rotors varied alike, it would be a random torque about elevation.
    """

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._deviation = 0.0

    def thrust(self, at: Moment) -> None:
        # First-order Gauss-Markov process with a correlation time of 4 s.
        decay = np.exp(-STEP_S / 4.0)
        self._deviation = (
            decay * self._deviation + self.size * np.sqrt(1.0 - decay**2) * self.flight_rng.standard_normal()
        )
        at.thrust_N = at.thrust_N * np.array([1.0 + self._deviation, 1.0])


class WakeOnTravel(HiddenEffect):
    """Thrust grows with the square of the travel rate; `size` is the share at 1 rad/s."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N * (1.0 + self.size * at.rates_rad_s[2] ** 2)


class HystereticThrust(HiddenEffect):
    """Thrust has hysteresis; `size` is the width of the loop in V."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._loop_V = np.zeros(2)

    def volts(self, at: Moment) -> None:
        # Play operator: the output moves only when the input pushes it at an edge of the loop.
        half_V = self.size / 2.0
        self._loop_V = np.clip(self._loop_V, at.volts_V - half_V, at.volts_V + half_V)
        at.volts_V = np.where(at.volts_V > 0.0, self._loop_V, 0.0)


class CrossCoupling(HiddenEffect):
    """Each rotor blows over the other: a share `size` of the thrust of one is added to the other."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N + self.size * at.thrust_N[::-1]


class StickSlip(HiddenEffect):
    """The travel bearing holds more at rest than in motion; `size` is the difference in N m."""

    def during(self, at: Moment, model: Any) -> None:
        # Stribeck curve: the additional friction has vanished at twice 0.05 rad/s.
        relative_speed = at.rates_rad_s[2] / 0.05
        model.dof_frictionloss[model.joint("travel").dofadr[0]] = self.size * np.exp(-(relative_speed**2))


OFF_LIST: dict[str, tuple[Callable[[float, np.random.Generator], HiddenEffect], float]] = {
    "draught": (Draught, 0.06),
    "pitch_drag_quadratic": (PitchDragQuadratic, 0.06),
    "stiff_bearing": (StiffBearing, 0.08),
    "cable_twist": (CableTwist, 0.03),
    "slosh": (Slosh, 0.2),
    "bumpy_pitch": (BumpyPitch, 0.02),
    "wandering_thrust": (WanderingThrust, 0.04),
    "wake_on_travel": (WakeOnTravel, 0.4),
}
"""Factory and size of each unlisted effect in cases without disturbances."""

MORE_OFF_LIST: dict[str, tuple[Callable[[float, np.random.Generator], HiddenEffect], float]] = {
    "hysteretic_thrust": (HystereticThrust, 0.3),
    "cross_coupling": (CrossCoupling, 0.2),
    "stick_slip": (StickSlip, 0.06),
}
"""Further effects with their sizes. They are a separate list, so that earlier cases keep their seeds."""


class TwiceAround(HiddenEffect):
    """A cable pulls the arm up and down twice per revolution; `size` is the torque in N m."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._centre_rad = rng.uniform(-0.4, 0.4)

    def torque(self, at: Moment) -> None:
        at.torque_Nm[0] += self.size * np.sin(2.0 * (at.angles_rad[2] - self._centre_rad))


class PitchByElevation(HiddenEffect):
    """A cable along the long arm turns the short arm; `size` is the torque in N m per rad of elevation."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] += self.size * at.angles_rad[0]


class LiftByTravel(HiddenEffect):
    """The arm acts as a wing; `size` is the elevation torque in N m at a travel rate of 1 rad/s."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[0] += self.size * at.rates_rad_s[2]


class TravelByElevation(HiddenEffect):
    """A twisted arm; `size` is the travel torque in N m per rad of elevation."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[2] += self.size * at.angles_rad[0]


class PitchByTravel(HiddenEffect):
    """A cable from the ceiling turns the short arm with the sine of travel; `size` is the torque in N m."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._centre_rad = rng.uniform(-0.5, 0.5)

    def torque(self, at: Moment) -> None:
        at.torque_Nm[1] += self.size * np.sin(at.angles_rad[2] - self._centre_rad)


class TravelByPitchRate(HiddenEffect):
    """A cable couples short arm and post; `size` is the travel torque in N m at a pitch rate of 1 rad/s."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[2] += self.size * at.rates_rad_s[1]


class SinkByPitch(HiddenEffect):
    """Wakes meet the post: lift decreases with the square of pitch; `size` is the torque in N m at 1 rad."""

    def torque(self, at: Moment) -> None:
        at.torque_Nm[0] -= self.size * at.angles_rad[1] ** 2


class ThrustByPlace(HiddenEffect):
    """A wall on one side of the room: thrust varies with travel by a share `size`."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._centre_rad = rng.uniform(-0.4, 0.4)

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N * (1.0 + self.size * np.sin(at.angles_rad[2] - self._centre_rad))


DISTURBED: dict[str, tuple[Callable[[float, np.random.Generator], HiddenEffect], float]] = {
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
"""Factory and size, for moderate disturbances, of the effects in disturbed cases.

A wandering thrust is missing, because it is a disturbance; slosh is missing, because it adds states
to MuJoCo.
"""
