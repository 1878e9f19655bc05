"""Samples of a flight as they come, in even steps: the same whatever pieces they come in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.arrays import Floats, Integers

from heli_lab.estimation.reference_trajectory import STEP_s

BRIDGED_s: Final = 0.04
"""Longest gap over which the filter goes on with the last voltage, s: one of its measurements is missing
then. Longer: what the motors did meanwhile is not known. Shorter: every lost batch begins anew."""


@dataclass(frozen=True)
class Samples:
    """Some samples of a flight, in order.

    Parameters
    ----------
    number : ndarray of int64 (n,)
        Place of each on the even grid of its log: the tick of a log of every tick.
    angles_rad : ndarray (n, 3)
        Elevation, pitch and travel.
    volts_V : ndarray (n, 2)
        Front and back voltage that act from each sample to the next.
    flying : ndarray of bool (n,)
        Whether the motors may run.
    landing : ndarray of bool (n,)
        Whether the board brings the arm down to its table.
    """

    number: Integers
    angles_rad: Floats
    volts_V: Floats
    flying: npt.NDArray[np.bool_]
    landing: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.number)

    def part(self, rows: slice | Integers | npt.NDArray[np.bool_]) -> Samples:
        """Take some `rows`."""
        return Samples(
            self.number[rows],
            self.angles_rad[rows],
            self.volts_V[rows],
            self.flying[rows],
            self.landing[rows],
        )


@dataclass(frozen=True)
class Step:
    """Some 10 ms of a flight.

    Parameters
    ----------
    index : int
        Number of the step: `index` times its length is the log's own time.
    measured_rad : ndarray (3,) or None
        Angles at its beginning, mean of the samples within half a step; None where none came.
    samples : int
        How many samples that mean is of.
    volts_V : ndarray (k, 2)
        Voltages of its samples.
    flying : bool
        Whether the motors may run during all of it.
    landing : bool
        Whether the board lands during some of it.
    begins : bool
        Whether it does not go on where the step before it ended.
    """

    index: int
    measured_rad: Floats | None
    samples: int
    volts_V: Floats
    flying: bool
    landing: bool
    begins: bool


class Stepper:
    """Cuts samples into steps, the borders of which do not depend on how the samples come.

    Parameters
    ----------
    sample_s : float
        Time from one number of the samples to the next.
    """

    def __init__(self, sample_s: float) -> None:
        self.every = max(1, int(STEP_s / sample_s + 1e-6))
        """Samples in a step."""
        self.step_s = self.every * sample_s
        """Length of a step."""
        self._bridged = round(BRIDGED_s / sample_s)
        self._begins = True
        self._clear(0)

    def _clear(self, first: int) -> None:
        self._first = first
        self._angles: Floats = np.empty((0, 3))
        self._volts: Floats = np.empty((0, 2))
        self._flying = np.empty(0, bool)
        self._landing = np.empty(0, bool)
        self._next = first

    def take(self, samples: Samples) -> Iterator[Step]:
        """Take samples in, and give the steps that they complete; those that come before the last ones are
        taken for a clock that began anew.
        """
        if not len(samples):
            return
        breaks = np.flatnonzero(np.diff(samples.number) != 1) + 1
        for part in np.split(np.arange(len(samples)), breaks):
            yield from self._take_piece(samples, slice(int(part[0]), int(part[-1]) + 1))

    def _take_piece(self, samples: Samples, rows: slice) -> Iterator[Step]:
        number = int(samples.number[rows.start])
        missing = number - self._next
        if not len(self._angles) or missing < 0 or missing > self._bridged:
            # Steps begin at multiples of their length, as those of every other reader of the same log.
            late = -number % self.every
            rows = slice(rows.start + late, rows.stop)
            if rows.start >= rows.stop:
                self._clear(number)
                self._begins = True
                return
            self._clear(number + late)
            self._begins = True
        elif missing:
            self._append(
                np.full((missing, 3), np.nan),
                np.repeat(self._volts[-1:], missing, axis=0),
                np.repeat(self._flying[-1:], missing),
                np.repeat(self._landing[-1:], missing),
            )
        new = samples.part(rows)
        self._append(new.angles_rad, new.volts_V, new.flying, new.landing)
        yield from self._steps()

    def _append(
        self,
        angles: Floats,
        volts: Floats,
        flying: npt.NDArray[np.bool_],
        landing: npt.NDArray[np.bool_],
    ) -> None:
        self._angles = np.concatenate((self._angles, angles))
        self._volts = np.concatenate((self._volts, volts))
        self._flying = np.concatenate((self._flying, flying))
        self._landing = np.concatenate((self._landing, landing))
        self._next += len(angles)

    def _steps(self) -> Iterator[Step]:
        every, half = self.every, self.every // 2
        at = -self._first % every
        while at + every <= len(self._angles):
            width = min(half, at)
            near = self._angles[at - width : at + width + 1]
            known = ~np.isnan(near[:, 0])
            count = int(known.sum())
            whole = slice(at, at + every)
            yield Step(
                (self._first + at) // every,
                near[known].mean(axis=0) if count else None,
                count,
                self._volts[whole],
                bool(self._flying[whole].all()),
                bool(self._landing[whole].any()),
                self._begins,
            )
            self._begins = False
            at += every
        # The mean about the next step's beginning needs those before it.
        done = max(0, at - half)
        self._first += done
        self._angles, self._volts = self._angles[done:], self._volts[done:]
        self._flying, self._landing = self._flying[done:], self._landing[done:]
