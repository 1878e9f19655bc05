"""Resample the columns of a table to even times, low-pass them and differentiate them twice."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_host.data.tables import Table
from numpy.typing import NDArray

from heli_lab.setup.guess.thresholds import EDGE_S, CUTOFF_Hz, SAMPLE_STEP_s

_EXTENDED_ROWS: Final = 15
"""Number of rows of padding at each end, reflected about the end value."""
_COUNTER: Final = 65536.0
"""Number at which a counter of 16 bits overflows."""
_WRAP_STEPS: Final = 3.0
"""Step across a wrap, as a multiple of the median step nearby. Angles have about 1; a voltage at take-off
has ten and more. A lost row next to a wrap doubles the step."""
_NEARBY_ROWS: Final = 10
"""Rows before and after a jump that count as nearby."""
_SETTLED_ROWS: Final = round(16.0 / (CUTOFF_Hz * SAMPLE_STEP_s))
"""Number of rows after which the impulse response of the low-pass filter has decayed to 1e-16."""


@dataclass(frozen=True)
class Signal:
    """A low-passed column and its derivatives: `value`, `rate` and `acceleration`, each of shape (n,).

    The unit is the column's, per s and per s^2.
    """

    value: Floats
    rate: Floats
    acceleration: Floats


@dataclass(frozen=True)
class Signals:
    """Columns of a table at even times, by name."""

    t_s: Floats  # (n,): Even times [s]
    raw: Mapping[str, Floats]  # (n,): Values at these times, unwrapped, without low-pass filter
    filtered: Mapping[str, Signal]  # Low-passed values with their derivatives
    inner: Booleans  # (n,): False for rows near both ends, where the filter has transients
    counts_per_turn: tuple[float, ...] = ()  # Counts per turn of the encoders that a column may come from


def column_signals(
    table: Table, t_s: Floats, names: list[str], counts_per_turn: Collection[float] = ()
) -> Signals:
    """Resample columns of a table to even times, and low-pass them. Shapes: `t_s` (n,)."""
    has_time = np.isfinite(t_s)
    has_time[has_time] = np.concatenate(([True], np.diff(t_s[has_time]) > 0.0))
    even_s = np.arange(t_s[has_time][0], t_s[has_time][-1], SAMPLE_STEP_s)
    raw = {}
    for name in names:
        values = table.columns[name].values
        known = has_time & np.isfinite(values)
        if known.sum() > 10:
            raw[name] = np.interp(even_s, t_s[known], unwrapped(values[known], counts_per_turn))
    filtered = {name: filtered_signal(samples) for name, samples in raw.items()}
    inner = (even_s > even_s[0] + EDGE_S) & (even_s < even_s[-1] - EDGE_S)
    return Signals(even_s, raw, filtered, inner, tuple(counts_per_turn))


def filtered_signal(values: Floats, cutoff_Hz: float = CUTOFF_Hz) -> Signal:
    """Low-pass evenly sampled `values` with zero phase, and differentiate the result twice."""
    extended = np.pad(values, _EXTENDED_ROWS, mode="reflect", reflect_type="odd")
    # The second pass, backwards in time, cancels the phase lag of the first one.
    forward = _butterworth(extended, cutoff_Hz)
    low_passed = _butterworth(forward[::-1], cutoff_Hz)[::-1][_EXTENDED_ROWS:-_EXTENDED_ROWS]
    rate = np.gradient(low_passed, SAMPLE_STEP_s)
    return Signal(low_passed, rate, np.gradient(rate, SAMPLE_STEP_s))


def _butterworth(values: Floats, cutoff_Hz: float) -> Floats:
    """Apply a fourth-order Butterworth low-pass that is settled at the first value.

    The result equals that of scipy.signal.sosfilt, but importing scipy.signal takes longer than a guess.
    """
    # The next power of 2 at which the end of the circular convolution does not reach its beginning.
    fft_rows = 1 << (values.size + _SETTLED_ROWS - 1).bit_length()
    spectrum = np.fft.rfft(values - values[0], fft_rows)
    convolution = np.fft.irfft(spectrum * _butterworth_response(fft_rows, cutoff_Hz), fft_rows)
    low_passed: Floats = convolution[: values.size] + values[0]
    return low_passed


@cache
def _butterworth_response(fft_rows: int, cutoff_Hz: float) -> NDArray[np.complex128]:
    """Frequency response of a digital fourth-order Butterworth filter (bilinear transform), at the
    frequencies of a real FFT of `fft_rows` values; shape (fft_rows / 2 + 1,).
    """
    warped = np.tan(np.pi * np.fft.rfftfreq(fft_rows)) / np.tan(np.pi * cutoff_Hz * SAMPLE_STEP_s)
    # Poles of the analogue prototype, evenly spaced on the left half of the unit circle.
    poles = np.exp(1j * np.pi * np.array([5.0, 7.0, 9.0, 11.0]) / 8.0)
    response: NDArray[np.complex128] = 1.0 / np.prod(1j * warped[:, None] - poles, axis=1)
    return response


def unwrapped(values: Floats, counts_per_turn: Collection[float] = ()) -> Floats:
    """Unwrap a column that jumps by one turn; return other columns unchanged. Shapes: `values` (n,).

    At a wrap, the jump minus one turn is a step as small as the steps nearby. A voltage that is switched on
    may jump by nearly a turn too, but the difference from a turn is large; such a column stays unchanged.
    """
    steps = np.abs(np.diff(values))
    # A wrap crosses almost the whole range of the column, and happens seldom.
    is_jump = steps > 0.5 * np.ptp(values)
    jumps = steps[is_jump]
    if not jumps.size or jumps.size > 0.02 * values.size:
        return values
    largest_smooth_step = _WRAP_STEPS * _median_steps_nearby(steps, is_jump)
    for turn in (2.0 * np.pi, 360.0, 1.0, *sorted(set(counts_per_turn)), _COUNTER):
        is_about_a_turn = np.all(np.abs(jumps / turn - 1.0) < 0.2)
        is_smooth = np.median(np.abs(jumps - turn) - largest_smooth_step) <= 0.0
        # The range of a wrapped angle is at most a turn.
        if is_about_a_turn and is_smooth and np.ptp(values) < 1.05 * turn:
            result: Floats = np.unwrap(values, period=turn)
            return result
    return values


def _median_steps_nearby(steps: Floats, is_jump: Booleans) -> Floats:
    """Compute the typical step of a column around each of its jumps. Shapes: `steps` (n,), `is_jump` (n,);
    returns (k,).
    """
    small_steps = np.where(is_jump, 0.0, steps)
    smallest = float(np.min(small_steps[small_steps > 0.0], initial=np.inf))
    if np.isinf(smallest):
        return np.zeros(int(is_jump.sum()))
    nearby_rows = [
        slice(max(row - _NEARBY_ROWS, 0), row + _NEARBY_ROWS + 1) for row in np.flatnonzero(is_jump)
    ]
    return np.array([max(float(np.median(small_steps[rows])), smallest) for rows in nearby_rows])


def delay(values: Floats, lag_s: float) -> Floats:
    """Delay evenly sampled `values` by `lag_s` [s]; the end value fills the gap."""
    rows = round(lag_s / SAMPLE_STEP_s)
    result: Floats = np.roll(values, rows)
    if rows > 0:
        result[:rows] = values[0]
    elif rows < 0:
        result[rows:] = values[-1]
    return result


def lagged(values: Floats, time_constant_s: float) -> Floats:
    """Pass evenly sampled `values` through a first-order lag that is settled at the first value."""
    age_s = np.arange(0.0, 10.0 * time_constant_s, SAMPLE_STEP_s)
    weight = np.exp(-age_s / time_constant_s)
    result: Floats = np.convolve(values - values[0], weight / weight.sum())[: values.size] + values[0]
    return result
