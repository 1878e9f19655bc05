"""An encoder that jumps and returns is reported as that; one that stays raises an alarm with the evidence."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_host.flight import Flight
from heli_lab.twin.files import DEFAULT_CALIBRATION, TwinRig
from heli_lab.twin.flights import count_rad_of
from heli_lab.twin.glitches import MAX_BLOCKS, GlitchWatch
from heli_lab.twin.healthy_flights import fly_simulated, random_plan
from heli_lab.twin.monitor import TwinReport, monitor_flight
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

COUNT_rad = np.full(3, 1.0)
RIG = load_rig("makki2024")


class _Filter:
    """A filter of which only the differences from its predictions matter."""

    left_out: int | None = None

    def __init__(self, std_rad: float) -> None:
        self.differences_rad, self.stds_rad = np.zeros(3), np.full(3, std_rad)

    def copy(self) -> _Filter:
        return _Filter(float(self.stds_rad[0]))


def decisions(pitch_counts: list[float], settled: int = 20, std_counts: float = 0.3) -> list[str]:
    """State after each measurement whether nothing happens, it is open, or the encoder has returned.

    Before it, `settled` measurements agreed with their predictions; `std_counts` is the standard deviation of
    a prediction.
    """
    watch: GlitchWatch[_Filter] = GlitchWatch(COUNT_rad)
    kalman, ratio = _Filter(std_counts), _Filter(std_counts)
    result = []
    for counts in settled * [0.0] + pitch_counts:
        before = watch.copies(kalman, ratio)  # type: ignore[arg-type]
        kalman.differences_rad[1] = counts
        watch.begin_jump(kalman, before)
        if watch.alternative is None:
            result.append("-")
            continue
        watch.alternative.kalman.differences_rad[1] = counts
        if watch.returned():
            watch.end_jump(1.0, 0.04)
            result.append("returned")
        else:
            result.append("-" if watch.alternative is None else "open")
    return result[settled:]


def test_a_jump_that_returns_is_reported_once() -> None:
    assert decisions([6.0, 6.0, 5.0, 0.0, 0.0]) == ["open", "open", "open", "returned", "-"]


def test_an_encoder_that_stays_is_open_for_half_a_second() -> None:
    assert decisions(30 * [6.0]) == MAX_BLOCKS * ["open"] + (30 - MAX_BLOCKS) * ["-"]
    assert MAX_BLOCKS * 0.04 < 0.5


def test_an_axis_that_moves_away_after_a_kick_is_open_for_two_measurements_only() -> None:
    assert decisions([5.0, 12.0, 20.0, 28.0]) == ["open", "open", "-", "-"]


def test_a_loose_contact_is_soon_followed() -> None:
    """The twin is not blind: it leaves out few measurements of an encoder that jumps all the time."""
    jumps = decisions(100 * [6.0, 0.0, 0.0])
    assert jumps.count("open") <= MAX_BLOCKS + 0.04 * 300


def test_two_counts_are_no_jump() -> None:
    assert set(decisions([2.0, 2.0, 0.0])) == {"-"}


def test_less_than_five_standard_deviations_are_no_jump() -> None:
    assert set(decisions([4.9, 4.9, 0.0], std_counts=1.0)) == {"-"}
    assert decisions([5.1, 5.1, 0.0], std_counts=1.0) == ["open", "open", "returned"]


def test_no_jump_begins_before_the_filter_has_settled_for_half_a_second() -> None:
    assert set(decisions([6.0, 6.0, 0.0], settled=MAX_BLOCKS - 1)) == {"-"}
    assert decisions([6.0, 6.0, 0.0], settled=MAX_BLOCKS) == ["open", "open", "returned"]


@cache
def healthy() -> Flight:
    return fly_simulated(MultibodyModel(), RIG, random_plan(3, 45.0), 3)


def report(counts: int, at_s: float, length_s: float) -> TwinReport:
    """Monitor a healthy flight whose elevation encoder is wrong by `counts` for a while."""
    flight = healthy()
    wrong = (flight.t_s >= at_s) & (flight.t_s < at_s + length_s)
    shift_rad = counts * count_rad_of(flight, RIG)[0]
    elevation_rad = flight.elevation_rad + np.where(wrong, shift_rad, 0.0)
    twin_rig = TwinRig(RIG, MultibodyModel(), DEFAULT_CALIBRATION, "makki2024")
    return monitor_flight(twin_rig, replace(flight, elevation_rad=elevation_rad), "jump", 10.0, stop_s=32.0)


@pytest.mark.slow
def test_a_flight_with_a_jump_for_a_fifth_of_a_second_is_quiet_and_reports_the_jump() -> None:
    seen = report(6, 22.0, 0.2)
    assert not seen.alarms and seen.max_evidence_nats < seen.threshold_nats
    (jump,) = (text for text in seen.sentences() if "jumped" in text)
    assert jump.startswith("the elevation encoder jumped by 6 counts at 22.0 s and returned within 0.")


@pytest.mark.slow
def test_an_encoder_that_lost_edges_is_named_within_a_second() -> None:
    seen = report(6, 22.0, 1e3)
    alarms = [event for event in seen.events if event.kind == "alarm"]
    assert 22.0 < alarms[0].t_s < 23.0
    assert alarms[0].ranking[0].change.id == "zero_offset.elevation"
    assert seen.max_evidence_nats > 5.0 * seen.threshold_nats
    assert not any("jumped" in text for text in seen.sentences())
