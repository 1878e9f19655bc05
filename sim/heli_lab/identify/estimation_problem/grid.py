"""Windows over a record, and the voltages within their steps."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from heli_host.arrays import Floats, Integers

from heli_lab.identify.free_run import Inputs
from heli_lab.identify.record import Record
from heli_lab.identify.thresholds import BLOCK_S


@dataclass(frozen=True)
class Grid:
    """Windows over a record at one step: what the kernel needs, and what it is compared with.

    Parameters
    ----------
    rows : ndarray of int64 (m,)
        Row of the flight at the beginning of each step.
    every : int
        Rows in a step.
    """

    record: Record
    inputs: Inputs
    rows: Integers
    every: int

    @property
    def measured_rad(self) -> Floats:
        """Angles at the beginning of each step, shape (m, 3)."""
        return self.record.angles_rad[self.rows]

    @property
    def slices(self) -> list[slice]:
        """Steps of each window."""
        first = self.inputs.first
        return [slice(int(f), int(f + n)) for f, n in zip(first, self.inputs.steps, strict=True)]

    def only(self, which: Integers) -> Grid:
        """Keep some windows alone, those of the numbers in `which`, in the order wanted."""
        inputs, slices = self.inputs, self.slices
        kept = np.concatenate([np.arange(slices[i].start, slices[i].stop) for i in which])
        chosen = Inputs(
            inputs.steps[which],
            inputs.start_s[which],
            inputs.step_s,
            inputs.mean_V[kept],
            inputs.change_V[kept],
            inputs.substeps,
            tuple((name, mean[kept], change[kept]) for name, mean, change in inputs.shaped_by),
        )
        return Grid(self.record, chosen, self.rows[kept], self.every)


def window_starts(record: Record, window_s: float, every: int, parts: int = 1) -> list[tuple[int, int]]:
    """Split the free segments into windows of nearly equal length, about `window_s`, and each of these into
    `parts`, all a multiple of `every` rows: first row and number of rows of each.
    """
    windows = []
    for start, stop in record.segments:
        blocks = (stop - start) // every
        count = max(1, round(blocks * every * record.step_s / window_s))
        edges = np.linspace(0, blocks, count + 1).astype(int)
        inner = [np.linspace(a, b, parts + 1).astype(int)[:-1] for a, b in itertools.pairwise(edges)]
        edges = np.append(np.concatenate(inner), blocks)
        windows += [
            (start + int(low) * every, int(high - low) * every)
            for low, high in itertools.pairwise(edges)
            if high > low
        ]
    return windows


def make_grid(
    record: Record,
    windows: Sequence[tuple[int, int]],
    every: int,
    *,
    longest_step_s: float = 0.01,
    delay: tuple[str, float] | None = None,
    dead_zone_V: float | None = None,
) -> Grid:
    """Lay a grid of steps over windows, with their inputs.

    Parameters
    ----------
    windows : sequence of (int, int)
        First row and number of rows of each window.
    every : int
        Rows in a step.
    longest_step_s : float
        Longest Runge-Kutta step.
    delay : (str, float), optional
        Name and value in s of the parameter that delays the voltages, for models that have one.
    dead_zone_V : float, optional
        Voltages below this give no thrust and are lifted to it before they are averaged over a step, so that
        the thrust of the mean is the mean of the thrust.
    """
    rows = np.concatenate([np.arange(first, first + count, every) for first, count in windows]).astype(
        np.int64
    )
    step_s = record.step_s * every
    volts, late_s = record.voltages_V, 0.0 if delay is None else delay[1]
    shaped: list[tuple[str, Floats, Floats]] = []
    if dead_zone_V is not None and every > 1:
        below = (volts < dead_zone_V).astype(float)
        volts = np.maximum(volts, dead_zone_V)
        shaped.append(("dead_zone", *_ramp(below, record.step_s, rows, every, late_s)))
    shape = _ramp(volts, record.step_s, rows, every, late_s)
    if delay is not None:
        half_s = 0.5 * record.step_s
        more = _ramp(volts, record.step_s, rows, every, late_s + half_s)
        less = _ramp(volts, record.step_s, rows, every, late_s - half_s)
        shaped.append((delay[0], (more[0] - less[0]) / record.step_s, (more[1] - less[1]) / record.step_s))
    inputs = Inputs(
        np.array([count // every for _, count in windows], np.int64),
        np.array([record.t_s[first] - record.t_s[0] for first, _ in windows]),
        step_s,
        *shape,
        max(1, math.ceil(step_s / longest_step_s - 1e-9)),
        tuple(shaped),
    )
    return Grid(record, inputs, rows, every)


class WindowGrids:
    """Windows of `records` and the grids over them, which are computed when they are first needed.

    Parameters
    ----------
    window_s : float
        Length of the windows, nearly.
    step_s : float
        Longest Runge-Kutta step, and distance of the samples compared, of the coarse grid.
    parts : int
        Number of windows that each window is divided into.
    """

    def __init__(self, records: Sequence[Record], window_s: float, step_s: float, parts: int = 1) -> None:
        self.records, self.window_s, self.step_s, self.parts = tuple(records), window_s, step_s, parts
        self._grids: dict[tuple[int, bool], tuple[object, Grid]] = {}

    def __getstate__(self) -> dict[str, Any]:
        # The grids follow from the records.
        return {**self.__dict__, "_grids": {}}

    def copy(self, *, window_s: float | None = None, parts: int | None = None) -> WindowGrids:
        """Lay other windows over the same records: of nearly `window_s`, each divided into `parts`."""
        return WindowGrids(self.records, window_s or self.window_s, self.step_s, parts or self.parts)

    def windows(self, index: int) -> list[tuple[int, int]]:
        """Windows of record `index`, a whole number of steps and of blocks of `thresholds.BLOCK_S`: first row
        and number of rows of each.
        """
        record = self.records[index]
        block = max(1, int(BLOCK_S / record.step_s + 1e-6))
        return window_starts(record, self.window_s, math.lcm(self._coarse(record), block), self.parts)

    def grid(
        self, index: int, fine: bool, delay: tuple[str, float] | None, dead_zone_V: float | None
    ) -> Grid:
        """Windows of a record, with their inputs; the coarse and the fine grid have the same windows.

        Parameters
        ----------
        index : int
            Which record.
        fine : bool
            Every sample, or steps of about `step_s`.
        delay : (str, float) or None
            As in `make_grid`.
        dead_zone_V : float or None
            As in `make_grid`.
        """
        key, shape = (index, fine), (delay, None if fine else dead_zone_V)
        if key not in self._grids or self._grids[key][0] != shape:
            record = self.records[index]
            grid = make_grid(
                record,
                self.windows(index),
                1 if fine else self._coarse(record),
                longest_step_s=self.step_s,
                delay=delay,
                dead_zone_V=dead_zone_V,
            )
            self._grids[key] = (shape, grid)
        return self._grids[key][1]

    def _coarse(self, record: Record) -> int:
        return max(1, int(self.step_s / record.step_s + 1e-6))


def _ramp(volts: Floats, dt: float, rows: Integers, every: int, delay_s: float) -> tuple[Floats, Floats]:
    """Mean and change over each step, with the integral and the double integral of the delayed voltages."""
    if every == 1 and delay_s == 0.0:
        return volts[rows], np.zeros((len(rows), 2))
    # Before the record the first voltage is taken to have acted.
    once, twice = np.zeros((2, len(volts) + 1, 2))
    np.cumsum(volts, axis=0, out=once[1:])
    once *= dt
    between = once[1:] + once[:-1]
    between *= 0.5
    np.cumsum(between, axis=0, out=twice[1:])
    twice *= dt

    def integrals(at: Floats) -> tuple[Floats, Floats]:
        place = np.clip(at / dt, None, len(volts) - 1e-9)
        index = np.clip(np.floor(place + 1e-9).astype(int), 0, len(volts) - 1)
        rest = (place - index)[:, None] * dt
        return (
            once[index] + volts[index] * rest,
            twice[index] + once[index] * rest + 0.5 * volts[index] * rest**2,
        )

    start: Floats = rows.astype(float) * dt - delay_s
    span = every * dt
    (a1, a2), (b1, b2) = integrals(start), integrals(start + span)
    mean = (b1 - a1) / span
    moment = (0.5 * (a1 + b1) * span - (b2 - a2)) / span**2
    return mean, 12.0 * moment
