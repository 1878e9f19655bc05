"""When the twin raises, names and suppresses alarms, for given sequences of evidence."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from heli_lab.watch import twin as twin_module
from heli_lab.watch.calibration import DEFAULT_CALIBRATION, Calibration, Tail
from heli_lab.watch.likelihood_ratio import (
    ONSETS,
    PERSISTENCE_BLOCKS,
    ChangeCandidate,
    Innovation,
    LikelihoodRatio,
)
from heli_lab.watch.steps import Samples
from heli_lab.watch.twin import DIAGNOSIS_DELAY_s, Twin
from heli_lab.watch.twin_model import EXACT, Change, ParameterUncertainty, all_changes
from heli_sim.rig import load_rig

CHANGES = all_changes()
COLUMNS = sum(len(change.parameters) for change in CHANGES)
THRESHOLD_nats = 15.0
ABOVE, BELOW = [16.0], [1.0]
"""Evidence of one measurement above and below the threshold [nats]; ``3 * ABOVE`` are three measurements."""
COUNT_rad = np.full(3, 2 * np.pi / 4096)
BLOCK_s = 0.04
BLOCK_ms = 40
FREE_ms = 1520
"""Time at which the comparison begins [ms]: one step after the settling time off the table."""
MOTORS_OFF_ms = 50
DIAGNOSIS_BLOCKS = round(DIAGNOSIS_DELAY_s / BLOCK_s)
"""Number of measurements from an alarm to its final ranking."""
CALIBRATION_s = 8.0
"""Time at the beginning of a flight in which evidence contradicts the model [s]."""


class _Filter:
    """A filter whose innovations have the given `value`, and that estimates nothing."""

    value: ClassVar = np.zeros(3)

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
) -> list[tuple[str, int]]:
    """Run a twin on a flight at rest with the given evidence, and return its events.

    Parameters
    ----------
    monkeypatch : MonkeyPatch
        Replaces filter and evidence of the twin.
    evidence_nats : list of float
        Evidence of each measurement.
    off_after, lands_after : int, optional
        Number of measurements after which the motors are off for a moment, and a landing begins.
    calibration_s : float
        Time at the beginning in which evidence contradicts the model [s].
    uncertainty : ParameterUncertainty
        Contains the range of known voltages; both rotors get 1 V.
    change, size : Change, float
        Most likely change, and the estimate of its size.

    Returns
    -------
    list of (str, int)
        Kind of each event, and the number of measurements before it.
    """
    remaining_evidence = iter(evidence_nats)
    candidate = ChangeCandidate(change, 0, size, 0.01, THRESHOLD_nats)
    monkeypatch.setattr(twin_module, "CALIBRATION_s", calibration_s)
    monkeypatch.setattr(twin_module, "KalmanFilter", _Filter)
    monkeypatch.setattr(twin_module, "start_state", lambda *_: np.zeros(6))
    monkeypatch.setattr(LikelihoodRatio, "update_cut", lambda *_: next(remaining_evidence, 0.0))
    monkeypatch.setattr(LikelihoodRatio, "ranking", lambda _: [candidate, candidate])
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
    events = twin.update(samples)
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
    assert kinds_of(events) == ["free", "alarm", "diagnosed"]


@pytest.mark.parametrize(("scale_error", "expected_kind"), [(-0.5, "alarm"), (-0.05, "contradicts")])
def test_early_evidence_names_only_a_large_error_of_an_encoder_scale(
    monkeypatch: pytest.MonkeyPatch, scale_error: float, expected_kind: str
) -> None:
    (scale,) = (change for change in CHANGES if change.id == "encoder_scale.travel")
    events = reported_events(
        monkeypatch, 100 * ABOVE, calibration_s=CALIBRATION_s, change=scale, size=scale_error
    )
    assert kinds_of(events)[1] == expected_kind


@pytest.mark.parametrize(("innovation", "contradictions"), [(1.2, []), (2.0, ["contradicts"])])
def test_innovations_twice_as_large_as_stated_contradict_the_rig(
    monkeypatch: pytest.MonkeyPatch, innovation: float, contradictions: list[str]
) -> None:
    monkeypatch.setattr(_Filter, "value", np.array([0.0, innovation, 0.0]))
    events = reported_events(monkeypatch, 300 * BELOW, calibration_s=CALIBRATION_s)
    assert kinds_of(events) == ["free", *contradictions]


def test_measurements_at_unknown_voltages_carry_no_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Filter, "value", np.array([0.0, 2.0, 0.0]))
    known_from_1_5_V = replace(EXACT, low_V=np.full(2, 1.5), high_V=np.full(2, 5.0))
    events = reported_events(
        monkeypatch, 300 * BELOW, calibration_s=CALIBRATION_s, uncertainty=known_from_1_5_V
    )
    assert kinds_of(events) == ["unjudged", "free"]
