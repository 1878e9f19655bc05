"""Steps do not depend on the pieces in which samples arrive; gaps are bridged, or the filter restarts."""

from __future__ import annotations

import numpy as np
from heli_host.declaration import Channel, State
from heli_lab.twin.flights import samples_of_ticks
from heli_lab.twin.samples import Samples, Step, Stepper
from hypothesis import given
from hypothesis import strategies as st


def made(first: int, count: int) -> Samples:
    number = np.arange(first, first + count)
    angles = np.sin(number[:, None] * 0.01 + np.arange(3))
    volts = np.cos(number[:, None] * 0.02 + np.arange(2))
    return Samples(number, angles, volts, number % 97 > 3, number % 89 > 70)


def told(steps: list[Step]) -> list[object]:
    return [
        (
            s.index,
            s.after_gap,
            s.flying,
            s.landing,
            s.samples,
            s.volts_V.tolist(),
            s.measured_rad is not None and s.measured_rad.tolist(),
        )
        for s in steps
    ]


@given(st.integers(0, 50), st.lists(st.integers(1, 60), min_size=1, max_size=12), st.sampled_from([1, 4, 10]))
def test_steps_do_not_depend_on_the_pieces(first: int, sizes: list[int], sample_ms: int) -> None:
    whole = made(first, sum(sizes))
    at_once = list(Stepper(1e-3 * sample_ms).update(whole))
    stepper, pieces, low = Stepper(1e-3 * sample_ms), [], 0
    for size in sizes:
        pieces += list(stepper.update(whole.select(slice(low, low + size))))
        low += size
    assert told(pieces) == told(at_once)


def test_a_step_holds_the_samples_of_its_ten_milliseconds() -> None:
    samples = made(13, 100)
    first, second, *_ = Stepper(0.001).update(samples)
    assert (first.index, first.after_gap, second.after_gap) == (2, True, False)
    assert np.array_equal(first.volts_V, samples.volts_V[7:17])
    about = samples.angles_rad[(samples.number >= 25) & (samples.number <= 35)]
    assert second.measured_rad is not None
    assert np.allclose(second.measured_rad, about.mean(axis=0))


def test_a_short_gap_is_bridged_and_after_a_long_one_the_filter_restarts() -> None:
    samples = made(0, 300)
    short = np.r_[0:103, 131:300]
    steps = list(Stepper(0.001).update(samples.select(short)))
    assert [s.index for s in steps] == list(range(30))
    assert [s.after_gap for s in steps] == [True] + 29 * [False]
    assert steps[12].measured_rad is None
    assert np.allclose(steps[11].volts_V, samples.volts_V[102])
    long = np.r_[0:103, 183:300]
    assert [s.index for s in Stepper(0.001).update(samples.select(long)) if s.after_gap] == [0, 19]


def test_a_clock_that_restarts_restarts_the_filter() -> None:
    stepper = Stepper(0.001)
    list(stepper.update(made(500, 100)))
    assert next(iter(stepper.update(made(0, 50)))).after_gap


def test_a_board_that_lands_says_so() -> None:
    states = [State.IDLE, State.CLOSED_LOOP, State.LANDING, State.EMERGENCY_LANDING, State.FAULT]
    raw = np.zeros((len(states), len(Channel)), np.int32)
    raw[:, Channel.STATE] = [int(state) for state in states]
    found = samples_of_ticks(np.arange(len(states)), raw, np.ones(3))
    assert found.flying.tolist() == [False, True, True, True, False]
    assert found.landing.tolist() == [False, False, True, True, False]
