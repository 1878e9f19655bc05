"""Periodic torques are tried at the frequencies where they are significant."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.explain.screening import peak_frequencies_Hz

STEP_s = 0.04
PERIODIC_Hz = 2.34


def impulse_scores(seed: int, size: float, seconds: float = 45.0) -> Floats:
    """Scores of impulses under slow disturbances, with a periodic torque of this size."""
    t_s = np.arange(0.0, seconds, STEP_s)
    noise = np.random.default_rng(seed).standard_normal((2, len(t_s)))
    slow = np.zeros(len(t_s))
    for i in range(1, len(t_s)):
        slow[i] = 0.97 * slow[i - 1] + noise[0, i]
    scores: Floats = slow + noise[1] + size * np.sin(2.0 * np.pi * PERIODIC_Hz * t_s)
    return scores


@pytest.mark.parametrize("seed", range(5))
def test_a_periodic_torque_far_below_slow_disturbances_is_tried_first(seed: int) -> None:
    first, *_ = peak_frequencies_Hz([impulse_scores(seed, 0.8)], STEP_s)
    assert first == pytest.approx(PERIODIC_Hz, abs=0.02)


def test_a_periodic_torque_in_the_second_flight_alone_is_tried_too() -> None:
    flights = [impulse_scores(6, 0.0), impulse_scores(7, 0.8, 60.0)]
    assert peak_frequencies_Hz(flights, STEP_s)[0] == pytest.approx(PERIODIC_Hz, abs=0.02)


def test_scores_of_a_resting_axis_give_one_default_frequency() -> None:
    assert peak_frequencies_Hz([np.zeros(500)], STEP_s) == (0.5,)
