"""When the twin raises, names and suppresses alarms, for given sequences of evidence."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_host.board.twins import TwinNews, TwinWatch
from heli_host.data.flight import Flight
from heli_host.declaration import CHANNELS
from heli_host.link.session import Session
from heli_host.link.telemetry import Ticks
from heli_lab.watch import twin as twin_module
from heli_lab.watch.calibration import DEFAULT_CALIBRATION, Calibration, Tail, TwinRig
from heli_lab.watch.glitches import MAX_BLOCKS, REFILL, GlitchWatch
from heli_lab.watch.learn import fly_simulated, random_plan
from heli_lab.watch.likelihood_ratio import (
    ONSETS,
    PERSISTENCE_BLOCKS,
    ChangeCandidate,
    Innovation,
    LikelihoodRatio,
)
from heli_lab.watch.monitor import TwinReport, monitor_flight
from heli_lab.watch.steps import Samples, VoltageRange, count_rad_of
from heli_lab.watch.twin import DIAGNOSIS_DELAY_s, Twin, TwinEvent
from heli_lab.watch.twin_model import EXACT, Change, ParameterUncertainty, all_changes
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

CHANGES = all_changes()
COLUMNS = sum(len(change.parameters) for change in CHANGES)
THRESHOLD_nats = 15.0
ABOVE, BELOW = [16.0], [1.0]
"""Evidence of one measurement above and below the threshold [nats]; ``3 * ABOVE`` are three measurements."""
COUNT_rad = np.full(3, 2 * np.pi / 4096)
BLOCK_s = 0.04
BLOCK_ms = 40
STEP_ms = 10
FREE_ms = 1520
"""Time at which the comparison begins [ms]: one step after the settling time off the table."""
MOTORS_OFF_ms = 50
DIAGNOSIS_BLOCKS = round(DIAGNOSIS_DELAY_s / BLOCK_s)
"""Number of measurements from an alarm to its final ranking."""
CALIBRATION_s = 8.0
"""Time at the beginning of a flight in which evidence contradicts the model [s]."""


class _StillFilter:
    """A filter whose innovations have the given `value`, and that estimates nothing."""

    value: Any = np.zeros(3)

    def __init__(self, *_: Any, **__: Any) -> None:
        states, order = 6, 17
        self.state, self.mean = np.zeros(states), np.zeros(order)
        self.state_sensitivity = np.zeros((order, COLUMNS, ONSETS))

    def predict(self, *_: Any) -> None: ...

    def propagate_sensitivity(self, *_: Any) -> None: ...

    def update(self, *_: Any, **__: Any) -> Innovation:
        return Innovation(self.value, np.zeros((3, COLUMNS, ONSETS)))


def reported_events(
    monkeypatch: pytest.MonkeyPatch,
    evidence_nats: list[float],
    *,
    off_after: int | None = None,
    lands_after: int | None = None,
    calibration_s: float = 0.0,
    uncertainty: ParameterUncertainty = EXACT,
    change: Change = CHANGES[0],
    size: float = 0.1,
    shown_nats: dict[str, float] | None = None,
) -> list[tuple[str, int]]:
    """Run a twin on a flight at rest with the given evidence of each measurement."""
    # Return the kind of each event, and the number of measurements before it.
    # After `off_after` measurements the motors are off for a moment; after `lands_after` a landing begins.
    # Both rotors get 1 V. The most likely change is `change` of the `size`. `shown_nats` gets the evidence
    # that is shown after each kind of event.
    remaining_evidence = iter(evidence_nats)
    candidate = ChangeCandidate(change, onset_block=0, size=size, std=0.01, log_evidence=THRESHOLD_nats)
    monkeypatch.setattr(twin_module, "CALIBRATION_s", calibration_s)
    monkeypatch.setattr(twin_module, "KalmanFilter", _StillFilter)
    monkeypatch.setattr(twin_module, "start_state", lambda *_: np.zeros(6))
    monkeypatch.setattr(LikelihoodRatio, "update_cut", lambda *_: next(remaining_evidence, 0.0))
    monkeypatch.setattr(LikelihoodRatio, "ranking", lambda *_, **__: [candidate, candidate])
    model: Any = SimpleNamespace(
        rig=load_rig("makki2024"),
        delay_s=0.0,
        min_thrust_V=-math.inf,
        changes=CHANGES,
        scales=(),
        uncertainty=uncertainty,
    )
    # So few excursions per hour that the threshold is the level of the tail.
    tail = Tail(THRESHOLD_nats, per_hour=1e-9, scale_nats=1.0, excesses=20)
    twin = Twin(
        model,
        Calibration(DEFAULT_CALIBRATION.disturbances, tail),
        COUNT_rad,
        sample_s=1e-3,
        watches_glitches=False,
    )
    count = 4000 + BLOCK_ms * len(evidence_nats)
    flying, landing = np.ones(count, bool), np.zeros(count, bool)
    if off_after is not None:
        off_ms = FREE_ms + BLOCK_ms * off_after
        flying[off_ms : off_ms + MOTORS_OFF_ms] = False
    if lands_after is not None:
        landing[FREE_ms + BLOCK_ms * lands_after :] = True
    samples = Samples(np.arange(count), np.zeros((count, 3)), np.ones((count, 2)), flying, landing)
    events = []
    for start in range(0, count, STEP_ms):
        of_step = twin.update(samples.select(slice(start, start + STEP_ms)))
        if shown_nats is not None:
            shown_nats |= {event.kind: twin.evidence_nats for event in of_step}
        events += of_step
    free_s = next(event.t_s for event in events if event.kind == "free")
    return [(event.kind, round((event.t_s - free_s) / BLOCK_s)) for event in events]


def kinds_of(events: list[tuple[str, int]]) -> list[str]:
    return [kind for kind, _ in events]


def alarm_blocks(
    monkeypatch: pytest.MonkeyPatch, evidence_nats: list[float], off_after: int | None = None
) -> list[int]:
    """Return the number of measurements before each alarm."""
    events = reported_events(monkeypatch, evidence_nats, off_after=off_after)
    return [block for kind, block in events if kind == "alarm"]


def test_short_pulses_of_evidence_raise_no_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    pulse = 9 * BELOW + (PERSISTENCE_BLOCKS - 1) * ABOVE
    assert alarm_blocks(monkeypatch, 4 * pulse) == []


def test_evidence_that_lasts_a_quarter_of_a_second_raises_an_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    assert alarm_blocks(monkeypatch, 9 * BELOW + 30 * ABOVE) == [9 + PERSISTENCE_BLOCKS]
    assert 0.2 <= PERSISTENCE_BLOCKS * BLOCK_s <= 0.25


def test_evidence_before_a_stop_of_the_motors_does_not_count_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    evidence_nats = PERSISTENCE_BLOCKS * ABOVE + 20 * BELOW
    assert alarm_blocks(monkeypatch, evidence_nats) == [PERSISTENCE_BLOCKS]
    assert alarm_blocks(monkeypatch, evidence_nats, off_after=PERSISTENCE_BLOCKS - 1) == []


def test_no_alarm_begins_during_a_landing(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a landing the motors run at the border of their dead zone, where nominal flights show evidence."""
    evidence_nats = 20 * BELOW + 60 * ABOVE
    assert ("alarm", 20 + PERSISTENCE_BLOCKS) in reported_events(monkeypatch, evidence_nats)
    events = reported_events(monkeypatch, evidence_nats, lands_after=20)
    assert events == [("free", 0), ("waits", 20)]


def test_an_alarm_before_a_landing_is_named_during_it(monkeypatch: pytest.MonkeyPatch) -> None:
    events = reported_events(monkeypatch, 120 * ABOVE, lands_after=PERSISTENCE_BLOCKS + 2)
    assert kinds_of(events) == ["free", "alarm", "diagnosed", "waits"]
    assert events[1] == ("alarm", PERSISTENCE_BLOCKS)
    assert events[2] == ("diagnosed", PERSISTENCE_BLOCKS + DIAGNOSIS_BLOCKS)


def test_a_second_change_raises_a_second_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    until_diagnosis = PERSISTENCE_BLOCKS + DIAGNOSIS_BLOCKS
    evidence_nats = until_diagnosis * ABOVE + 50 * BELOW + until_diagnosis * ABOVE
    events = reported_events(monkeypatch, evidence_nats)
    assert kinds_of(events) == ["free", "alarm", "diagnosed", "alarm", "diagnosed"]
    assert events[3] == ("alarm", until_diagnosis + 50 + PERSISTENCE_BLOCKS)


def test_early_evidence_contradicts_the_rig_and_names_no_change(monkeypatch: pytest.MonkeyPatch) -> None:
    events = reported_events(monkeypatch, 10 * BELOW + 400 * ABOVE, calibration_s=CALIBRATION_s)
    assert kinds_of(events) == ["free", "contradicts"]


def test_evidence_after_the_calibration_names_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    first_later_block = round(CALIBRATION_s / BLOCK_s) + 1
    evidence_nats = first_later_block * BELOW + 80 * ABOVE
    events = reported_events(monkeypatch, evidence_nats, calibration_s=CALIBRATION_s)
    assert kinds_of(events) == ["free", "fits", "alarm", "diagnosed"]


def test_the_evidence_of_an_alarm_is_shown_after_its_final_ranking(monkeypatch: pytest.MonkeyPatch) -> None:
    shown_nats: dict[str, float] = {}
    reported_events(monkeypatch, (PERSISTENCE_BLOCKS + DIAGNOSIS_BLOCKS) * ABOVE, shown_nats=shown_nats)
    assert shown_nats == {"free": -math.inf, "alarm": ABOVE[0], "diagnosed": ABOVE[0]}


def test_a_third_change_contradicts_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rig does not change three times within a minute; a model that does not fit seems to."""
    until_diagnosis = PERSISTENCE_BLOCKS + DIAGNOSIS_BLOCKS
    evidence_nats = 4 * (until_diagnosis * ABOVE + 50 * BELOW)
    events = reported_events(monkeypatch, evidence_nats)
    assert kinds_of(events) == ["free", "alarm", "diagnosed", "alarm", "diagnosed", "contradicts"]


def test_the_changes_that_a_wrong_model_named_before_are_withdrawn_in_the_report() -> None:
    events = (TwinEvent("diagnosed", 5.0, "alarm at 4.0 s"), TwinEvent("contradicts", 9.0, "not this model"))
    report = TwinReport("x", events, (), threshold_nats=1.0, free_s=60.0)
    assert report.sentences() == ["not this model", "withdrawn: alarm at 4.0 s"]


@pytest.mark.parametrize(
    ("axis", "scale_error", "expected_kind"),
    [("travel", -0.5, "alarm"), ("travel", -0.05, "contradicts"), ("elevation", 1.0, "contradicts")],
)
def test_early_evidence_names_only_a_large_error_of_an_encoder_scale(
    monkeypatch: pytest.MonkeyPatch, axis: str, scale_error: float, expected_kind: str
) -> None:
    (scale,) = (change for change in CHANGES if change.id == f"encoder_scale.{axis}")
    events = reported_events(
        monkeypatch, 100 * ABOVE, calibration_s=CALIBRATION_s, change=scale, size=scale_error
    )
    assert kinds_of(events)[1] == expected_kind


@pytest.mark.parametrize(
    ("innovations", "kind"),
    [
        # Successive errors of opposite sign have no sum.
        ((1.2, -1.2), "fits"),
        ((2.0, -2.0), "contradicts"),
        # Lasting errors of half the stated deviation: sums over 1 s are 2.5 times as large as stated.
        ((0.5, 0.5), "contradicts"),
        ((0.2, 0.2), "fits"),
    ],
)
def test_innovations_larger_than_stated_contradict_the_rig(
    monkeypatch: pytest.MonkeyPatch, innovations: tuple[float, float], kind: str
) -> None:
    numbers = itertools.count()
    monkeypatch.setattr(
        _StillFilter, "value", property(lambda _: np.array([0.0, innovations[next(numbers) % 2], 0.0]))
    )
    events = reported_events(monkeypatch, 300 * BELOW, calibration_s=CALIBRATION_s)
    assert kinds_of(events) == ["free", kind]


def test_measurements_at_unknown_voltages_carry_no_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_StillFilter, "value", np.array([0.0, 2.0, 0.0]))
    known_from_1_5_V = replace(EXACT, low_V=np.full(2, 1.5), high_V=np.full(2, 5.0))
    events = reported_events(
        monkeypatch, 300 * BELOW, calibration_s=CALIBRATION_s, uncertainty=known_from_1_5_V
    )
    assert kinds_of(events) == ["unjudged", "free"]


ONE_COUNT_rad = np.full(3, 1.0)
"""Angles are in counts here [rad]."""
ELEVATION, PITCH = 0, 1
RIG = load_rig("makki2024")


class _JumpFilter:
    """A filter whose differences from its predictions the test sets itself."""

    left_out: int | None = None

    def __init__(self, std_rad: float) -> None:
        self.differences_rad, self.stds_rad = np.zeros(3), np.full(3, std_rad)

    def copy(self) -> _JumpFilter:
        return _JumpFilter(float(self.stds_rad[0]))


def decisions(
    differences_counts: list[float], settled_blocks: int = 20, std_counts: float = 0.3
) -> list[str]:
    """Return the decision after each measurement of pitch: ``open`` while a jump may return, ``returned``
    when the encoder has returned, otherwise ``-``.
    """
    # Before them, `settled_blocks` measurements had their predictions.
    watch: GlitchWatch[_JumpFilter] = GlitchWatch(ONE_COUNT_rad)
    kalman, ratio = _JumpFilter(std_counts), _JumpFilter(std_counts)

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


STEP_s = 0.01
KNOWN_VOLTAGES = replace(EXACT, low_V=np.array([0.0, 1.7]), high_V=np.full(2, 5.5))
REASON = "the front rotor gets -0.3 V (it reverses); the twin knows 0.0 V to 5.5 V from its nominal flights"


def test_a_rotor_that_reverses_is_not_judged_for_one_second_and_reported_once() -> None:
    voltage_range = VoltageRange(KNOWN_VOLTAGES, STEP_s)
    assert voltage_range.update(1, np.array([1.0, 2.0])) == ""
    assert voltage_range.is_known(1)
    assert voltage_range.update(2, np.array([-0.3, 2.0])) == REASON
    assert voltage_range.update(3, np.array([-0.4, 2.0])) == ""
    # Step 103 is one second after the last step with an unknown voltage.
    assert not voltage_range.is_known(3) and not voltage_range.is_known(103)
    assert voltage_range.is_known(104)


def test_a_range_is_extrapolated_by_a_tenth_but_not_across_zero() -> None:
    voltages = replace(EXACT, low_V=np.array([0.0, -1.0]), high_V=np.array([2.0, 3.0]))
    known = [(0.0, 0.0), (2.19, 0.0), (0.0, 3.39), (0.0, -1.39)]
    unknown = [(-0.01, 0.0), (2.21, 0.0), (0.0, 3.41), (0.0, -1.41)]
    for volts_V in known:
        assert VoltageRange(voltages, STEP_s).update(0, np.array(volts_V)) == ""
    for volts_V in unknown:
        assert VoltageRange(voltages, STEP_s).update(0, np.array(volts_V)) != ""


def test_exact_parameters_hold_for_all_voltages() -> None:
    assert VoltageRange(EXACT, STEP_s).update(0, np.array([-100.0, 100.0])) == ""


def test_the_rotor_that_is_farthest_outside_is_named() -> None:
    reason = VoltageRange(KNOWN_VOLTAGES, STEP_s).update(0, np.array([-0.1, 1.0]))
    assert reason.startswith("the back rotor gets 1.0 V; the twin knows 1.7 V to 5.5 V")


def sentences_of_flight(unjudged_s: float) -> list[str]:
    """Describe a flight of 20 s without an alarm, of which `unjudged_s` were not judged."""
    report = TwinReport(
        label="flight",
        events=(TwinEvent("unjudged", 7.0, REASON),),
        evidence_nats=((8.0, 3.0),),
        threshold_nats=14.0,
        free_s=20.0,
        unjudged_s=unjudged_s,
    )
    return report.sentences()


def test_the_report_states_how_long_the_twin_did_not_judge() -> None:
    no_change, not_judged = sentences_of_flight(12.0)
    assert no_change == "no change of the rig in 8 s (evidence: 3.0 nats at most)"
    assert not_judged == f"12.0 s of 20.0 s are not judged: {REASON}"


def test_a_flight_that_was_not_judged_is_not_called_unchanged() -> None:
    assert sentences_of_flight(19.5) == [f"19.5 s of 20.0 s are not judged: {REASON}"]


BATCH_TICKS = 1000
BATCHES = 100


class _Session:
    """A session whose ticks the test sends itself."""

    lockstep = False

    def subscribe_ticks(self, callback: Callable[[Ticks], None]) -> Callable[[], None]:
        self.send = callback
        return lambda: None

    def ticks_counted_on(self, ticks: Ticks) -> Any:
        return ticks.tick.astype(np.int64)


class _SlowTwin:
    """A twin whose first update lasts until `may_continue` is set."""

    def __init__(self) -> None:
        self.has_begun, self.may_continue = threading.Event(), threading.Event()
        self.first_ticks: list[int] = []

    def update(self, tick: Any, raw: Any) -> Sequence[TwinNews]:
        self.has_begun.set()
        self.may_continue.wait(60.0)
        self.first_ticks.append(int(tick[0]))
        return []

    def ghost_rad(self) -> None:
        return None

    def words(self) -> str:
        return "follows"


def test_a_slow_twin_skips_samples_and_reports_it() -> None:
    session, twin = _Session(), _SlowTwin()
    watch = TwinWatch(cast(Session, session), twin)
    raw = np.zeros((BATCH_TICKS, len(CHANNELS)), np.int32)
    for batch in range(BATCHES):
        ticks = np.arange(batch * BATCH_TICKS, (batch + 1) * BATCH_TICKS, dtype=np.uint32)
        session.send(Ticks(ticks, raw))
        twin.has_begun.wait(60.0)
    twin.may_continue.set()
    watch.close()
    # At most 10 s of samples wait for the twin; the newest batch is always processed.
    assert len(twin.first_ticks) <= 13 and twin.first_ticks[-1] == (BATCHES - 1) * BATCH_TICKS
    assert watch.skipped_ticks == (BATCHES - len(twin.first_ticks)) * BATCH_TICKS
    skipped_s = watch.skipped_ticks // 1000
    assert watch.words() == f"follows; {skipped_s} s of samples skipped, because this computer is slow"
