"""An encoder that jumps and returns is reported as a jump; an encoder that stays away raises an alarm."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.watch.calibration import DEFAULT_CALIBRATION, TwinRig
from heli_lab.watch.glitches import MAX_BLOCKS, REFILL, GlitchWatch
from heli_lab.watch.learn import fly_simulated, random_plan
from heli_lab.watch.monitor import TwinReport, monitor_flight
from heli_lab.watch.steps import count_rad_of
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

COUNT_rad = np.full(3, 1.0)
"""Angles are in counts here [rad]."""
BLOCK_s = 0.04
ELEVATION, PITCH = 0, 1
RIG = load_rig("makki2024")


class _Filter:
    """A filter whose differences from its predictions the test sets itself."""

    left_out: int | None = None

    def __init__(self, std_rad: float) -> None:
        self.differences_rad, self.stds_rad = np.zeros(3), np.full(3, std_rad)

    def copy(self) -> _Filter:
        return _Filter(float(self.stds_rad[0]))


def decisions(
    differences_counts: list[float], settled_blocks: int = 20, std_counts: float = 0.3
) -> list[str]:
    """Return the decision after each measurement of pitch.

    Parameters
    ----------
    differences_counts : list of float
        Measured minus predicted pitch of each measurement [counts].
    settled_blocks : int
        Number of earlier measurements, which agreed with their predictions.
    std_counts : float
        Standard deviation of a prediction [counts].

    Returns
    -------
    list of str
        ``open`` while a jump may return, ``returned`` when the encoder has returned, otherwise ``-``.
    """
    watch: GlitchWatch[_Filter] = GlitchWatch(COUNT_rad)
    kalman, ratio = _Filter(std_counts), _Filter(std_counts)

    def decision(counts: float) -> str:
        before = watch.copies(kalman, ratio)  # type: ignore[arg-type]
        kalman.differences_rad[PITCH] = counts
        watch.begin_jump(kalman, before)
        if watch.alternative is None:
            return "-"
        watch.alternative.kalman.differences_rad[PITCH] = counts
        if watch.decide_return():
            watch.end_jump(t_s=1.0, block_s=BLOCK_s)
            return "returned"
        return "-" if watch.alternative is None else "open"

    for _ in range(settled_blocks):
        decision(0.0)
    return [decision(counts) for counts in differences_counts]


def test_a_jump_that_returns_is_reported_once() -> None:
    assert decisions([6.0, 6.0, 5.0, 0.0, 0.0]) == ["open", "open", "open", "returned", "-"]


def test_a_jump_in_the_other_direction_returns_too() -> None:
    assert decisions([-6.0, -6.0, -5.0, 0.0, 0.0]) == ["open", "open", "open", "returned", "-"]


def test_a_slow_fall_is_the_drift_of_the_prediction_and_no_return() -> None:
    drifting = [5.4, 4.9, 4.5, 4.2, 3.8, 3.7, 3.5, 3.1, 2.6, 2.3, 2.0, 1.8]
    assert decisions(drifting) == MAX_BLOCKS * ["open"]
    assert decisions([*drifting[:6], -1.7]) == [*(6 * ["open"]), "returned"]


def test_a_return_within_two_measurements_is_a_return() -> None:
    assert decisions([6.0, 6.0, 3.5, 0.2]) == ["open", "open", "open", "returned"]


def test_a_jump_without_a_return_is_open_for_half_a_second() -> None:
    assert decisions(30 * [6.0]) == MAX_BLOCKS * ["open"] + (30 - MAX_BLOCKS) * ["-"]
    assert MAX_BLOCKS * BLOCK_s < 0.5


def test_a_growing_difference_after_a_kick_is_open_for_two_measurements() -> None:
    assert decisions([5.0, 12.0, 20.0, 28.0]) == ["open", "open", "-", "-"]


def test_few_measurements_of_a_loose_contact_are_left_out() -> None:
    """An encoder that jumps all the time is damaged, and must raise an alarm."""
    differences_counts = 100 * [6.0, 0.0, 0.0]
    left_out = decisions(differences_counts).count("open")
    assert left_out <= MAX_BLOCKS + REFILL * len(differences_counts)


def test_two_counts_are_no_jump() -> None:
    assert set(decisions([2.0, 2.0, 0.0])) == {"-"}


def test_less_than_five_standard_deviations_are_no_jump() -> None:
    assert set(decisions([4.9, 4.9, 0.0], std_counts=1.0)) == {"-"}
    assert decisions([5.1, 5.1, 0.0], std_counts=1.0) == ["open", "open", "returned"]


def test_no_jump_begins_before_the_filter_has_settled_for_half_a_second() -> None:
    assert set(decisions([6.0, 6.0, 0.0], settled_blocks=MAX_BLOCKS - 1)) == {"-"}
    assert decisions([6.0, 6.0, 0.0], settled_blocks=MAX_BLOCKS) == ["open", "open", "returned"]


@cache
def healthy_flight() -> Flight:
    return fly_simulated(MultibodyModel(), RIG, random_plan(3, 45.0), seed=3)


def report_of_jump(counts: int, at_s: float, length_s: float) -> TwinReport:
    """Monitor a flight whose elevation encoder is wrong by `counts` for `length_s`."""
    flight = healthy_flight()
    is_wrong = (flight.t_s >= at_s) & (flight.t_s < at_s + length_s)
    shift_rad = counts * count_rad_of(flight, RIG)[ELEVATION]
    elevation_rad = flight.elevation_rad + np.where(is_wrong, shift_rad, 0.0)
    twin_rig = TwinRig(RIG, MultibodyModel(), DEFAULT_CALIBRATION, "makki2024")
    return monitor_flight(twin_rig, replace(flight, elevation_rad=elevation_rad), "jump", 10.0, stop_s=32.0)


@pytest.mark.slow
def test_a_jump_for_a_fifth_of_a_second_is_reported_without_an_alarm() -> None:
    report = report_of_jump(6, at_s=22.0, length_s=0.2)
    assert not report.alarms and report.max_evidence_nats < report.threshold_nats
    (sentence,) = (sentence for sentence in report.sentences() if "jumped" in sentence)
    assert sentence.startswith("the elevation encoder jumped by 6 counts at 22.0 s and returned within 0.")


@pytest.mark.slow
def test_an_encoder_that_lost_edges_is_named_within_a_second() -> None:
    report = report_of_jump(6, at_s=22.0, length_s=1e3)
    first_alarm = next(event for event in report.events if event.kind == "alarm")
    assert 22.0 < first_alarm.t_s < 23.0
    assert first_alarm.ranking[0].change.id == "zero_offset.elevation"
    assert report.max_evidence_nats > 5.0 * report.threshold_nats
    assert not any("jumped" in sentence for sentence in report.sentences())
