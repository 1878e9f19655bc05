"""A flight as even steps of 10 ms, with the voltages that act and whether the flight is free.

Flights in files, logs and ticks of boards become the same samples. The steps do not depend on how the samples
are split over calls.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Final, NamedTuple

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
from heli_lab.fit import thresholds
from heli_lab.fit.records import ON_GROUND, encoder_counts
from heli_lab.fit.reference_trajectory import STEP_s
from heli_lab.watch.twin_model import ParameterUncertainty, TwinModel

_MAX_GAP_s: Final = 0.04
"""Longest gap that the filter bridges with the last voltage, s: one of its measurements is then missing.
Longer: the voltages in the gap are unknown. Shorter: every lost batch restarts the filter."""


@dataclass(frozen=True)
class Samples:
    """Samples of a flight, in order of time."""

    number: Integers  # (n,): Number of each sample on the even time grid of its log, such as the board's tick
    angles_rad: Floats  # (n, 3): Elevation, pitch and travel [rad]
    volts_V: Floats  # (n, 2): Front and back voltage that act from each sample to the next [V]
    flying: npt.NDArray[np.bool_]  # (n,): True where the motors may run
    landing: npt.NDArray[np.bool_]  # (n,): True where the board lands the arm

    def __len__(self) -> int:
        return len(self.number)

    def select(self, rows: slice | Integers | npt.NDArray[np.bool_]) -> Samples:
        """Return the samples in `rows`, a slice, a mask or an array of places."""
        return Samples(*(getattr(self, column.name)[rows] for column in fields(self)))

    def followed_by(self, other: Samples) -> Samples:
        """Return these samples, and then those of `other`."""
        pairs = ((getattr(self, column.name), getattr(other, column.name)) for column in fields(self))
        return Samples(*map(np.concatenate, pairs))


_NO_SAMPLES: Final = Samples(
    np.empty(0, np.int64),
    angles_rad=np.empty((0, 3)),
    volts_V=np.empty((0, 2)),
    flying=np.empty(0, bool),
    landing=np.empty(0, bool),
)


@dataclass(frozen=True)
class Step:
    """A step of the filter, about 10 ms of a flight."""

    index: int  # Number of the step; `index` times the length of a step is the time on the clock of the log
    measured_rad: Floats | None
    """(3,): Angles at its beginning [rad]: the mean of the samples within half a step; None without samples.
    """
    samples: int  # Number of samples in that mean
    volts_V: Floats  # (k, 2): Voltages of its samples [V]
    flying: bool  # True if the motors may run during the whole step
    landing: bool  # True if the board lands during a part of the step
    after_gap: bool  # True if the step does not continue the previous one


class Stepper:
    """Groups samples into steps. The borders of the steps do not depend on how the samples arrive."""

    def __init__(self, sample_s: float) -> None:
        self.samples_per_step = max(1, int(STEP_s / sample_s + 1e-6))
        self.step_s = self.samples_per_step * sample_s
        self._max_gap = round(_MAX_GAP_s / sample_s)
        self._after_gap = True
        self._reset(0)

    def _reset(self, first: int) -> None:
        """Discard all samples; `first` is the number of the next one."""
        # Samples that later steps need, and the newest of them.
        self._pending = self._newest = _NO_SAMPLES
        # Number of the first of these samples, and the number after the last.
        self._first = self._next = first

    def update(self, samples: Samples) -> Iterator[Step]:
        """Process samples and yield the steps that they complete. A number below the previous one counts as a
        restart of the clock.
        """
        if not len(samples):
            return
        # Rows at which a run of successive numbers begins, and the row after the last.
        breaks = np.flatnonzero(np.diff(samples.number) != 1) + 1
        borders = [0, *map(int, breaks), len(samples)]
        for start, stop in itertools.pairwise(borders):
            yield from self._update_contiguous(samples, slice(start, stop))

    def _update_contiguous(self, samples: Samples, rows: slice) -> Iterator[Step]:
        """Process `rows` of samples with successive numbers, and yield the steps that they complete."""
        # A short gap before them is filled. After a long one, or a restart of the clock, the steps begin
        # again.
        number = int(samples.number[rows.start])
        missing = number - self._next
        if not len(self._newest) or missing < 0 or missing > self._max_gap:
            # Steps begin at multiples of their length, so that they do not depend on the first sample.
            skipped = -number % self.samples_per_step
            rows = slice(rows.start + skipped, rows.stop)
            if rows.start >= rows.stop:
                self._reset(number)
                self._after_gap = True
                return
            self._reset(number + skipped)
            self._after_gap = True
        elif missing:
            # The last voltage holds over the gap; the angles are missing.
            repeated = self._newest.select(np.zeros(missing, int))
            self._append(replace(repeated, angles_rad=np.full((missing, 3), np.nan)))
        self._append(samples.select(rows))
        yield from self._complete_steps()

    def _append(self, samples: Samples) -> None:
        """Append samples to the pending ones; missing angles are nan."""
        self._pending = self._pending.followed_by(samples)
        self._newest = samples.select(slice(-1, None))
        self._next += len(samples)

    def _complete_steps(self) -> Iterator[Step]:
        """Yield the complete steps, and discard samples that no later step needs."""
        step_rows, half_step = self.samples_per_step, self.samples_per_step // 2
        pending = self._pending
        # `start` is the place among the pending samples at which a step begins; steps begin at multiples of
        # `step_rows`, and `_first` is the number of the first pending sample.
        start = -self._first % step_rows
        while start + step_rows <= len(pending):
            # The mean is symmetric about the beginning of the step.
            half_width = min(half_step, start)
            angles_rad = pending.angles_rad[start - half_width : start + half_width + 1]
            angles_rad = angles_rad[~np.isnan(angles_rad[:, 0])]
            rows = slice(start, start + step_rows)
            yield Step(
                index=(self._first + start) // step_rows,
                measured_rad=angles_rad.mean(axis=0) if len(angles_rad) else None,
                samples=len(angles_rad),
                volts_V=pending.volts_V[rows],
                flying=bool(pending.flying[rows].all()),
                landing=bool(pending.landing[rows].any()),
                after_gap=self._after_gap,
            )
            self._after_gap = False
            start += step_rows
        # The mean about the beginning of the next step needs half a step before it.
        used_rows = max(0, start - half_step)
        self._first += used_rows
        self._pending = pending.select(slice(used_rows, None))


_OFF_STATES: Final = np.array([int(state) for state in State if state.name.lower() in ON_GROUND])
_LANDING_NAMES: Final = frozenset({"landing", "emergency_landing"})
_LANDING_STATES: Final = np.array([int(state) for state in State if state.name.lower() in _LANDING_NAMES])
_MAX_TIME_ERROR_STEPS: Final = 0.3
"""Steps by which a row's time may stray from the even grid."""


def samples_of(flight: Flight) -> tuple[Samples, float]:
    """Convert the rows of a flight to samples that are numbered on an even grid. Returns `samples`, and the
    time between two numbers, `sample_s` [s].
    """
    t_s, step_s = flight.t_s, flight.step_s
    # Times in a table may be rounded to 0.01 ms.
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
        off_states = [state for state, name in flight.state_names.items() if name in ON_GROUND]
        flying = ~np.isin(flight.state, off_states)
        landing_states = [state for state, name in flight.state_names.items() if name in _LANDING_NAMES]
        landing = np.isin(flight.state, landing_states)
    samples = Samples(number, flight.angles_rad, flight.voltages_V, flying=flying, landing=landing)
    return samples, sample_s


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
    return Samples(
        tick, angles, volts, flying=~np.isin(state, _OFF_STATES), landing=np.isin(state, _LANDING_STATES)
    )


def count_rad_of(flight: Flight, rig: Rig) -> Floats:
    """Return the angle of one count of each encoder [rad], (3,): from the board's parameters if the flight
    has them, otherwise from the steps of the angles.
    """
    return encoder_counts(flight, rig)[0]


_SETTLE_s: Final = 1.5
"""Time off the table before a flight counts as free, s: the ground effect and the thrust of the take-off have
then decayed. Compare `heli_lab.fit.thresholds.SETTLED_S`. Longer: damage at take-off is detected late.
Shorter: the ground effect is taken for a change."""


class FreeFlight:
    """Decides for successive steps whether the flight is free: the motors have run off the table and the
    stops for `_SETTLE_s`.
    """

    def __init__(self, rig: Rig, step_s: float) -> None:
        self._settling_steps = round(_SETTLE_s / step_s)
        # Number of successive steps off the table and the stops.
        self._clear_steps = 0
        uncertainty_deg = min(rig["elevation_min"].tolerance, thresholds.MAX_UNSURE_DEG)
        self._table_deg = rig["elevation_min"].value
        self._low_deg = self._table_deg + uncertainty_deg + thresholds.TABLE_MARGIN_DEG
        # Distance of a rotor's edge from the arm, as a share of the arm's length.
        self._rotor_reach = (rig["L_h"].value + thresholds.ROTOR_m) / rig["L_a"].value
        stops = [rig[name] for name in ("elevation_max", "pitch_max", "travel_max")]
        self._stop_deg = [
            stop.value - min(stop.tolerance, thresholds.MAX_UNSURE_DEG) - thresholds.STOP_MARGIN_DEG
            for stop in stops
        ]

    def update(self, angles_rad: Floats | None, flying: bool) -> bool:
        """Return whether a step is free. Shapes: `angles_rad` (3,), None without samples."""
        if not flying:
            self._clear_steps = 0
        elif angles_rad is not None:  # without angles, the count stays
            self._clear_steps = 0 if self._touches(angles_rad) else self._clear_steps + 1
        return self._clear_steps > self._settling_steps

    def _touches(self, angles_rad: Floats) -> bool:
        """Whether the arm or a rotor may touch the table, or an axis a stop, at angles [rad]."""
        elevation_rad, pitch_rad, _ = angles_rad
        elevation_deg, pitch_deg, travel_deg = np.rad2deg(angles_rad)
        if elevation_deg < self._low_deg:
            return True
        # If the arm is pitched, its lower rotor reaches the table before the arm does. Heights are above the
        # pivot, in lengths of the arm.
        depth = self._rotor_reach * abs(math.sin(pitch_rad)) * math.cos(elevation_rad)
        lowest_height = math.sin(elevation_rad) - depth
        if lowest_height < math.sin(math.radians(self._table_deg)):
            return True
        elevation_max_deg, pitch_max_deg, travel_max_deg = self._stop_deg
        return bool(
            elevation_deg > elevation_max_deg
            or abs(pitch_deg) > pitch_max_deg
            or abs(travel_deg) > travel_max_deg
        )


_HISTORY_s: Final = 2.0
"""Length of the flight before the filter begins from which the states of effects are integrated, s: far
longer than the lag of any rotor."""


class Motion(NamedTuple):
    """Measured motion and acting voltages over some steps."""

    times_s: Floats  # (n,): Times since the motors started [s]
    angles_rad: Floats  # (n, 3): Measured angles [rad]
    volts_V: Floats  # (n, 2): Acting voltages [V]


class InputHistory:
    """Inputs of the latest steps, with the delay between a voltage and its action. `acting_V` has shape
    (2,).
    """

    def __init__(self, model: TwinModel, step_s: float) -> None:
        self.motor_time_s = 0.0
        self.acting_V: Floats = np.zeros(2)
        self._min_thrust_V = model.min_thrust_V
        self._delayed_volts_V: deque[Floats] = deque(maxlen=round(model.delay_s / step_s) + 1)
        self._motor_start_s = math.nan
        self._motion: deque[tuple[float, Floats, Floats]] = deque(maxlen=round(_HISTORY_s / step_s))

    def update(self, step: Step, t_s: float) -> None:
        """Compute the inputs of a `step` at time `t_s` [s]."""
        mean_volts_V = np.maximum(step.volts_V, self._min_thrust_V).mean(axis=0)
        self._delayed_volts_V.append(mean_volts_V)
        # The queue is as long as the delay: its oldest voltage acts now.
        self.acting_V = self._delayed_volts_V[0]
        if not step.flying:
            self._motor_start_s = math.nan
        elif math.isnan(self._motor_start_s) and np.any(step.volts_V):
            self._motor_start_s = t_s
        self.motor_time_s = 0.0 if math.isnan(self._motor_start_s) else t_s - self._motor_start_s

    def remember(self, measured_rad: Floats) -> None:
        """Keep the present inputs with angles that were measured at the same step. Shapes: `measured_rad`
        (3,).
        """
        self._motion.append((self.motor_time_s, measured_rad, self.acting_V))

    def forget_motion(self) -> None:
        """Discard the kept inputs."""
        self._motion.clear()

    def restart(self) -> None:
        """Discard everything, because samples are missing."""
        self._motion.clear()
        self._delayed_volts_V.clear()
        self._motor_start_s = math.nan

    def initial_motion(self) -> Motion:
        """Return the motion before the present step, from which the filter starts."""
        times_s, angles_rad, volts_V = (np.array(values) for values in zip(*self._motion, strict=True))
        return Motion(times_s, angles_rad, volts_V)


_UNKNOWN_s: Final = 1.0
"""Time after a voltage that no nominal flight shows for which measurements carry no evidence, s: the filter
has to settle again. Longer: aggressive flights hide changes. Shorter: what an unknown voltage does is taken
for a change."""
_EXTRAPOLATED_SHARE: Final = 0.1
"""Distance from the range of the nominal flights up to which measurements still carry evidence, as a share of
the width of that range. The filter adds process noise for such voltages. Larger: what an unknown voltage does
is taken for a change; with 0.25, two of eight healthy measured flights have a false alarm. Smaller: a change
hides itself, because the controller answers it with unusual voltages. With 0, a zero error of pitch of 74
standard errors was missed, because the back rotor got 2.3 V instead of at most 2.2 V (2026-11)."""
_ROTORS: Final = ("front", "back")


class VoltageRange:
    """Compares the voltages of a flight with those of the nominal flights."""

    # Voltages that are outside of their range by less than `_EXTRAPOLATED_SHARE` of its width count as known.

    def __init__(self, uncertainty: ParameterUncertainty, step_s: float) -> None:
        self._uncertainty = uncertainty
        self._unknown_steps = round(_UNKNOWN_s / step_s)
        tolerance_V = _EXTRAPOLATED_SHARE * (uncertainty.high_V - uncertainty.low_V)
        # A rotor that reverses follows another curve, so no range is extrapolated across 0 V.
        min_V = np.where(uncertainty.low_V < 0.0, -np.inf, 0.0)
        self._extrapolated = replace(
            uncertainty,
            low_V=np.maximum(uncertainty.low_V - tolerance_V, min_V),
            high_V=uncertainty.high_V + tolerance_V,
        )
        self._last_unknown_step: int | None = None

    def update(self, index: int, volts_V: Floats) -> str:
        """Take the acting voltages `volts_V` [V], (2,), of the step `index`."""
        # Returns the reason why the twin does not judge them if these voltages are the first outside the
        # range; otherwise the empty string.
        outside_V = self._extrapolated.outside_V(volts_V)
        if not np.any(outside_V > 0.0):
            return ""  # both voltages are known
        is_first = self._last_unknown_step is None
        self._last_unknown_step = index + self._unknown_steps
        return self._unknown_voltage_text(volts_V, int(np.argmax(outside_V))) if is_first else ""

    def is_known(self, index: int) -> bool:
        """Whether the measurement at the step `index` carries evidence."""
        return self._last_unknown_step is None or index > self._last_unknown_step

    def _unknown_voltage_text(self, volts_V: Floats, rotor: int) -> str:
        """State the voltage of a `rotor`, and the range of the nominal flights."""
        low_V, high_V = self._uncertainty.low_V[rotor], self._uncertainty.high_V[rotor]
        reverses = volts_V[rotor] < 0.0 <= low_V
        return (
            f"the {_ROTORS[rotor]} rotor gets {volts_V[rotor]:.1f} V{' (it reverses)' if reverses else ''}; "
            f"the twin knows {low_V:.1f} V to {high_V:.1f} V from its nominal flights"
        )
