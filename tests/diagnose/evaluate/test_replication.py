"""Causes are confirmed if they hold in both directions, and enter the extended rig only then."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from heli_host.data.log.table import write_csv
from heli_lab.diagnose import Diagnosis, to_json
from heli_lab.explain import replication
from heli_lab.explain.comparison import split, two_folds
from heli_lab.explain.prediction import ErrorReduction, extrapolations
from heli_lab.explain.replication import Replication, replicate
from heli_lab.explain.stepwise import Direction
from heli_lab.explain.verdict import unconfirmed_confidence
from heli_lab.report.diagnosis.text import lines
from heli_sim.rig import load_rig

from tests.cli.terminal import Terminal
from tests.diagnose.hidden import flights
from tests.diagnose.test_causes import diagnosed

pytestmark = pytest.mark.diagnosis


def judged(
    monkeypatch: pytest.MonkeyPatch, diagnosis: Diagnosis, nats: float, worst: tuple[float, float]
) -> Replication:
    """Judge a lag again whose reverse direction has this log-likelihood ratio and interval of pitch."""
    records = (
        diagnosis.assessment.after.fit.problem.records,
        diagnosis.held_out.extension.after[0].fit.problem.records,
    )
    comparison: Any = SimpleNamespace(
        train=records[0],
        held_out=records[1],
        seed=0,
        held_out_estimate=lambda _final: None,
        exchanged=lambda: None,
    )
    final = diagnosis.search.final
    back = Direction(comparison, diagnosis.search.baseline, final, {"rotor_lag": nats})
    monkeypatch.setattr(replication, "direction", lambda *_: back)

    def reductions(_judge: object, _ids: object, reverse: bool) -> dict[str, ErrorReduction]:
        ratio = float(np.mean(worst)) if reverse else 0.1
        return {"pitch": ErrorReduction(1.0, ratio, worst if reverse else (0.05, 0.2))}

    monkeypatch.setattr(replication._CauseSubsets, "reductions", reductions)
    return replicate(comparison, diagnosis.search, diagnosis.assessment, diagnosis.held_out)


def test_lag_that_both_flights_show_is_confirmed_and_in_the_rig() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    cause = diagnosis.replication.causes["rotor_lag"]
    assert cause.confirmed
    assert cause.forward is not None and cause.reverse is not None
    # The flights are alike but for their length, and so is the evidence.
    assert cause.reverse == pytest.approx(cause.forward, rel=0.6)
    assert min(cause.forward, cause.reverse) > 20.0
    assert diagnosis.replication.worse == ()
    assert diagnosis.replication.model is diagnosis.assessment.extended
    assert "rotor_lag" in diagnosis.rig("extended").effects
    assert to_json(diagnosis)["causes"][0]["confirmed"] is True


@pytest.mark.parametrize(
    ("nats", "interval", "why"),
    [
        (-1.0, (0.1, 0.3), "less likely (log-likelihood ratio -1.0 nats)"),
        (50.0, (1.1, 1.5), "its error at 1 s is 1.30 times as large (1.10 to 1.50)"),
    ],
    ids=["likelihood", "open-loop error"],
)
def test_cause_that_fails_in_reverse_enters_the_rig_on_request_only(
    monkeypatch: pytest.MonkeyPatch, nats: float, interval: tuple[float, float], why: str
) -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    refuted = replace(diagnosis, replication=judged(monkeypatch, diagnosis, nats, interval))
    assert not refuted.replication.causes["rotor_lag"].confirmed
    assert refuted.rig("extended").effects == {}
    assert "rotor_lag" in refuted.rig("extended", with_unconfirmed=True).effects
    # The gain is that of the rig that is written: nothing was added to the baseline.
    assert all(reduction.ratio == 1.0 for reduction in refuted.error_reductions.values())
    (cause,) = to_json(refuted)["causes"]
    assert cause["confirmed"] is False
    assert why in cause["replication"]["why_not"]
    printed = "\n".join(lines(refuted))
    assert f"not confirmed: {cause['replication']['why_not']}" in printed
    # Name and verdict stay; the confidence is lower, and the same on the terminal and in the JSON.
    assert (refuted.label, cause["effect"]) == (diagnosis.label, diagnosis.verdict.causes[0].effect)
    lowered = unconfirmed_confidence(diagnosis.verdict.causes[0].confidence)
    assert cause["confidence"] == round(lowered, 3) < diagnosis.verdict.causes[0].confidence
    assert f"(confidence {cause['confidence']:.2f}; not confirmed" in printed
    assert ("predicts pitch of" in printed) == (interval[0] > 1.0)


def test_worse_prediction_within_its_interval_does_not_refute_a_cause(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    assert judged(monkeypatch, diagnosis, 50.0, (0.9, 1.5)).causes["rotor_lag"].confirmed


def test_nothing_is_confirmed_and_saved_without_a_held_out_flight(terminal: Terminal, tmp_path: Path) -> None:
    # Both halves of the flight show the lag clearly.
    fit, _ = flights("rotor_lag=0.06", seconds=(34.0, 14.0))
    write_csv(fit, tmp_path / "a.csv")
    result = terminal("diagnose", "a.csv", "--json", "a.json", "--save-rig", "a.toml")
    assert result.code == 0, result.err
    (cause,) = json.loads(Path("a.json").read_text())["causes"]
    ratios = cause["replication"]["log_likelihood_ratio"]
    assert cause["effect"] == "rotor_lag" and min(ratios.values()) > 20.0
    assert cause["confirmed"] is False and cause["confidence"] <= 0.88
    why = cause["replication"]["why_not"]
    assert why.startswith("no other flight was given")
    assert load_rig("a.toml").effects == {}
    remark = f"Not confirmed, and not in this rig: rotor_lag ({why})."
    assert f"a.toml: {remark}" in result.out
    assert remark in " ".join(Path("a.toml").read_text().replace("#", "").split())
    assert "cause_found: Perhaps the rotors' thrust lags" in result.out
    assert "what to do next: fly another plan, and give that flight to --validate" in result.out
    assert "save the extended model" not in result.out


def test_flight_is_divided_into_two_folds_of_the_same_length() -> None:
    (record,) = diagnosed("rotor_lag=0.06").assessment.after.fit.problem.records
    (first,), (second,) = two_folds([record])
    assert first.used_s == pytest.approx(second.used_s, abs=2.0 * record.step_s)
    assert max(stop for _, stop in first.segments) <= min(start for start, _ in second.segments)
    assert two_folds([first, second]) == ((first,), (second,))
    beginning, _ = split(record, 3.0)
    assert beginning.used_s == pytest.approx(3.0)


def test_prediction_with_other_voltages_is_marked_as_extrapolation() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    runs = diagnosis.held_out.extension.after
    (record,) = runs[0].fit.problem.records
    (same,) = extrapolations([record], runs)
    assert same.spans_s == ()
    mean_V = record.voltages_V.mean(axis=0)
    narrow = replace(record, voltages_V=mean_V + 0.1 * (record.voltages_V - mean_V))
    (outside,) = extrapolations([narrow], runs)
    assert len(outside.spans_s) == outside.windows > 0
