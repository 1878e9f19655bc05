"""Effects and equations that the catalogue does not list: the right verdict is `unexplained`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from heli_sim.rig import Rig

from heli_benchmark.effects.listed import Maker, PitchDrag
from heli_benchmark.plant import STEP_S, HiddenEffect, Moment


class Draught(HiddenEffect):
    """A jet of air pushes the arm in a sector of the room; `size` is the torque in N m."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._jet_rad = rng.uniform(-0.3, 0.3)

    def torque(self, at: Moment) -> None:
        # The jet has the shape of a normal distribution with a standard deviation of 0.12 rad.
        distance_std = (at.angles_rad[2] - self._jet_rad) / 0.12
        at.torque_Nm[2] += self.size * np.exp(-0.5 * distance_std**2)


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
    """The thrust of the front rotor varies slowly, as with worn brushes; `size` is its relative deviation."""

    # If both rotors varied alike, it would be a random torque about elevation.

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


class UnlistedEffect(NamedTuple):
    """How to hide an effect that the catalogue does not list, and its size."""

    maker: Maker
    size: float


OFF_LIST: dict[str, UnlistedEffect] = {
    "draught": UnlistedEffect(Draught, 0.06),
    "pitch_drag_quadratic": UnlistedEffect(PitchDrag, 0.06),
    "stiff_bearing": UnlistedEffect(StiffBearing, 0.08),
    "cable_twist": UnlistedEffect(CableTwist, 0.03),
    "slosh": UnlistedEffect(Slosh, 0.2),
    "bumpy_pitch": UnlistedEffect(BumpyPitch, 0.02),
    "wandering_thrust": UnlistedEffect(WanderingThrust, 0.04),
    "wake_on_travel": UnlistedEffect(WakeOnTravel, 0.4),
}
"""Factory and size of each unlisted effect in cases without disturbances."""

MORE_OFF_LIST: dict[str, UnlistedEffect] = {
    "hysteretic_thrust": UnlistedEffect(HystereticThrust, 0.3),
    "cross_coupling": UnlistedEffect(CrossCoupling, 0.2),
    "stick_slip": UnlistedEffect(StickSlip, 0.06),
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


DISTURBED: dict[str, UnlistedEffect] = {
    "elevation_by_twice_travel": UnlistedEffect(TwiceAround, 0.06),
    "pitch_by_elevation": UnlistedEffect(PitchByElevation, 0.1),
    "elevation_by_travel_rate": UnlistedEffect(LiftByTravel, 0.2),
    "travel_by_elevation": UnlistedEffect(TravelByElevation, 0.2),
    "pitch_by_travel": UnlistedEffect(PitchByTravel, 0.03),
    "travel_by_pitch_rate": UnlistedEffect(TravelByPitchRate, 0.12),
    "elevation_by_pitch_squared": UnlistedEffect(SinkByPitch, 2.0),
    "thrust_by_travel": UnlistedEffect(ThrustByPlace, 0.12),
    "draught": UnlistedEffect(Draught, 0.08),
    "stiff_bearing": UnlistedEffect(StiffBearing, 0.25),
    "bumpy_pitch": UnlistedEffect(BumpyPitch, 0.02),
    "wake_on_travel": UnlistedEffect(WakeOnTravel, 0.8),
    "hysteretic_thrust": UnlistedEffect(HystereticThrust, 0.2),
}
"""Factory and size, for moderate disturbances, of the effects in disturbed cases.

A wandering thrust is missing, because it is a disturbance; slosh is missing, because it adds states
to MuJoCo.
"""


EquationNumbers = Mapping[str, float]


@dataclass(frozen=True)
class EquationInputs:
    """Arguments of an equation, numbers or symbols."""

    q: Any  # q, w: Angles and rates of elevation, pitch and travel
    w: Any
    thrust_N: Any  # Thrusts, front and back, before the equation acts
    late: Any = 0.0  # Output of the first-order lag; 0 for an equation without memory


@dataclass(frozen=True)
class TrueEquation:
    """An equation of a torque or of a relative change of thrust."""

    channel: str
    """``torque.AXIS`` in N m, or ``thrust.both``, ``thrust.front``, ``thrust.back`` as a share of itself."""
    value: Callable[[Any, EquationInputs, EquationNumbers], Any]
    """Its value for a size of 1, from the module of functions (numpy or casadi), `EquationInputs` and its
    numbers."""
    size: float  # Typical size under moderate disturbances
    numbers: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Bounds of its other numbers, which are drawn uniformly."""
    remembers: Callable[[EquationInputs], Any] | None = None
    """Input of the first-order lag, from `EquationInputs`; its time constant is the number ``lag_s``."""


_ANY: Final = {"at": (-0.4, 0.4)}

EQUATIONS: Final[Mapping[str, TrueEquation]] = {
    # A cable that pulls elevation up and down twice a revolution.
    "elevation_by_twice_travel": TrueEquation(
        "torque.elevation", lambda m, s, n: m.sin(2.0 * (s.q[2] - n["at"])), 0.06, _ANY
    ),
    # A cable along the long arm turns the short one.
    "pitch_by_elevation": TrueEquation("torque.pitch", lambda _m, s, _n: s.q[0], 0.1),
    # The arm is a wing.
    "elevation_by_travel_rate": TrueEquation("torque.elevation", lambda _m, s, _n: s.w[2], 0.2),
    "elevation_by_travel_rate_squared": TrueEquation(
        "torque.elevation", lambda m, s, _n: s.w[2] * m.fabs(s.w[2]), 0.4
    ),
    # A twisted arm.
    "travel_by_elevation": TrueEquation("torque.travel", lambda _m, s, _n: s.q[0], 0.2),
    # A cable from the ceiling.
    "pitch_by_travel": TrueEquation("torque.pitch", lambda m, s, n: m.sin(s.q[2] - n["at"]), 0.03, _ANY),
    # Short arm and post geared by a cable.
    "travel_by_pitch_rate": TrueEquation("torque.travel", lambda _m, s, _n: s.w[1], 0.12),
    "pitch_by_travel_rate": TrueEquation("torque.pitch", lambda _m, s, _n: s.w[2], 0.04),
    # Wakes that meet the post.
    "elevation_by_pitch_squared": TrueEquation("torque.elevation", lambda _m, s, _n: -(s.q[1] ** 2), 2.0),
    # A jet of air across a sector of the room.
    "draught": TrueEquation(
        "torque.travel", lambda m, s, n: m.exp(-0.5 * ((s.q[2] - n["at"]) / 0.12) ** 2), 0.08, _ANY
    ),
    # A bearing that runs stiffer the higher the arm is, and free far below.
    "stiff_bearing": TrueEquation(
        "torque.travel", lambda m, s, _n: -m.fmax(0.0, 1.0 + s.q[0] / 0.2) * s.w[2], 0.25
    ),
    # Magnets in the pitch bearing.
    "bumpy_pitch": TrueEquation("torque.pitch", lambda m, s, _n: -m.sin(18.0 * s.q[1]), 0.02),
    "bumpy_travel": TrueEquation(
        "torque.travel", lambda m, s, n: m.sin(7.0 * (s.q[2] - n["at"])), 0.05, _ANY
    ),
    # Rubber stops beyond an angle on either side.
    "travel_stops": TrueEquation(
        "torque.travel", lambda m, s, _n: -m.fmax(s.q[2] - 0.5, 0.0) + m.fmax(-0.5 - s.q[2], 0.0), 0.6
    ),
    # A spring that stiffens.
    "stiffening_pitch": TrueEquation("torque.pitch", lambda _m, s, _n: -(s.q[1] ** 3), 1.5),
    # Geometry of a cable that runs over two axes.
    "pitch_spring_by_elevation": TrueEquation("torque.pitch", lambda _m, s, _n: -s.q[0] * s.q[1], 0.6),
    "travel_by_pitch_and_elevation": TrueEquation("torque.travel", lambda _m, s, _n: s.q[0] * s.q[1], 1.0),
    # Frictions that depend on another axis.
    "elevation_damping_by_pitch": TrueEquation(
        "torque.elevation", lambda m, s, _n: -m.fabs(s.q[1]) * s.w[0], 2.0
    ),
    "travel_damping_by_pitch_rate": TrueEquation(
        "torque.travel", lambda m, s, _n: -m.fabs(s.w[1]) * s.w[2], 0.8
    ),
    "pitch_by_place_and_rate": TrueEquation("torque.pitch", lambda _m, s, _n: s.q[2] * s.w[2], 0.06),
    "pitch_damping_by_thrust": TrueEquation(
        "torque.pitch", lambda _m, s, _n: -(s.thrust_N[0] + s.thrust_N[1]) * s.w[1], 0.03
    ),
    # The downwash comes back from walls.
    "travel_by_thrust_and_place": TrueEquation(
        "torque.travel", lambda m, s, _n: (s.thrust_N[0] + s.thrust_N[1]) * m.sin(2.0 * s.q[2]), 0.02
    ),
    # A cable that creeps after the arm.
    "elevation_by_late_travel_rate": TrueEquation(
        "torque.elevation", lambda _m, s, _n: s.late, 0.3, {"lag_s": (0.4, 0.7)}, lambda s: s.w[2]
    ),
    "pitch_by_late_elevation": TrueEquation(
        "torque.pitch", lambda _m, s, _n: s.late, 0.12, {"lag_s": (0.3, 0.6)}, lambda s: s.q[0]
    ),
    # Air that the rotors meet.
    "thrust_by_travel": TrueEquation("thrust.both", lambda m, s, n: m.sin(s.q[2] - n["at"]), 0.12, _ANY),
    "wake_on_travel": TrueEquation("thrust.both", lambda _m, s, _n: s.w[2] ** 2, 0.8),
    "front_by_pitch": TrueEquation("thrust.front", lambda _m, s, _n: s.q[1], 0.25),
    "back_by_travel_rate": TrueEquation("thrust.back", lambda _m, s, _n: s.w[2], 0.25),
}
"""Equations by name."""


class Unlisted(HiddenEffect):
    """An equation as a hidden effect."""

    def __init__(self, equation: str, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self.equation = EQUATIONS[equation]
        self.numbers = {name: float(rng.uniform(*span)) for name, span in self.equation.numbers.items()}
        self.truth = {"size": size, **self.numbers}
        self._late = 0.0

    def _value_at(self, at: Moment) -> float:
        """Return the value of the equation at a moment: a torque in N m, or a share of thrust."""
        inputs = EquationInputs(at.angles_rad, at.rates_rad_s, at.thrust_N)
        if self.equation.remembers is not None:
            keep = np.exp(-STEP_S / self.numbers["lag_s"])
            self._late = keep * self._late + (1.0 - keep) * float(self.equation.remembers(inputs))
            inputs = EquationInputs(inputs.q, inputs.w, inputs.thrust_N, self._late)
        return self.size * float(self.equation.value(np, inputs, self.numbers))

    def torque(self, at: Moment) -> None:
        kind, _, target = self.equation.channel.partition(".")
        if kind == "torque":
            at.torque_Nm[("elevation", "pitch", "travel").index(target)] += self._value_at(at)

    def thrust(self, at: Moment) -> None:
        kind, _, target = self.equation.channel.partition(".")
        if kind == "thrust":
            shares = {"both": (1.0, 1.0), "front": (1.0, 0.0), "back": (0.0, 1.0)}[target]
            at.thrust_N = at.thrust_N * (1.0 + self._value_at(at) * np.array(shares))


@dataclass(frozen=True)
class MakeUnlisted:
    """Factory of an `equation` by name. Unlike a lambda it can be pickled."""

    equation: str

    def __call__(self, size: float, rng: np.random.Generator) -> Unlisted:
        return Unlisted(self.equation, size, rng)
