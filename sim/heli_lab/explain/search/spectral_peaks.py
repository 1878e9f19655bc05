"""Finds the frequencies at which a periodic torque would improve a model most, from scores of impulses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

_MAX_PEAKS: Final = 4
"""Frequencies that are tried on each axis. Fewer: a periodic torque is missed in large disturbances. More:
time."""
_MIN_Hz, _MAX_Hz = 0.03, 12.0
"""Range of the frequencies. Below, a period is longer than half a minute of flight; above, the arm hardly
moves."""
_DEFAULT_Hz: Final = 0.5
"""Frequency that is tried if the spectrum has no peak."""
_PADDING: Final = 4
"""Points of a spectrum for each frequency that a flight distinguishes."""
_NEIGHBOURS: Final = 10
"""Frequencies on either side of a peak whose median standardises the peak. Fewer: a peak, which is four
frequencies wide, raises this median itself. More: the slope of the spectrum makes false peaks."""


def peak_frequencies_Hz(impulse_scores: Sequence[Floats], step_s: float) -> tuple[float, ...]:
    """Return the frequencies at which a periodic torque is most significant, the most significant first.
    Shapes: `impulse_scores` (k,).

    The score of a periodic torque is the Fourier transform of the scores of an impulse at every instant.
    Disturbances and quantisation alone give this transform a smooth spectrum, which the median of
    neighbouring frequencies estimates. A peak counts by its ratio to that median.
    """
    point_count = _PADDING * max(map(len, impulse_scores))
    windowed = [(score - score.mean()) * np.hanning(len(score)) for score in impulse_scores]
    # Powers are added, not amplitudes, because the phase may differ from flight to flight.
    power = np.sum([np.abs(np.fft.rfft(score, point_count)) ** 2 for score in windowed], axis=0)
    power /= np.maximum(_local_median(power), np.finfo(float).tiny)
    frequency_Hz = np.fft.rfftfreq(point_count, step_s)
    power[(frequency_Hz < _MIN_Hz) | (frequency_Hz > _MAX_Hz)] = 0.0
    peaks = 1 + np.flatnonzero((power[:-2] <= power[1:-1]) & (power[1:-1] > power[2:]))
    highest = peaks[np.argsort(-power[peaks], kind="stable")][:_MAX_PEAKS]
    return tuple(map(float, frequency_Hz[highest])) or (_DEFAULT_Hz,)


def _local_median(power: Floats) -> Floats:
    """Return the median of a spectrum over the neighbouring frequencies of each of its points, shape (k,)."""
    reach = _PADDING * _NEIGHBOURS
    padded = np.pad(power, reach, mode="reflect")
    neighbours = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)[:, ::_PADDING]
    return np.asarray(np.median(neighbours, axis=1))
