"""The shaping of setpoints against the same written a second time, in double precision and degrees."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from heli_host.declaration import PARAMS
from heli_test_native import flight

pytestmark = pytest.mark.medium

INDEX = {p.name: p.index for p in PARAMS}
DEFAULTS = {p.name: p.default for p in PARAMS}
TICK_S = 0.001
CLOSE_IN = 0.01


def bound(value: float, most: float) -> float:
    return max(-most, min(most, value))


@dataclass
class ReferenceAxis:
    """One axis; `change` is its acceleration a tick, infinite for pitch."""

    step_max: float
    change_max: float
    path: float = 0.0
    target: float = 0.0
    slope: float = 0.0
    ramp: int = 0
    angle: float = 0.0
    step: float = 0.0
    smooth: float = 0.0

    def aim(self, target: float, ahead: int) -> None:
        self.target, self.ramp = target, ahead
        self.slope = (target - self.path) / ahead if ahead else 0.0

    def advance(self) -> tuple[float, float, float]:
        self.ramp = max(0, self.ramp - 1)
        self.path, self.slope = (self.path + self.slope, self.slope) if self.ramp else (self.target, 0.0)
        way = self.path - self.angle
        if math.isinf(self.change_max):
            self.angle += bound(way, self.step_max)
            return self.angle, 0.0, 0.0
        near = self.change_max / CLOSE_IN**2
        speed = (
            way * CLOSE_IN
            if abs(way) <= near
            else math.copysign(math.sqrt(2 * self.change_max * (abs(way) - near / 2)), way)
        )
        wanted = bound(bound(self.slope, self.step_max) + speed, self.step_max)
        change = bound(wanted - self.step, self.change_max)
        self.step += change
        self.angle += self.step
        self.smooth += 0.01 * (change - self.smooth)
        return self.angle, self.step / TICK_S, self.smooth / TICK_S**2


def limit(deg: float) -> float:
    """A limit as the firmware keeps it: in 2^-36 rad a tick, so 8e-4 deg/s2 for an acceleration."""
    return math.degrees(round(math.radians(deg) * 2**36) / 2**36)


def fly_both(seed: int, ticks: int, **changes: float) -> np.ndarray:
    """Random targets through firmware and reference; (ticks, 2, axis, angle to acceleration), in degrees."""
    p = DEFAULTS | changes
    rng = np.random.default_rng(seed)
    shaper: Any = flight.Shaper([(INDEX[name], value) for name, value in p.items()])
    axes = [
        ReferenceAxis(limit(p[f"{axis}_slew_deg_s"] * TICK_S), change)
        for axis, change in (
            ("elevation", limit(p["elevation_acceleration_deg_s2"] * TICK_S**2)),
            ("pitch", math.inf),
            ("travel", limit(p["travel_acceleration_deg_s2"] * TICK_S**2)),
        )
    ]
    out = np.empty((ticks, 2, 3, 3))
    sizes_deg = np.array((15.0, 15.0, 120.0))
    for tick in range(ticks):
        if tick % 500 == 0:
            # A step, or the pieces of a smooth path.
            ahead = int(rng.choice([0, 20, 300]))
            targets_deg = rng.uniform(-1.0, 1.0, 3) * sizes_deg
            assert shaper.aim([float(x) for x in np.radians(targets_deg)], ahead)
            for axis, target in zip(axes, targets_deg.tolist(), strict=True):
                axis.aim(target, ahead)
        out[tick, 0] = np.degrees(shaper.advance())
        out[tick, 1] = [axis.advance() for axis in axes]
    return out


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"travel_acceleration_deg_s2": 1.0, "travel_slew_deg_s": 0.5, "elevation_acceleration_deg_s2": 1.0},
        {
            "travel_acceleration_deg_s2": 2000.0,
            "travel_slew_deg_s": 200.0,
            "elevation_acceleration_deg_s2": 2000.0,
        },
    ],
    ids=["default", "slowest", "fastest"],
)
@pytest.mark.parametrize("seed", range(3))
def test_shaping_agrees_with_the_equations(seed: int, changes: dict[str, float]) -> None:
    both = fly_both(seed, 8000, **changes)
    worst = np.abs(both[:, 0] - both[:, 1]).max(axis=(0, 1))
    # Near its path a setpoint is rounded to 2^-32 rad, and by the tick rate that is 1e-5 deg/s.
    assert worst[0] < 1e-4  # deg
    assert worst[1] < 1e-3  # deg/s
    assert worst[2] < 1e-2  # deg/s2
