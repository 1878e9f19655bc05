"""Steps do not depend on the batches of samples; short gaps are bridged, long ones restart the filter."""

from __future__ import annotations

import numpy as np
from heli_host.declaration import Channel, State
from heli_lab.watch.steps import Samples, Step, Stepper, samples_of_ticks
from hypothesis import given
from hypothesis import strategies as st

TICK_s = 1e-3


def smooth_samples(first: int, count: int) -> Samples:
    """Return samples with smooth angles and voltages that are numbered from `first` on."""
    number = np.arange(first, first + count)
    angles_rad = np.sin(number[:, None] * 0.01 + np.arange(3))
    volts_V = np.cos(number[:, None] * 0.02 + np.arange(2))
    return Samples(number, angles_rad, volts_V, flying=number % 97 > 3, landing=number % 89 > 70)


def comparable(steps: list[Step]) -> list[object]:
    """Return the steps with lists instead of arrays, so that ``==`` can compare them."""
    return [
        (
            step.index,
            step.after_gap,
            step.flying,
            step.landing,
            step.samples,
            step.volts_V.tolist(),
            None if step.measured_rad is None else step.measured_rad.tolist(),
        )
        for step in steps
    ]


@given(
    first=st.integers(0, 50),
    batch_sizes=st.lists(st.integers(1, 60), min_size=1, max_size=12),
    sample_ms=st.sampled_from([1, 4, 10]),
)
def test_steps_do_not_depend_on_the_batches(first: int, batch_sizes: list[int], sample_ms: int) -> None:
    samples = smooth_samples(first, sum(batch_sizes))
    steps_of_one_batch = list(Stepper(1e-3 * sample_ms).update(samples))
    stepper = Stepper(1e-3 * sample_ms)
    steps: list[Step] = []
    start = 0
    for size in batch_sizes:
        steps += stepper.update(samples.select(slice(start, start + size)))
        start += size
    assert comparable(steps) == comparable(steps_of_one_batch)


def test_a_step_contains_the_samples_of_its_ten_milliseconds() -> None:
    samples = smooth_samples(13, 100)
    first, second, *_ = Stepper(TICK_s).update(samples)
    # Steps begin at multiples of 10 ms: the first one at tick 20, the second one at tick 30.
    assert (first.index, first.after_gap, second.after_gap) == (2, True, False)
    assert np.array_equal(first.volts_V, samples.volts_V[7:17])
    # The angles at the beginning of a step are the mean of the samples within half a step.
    is_near_tick_30 = (samples.number >= 25) & (samples.number <= 35)
    assert second.measured_rad is not None
    assert np.allclose(second.measured_rad, samples.angles_rad[is_near_tick_30].mean(axis=0))


def test_a_short_gap_is_bridged() -> None:
    samples = smooth_samples(0, 300)
    with_gap_of_28_ms = samples.select(np.r_[0:103, 131:300])
    steps = list(Stepper(TICK_s).update(with_gap_of_28_ms))
    assert [step.index for step in steps] == list(range(30))
    assert [step.after_gap for step in steps] == [True] + 29 * [False]
    assert steps[12].measured_rad is None
    # The last voltage before the gap holds over the gap.
    assert np.allclose(steps[11].volts_V, samples.volts_V[102])


def test_the_steps_restart_after_a_long_gap() -> None:
    with_gap_of_80_ms = smooth_samples(0, 300).select(np.r_[0:103, 183:300])
    steps = list(Stepper(TICK_s).update(with_gap_of_80_ms))
    assert [step.index for step in steps if step.after_gap] == [0, 19]


def test_a_clock_that_restarts_restarts_the_steps() -> None:
    stepper = Stepper(TICK_s)
    list(stepper.update(smooth_samples(500, 100)))
    first_step = next(iter(stepper.update(smooth_samples(0, 50))))
    assert first_step.after_gap


def test_states_of_the_board_become_flying_and_landing() -> None:
    states = [State.IDLE, State.CLOSED_LOOP, State.LANDING, State.EMERGENCY_LANDING, State.FAULT]
    raw = np.zeros((len(states), len(Channel)), np.int32)
    raw[:, Channel.STATE] = [int(state) for state in states]
    samples = samples_of_ticks(np.arange(len(states)), raw, np.ones(3))
    assert samples.flying.tolist() == [False, True, True, True, False]
    assert samples.landing.tolist() == [False, False, True, True, False]
