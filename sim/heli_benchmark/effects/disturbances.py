"""Disturbances: random torques about all axes, and five kinds that are not torques of constant strength."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from typing_extensions import override

from heli_benchmark.plant import STEP_S, HiddenEffect, Moment

STRENGTHS_Nm = ((0.006, 0.002, 0.004), (0.012, 0.004, 0.008), (0.02, 0.006, 0.012))
"""Standard deviations about elevation, pitch and travel: weak, moderate, strong."""
CORRELATION_TIMES_s = (0.3, 0.6, 1.2)
"""Correlation times of the gusts; on measured flights they are 0.1 to 1.2 s."""
LONGEST_s = 130.0


@dataclass(frozen=True)
class DisturbanceModel:
    """Size and correlation of random torques."""

    gusts_Nm: tuple[float, float, float]  # Standard deviations of the gusts about elevation, pitch and travel
    correlation_time_s: float  # Correlation time of the gusts
    slow_std_Nm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Standard deviations of an additional slow drift; zeros without one."""
    drift_s: float = 30.0  # Correlation time of the drift


class DisturbanceTorques(HiddenEffect):
    """Independent Ornstein-Uhlenbeck torques about the three axes; they are no cause to be named."""

    def __init__(self, disturbances: DisturbanceModel, rng: np.random.Generator) -> None:
        super().__init__(1.0, rng)
        steps = round(LONGEST_s / STEP_S)
        gusts = wander(disturbances.correlation_time_s, steps, rng) * disturbances.gusts_Nm
        drift = wander(disturbances.drift_s, steps, rng) * disturbances.slow_std_Nm
        self._torque_Nm = gusts + drift

    def torque(self, at: Moment) -> None:
        at.torque_Nm += self._torque_Nm[round(at.flight_s / STEP_S)]


def wander(correlation_time_s: float, steps: int, rng: np.random.Generator) -> Floats:
    """Draw three stationary Ornstein-Uhlenbeck processes of unit variance, shape (`steps`, 3), by `rng`."""
    from scipy.signal import lfilter

    decay = np.exp(-STEP_S / correlation_time_s)
    innovations = np.sqrt(1.0 - decay**2) * rng.standard_normal((steps, 3))
    innovations[0] = rng.standard_normal(3)
    return np.asarray(lfilter([1.0], [1.0, -decay], innovations, axis=0))


_GUSTS_Nm: Final = np.array([0.012, 0.004, 0.008])
"""Moderate gusts about elevation, pitch and travel."""
_BACKGROUND: Final = 0.4
"""Strength of the weak gusts that accompany other noise, as a share of moderate gusts."""
_CORRELATION_TIME_s: Final = 0.5
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
    """Torques that are proportional to the sum of both thrusts; the given ones act at 4 N."""

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


def _gusts_Nm(correlation_time_s: float, rng: np.random.Generator) -> Floats:
    """Draw moderate gusts about the three axes over the longest flight, shape (steps, 3)."""
    torque_Nm: Floats = wander(correlation_time_s, _STEPS, rng) * _GUSTS_Nm
    return torque_Nm


def _bursts(rng: np.random.Generator) -> list[HiddenEffect]:
    """Bursts of 1 to 4 s with 2.5 times the moderate strength; for 4 to 12 s between them, weak gusts."""
    strength = np.full(_STEPS, _BACKGROUND)
    start_s = float(rng.uniform(2.0, 8.0))
    while start_s < LONGEST_s:
        end_s = start_s + float(rng.uniform(1.0, 4.0))
        strength[round(start_s / STEP_S) : round(end_s / STEP_S)] = 2.5
        start_s = end_s + float(rng.uniform(4.0, 12.0))
    return [_Torques(strength[:, None] * _gusts_Nm(_CORRELATION_TIME_s, rng))]


def _gusts_and_kicks(rng: np.random.Generator) -> list[HiddenEffect]:
    """Weak gusts, and a torque pulse of 50 ms about a random axis every 3 s on average."""
    torque_Nm = _BACKGROUND * _gusts_Nm(_CORRELATION_TIME_s, rng)
    for at_s in np.cumsum(rng.exponential(3.0, 200)):
        # A pulse is 3 to 12 times as strong as moderate gusts, to either side.
        axis, size = int(rng.integers(3)), float(rng.uniform(3.0, 12.0) * rng.choice([-1.0, 1.0]))
        first_step = round(float(at_s) / STEP_S)
        torque_Nm[first_step : first_step + round(0.05 / STEP_S), axis] += size * _GUSTS_Nm[axis]
    return [_Torques(torque_Nm)]


def _thrust_torques(rng: np.random.Generator) -> list[HiddenEffect]:
    """Moderate gusts that are proportional to the thrust."""
    return [_ThrustTorques(_gusts_Nm(_CORRELATION_TIME_s, rng))]


def _gusts_of_two_time_scales(rng: np.random.Generator) -> list[HiddenEffect]:
    """Gusts with correlation times of 0.1 s and 2.5 s."""
    return [_Torques(0.8 * (_gusts_Nm(0.1, rng) + _gusts_Nm(2.5, rng)))]


def _wandering_supply(rng: np.random.Generator) -> list[HiddenEffect]:
    """Weak gusts, and a supply that varies by 2 to 4 % with a correlation time of 1 to 4 s."""
    size, correlation_time_s = float(rng.uniform(0.02, 0.04)), float(rng.uniform(1.0, 4.0))
    weak = _Torques(_BACKGROUND * _gusts_Nm(_CORRELATION_TIME_s, rng))
    return [_Supply(size * wander(correlation_time_s, _STEPS, rng)[:, 0]), weak]


NOISE: Final[dict[str, Callable[[np.random.Generator], list[HiddenEffect]]]] = {
    "bursts": _bursts,
    "kicks": _gusts_and_kicks,
    "thrust": _thrust_torques,
    "two-scales": _gusts_of_two_time_scales,
    "supply": _wandering_supply,
}
"""Hidden effects of a flight with each kind of noise."""
