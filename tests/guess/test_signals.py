"""Signals are low-passed as the literature's filter does it: both ways, so that nothing is late."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.setup.guess.regression.signals import filtered_signal, unwrapped
from heli_lab.setup.guess.thresholds import CUTOFF_Hz, SAMPLE_STEP_s

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


def test_a_wrapped_angle_is_unwrapped_and_a_motor_that_is_switched_on_is_not() -> None:
    angle_deg: Floats = np.linspace(-300.0, 500.0, 2000)
    wrapped = np.mod(angle_deg + 180.0, 360.0) - 180.0
    assert np.ptp(unwrapped(wrapped)) == pytest.approx(800.0)
    # An encoder that turns by less than a count per row.
    counts = np.floor(np.arange(3000) / 40.0) % 64.0
    assert np.ptp(unwrapped(counts, (64.0,))) == 74.0
    # The command of a motor is steady at first, and noisy in flight.
    rising = 320.0 + 2.0 * np.arange(9.0)
    noise = np.clip(np.random.default_rng(1).normal(0.0, 30.0, 1500), -90.0, 90.0)
    percent: Floats = np.concatenate((np.zeros(200), rising, 200.0 + noise))
    assert unwrapped(percent) is percent
