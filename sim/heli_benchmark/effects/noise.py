"""Five kinds of disturbances that are not torques of constant strength."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from typing_extensions import override

from heli_benchmark.effects.disturbances import LONGEST_s, wander
from heli_benchmark.engine.plant import STEP_S, HiddenEffect, Moment

_GUSTS_Nm: Final = np.array([0.012, 0.004, 0.008])
"""Moderate gusts about elevation, pitch and travel."""
_BACKGROUND: Final = 0.4
"""Strength of the ordinary gusts under noise of another kind, as a share of moderate ones."""
_MEMORY_s: Final = 0.5
_STEPS: Final = round(LONGEST_s / STEP_S)


class _Torques(HiddenEffect):
    """Torques about the three axes over the flight, in N m, (steps, 3)."""

    def __init__(self, torque_Nm: Floats) -> None:
        super().__init__(1.0, np.random.default_rng(0))
        self._torque_Nm = torque_Nm

    @override
    def torque(self, at: Moment) -> None:
        at.torque_Nm += self._torque_Nm[round(at.flight_s / STEP_S)]


class _ThrustTorques(_Torques):
    """The torques are proportional to the sum of both thrusts; given are those at 4 N."""

    @override
    def torque(self, at: Moment) -> None:
        at.torque_Nm += self._torque_Nm[round(at.flight_s / STEP_S)] * abs(float(at.thrust_N.sum())) / 4.0


class _Supply(HiddenEffect):
    """The voltage of both motors varies by a `share` over the flight, (steps,)."""

    def __init__(self, share: Floats) -> None:
        super().__init__(1.0, np.random.default_rng(0))
        self._share = share

    @override
    def volts(self, at: Moment) -> None:
        at.volts_V = at.volts_V * (1.0 + self._share[round(at.flight_s / STEP_S)])


def _gusts_Nm(memory_s: float, chance: np.random.Generator) -> Floats:
    torque_Nm: Floats = wander(memory_s, _STEPS, chance) * _GUSTS_Nm
    return torque_Nm


def _bursts(chance: np.random.Generator) -> list[HiddenEffect]:
    """Gusts of 2.5 times the moderate strength for 1 to 4 s, with weak gusts for 4 to 12 s between."""
    strength = np.full(_STEPS, _BACKGROUND)
    at_s = float(chance.uniform(2.0, 8.0))
    while at_s < LONGEST_s:
        end_s = at_s + float(chance.uniform(1.0, 4.0))
        strength[round(at_s / STEP_S) : round(end_s / STEP_S)] = 2.5
        at_s = end_s + float(chance.uniform(4.0, 12.0))
    return [_Torques(strength[:, None] * _gusts_Nm(_MEMORY_s, chance))]


def _kicks(chance: np.random.Generator) -> list[HiddenEffect]:
    """Torques of 50 ms about a random axis every 3 s on average, next to weak gusts."""
    torque_Nm = _BACKGROUND * _gusts_Nm(_MEMORY_s, chance)
    for at_s in np.cumsum(chance.exponential(3.0, 200)):
        axis, size = int(chance.integers(3)), float(chance.uniform(3.0, 12.0) * chance.choice([-1.0, 1.0]))
        first = round(float(at_s) / STEP_S)
        torque_Nm[first : first + round(0.05 / STEP_S), axis] += size * _GUSTS_Nm[axis]
    return [_Torques(torque_Nm)]


def _thrust_torques(chance: np.random.Generator) -> list[HiddenEffect]:
    """Moderate gusts that are proportional to the thrust."""
    return [_ThrustTorques(_gusts_Nm(_MEMORY_s, chance))]


def _two_scales(chance: np.random.Generator) -> list[HiddenEffect]:
    """Gusts with correlation times of 0.1 s and 2.5 s."""
    return [_Torques(0.8 * (_gusts_Nm(0.1, chance) + _gusts_Nm(2.5, chance)))]


def _wandering_supply(chance: np.random.Generator) -> list[HiddenEffect]:
    """The supply varies by 2 to 4 % with a correlation time of 1 to 4 s, next to weak gusts."""
    size, memory_s = float(chance.uniform(0.02, 0.04)), float(chance.uniform(1.0, 4.0))
    weak = _Torques(_BACKGROUND * _gusts_Nm(_MEMORY_s, chance))
    return [_Supply(size * wander(memory_s, _STEPS, chance)[:, 0]), weak]


NOISE: Final[dict[str, Callable[[np.random.Generator], list[HiddenEffect]]]] = {
    "bursts": _bursts,
    "kicks": _kicks,
    "thrust": _thrust_torques,
    "two-scales": _two_scales,
    "supply": _wandering_supply,
}
"""Hidden effects of a flight with each kind of noise."""
