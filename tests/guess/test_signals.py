"""Signals are low-passed as the literature's filter does it: both ways, so that nothing is late."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.guess.regression.signals import filtered_signal
from heli_lab.guess.thresholds import CUTOFF_Hz, SAMPLE_STEP_s

pytestmark = pytest.mark.medium


@pytest.mark.parametrize("rows", [16, 40, 6001])
def test_the_low_pass_is_the_butterworth_filter_of_scipy_both_ways(rows: int) -> None:
    from scipy.signal import butter, sosfiltfilt

    wandering = np.cumsum(np.random.default_rng(rows).normal(size=rows)) + 100.0
    sections = butter(4, CUTOFF_Hz, fs=1.0 / SAMPLE_STEP_s, output="sos")
    low = sosfiltfilt(sections, wandering)
    guess_result = filtered_signal(wandering)
    np.testing.assert_allclose(guess_result.value, low, atol=1e-10)
    acceleration = np.gradient(np.gradient(low, SAMPLE_STEP_s), SAMPLE_STEP_s)
    np.testing.assert_allclose(
        guess_result.acceleration, acceleration, atol=1e-8 * np.abs(acceleration).max()
    )
