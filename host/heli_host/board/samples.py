"""Samples in units: one of them, many as arrays, and the ring that keeps the last minutes.

The declaration names the channels of a sample and their units: the table in docs/reference/link.md.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
import numpy.typing as npt

from heli_host.data.arrays import Floats
from heli_host.data.flight import AngleViews, shares
from heli_host.declaration import CHANNELS, Channel, ChannelArrays, ChannelValues, State
from heli_host.link.channels import is_whole, numbers, rad_per_count
from heli_host.link.clock import TICK_S
from heli_host.link.telemetry import CHANNEL_COUNT, Ticks


class Sample(ChannelValues):
    """Measurements and outputs of the board in one tick: a `ChannelValues`.

    Angles were read at the beginning of the tick, and are 0 at level; voltages acted during the tick.
    """

    @property
    def t_s(self) -> float:
        """Device time [s]."""
        return self.tick * TICK_S

    @property
    def elevation_deg(self) -> float:
        """Elevation [deg]."""
        return float(np.degrees(self.elevation_rad))

    @property
    def pitch_deg(self) -> float:
        """Pitch [deg]."""
        return float(np.degrees(self.pitch_rad))

    @property
    def travel_deg(self) -> float:
        """Travel [deg]."""
        return float(np.degrees(self.travel_rad))

    def __repr__(self) -> str:
        fault = f", fault {self.fault}" if self.fault else ""
        return (
            f"<Sample at {self.t_s:.3f} s: {self.state}{fault}, elevation {self.elevation_deg:.1f} deg, "
            f"pitch {self.pitch_deg:.1f} deg, travel {self.travel_deg:.1f} deg, "
            f"front {self.front_V:.2f} V, back {self.back_V:.2f} V>"
        )


class Samples(AngleViews, ChannelArrays):
    """Consecutive samples as arrays, one entry per tick: `ChannelArrays` with `AngleViews`."""

    @property
    def t_s(self) -> Floats:
        """Device time [s], shape (n,)."""
        return np.asarray(self.tick * TICK_S, np.float64)

    def __len__(self) -> int:
        return len(self.tick)

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return every channel by name, time first."""
        return {"t_s": self.t_s} | {field.name: getattr(self, field.name) for field in fields(self)}

    def __repr__(self) -> str:
        if not len(self):
            return "<Samples: none>"
        names = {int(state): str(state) for state in State}
        return (
            f"<Samples: {len(self)} ticks from {self.t_s[0]:.3f} to {self.t_s[-1]:.3f} s; "
            f"{shares(self.state, names)}>"
        )


class Scales:
    """Raw telemetry to units; counts become angles by the board's own parameters."""

    def __init__(self, params: Mapping[str, float]) -> None:
        rad: list[float] = rad_per_count(params).tolist()
        # Factors from raw numbers to the units of the columns; None if the raw number is the value.
        self._scale = [
            rad[spec.axis] if spec.axis is not None else None if is_whole(spec) else spec.scale
            for spec in CHANNELS
        ]

    def sample(self, tick: int, raw: npt.NDArray[np.int32]) -> Sample:
        """Convert one sample at a device `tick` from `raw`: int32, shape (channels,), in the declaration's
        order.
        """
        values: dict[str, Any] = {}
        for spec, number, scale in zip(CHANNELS, raw.tolist(), self._scale, strict=True):
            raw_number = number & 0xFFFFFFFF if spec.code.isupper() else number
            if scale is not None:
                values[spec.column] = raw_number * scale
            else:
                values[spec.column] = raw_number if spec.kind is None else spec.kind(raw_number)
        return Sample(tick, **values)

    def samples(self, tick: npt.NDArray[np.int64], raw: npt.NDArray[np.int32]) -> Samples:
        """Convert samples at device ticks `tick`, int64, shape (n,), from `raw`: int32, shape (n, channels),
        in the declaration's order.
        """
        columns: dict[str, npt.NDArray[Any]] = {}
        for channel, scale in zip(Channel, self._scale, strict=True):
            raw_number = numbers(raw, channel)
            columns[CHANNELS[channel].column] = (
                raw_number if scale is None else raw_number.astype(np.float64) * scale
            )
        return Samples(tick, **columns)


class SampleRing:
    """Keeps the newest samples of a session, `capacity` at most."""

    def __init__(self, capacity: int) -> None:
        self._tick = np.empty(capacity, np.uint32)
        self._raw = np.empty((capacity, CHANNEL_COUNT), np.int32)
        self._written = 0
        self._lock = threading.Lock()

    def clear(self) -> None:
        """Forget all samples, because the board and its time have restarted."""
        with self._lock:
            self._written = 0

    def append(self, ticks: Ticks) -> None:
        """Add new samples; of more `ticks` than fit, the newest stay."""
        capacity = len(self._tick)
        tick, raw = ticks.tick[-capacity:], ticks.raw[-capacity:]
        with self._lock:
            start = self._written % capacity
            room = capacity - start
            self._tick[start : start + len(tick)] = tick[:room]
            self._raw[start : start + len(raw)] = raw[:room]
            if len(tick) > room:
                self._tick[: len(tick) - room] = tick[room:]
                self._raw[: len(raw) - room] = raw[room:]
            self._written += len(tick)

    def newest(self, count: int | None = None) -> Ticks:
        """Return at most `count` newest samples, oldest first; None for all that are kept."""
        with self._lock:
            capacity = len(self._tick)
            available = min(self._written, capacity)
            count = available if count is None else min(max(count, 0), available)
            index = (self._written - count + np.arange(count)) % capacity
            return Ticks(self._tick[index], self._raw[index])
