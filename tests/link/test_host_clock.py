"""The map from device time to host time, from arrivals that are late by anything but never early."""

from __future__ import annotations

import random

import numpy as np
import pytest
from heli_host.declaration import Channel
from heli_host.link.clock import ClockEstimate, ClockFit
from heli_host.link.telemetry import TickAccount, Ticks


def arrivals(
    fit: ClockFit,
    *,
    ticks: range,
    tick_s: float = 1e-3,
    start_s: float = 100.0,
    quickest_s: float = 0.0,
    late_s: float = 0.02,
) -> None:
    """Batches of 20 ticks, each late by a length of time that only chance knows."""
    chance = random.Random(3)
    for tick in ticks[::20]:
        fit.observe(tick, start_s + tick * tick_s + quickest_s + late_s * chance.random() ** 2)


def estimated(fit: ClockFit) -> ClockEstimate:
    estimate = fit.estimate()
    assert estimate is not None
    return estimate


def test_nothing_seen_is_no_estimate() -> None:
    assert ClockFit().estimate() is None


@pytest.mark.parametrize("drift_ppm", [-80.0, 0.0, 50.0])
def test_offset_and_drift_are_found_below_late_arrivals(drift_ppm: float) -> None:
    fit = ClockFit()
    tick_s = 1e-3 / (1.0 + drift_ppm * 1e-6)
    arrivals(fit, ticks=range(60_000), tick_s=tick_s)
    estimate = estimated(fit)
    assert estimate.host_s_at(60_000) == pytest.approx(100.0 + 60_000 * tick_s, abs=1e-3)
    assert estimate.drift_ppm == pytest.approx(drift_ppm, abs=15.0)
    assert estimate.tick_at(estimate.host_s_at(12_345.0)) == pytest.approx(12_345.0, abs=1e-3)
    assert 0.01 < estimate.jitter_s < 0.021


def test_half_of_the_shortest_round_trip_is_taken_off() -> None:
    fit = ClockFit()
    for second in range(30):
        tick = 1000 * second
        asked_s = 100.0 + tick * 1e-3 - 0.002
        fit.observe_pong(asked_s, tick, asked_s + 0.004)
        arrivals(fit, ticks=range(tick + 20, tick + 1000), quickest_s=0.006)
    estimate = estimated(fit)
    assert estimate.round_trip_s == pytest.approx(0.004)
    assert estimate.host_s_at(29_000) == pytest.approx(129.0, abs=1e-3)


@pytest.mark.parametrize("speed", [0.2, 5.0, 50.0])
def test_a_simulation_at_any_speed_is_followed(speed: float) -> None:
    fit = ClockFit()
    arrivals(fit, ticks=range(30_000), tick_s=1e-3 / speed, late_s=0.01 / speed)
    assert estimated(fit).rate == pytest.approx(speed, rel=1e-3)


def test_a_pause_of_the_device_is_forgotten_within_three_seconds() -> None:
    fit = ClockFit()
    arrivals(fit, ticks=range(30_000))
    arrivals(fit, ticks=range(30_000, 33_000), start_s=101.5)
    assert estimated(fit).host_s_at(33_000) == pytest.approx(134.5, abs=3e-3)


def test_a_change_of_speed_is_followed() -> None:
    fit = ClockFit()
    arrivals(fit, ticks=range(20_000))
    arrivals(
        fit, ticks=range(20_000, 80_000), start_s=100.0 + 20.0 - 20_000 * 1e-4, tick_s=1e-4, late_s=0.002
    )
    estimate = estimated(fit)
    assert estimate.rate == pytest.approx(10.0, rel=0.02)
    assert estimate.host_s_at(80_000) == pytest.approx(126.0, abs=0.01)


def test_one_arrival_gives_an_offset_at_the_nominal_rate() -> None:
    fit = ClockFit()
    fit.observe(500, 7.0)
    assert estimated(fit).host_s_at(1500) == pytest.approx(8.0)


def test_a_reset_forgets() -> None:
    fit = ClockFit()
    arrivals(fit, ticks=range(5000))
    fit.reset()
    assert fit.estimate() is None


def ticks_of(*numbers: int) -> Ticks:
    tick = np.array([number % 2**32 for number in numbers], np.uint32)
    return Ticks(tick, np.arange(len(numbers) * len(Channel), dtype=np.int32).reshape(-1, len(Channel)))


def test_consecutive_ticks_are_received_and_none_lost() -> None:
    account = TickAccount()
    account.take(ticks_of(7, 8, 9))
    account.take(ticks_of(10, 11))
    assert (account.received, account.lost, account.last) == (5, 0, 11)


def test_gaps_between_and_within_readings_are_lost() -> None:
    account = TickAccount()
    account.take(ticks_of(7, 8, 12))
    accepted, jumped = account.take(ticks_of(20, 21))
    assert (account.received, account.lost, account.last) == (5, 3 + 7, 21)
    assert (len(accepted), jumped) == (2, False)


def test_ticks_are_counted_on_when_32_bits_run_out() -> None:
    account = TickAccount()
    account.take(ticks_of(2**32 - 2, 2**32 - 1, 2**32, 2**32 + 3))
    assert (account.received, account.lost, account.last) == (4, 2, 2**32 + 3)
    assert account.unwrap(5) == 2**32 + 5
    assert account.unwrap(2**32 - 1) == 2**32 - 1


def test_a_jump_back_ends_what_is_accepted() -> None:
    account = TickAccount()
    accepted, jumped = account.take(ticks_of(100, 101, 3, 4))
    assert jumped
    assert accepted.tick.tolist() == [100, 101]
    accepted, jumped = account.take(ticks_of(101, 102))
    assert jumped
    assert len(accepted) == 0
    assert (account.received, account.lost) == (2, 0)
    account.restart()
    account.take(ticks_of(3, 4))
    assert (account.received, account.lost, account.last) == (4, 0, 4)
