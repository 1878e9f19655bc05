"""Equations that no list has. MuJoCo flies them, and a reference fit uses the same definition.

An equation is a function of the state of the rig. This file does not know the grammar of the discovery: some
equations are within it, others only near it, such as a stop, a one-sided friction or a jet of air.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from heli_benchmark.engine.plant import STEP_S, HiddenEffect, Moment

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
        "torque.travel",
        lambda m, s, _n: -m.fmax(s.q[2] - 0.5, 0.0) + m.fmax(-0.5 - s.q[2], 0.0),
        0.6,
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
