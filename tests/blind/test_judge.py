"""What counts as right, and what as a miss."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.blind.cases import every_case
from tests.blind.judge import Row, judged
from tests.blind.oracle import Told
from tests.blind.summary import calibration, confusion, goals, text
from tests.blind.truth import hidden_in

LAG = next(case for case in every_case() if case.name == "rotor_lag-small")
TRUE_S = LAG.truth()["rotor_lag"]["size"]


def cause(
    effect: str, confidence: float = 0.95, *others: str, **numbers: tuple[float, float]
) -> dict[str, Any]:
    spelled = {name: {"value": value, "std": std, "unit": "s"} for name, (value, std) in numbers.items()}
    return {"effect": effect, "confidence": confidence, "ambiguous_with": list(others), "parameters": spelled}


def row(verdict: str, *causes: dict[str, Any], significance: float = 50.0, held_out: float = 1.01) -> Row:
    told = Told(1.0, 1.0, 5.0, 5.5, {"rotor_lag": significance}, {}, {})
    residual = {"normalised": {"after": 1.0, "held_out_after": held_out}}
    result = {"verdict": verdict, "causes": list(causes), "residual": residual}
    return judged(LAG, hidden_in(LAG, 0.6), told, result, 30.0)


def test_the_cause_named_first_is_right_and_another_is_not() -> None:
    assert row("cause_found", cause("rotor_lag")).right
    assert not row("cause_found", cause("input_delay"), cause("rotor_lag")).right
    assert not row("explained").right


def test_ambiguous_counts_among_two_but_not_among_three() -> None:
    assert row("ambiguous", cause("input_delay", 0.5, "rotor_lag")).right
    assert not row("ambiguous", cause("input_delay", 0.5, "supply_sag", "rotor_lag")).right
    assert row("ambiguous", cause("rotor_lag", 0.5, "supply_sag", "input_delay")).right


def test_a_number_counts_as_found_within_three_standard_errors() -> None:
    near = row("cause_found", cause("rotor_lag", rotor_lag_s=(TRUE_S + 0.0029, 0.001)))
    far = row("cause_found", cause("rotor_lag", rotor_lag_s=(TRUE_S + 0.0031, 0.001)))
    assert near.within == {"rotor_lag_s": True}
    assert far.within == {"rotor_lag_s": False}


def test_what_is_too_small_to_be_seen_is_left_out_of_the_goal() -> None:
    rows = [row("cause_found", cause("rotor_lag")), row("explained", significance=2.0)]
    assert goals(rows)["cause named first"]["of"] == 1
    assert "explained (too small to be seen)" in confusion(rows)["rotor_lag"]


@pytest.mark.parametrize(("verdict", "alarms"), [("explained", 0), ("unexplained", 1), ("cause_found", 1)])
def test_anything_but_explained_is_a_false_alarm_where_nothing_is_hidden(verdict: str, alarms: int) -> None:
    nothing = replace(row(verdict), kind="nothing", hidden=(), visible=())
    assert goals([nothing])["false alarms on nothing hidden"]["count"] == alarms


def test_off_the_list_only_unexplained_is_right() -> None:
    off = replace(row("unexplained"), kind="off_list", hidden=("off-draught",), visible=())
    named = replace(row("cause_found", cause("rotor_lag")), kind="off_list", hidden=("off-draught",))
    assert (off.right, named.right) == (True, False)


def test_wrong_names_given_off_the_list_count_in_the_calibration() -> None:
    off = replace(row("cause_found", cause("rotor_lag", 0.97)), kind="off_list", hidden=("off-draught",))
    (curve,) = calibration([off, row("cause_found", cause("rotor_lag", 0.99))])
    assert (curve["causes"], curve["share_right"]) == (2, 0.5)
    assert goals([off])["given with confidence 0.9 and right"]["count"] == 0


def test_the_held_out_error_is_compared_with_the_fit_told_the_answer() -> None:
    name = "held-out error within 10 % of the fit told the answer"
    assert goals([row("cause_found", cause("rotor_lag"), held_out=1.09)])[name]["count"] == 1
    assert goals([row("cause_found", cause("rotor_lag"), held_out=1.11)])[name]["count"] == 0


def test_a_diagnosis_that_dies_is_a_miss_and_is_said() -> None:
    died = judged(LAG, hidden_in(LAG, 0.6), Told(1, 1, 5, 5, {"rotor_lag": 50.0}, {}, {}), None, 3.0, "boom")
    assert goals([died])["diagnosis died"]["count"] == 1
    assert "died: boom" in text([died])
