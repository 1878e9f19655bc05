"""The simulated clock is a matter of arithmetic: what is due at a given time, after given bytes."""

from __future__ import annotations

import pytest
from heli_sim.sil.clock import Clock, LockstepClock, TimedClock, make_clock


def run(clock: Clock, until_s: float, tick: int = 0, start_s: float = 0.0, late_s: float = 0.0) -> int:
    """Ask as a server does, waking up late each time; the tick reached."""
    now_s = start_s
    while now_s < until_s:
        ticks = clock.ticks_due(now_s, tick)
        tick += ticks
        if ticks == 0:
            now_s += max(clock.wait_s(now_s, tick), 1e-9) + late_s
    return tick


@pytest.mark.medium
@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0, 50.0])
@pytest.mark.parametrize("late_s", [0.0, 0.0013])
def test_a_timed_clock_does_not_drift_however_late_it_wakes(speed: float, late_s: float) -> None:
    slice_ticks = max(4, min(20, round(4 * speed)))
    assert run(TimedClock(speed), 60.0, late_s=late_s) == pytest.approx(
        60_000 * speed, abs=2 * slice_ticks + 1300 * speed * 1e-3
    )


def test_real_time_wakes_up_every_4_ms() -> None:
    clock = TimedClock(1.0)
    assert clock.ticks_due(10.0, 0) == 0
    assert clock.wait_s(10.0, 0) == pytest.approx(0.004)
    assert clock.ticks_due(10.0041, 0) == 4
    assert clock.wait_s(10.0041, 4) == pytest.approx(0.0039)


def test_a_short_hold_up_is_caught_up_and_a_long_one_is_given_up() -> None:
    clock = TimedClock(1.0)
    tick = run(clock, 1.0)
    tick = run(clock, 2.0, tick, start_s=1.3)
    assert tick == pytest.approx(2000, abs=8)
    assert clock.slipped_s == 0.0
    tick = run(clock, 102.0, tick, start_s=101.0)
    assert tick == pytest.approx(3000, abs=8)
    assert clock.slipped_s == pytest.approx(99.0, abs=0.01)


def test_lockstep_runs_40_ms_ahead_of_the_host_and_no_further() -> None:
    clock = LockstepClock()
    tick = 0
    while ticks := clock.ticks_due(5.0, tick):
        tick += ticks
    assert tick == 40
    assert clock.ticks_due(5.0, tick) == 0
    clock.heard(5.0, tick)
    while ticks := clock.ticks_due(5.0, tick):
        tick += ticks
    assert tick == 80


def test_lockstep_simulates_at_most_20_ms_in_one_slice() -> None:
    clock = LockstepClock()
    assert [clock.ticks_due(5.0, tick) for tick in (0, 20, 37)] == [20, 20, 0]
    assert clock.ticks_due(7.0, 20) == 20


def test_lockstep_never_runs_slower_than_real_time() -> None:
    clock = LockstepClock()
    assert run(clock, 5.0) == pytest.approx(5040, abs=4)


def test_lockstep_waits_no_longer_than_real_time_needs() -> None:
    clock = LockstepClock()
    tick = 0
    while ticks := clock.ticks_due(0.0, tick):
        tick += ticks
    assert clock.wait_s(0.0, tick) == pytest.approx(0.004)


def test_after_a_silence_the_window_counts_from_the_next_byte() -> None:
    clock = LockstepClock()
    tick = run(clock, 3.0)
    clock.heard(3.0, tick)
    assert run(clock, 3.0 + 1e-6, tick, start_s=3.0) == tick + 40


def test_only_lockstep_follows_the_host() -> None:
    assert make_clock(None).follows_host
    assert not make_clock(2.0).follows_host
