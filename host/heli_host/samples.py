"""Samples in units: one of them, many as arrays, and the ring that keeps the last minutes."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heli_host.link.clock import TICK_S
from heli_host.link.declaration import CHANNELS, Fault, Flags, State
from heli_host.link.telemetry import CHANNEL_COUNT, Ticks

Floats = npt.NDArray[np.float64]

_AXES = ("elevation", "pitch", "travel")
_CHANNEL = {channel.name: index for index, channel in enumerate(CHANNELS)}
_STATE, _FAULT, _FLAGS = _CHANNEL["state"], _CHANNEL["fault"], _CHANNEL["flags"]
_SCALE: Floats = np.array([channel.scale for channel in CHANNELS])  # (11,)


@dataclass(frozen=True)
class Sample:
    """What the board measured and did in one tick.

    Parameters
    ----------
    tick : int
        Device time [tick of 1 ms], counted on over 2^32.
    elevation_rad, pitch_rad, travel_rad : float
        Angles at the beginning of the tick [rad]; level is 0.
    elevation_setpoint_rad, pitch_setpoint_rad, travel_setpoint_rad : float
        Setpoints that the on-board control law used [rad].
    front_V, back_V : float
        Voltages that acted on the motors during the tick [V].
    state : State
        Supervisor state.
    fault : Fault
        Fault, or none.
    flags : Flags
        Flag bits.
    """

    tick: int
    elevation_rad: float
    pitch_rad: float
    travel_rad: float
    elevation_setpoint_rad: float
    pitch_setpoint_rad: float
    travel_setpoint_rad: float
    front_V: float
    back_V: float
    state: State
    fault: Fault
    flags: Flags

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


@dataclass(frozen=True)
class Samples:
    """Consecutive samples as arrays, one entry a tick; a gap in ``tick`` is a loss.

    Parameters
    ----------
    tick : ndarray of int64, shape (n,)
        Device time [tick of 1 ms], counted on over 2^32.
    t_s : ndarray, shape (n,)
        Device time [s].
    elevation_rad, pitch_rad, travel_rad : ndarray, shape (n,)
        Angles [rad].
    elevation_setpoint_rad, pitch_setpoint_rad, travel_setpoint_rad : ndarray, shape (n,)
        Setpoints that the on-board control law used [rad].
    front_V, back_V : ndarray, shape (n,)
        Voltages that acted on the motors [V].
    state, fault, flags : ndarray of uint8, shape (n,)
        Supervisor state, fault code and flag bits.
    """

    tick: npt.NDArray[np.int64]
    t_s: Floats
    elevation_rad: Floats
    pitch_rad: Floats
    travel_rad: Floats
    elevation_setpoint_rad: Floats
    pitch_setpoint_rad: Floats
    travel_setpoint_rad: Floats
    front_V: Floats
    back_V: Floats
    state: npt.NDArray[np.uint8]
    fault: npt.NDArray[np.uint8]
    flags: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.tick)


class Scales:
    """Raw telemetry to units; counts become angles by the board's own parameters.

    Parameters
    ----------
    params : Mapping of str to float
        The board's parameters, of which ``*_counts_per_rev`` are used.
    """

    def __init__(self, params: Mapping[str, float]) -> None:
        self._scale = _SCALE.copy()
        for axis in _AXES:
            self._scale[_CHANNEL[f"{axis}_count"]] = 2.0 * np.pi / abs(params[f"{axis}_counts_per_rev"])

    def sample(self, tick: int, raw: npt.NDArray[np.int32]) -> Sample:
        """Convert one sample.

        Parameters
        ----------
        tick : int
            Device time [tick].
        raw : ndarray of int32, shape (11,)
            Channels in the declaration's order.

        Returns
        -------
        Sample
            The same in units.
        """
        value = dict(zip(_CHANNEL, (raw * self._scale).tolist(), strict=True))
        return Sample(
            tick,
            value["elevation_count"],
            value["pitch_count"],
            value["travel_count"],
            value["elevation_setpoint"],
            value["pitch_setpoint"],
            value["travel_setpoint"],
            value["front"],
            value["back"],
            State(int(raw[_STATE])),
            Fault(int(raw[_FAULT])),
            Flags(int(raw[_FLAGS])),
        )

    def samples(self, tick: npt.NDArray[np.int64], raw: npt.NDArray[np.int32]) -> Samples:
        """Convert many samples.

        Parameters
        ----------
        tick : ndarray of int64, shape (n,)
            Device time [tick].
        raw : ndarray of int32, shape (n, 11)
            Channels in the declaration's order.

        Returns
        -------
        Samples
            The same in units.
        """
        columns = np.asarray(raw.T * self._scale[:, None], np.float64)  # (11, n)
        value = {name: columns[index] for name, index in _CHANNEL.items()}
        return Samples(
            tick,
            np.asarray(tick * TICK_S, np.float64),
            value["elevation_count"],
            value["pitch_count"],
            value["travel_count"],
            value["elevation_setpoint"],
            value["pitch_setpoint"],
            value["travel_setpoint"],
            value["front"],
            value["back"],
            raw[:, _STATE].astype(np.uint8),
            raw[:, _FAULT].astype(np.uint8),
            raw[:, _FLAGS].astype(np.uint8),
        )


class SampleRing:
    """Keeps the newest samples of a session.

    Parameters
    ----------
    capacity : int
        Samples kept [ticks].
    """

    def __init__(self, capacity: int) -> None:
        self._tick = np.empty(capacity, np.uint32)
        self._raw = np.empty((capacity, CHANNEL_COUNT), np.int32)
        self._written = 0
        self._lock = threading.Lock()

    def clear(self) -> None:
        """Forget all: the board has started anew, and its time with it."""
        with self._lock:
            self._written = 0

    def append(self, ticks: Ticks) -> None:
        """Add samples.

        Parameters
        ----------
        ticks : Ticks
            New samples; of more than fit, the newest stay.
        """
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
        """Return the newest samples, oldest first.

        Parameters
        ----------
        count : int or None
            How many at most; None for all that are kept.

        Returns
        -------
        Ticks
            Copies.
        """
        with self._lock:
            capacity = len(self._tick)
            kept = min(self._written, capacity)
            count = kept if count is None else min(max(count, 0), kept)
            index = (self._written - count + np.arange(count)) % capacity
            return Ticks(self._tick[index], self._raw[index])
