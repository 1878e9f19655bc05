"""The weak form of the equations of motion: flights on a coarse grid, and smooth test functions.

Multiplied by a smooth test function and integrated by parts, an equation of motion needs no second derivative
of a measured angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_host.data.flight import Flight

GRID_s: Final = 0.02
"""Step of the grid [s]. Twice as long: blurred rates give scales an error of 2 %, twice as much. Half as
long: a fit takes twice the time."""
WIDTHS_s: Final = (3.0, 1.5, 3.0)
"""Length of the test functions of elevation, pitch and travel [s]. Shorter: errors by the encoders' rounding
grow with the inverse square. Longer: the sines of a flight average out."""
_OVERLAP: Final = 0.5
"""Distance between two test functions, as a share of their length."""
_BLOCK: Final = 64
"""Number of rows that the low-pass filter computes together."""
_MIN_LAG_s: Final = 1e-3
"""Smallest lag [s]; a shorter one has no effect on the grid."""
_SMOOTH_s: Final = 0.1
"""Standard deviation of the Gaussian that smooths the rates [s]."""


@dataclass(frozen=True)
class Part:
    """Consecutive steps of free flight."""

    t_s: Floats  # (n,): Beginning of each step
    angles_rad: Floats
    """angles_rad, rates_rad_s: (n, 3): Mean of the measured angles in each step, and their smoothed rates."""
    rates_rad_s: Floats
    volts_V: Floats  # (n, 2): Mean of the voltages in each step
    step_s: float  # Length of a step [s]

    @property
    def seconds(self) -> float:
        """Length of the part [s]."""
        return len(self.angles_rad) * self.step_s

    def lagged_V(self, lag_s: float) -> Floats:
        """Pass the voltages through a first-order lag that is settled at the first voltage. Returns shape
        (n, 2).
        """
        lag_s = max(lag_s, _MIN_LAG_s)
        decay = math.exp(-self.step_s / lag_s)
        at_start = _low_passed(self.volts_V, decay)
        # Within a step, the output decays exponentially from its value at the start to the step's voltage.
        mean_share = lag_s / self.step_s * (1.0 - decay)
        return np.asarray(self.volts_V + mean_share * (at_start - self.volts_V))


def _low_passed(values: Floats, decay: float) -> Floats:
    """Pass the columns of `values` through a first-order low-pass filter that is settled at the first row.
    Returns shape (n, k).

    The filter is computed in blocks of rows, as a product of matrices for each block. SciPy has such a
    filter, but importing SciPy takes as long as filtering half a minute of flight.
    """
    rows, columns = values.shape
    blocks = -(-rows // _BLOCK)
    padded = np.zeros((blocks * _BLOCK, columns))
    padded[:rows] = values
    powers = decay ** np.arange(_BLOCK + 1)
    # Impulse response: how an input row of a block acts on each output row after it.
    distance = np.subtract.outer(np.arange(_BLOCK + 1), np.arange(_BLOCK)) - 1
    response = (1.0 - decay) * np.where(distance >= 0, powers[np.maximum(distance, 0)], 0.0)
    result = response @ padded.reshape(blocks, _BLOCK, columns)
    # Add the decaying output at the start of each block; its last row is the start of the next block.
    start = values[0]
    for number in range(blocks):
        result[number] += np.outer(powers, start)
        start = result[number, -1]
    return np.asarray(result[:, :-1].reshape(-1, columns)[:rows])


def gap_free_parts(flight: Flight, rows: Booleans, min_V: float) -> list[Part]:
    """Cut a flight into parts without gaps, each longer than the longest test function, on a coarse grid.
    Shapes: `rows` (n,).
    """
    step_s = flight.step_s
    if not step_s > 0.0:
        return []
    every = max(1, round(GRID_s / step_s))
    usable = rows & np.isfinite(flight.angles_rad).all(axis=1) & np.isfinite(flight.voltages_V).all(axis=1)
    is_start = np.ones(len(usable), bool)
    is_start[1:] = (np.diff(flight.t_s) > 1.5 * step_s) | (usable[1:] != usable[:-1])
    starts = np.flatnonzero(is_start)
    parts = []
    for start, stop in zip(starts, [*starts[1:], len(usable)], strict=True):
        count = (stop - start) // every
        if not usable[start] or count * every * step_s < max(WIDTHS_s):
            continue
        chosen = slice(start, start + count * every)
        angles = flight.angles_rad[chosen].reshape(count, every, 3).mean(axis=1)
        volts = np.maximum(flight.voltages_V[chosen], min_V).reshape(count, every, 2).mean(axis=1)
        grid_s = every * step_s
        t_s = flight.t_s[chosen][::every]
        parts.append(Part(t_s, angles, _smoothed_rates(angles, grid_s), volts, grid_s))
    return parts


def _smoothed_rates(values: Floats, step_s: float) -> Floats:
    """Differentiate the columns of `values`, shape (n, k), after smoothing them by a Gaussian."""
    # Three standard deviations on either side.
    reach = max(1, round(3.0 * _SMOOTH_s / step_s))
    gaussian = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_s / _SMOOTH_s) ** 2)
    gaussian /= gaussian.sum()
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    smooth = np.column_stack([np.convolve(column, gaussian, mode="valid") for column in padded.T])
    return np.asarray(np.gradient(smooth, step_s, axis=0))


class TestFunctions:
    """Test functions of the weak form, at even distances over a part of a flight.

    A test function is w(t) = c (1 - x^2)^4 for |x| < 1, with integral 1; each axis has its own width. After
    integration by parts, the mean of an acceleration weighted by w is the mean of the angle weighted by the
    second derivative of w.
    """

    __test__ = False

    def __init__(self, part: Part) -> None:
        self._of_axes: list[tuple[Floats, Floats, Integers]] = []
        """For each axis: weights of w, weights of its second derivative, first step of each test function."""
        for width_s in WIDTHS_s:
            count = round(width_s / part.step_s)
            x = (np.arange(count) + 0.5) / count * 2.0 - 1.0
            scale = 2.0 / width_s
            w = (1.0 - x**2) ** 4
            second = scale**2 * (-8.0 * (1.0 - x**2) ** 3 + 48.0 * x**2 * (1.0 - x**2) ** 2)
            # On the grid, the weights must be exact for angles that are polynomials of second order: a
            # constant and a line have the acceleration 0, and t^2 / 2 has 1.
            second -= second.mean()
            t_s = x / scale
            parabola = float(second @ (0.5 * t_s**2))
            starts = np.arange(0, len(part.angles_rad) - count + 1, max(1, round(_OVERLAP * count)))
            self._of_axes.append((w / w.sum(), second / parabola, starts))

    def second_derivative(self, angles_rad: Floats) -> list[Floats]:
        """Compute the mean acceleration of each axis [rad/s^2], weighted by each of its test functions.
        Shapes: `angles_rad` (n, 3); returns (k,).
        """
        return [
            _weighted_sums(second, starts, angles_rad[:, axis])
            for axis, (_, second, starts) in enumerate(self._of_axes)
        ]

    def mean(self, axis: int, values: Floats) -> Floats:
        """Average `values`, shape (n,) or (n, k), weighted by each test function of an `axis`, 0 to 2."""
        weights, _, starts = self._of_axes[axis]
        return _weighted_sums(weights, starts, values)


def _weighted_sums(weights: Floats, starts: Integers, values: Floats) -> Floats:
    """Sum up `values`, shape (n,) or (n, k), multiplied by the `weights` from each of the `starts` on."""
    windows = np.lib.stride_tricks.sliding_window_view(values, len(weights), axis=0)[starts]
    return np.asarray(windows @ weights)
