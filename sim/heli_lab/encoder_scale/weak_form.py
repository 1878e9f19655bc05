"""Parts of a flight on a coarse grid, and smooth test functions that integrate the equations over them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Booleans, Floats, Integers
from heli_host.flight import Flight

GRID_s: Final = 0.02
"""Step of the grid, s. Twice as long: blurred rates put scales off by 2 %, twice as much. Half: twice the
time of a fit."""
WIDTHS_s: Final = (3.0, 1.5, 3.0)
"""Length of the test functions of elevation, pitch and travel, s. Shorter: rounding of the encoders grows as
its inverse square. Longer: the sines of a flight average out."""
_OVERLAP: Final = 0.5
_BLOCK: Final = 64
"""Rows that a low-pass filters at a time."""
_MIN_LAG_s: Final = 1e-3
"""Lag below which there is none, s."""
_SMOOTH_s: Final = 0.1
"""Standard deviation of the bell over which rates are smoothed, s."""


@dataclass(frozen=True)
class Part:
    """Consecutive steps of free flight.

    Parameters
    ----------
    t_s : ndarray (n,)
        Beginning of each step.
    angles_rad, rates_rad_s : ndarray (n, 3)
        Means of the angles shown in each step, and their smoothed rates.
    volts_V : ndarray (n, 2)
        Means of the voltages.
    step_s : float
        Length of a step.
    """

    t_s: Floats
    angles_rad: Floats
    rates_rad_s: Floats
    volts_V: Floats
    step_s: float

    @property
    def seconds(self) -> float:
        """Its length, s."""
        return len(self.angles_rad) * self.step_s

    def lagged_V(self, lag_s: float) -> Floats:
        """Voltages behind a lag of first order with the time constant `lag_s`, (n, 2), at rest before the
        part: their mean over each step.
        """
        lag_s = max(lag_s, _MIN_LAG_s)
        keep = math.exp(-self.step_s / lag_s)
        before = _low_passed(self.volts_V, keep)
        # Within a step the lag goes on from its value before it towards that of the step's voltage.
        share = lag_s / self.step_s * (1.0 - keep)
        return np.asarray(self.volts_V + share * (before - self.volts_V))


def _low_passed(values: Floats, keep: float) -> Floats:
    """Values behind a low-pass of first order, each before its row acts on it; at rest before the first row.

    Not by SciPy, whose import takes as long as a flight of half a minute: in blocks of rows, as a product of
    matrices within a block.
    """
    rows, columns = values.shape
    blocks = -(-rows // _BLOCK)
    padded = np.zeros((blocks * _BLOCK, columns))
    padded[:rows] = values
    powers = keep ** np.arange(_BLOCK + 1)
    distance = np.subtract.outer(np.arange(_BLOCK + 1), np.arange(_BLOCK)) - 1
    response = (1.0 - keep) * np.where(distance >= 0, powers[np.maximum(distance, 0)], 0.0)
    result = response @ padded.reshape(blocks, _BLOCK, columns)
    start = values[0]
    for number in range(blocks):
        result[number] += np.outer(powers, start)
        start = result[number, -1]
    return np.asarray(result[:, :-1].reshape(-1, columns)[:rows])


def gap_free_parts(flight: Flight, rows: Booleans, least_V: float) -> list[Part]:
    """Cut a flight into parts without gaps, each longer than the longest test function, on a coarse grid.

    Parameters
    ----------
    rows : ndarray of bool (n,)
        Rows in free flight.
    least_V : float
        Dead zone: voltages below it act like it [V].
    """
    step_s = flight.step_s
    if not step_s > 0.0:
        return []
    every = max(1, round(GRID_s / step_s))
    usable = rows & np.isfinite(flight.angles_rad).all(axis=1) & np.isfinite(flight.voltages_V).all(axis=1)
    broken = np.ones(len(usable), bool)
    broken[1:] = (np.diff(flight.t_s) > 1.5 * step_s) | (usable[1:] != usable[:-1])
    starts = np.flatnonzero(broken)
    parts = []
    for start, stop in zip(starts, [*starts[1:], len(usable)], strict=True):
        count = (stop - start) // every
        if not usable[start] or count * every * step_s < max(WIDTHS_s):
            continue
        chosen = slice(start, start + count * every)
        angles = flight.angles_rad[chosen].reshape(count, every, 3).mean(axis=1)
        volts = np.maximum(flight.voltages_V[chosen], least_V).reshape(count, every, 2).mean(axis=1)
        grid_s = every * step_s
        t_s = flight.t_s[chosen][::every]
        parts.append(Part(t_s, angles, _rates(angles, grid_s), volts, grid_s))
    return parts


def _rates(values: Floats, step_s: float) -> Floats:
    """Rates of the columns of `values`, smoothed by a Gaussian bell, shape (n, k)."""
    reach = max(1, round(3.0 * _SMOOTH_s / step_s))
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_s / _SMOOTH_s) ** 2)
    bell /= bell.sum()
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    smooth = np.column_stack([np.convolve(column, bell, mode="valid") for column in padded.T])
    return np.asarray(np.gradient(smooth, step_s, axis=0))


class TestFunctions:
    """Test functions of the weak form: w(t) = c (1 - x^2)^4, |x| < 1, with integral 1, at even distances over
    a part; one width for each axis.

    Integrated by parts, the mean of an acceleration weighted by w is the mean of the angle weighted by the
    second derivative of w.
    """

    __test__ = False

    def __init__(self, part: Part) -> None:
        self._of_axes: list[tuple[Floats, Floats, Integers]] = []
        """For each axis: weights, weights of the second derivative, and first steps of the test functions."""
        for width_s in WIDTHS_s:
            count = round(width_s / part.step_s)
            x = (np.arange(count) + 0.5) / count * 2.0 - 1.0
            scale = 2.0 / width_s
            w = (1.0 - x**2) ** 4
            second = scale**2 * (-8.0 * (1.0 - x**2) ** 3 + 48.0 * x**2 * (1.0 - x**2) ** 2)
            # On the grid, the weights must be exact for angles up to second order: a constant and a slope
            # have no acceleration, and t^2 / 2 has 1.
            second -= second.mean()
            t_s = x / scale
            parabola = float(second @ (0.5 * t_s**2))
            starts = np.arange(0, len(part.angles_rad) - count + 1, max(1, round(_OVERLAP * count)))
            self._of_axes.append((w / w.sum(), second / parabola, starts))

    def second_derivative(self, angles_rad: Floats) -> list[Floats]:
        """Weighted mean accelerations of each axis, from `angles_rad`, shape (n, 3): one array per axis
        [rad/s^2].
        """
        return [
            _apply(second, starts, angles_rad[:, axis])
            for axis, (_, second, starts) in enumerate(self._of_axes)
        ]

    def mean(self, axis: int, values: Floats) -> Floats:
        """Weighted means of `values`, (n,) or (n, k), with the test functions of an `axis`, 0 to 2."""
        weights, _, starts = self._of_axes[axis]
        return _apply(weights, starts, values)


def _apply(weights: Floats, starts: Integers, values: Floats) -> Floats:
    """Weighted sums of `values`, shape (n,) or (n, k), with the `weights` placed at each of the `starts`."""
    windows = np.lib.stride_tricks.sliding_window_view(values, len(weights), axis=0)[starts]
    return np.asarray(windows @ weights)
