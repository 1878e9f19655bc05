"""Evidence is an alarm where it lasts, and after as long as it has to; a new flight begins from none."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from heli_lab.twin import twin as twin_module
from heli_lab.twin.calibration import Calibration
from heli_lab.twin.changes import Change, all_changes
from heli_lab.twin.files import DEFAULT_CALIBRATION
from heli_lab.twin.likelihood_ratio import ONSETS, ChangeCandidate, Innovation, LikelihoodRatio
from heli_lab.twin.parameter_uncertainty import EXACT, ParameterUncertainty
from heli_lab.twin.persistence import PERSISTENCE_BLOCKS
from heli_lab.twin.samples import Samples
from heli_lab.twin.tail import Tail
from heli_lab.twin.twin import DIAGNOSIS_DELAY_s, Twin
from heli_sim.rig import load_rig

CHANGES = all_changes()

THRESHOLD_nats = 15.0
MUCH, LITTLE = [16.0], [1.0]
COUNT_rad = np.full(3, 2 * np.pi / 4096)
BLOCK_s = 0.04
FREE_ms = 1520
"""When it begins to compare: one step after the table's air is left behind."""
COLUMNS = sum(len(change.numbers) for change in CHANGES)


class _Filter:
    """Stands for a filter of which only the times of the measurements count."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.mean, self.state, self.state_sensitivity = (
            np.zeros(17),
            np.zeros(6),
            np.zeros((17, COLUMNS, ONSETS)),
        )

    value: ClassVar = np.zeros(3)

    def _nothing(self, *_: Any) -> None: ...

    def update(self, *_: Any) -> Innovation:
        return Innovation(self.value, np.zeros((3, COLUMNS, ONSETS)))

    predict = propagate_sensitivity = _nothing


def reported_events(
    monkeypatch: pytest.MonkeyPatch,
    evidence: list[float],
    *,
    off_after: int | None = None,
    lands_after: int | None = None,
    calibration_s: float = 0.0,
    uncertainty: ParameterUncertainty = EXACT,
    change: Change = CHANGES[0],
    size: float = 0.1,
) -> list[tuple[str, int]]:
    """Report of the twin, and the number of measurements until then, for this evidence. The motors are off
    for a moment after the given number of measurements, or a landing begins there.
    """
    remaining_evidence = iter(evidence)
    first = ChangeCandidate(change, 0, size, 0.01, THRESHOLD_nats)
    monkeypatch.setattr(twin_module, "CALIBRATION_s", calibration_s)
    monkeypatch.setattr(twin_module, "KalmanFilter", _Filter)
    monkeypatch.setattr(Twin, "watches_glitches", False)
    monkeypatch.setattr(twin_module, "start_state", lambda *_: np.zeros(6))
    monkeypatch.setattr(LikelihoodRatio, "update_cut", lambda *_: next(remaining_evidence, 0.0))
    monkeypatch.setattr(LikelihoodRatio, "ranking", lambda _: [first, first])
    model: Any = SimpleNamespace(
        rig=load_rig("makki2024"),
        delay_s=0.0,
        min_thrust_V=-math.inf,
        changes=CHANGES,
        scales=(),
        uncertainty=uncertainty,
    )
    twin = Twin(
        model,
        Calibration(DEFAULT_CALIBRATION.disturbances, Tail(THRESHOLD_nats, 1e-9, 1.0, 20)),
        COUNT_rad,
        1e-3,
    )
    flying = np.ones(4000 + 40 * len(evidence), bool)
    count = len(flying)
    landing = np.zeros(count, bool)
    if off_after is not None:
        flying[FREE_ms + 40 * off_after :][:50] = False
    if lands_after is not None:
        landing[FREE_ms + 40 * lands_after :] = True
    events = twin.update(
        Samples(np.arange(count), np.zeros((count, 3)), np.ones((count, 2)), flying, landing)
    )
    free_s = next(event.t_s for event in events if event.kind == "free")
    return [(event.kind, round((event.t_s - free_s) / BLOCK_s)) for event in events]


def alarm_blocks(
    monkeypatch: pytest.MonkeyPatch, evidence: list[float], off_after: int | None = None
) -> list[int]:
    """Numbers of the measurements that are alarms."""
    events = reported_events(monkeypatch, evidence, off_after=off_after)
    return [number for kind, number in events if kind == "alarm"]


def test_evidence_that_falls_back_is_no_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    pulse = 9 * LITTLE + (PERSISTENCE_BLOCKS - 1) * MUCH
    assert alarm_blocks(monkeypatch, 4 * pulse) == []


def test_evidence_that_lasts_a_quarter_of_a_second_is_an_alarm_then(monkeypatch: pytest.MonkeyPatch) -> None:
    assert alarm_blocks(monkeypatch, 9 * LITTLE + 30 * MUCH) == [9 + PERSISTENCE_BLOCKS]
    assert 0.2 <= PERSISTENCE_BLOCKS * BLOCK_s <= 0.25


def test_what_was_seen_in_one_flight_counts_for_nothing_in_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    before, after = (PERSISTENCE_BLOCKS - 1) * MUCH, MUCH + 20 * LITTLE
    assert alarm_blocks(monkeypatch, before + after) == [PERSISTENCE_BLOCKS]
    assert alarm_blocks(monkeypatch, before + after, off_after=PERSISTENCE_BLOCKS - 1) == []


def test_a_landing_begins_no_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    """The motors run at the border of their dead zone, where nominal flights have raised alarms."""
    flown = 20 * LITTLE + 60 * MUCH
    assert ("alarm", 20 + PERSISTENCE_BLOCKS) in reported_events(monkeypatch, flown)
    landed = reported_events(monkeypatch, flown, lands_after=20)
    assert [kind for kind, _ in landed] == ["free", "waits"] and landed[1][1] == 20


def test_what_parts_before_a_landing_is_named_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    events = reported_events(monkeypatch, 120 * MUCH, lands_after=PERSISTENCE_BLOCKS + 2)
    named = PERSISTENCE_BLOCKS + round(DIAGNOSIS_DELAY_s / BLOCK_s)
    assert [kind for kind, _ in events] == ["free", "alarm", "diagnosed", "waits"]
    assert [number for _, number in events[1:3]] == [PERSISTENCE_BLOCKS, named]


def test_after_an_alarm_a_second_change_raises_another(monkeypatch: pytest.MonkeyPatch) -> None:
    named = PERSISTENCE_BLOCKS + round(DIAGNOSIS_DELAY_s / BLOCK_s)
    events = reported_events(monkeypatch, named * MUCH + 50 * LITTLE + named * MUCH)
    assert [kind for kind, _ in events] == ["free", "alarm", "diagnosed", "alarm", "diagnosed"]
    assert events[3][1] == named + 50 + PERSISTENCE_BLOCKS


def test_a_flight_that_contradicts_the_rig_at_once_names_no_change(monkeypatch: pytest.MonkeyPatch) -> None:
    events = reported_events(monkeypatch, 10 * LITTLE + 400 * MUCH, calibration_s=8.0)
    assert [kind for kind, _ in events] == ["free", "contradicts"]


def test_evidence_after_the_first_seconds_is_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    events = reported_events(monkeypatch, 201 * LITTLE + 80 * MUCH, calibration_s=8.0)
    assert [kind for kind, _ in events] == ["free", "alarm", "diagnosed"]


def test_a_decoder_that_counts_half_the_edges_is_named_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    (scale,) = (change for change in CHANGES if change.id == "encoder_scale.travel")
    kinds = []
    for size in (-0.5, -0.05):
        events = reported_events(monkeypatch, 100 * MUCH, calibration_s=8.0, change=scale, size=size)
        kinds.append([kind for kind, _ in events][1])
    assert kinds == ["alarm", "contradicts"]


def test_innovations_twice_as_large_as_stated_contradict_the_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    for value, expected in ((1.2, ["free"]), (2.0, ["free", "contradicts"])):
        monkeypatch.setattr(_Filter, "value", np.array([0.0, value, 0.0]))
        events = reported_events(monkeypatch, 300 * LITTLE, calibration_s=8.0)
        assert [kind for kind, _ in events] == expected


def test_a_voltage_that_no_nominal_flight_had_carries_no_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Filter, "value", np.array([0.0, 2.0, 0.0]))
    gentle = replace(EXACT, low_V=np.full(2, 1.5))
    events = reported_events(monkeypatch, 300 * LITTLE, calibration_s=8.0, uncertainty=gentle)
    assert [kind for kind, _ in events] == ["unjudged", "free"]
