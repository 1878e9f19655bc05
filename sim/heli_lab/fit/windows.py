"""Divide flights into windows and the windows into steps, and average the voltages over each step."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats, Integers

from heli_lab.fit.free_run import Inputs, VoltageDerivative
from heli_lab.fit.records import Record
from heli_lab.fit.thresholds import BLOCK_S


class VoltageDelay(NamedTuple):
    """Delay of the voltages before they act, and the parameter that it is the value of."""

    parameter: str
    value_s: float


@dataclass(frozen=True)
class Grid:
    """Windows of a flight, divided into equal steps, with the voltages of each step and the measured
    angles.
    """

    record: Record  # The flight
    inputs: Inputs  # Voltages in each step of each window
    rows: Integers  # (m,): Row of the flight at the beginning of each step
    every: int  # Rows of the flight per step

    @property
    def measured_rad(self) -> Floats:
        """Angles at the beginning of each step, shape (m, 3)."""
        return self.record.angles_rad[self.rows]

    @property
    def slices(self) -> list[slice]:
        """Steps of each window."""
        starts = self.inputs.first
        return [
            slice(int(start), int(start + count))
            for start, count in zip(starts, self.inputs.steps, strict=True)
        ]

    def steps_of(self, windows: Integers) -> Integers:
        """Return the numbers of all steps of the given windows, window after window. Shapes: `windows`
        (k,).
        """
        slices = self.slices
        return np.concatenate([np.arange(slices[i].start, slices[i].stop) for i in windows])

    def only(self, windows: Integers) -> Grid:
        """Return a grid of the given `windows` alone, ndarray of int64 (k,), in their order there."""
        inputs, steps = self.inputs, self.steps_of(windows)
        inputs_of_windows = replace(
            inputs,
            steps=inputs.steps[windows],
            start_s=inputs.start_s[windows],
            mean_V=inputs.mean_V[steps],
            change_V=inputs.change_V[steps],
            voltage_derivatives=tuple(
                VoltageDerivative(by.parameter, by.of_mean[steps], by.of_change[steps])
                for by in inputs.voltage_derivatives
            ),
        )
        return replace(self, inputs=inputs_of_windows, rows=self.rows[steps])


def split_into_windows(record: Record, window_s: float, every: int, parts: int = 1) -> list[tuple[int, int]]:
    """Split each free segment of a flight into windows of about equal length, and each window into parts;
    return the first row and the number of rows of each part.
    """
    windows = []
    for start, stop in record.segments:
        steps = (stop - start) // every
        window_count = max(1, round(steps * every * record.step_s / window_s))
        # Edges of the windows, then of their parts, in steps since the segment's first row.
        edges = np.linspace(0, steps, window_count + 1).astype(int)
        starts_of_parts = [
            np.linspace(first, last, parts + 1).astype(int)[:-1] for first, last in itertools.pairwise(edges)
        ]
        edges = np.append(np.concatenate(starts_of_parts), steps)
        windows += [
            (start + int(first) * every, int(last - first) * every)
            for first, last in itertools.pairwise(edges)
            if last > first
        ]
    return windows


def make_grid(
    record: Record,
    windows: Sequence[tuple[int, int]],
    every: int,
    *,
    longest_step_s: float = 0.01,
    delay: VoltageDelay | None = None,
    dead_zone_V: float | None = None,
) -> Grid:
    """Divide windows of a flight into steps of `every` rows, and average the voltages over each step. A
    window is given by its first row and its number of rows.
    """
    rows = np.concatenate([np.arange(first, first + count, every) for first, count in windows]).astype(
        np.int64
    )
    step_s = record.step_s * every
    volts_V, delay_s = record.voltages_V, 0.0 if delay is None else delay.value_s
    derivatives: list[VoltageDerivative] = []
    # Without averages, the model itself applies the dead zone to each voltage.
    is_averaged = every > 1 or record.advance_rows > 0.0
    if dead_zone_V is not None and is_averaged:
        # A raised voltage is the dead zone itself, so that its derivative to the dead zone is 1.
        raised_share = record.over_rows((volts_V < dead_zone_V).astype(float))
        volts_V = np.maximum(volts_V, dead_zone_V)
        of_mean, of_change = _mean_and_change(raised_share, record.step_s, rows, every, delay_s)
        derivatives.append(VoltageDerivative("dead_zone", of_mean, of_change))
    volts_V = record.over_rows(volts_V)
    mean_V, change_V = _mean_and_change(volts_V, record.step_s, rows, every, delay_s)
    if delay is not None:
        # Central difference, with delays half a row longer and shorter.
        half_row_s = 0.5 * record.step_s
        mean_later, change_later = _mean_and_change(volts_V, record.step_s, rows, every, delay_s + half_row_s)
        mean_earlier, change_earlier = _mean_and_change(
            volts_V, record.step_s, rows, every, delay_s - half_row_s
        )
        derivatives.append(
            VoltageDerivative(
                parameter=delay.parameter,
                of_mean=(mean_later - mean_earlier) / record.step_s,
                of_change=(change_later - change_earlier) / record.step_s,
            )
        )
    inputs = Inputs(
        steps=np.array([count // every for _, count in windows], np.int64),
        start_s=np.array([record.t_s[first] - record.t_s[0] for first, _ in windows]),
        step_s=step_s,
        mean_V=mean_V,
        change_V=change_V,
        substeps=max(1, math.ceil(step_s / longest_step_s - 1e-9)),
        voltage_derivatives=tuple(derivatives),
    )
    return Grid(record, inputs, rows, every)


class WindowGrids:
    """Windows of all flights, each with a fine and a coarse grid that are computed when first needed."""

    def __init__(self, records: Sequence[Record], window_s: float, step_s: float, parts: int = 1) -> None:
        self.records, self.window_s, self.step_s, self.parts = tuple(records), window_s, step_s, parts
        self._grids: dict[tuple[int, bool], tuple[object, Grid]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return everything except the grids, for pickling: they are large, and computed again when
        needed.
        """
        return {**self.__dict__, "_grids": {}}

    def copy(self, *, window_s: float | None = None, parts: int | None = None) -> WindowGrids:
        """Return other windows over the same flights: of about `window_s` [s], each divided into `parts`."""
        return WindowGrids(self.records, window_s or self.window_s, self.step_s, parts or self.parts)

    def windows(self, index: int) -> list[tuple[int, int]]:
        """Return first row and number of rows of each window of flight `index`."""
        record = self.records[index]
        rows_per_block = max(1, int(BLOCK_S / record.step_s + 1e-6))
        every = math.lcm(self._rows_per_coarse_step(record), rows_per_block)
        return split_into_windows(record, self.window_s, every, self.parts)

    def grid(self, index: int, fine: bool, delay: VoltageDelay | None, dead_zone_V: float | None) -> Grid:
        """Return the grid of one flight, which is computed at its first use.

        The coarse and the fine grid have the same windows.
        """
        key = (index, fine)
        record = self.records[index]
        arguments = (delay, None if fine and not record.advance_rows else dead_zone_V)
        if key not in self._grids or self._grids[key][0] != arguments:
            grid = make_grid(
                record,
                self.windows(index),
                1 if fine else self._rows_per_coarse_step(record),
                longest_step_s=self.step_s,
                delay=delay,
                dead_zone_V=dead_zone_V,
            )
            self._grids[key] = (arguments, grid)
        return self._grids[key][1]

    def _rows_per_coarse_step(self, record: Record) -> int:
        """Number of rows of a flight between compared samples of the coarse grid."""
        return max(1, int(self.step_s / record.step_s + 1e-6))


_ROUNDING_ROWS: Final = 1e-9
"""Rounding of a time in rows: the beginning of a row must not fall into the row before it."""


def _mean_and_change(
    volts: Floats, row_s: float, rows: Integers, every: int, delay_s: float
) -> tuple[Floats, Floats]:
    """Replace the delayed voltages within each step by a straight line. Shapes: `volts` (n, 2), `rows` (m,);
    returns `mean` (m, 2), `change` (m, 2).
    """
    # The line has the same first and second integral over the step as the voltages. A rotor and an axis,
    # which integrate the voltage, then end the step with nearly the same speed and angle.
    if every == 1 and delay_s == 0.0:
        return volts[rows], np.zeros((len(rows), 2))
    # Both integrals at the beginning of each row, and at the end of the last one.
    first_integral, second_integral = np.zeros((2, len(volts) + 1, 2))
    np.cumsum(volts, axis=0, out=first_integral[1:])
    first_integral *= row_s
    middle = first_integral[1:] + first_integral[:-1]
    middle *= 0.5
    np.cumsum(middle, axis=0, out=second_integral[1:])
    second_integral *= row_s

    def integrals_at(t_s: Floats) -> tuple[Floats, Floats]:
        """First and second integral of the voltages at times since the first row, shape (m, 2) each."""
        time_in_rows = np.clip(t_s / row_s, None, len(volts) - _ROUNDING_ROWS)
        # Before the first row, its voltage is assumed to have acted.
        row = np.clip(np.floor(time_in_rows + _ROUNDING_ROWS).astype(int), 0, len(volts) - 1)
        within_row_s = (time_in_rows - row)[:, None] * row_s
        return (
            first_integral[row] + volts[row] * within_row_s,
            second_integral[row] + first_integral[row] * within_row_s + 0.5 * volts[row] * within_row_s**2,
        )

    start_s: Floats = rows.astype(float) * row_s - delay_s
    step_s = every * row_s
    first_start, second_start = integrals_at(start_s)
    first_end, second_end = integrals_at(start_s + step_s)
    mean = (first_end - first_start) / step_s
    # With the first integral F, the second integral G and the step h, the line has F1 - F0 = mean h and
    # G1 - G0 = (F0 + F1) h / 2 - change h^2 / 12.
    change_over_12 = (0.5 * (first_start + first_end) * step_s - (second_end - second_start)) / step_s**2
    return mean, 12.0 * change_over_12
