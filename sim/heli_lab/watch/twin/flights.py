"""Converts flights in files, and ticks from boards, to samples; both give the same samples for a flight."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats, Integers
from heli_host.data.flight import Flight
from heli_host.data.log.reader import Log
from heli_host.declaration import Channel, State
from heli_host.link.channels import ENCODERS, numbers, physical, rad_per_count
from heli_host.link.clock import TICK_S
from heli_sim.rig import Rig

from heli_lab.errors import TwinError
from heli_lab.fit.records import ON_GROUND, encoder_counts
from heli_lab.watch.twin.samples import Samples

_OFF_STATES: Final = np.array([int(state) for state in State if state.name.lower() in ON_GROUND])
_LANDING_NAMES: Final = frozenset({"landing", "emergency_landing"})
_LANDING_STATES: Final = np.array([int(state) for state in State if state.name.lower() in _LANDING_NAMES])
_MAX_TIME_ERROR_STEPS: Final = 0.3
"""Steps by which a row's time may stray from the even grid."""


def samples_of(flight: Flight) -> tuple[Samples, float]:
    """Convert the rows of a flight to samples that are numbered on an even grid."""
    t_s, step_s = flight.t_s, flight.step_s
    if abs(step_s - TICK_S) < 1e-5:
        # The rows are ticks of the board.
        sample_s = TICK_S
        steps = t_s / sample_s
    else:
        intervals_s = np.diff(t_s)
        is_gap = intervals_s >= 1.5 * step_s
        sample_s = float(intervals_s[~is_gap].mean())
        steps = (t_s - t_s[0]) / sample_s
    number: Integers = np.rint(steps).astype(np.int64)
    if np.any(np.diff(number) < 1) or np.max(np.abs(steps - number)) > _MAX_TIME_ERROR_STEPS:
        raise TwinError(
            "the rows of the flight are not evenly spaced", "log at a constant rate, or resample the flight"
        )
    flying, landing = np.ones(len(flight), bool), np.zeros(len(flight), bool)
    if flight.state is not None and flight.state_names:
        off_states = [number for number, name in flight.state_names.items() if name in ON_GROUND]
        flying = ~np.isin(flight.state, off_states)
        landing_states = [number for number, name in flight.state_names.items() if name in _LANDING_NAMES]
        landing = np.isin(flight.state, landing_states)
    return Samples(number, flight.angles_rad, flight.voltages_V, flying, landing), sample_s


def samples_of_log(log: Log) -> tuple[Samples, float]:
    """Convert a log to samples that are numbered by the board's ticks."""
    count_rad = rad_per_count(log.parameters)
    if not len(log.ticks) or not np.all(np.isfinite(count_rad)):
        raise TwinError(f"{log.path} holds no ticks, or no counts of the encoders", "record the flight again")
    first = int(log.ticks["tick"][0])
    # The time of a log goes on over restarts of the board and over 2^32 ticks.
    number = first + np.rint(log.ticks["t_s"] / TICK_S).astype(np.int64)
    return samples_of_ticks(number, log.raw, count_rad), first * TICK_S


def samples_of_ticks(tick: Integers, raw: npt.NDArray[np.int32], count_rad: Floats) -> Samples:
    """Convert ticks of a board to samples. Shapes: `tick` (n,), `raw` (n, channels), `count_rad` (3,)."""
    angles = np.column_stack(
        [numbers(raw, channel) * count_rad[axis] for axis, channel in enumerate(ENCODERS)]
    )
    volts = np.column_stack([physical(raw, channel) for channel in (Channel.FRONT, Channel.BACK)])
    state = numbers(raw, Channel.STATE)
    return Samples(tick, angles, volts, ~np.isin(state, _OFF_STATES), np.isin(state, _LANDING_STATES))


def count_rad_of(flight: Flight, rig: Rig) -> Floats:
    """Return the angle of one count of each encoder [rad], (3,): from the board's parameters if the flight
    has them, otherwise from the steps of the angles.
    """
    return encoder_counts(flight, rig)[0]
