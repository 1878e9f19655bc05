"""Groups the samples of a flight into even steps, independent of how the samples are split over calls."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats, Integers

from heli_lab.fit.reference_trajectory import STEP_s

MAX_GAP_s: Final = 0.04
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
    np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 2)), np.empty(0, bool), np.empty(0, bool)
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
        self._max_gap = round(MAX_GAP_s / sample_s)
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
        """Process `rows` of samples with successive numbers, and yield the steps that they complete.

        A short gap before them is filled. After a long one, or a restart of the clock, the steps begin again.
        """
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
