"""Rules for right answers and misses, and calibration."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from heli_benchmark.cases.clean import clean_cases
from heli_benchmark.cases.disturbed import disturbed_cases
from heli_benchmark.goals import BINS, confusion, draw, further_counts, goals, holds, reliability, text
from heli_benchmark.judge import Row, judge
from heli_benchmark.truth import InformedFit, hidden_in
from tests.running.pixels import coloured_share

LAG = next(case for case in clean_cases() if case.name == "rotor_lag-small")
TRUE_S = LAG.truth()["rotor_lag"]["size"]
TWO = next(case for case in disturbed_cases() if case.name == "w-lag+coulomb_friction.pitch")
DELAYED = next(case for case in disturbed_cases() if case.name == "w-lag+input_delay")
AIR = {"rig": "makki2024"}


def cause(
    effect: str, confidence: float = 0.95, *others: str, **numbers: tuple[float, float]
) -> dict[str, Any]:
    spelled = {name: {"value": value, "std": std, "unit": "s"} for name, (value, std) in numbers.items()}
    return {"effect": effect, "confidence": confidence, "ambiguous_with": list(others), "parameters": spelled}


def answer(verdict: str, *causes: dict[str, Any], held_out: float = 1.01) -> dict[str, Any]:
    residual = {"normalised": {"after": 1.0, "held_out_after": held_out}}
    return {"verdict": verdict, "causes": list(causes), "residual": residual}


def row(verdict: str, *causes: dict[str, Any], significance: float = 50.0, held_out: float = 1.01) -> Row:
    informed = InformedFit(1.0, 1.0, 5.0, 5.5, {"rotor_lag": significance}, {}, {})
    return judge(LAG, hidden_in(LAG, 0.6), informed, answer(verdict, *causes, held_out=held_out), 30.0)


def disturbed(verdict: str, *causes: dict[str, Any], least: float = 40.0, case: Any = TWO) -> Row:
    seen = {name: least for name, _ in case.effects} | {"rotor_lag": 200.0}
    return judge(case, hidden_in(case, 0.0), seen, answer(verdict, *causes), 3.0, disturbances=AIR)


def nothing(verdict: str, *causes: dict[str, Any]) -> Row:
    return replace(disturbed(verdict, *causes), kind="nothing", hidden=(), significance={})


def count(rows: list[Row], goal: str) -> tuple[int, int]:
    counted = (goals(rows) | further_counts(rows))[goal]
    return counted["count"], counted["of"]


def test_the_cause_named_first_is_right_and_another_is_not() -> None:
    assert row("cause_found", cause("rotor_lag")).right
    assert not row("cause_found", cause("input_delay"), cause("rotor_lag")).right
    assert not row("explained").right


def test_a_hidden_effect_that_is_listed_as_too_small_is_right_and_counted_apart() -> None:
    result = answer("explained") | {"too_small": [{"effect": "rotor_lag"}]}
    informed = InformedFit(1.0, 1.0, 5.0, 5.5, {"rotor_lag": 50.0}, {}, {})
    small = judge(LAG, hidden_in(LAG, 0.6), informed, result, 30.0)
    assert small.right
    assert count([small, row("cause_found", cause("rotor_lag"))], "clean: listed as too small") == (1, 2)
    assert not replace(small, too_small=("input_delay",)).right
    assert not replace(small, named=("input_delay",), confidence=(0.9,), alternatives=((),)).right
    assert Row.read(json.loads(json.dumps(asdict(small)))) == small


def test_ambiguous_counts_among_two_but_not_among_three() -> None:
    assert row("ambiguous", cause("input_delay", 0.5, "rotor_lag")).right
    assert not row("ambiguous", cause("input_delay", 0.5, "supply_sag", "rotor_lag")).right
    assert row("ambiguous", cause("rotor_lag", 0.5, "supply_sag", "input_delay")).right


def test_a_number_counts_as_found_within_two_standard_errors() -> None:
    near = row("cause_found", cause("rotor_lag", rotor_lag_s=(TRUE_S + 0.0019, 0.001)))
    far = row("cause_found", cause("rotor_lag", rotor_lag_s=(TRUE_S + 0.0021, 0.001)))
    assert near.within == {"rotor_lag_s": True}
    assert far.within == {"rotor_lag_s": False}
    assert count([near, far], "numbers within 2 standard errors") == (1, 2)


def test_what_is_too_small_to_be_seen_is_left_out_of_the_goal() -> None:
    rows = [row("cause_found", cause("rotor_lag")), row("explained", significance=2.0)]
    assert count(rows, "clean: named first, or listed as too small") == (1, 1)
    assert "explained (too small to be visible)" in confusion(rows)["rotor_lag"]


@pytest.mark.parametrize(("verdict", "alarms"), [("explained", 0), ("unexplained", 1), ("cause_found", 1)])
def test_anything_but_explained_is_a_false_alarm_where_nothing_is_hidden(verdict: str, alarms: int) -> None:
    clean = replace(row(verdict), kind="nothing", hidden=(), significance={})
    assert count([clean], "clean: false alarms on nothing hidden") == (alarms, 1)
    assert count([nothing(verdict)], "disturbed: nothing hidden is explained") == (1 - alarms, 1)


def test_off_the_list_only_unexplained_is_right() -> None:
    off = replace(row("unexplained"), kind="off_list", hidden=("off-draught",))
    named = replace(row("cause_found", cause("rotor_lag")), kind="off_list", hidden=("off-draught",))
    assert (off.right, named.right) == (True, False)


def test_a_law_that_came_onto_the_list_may_be_named() -> None:
    named = row("cause_found", cause("pitch_drag_quadratic"))
    assert replace(named, kind="off_list", hidden=("off-pitch_drag_quadratic",)).right
    assert not replace(named, kind="off_list", hidden=("off-draught",)).right


def test_in_disturbed_cases_every_cause_must_be_named_in_any_order() -> None:
    both = cause("coulomb_friction.pitch"), cause("rotor_lag")
    rows = [disturbed("cause_found", *both), disturbed("cause_found", both[1])]
    assert count(rows, "disturbed: every cause named") == (1, 2)
    assert count(rows, "disturbed: visible causes named, one by one") == (3, 4)


@pytest.mark.parametrize(
    ("least", "counted", "borderline"), [(15.0, 1, 0), (14.9, 0, 1), (8.0, 0, 1), (7.9, 0, 0)]
)
def test_a_case_counts_by_the_faintest_of_its_causes(least: float, counted: int, borderline: int) -> None:
    goal = goals([disturbed("cause_found", cause("rotor_lag"), least=least)])["disturbed: every cause named"]
    assert (goal["of"], goal.get("borderline", {"of": 0})["of"]) == (counted, borderline)


def test_a_false_name_counts_in_a_disturbed_case_and_a_random_torque_is_none() -> None:
    gust = cause("random_torque.pitch", 0.99)
    rows = [
        nothing("explained", gust),
        nothing("cause_found", cause("axis_tilt", 0.71)),
        disturbed("explained"),
    ]
    assert rows[0].right
    assert count(rows, "disturbed: cases with any false name") == (1, 3)
    assert count(rows, "disturbed: false names with confidence 0.7 or more") == (1, 1)
    timid = nothing("ambiguous", cause("axis_tilt", 0.69))
    assert count([timid], "disturbed: false names with confidence 0.7 or more") == (0, 1)


def test_a_lag_with_dead_time_is_both_of_its_parts_where_both_are_hidden() -> None:
    numbers = {"rotor_lag_with_delay_lag_s": (0.1, 0.01), "rotor_lag_with_delay_delay_s": (0.02, 0.01)}
    joint = cause("rotor_lag_with_delay", 0.9, **numbers)
    both = disturbed("cause_found", joint, case=DELAYED)
    assert (both.right, both.false_names) == (True, ())
    assert set(both.parameters) == {"rotor_lag_s", "input_delay_s"}
    assert disturbed("cause_found", joint).false_names == ("rotor_lag_with_delay",)


def test_the_held_out_error_is_compared_with_the_fit_with_the_true_causes() -> None:
    name = "clean: held-out error within 10 % of the fit with the true causes"
    assert count([row("cause_found", cause("rotor_lag"), held_out=1.09)], name) == (1, 1)
    assert count([row("cause_found", cause("rotor_lag"), held_out=1.11)], name) == (0, 1)


def test_a_diagnosis_that_fails_is_a_miss_and_is_reported() -> None:
    informed = InformedFit(1, 1, 5, 5, {"rotor_lag": 50.0}, {}, {})
    failed = judge(LAG, hidden_in(LAG, 0.6), informed, None, 3.0, "boom")
    assert count([failed], "diagnosis failed") == (1, 1)
    assert count([failed], "clean: named first, or listed as too small") == (0, 1)
    assert "failed: boom" in text([failed])


def test_a_row_is_read_back_as_it_was_written() -> None:
    rows = [
        row("ambiguous", cause("rotor_lag", 0.5, "input_delay", rotor_lag_s=(TRUE_S, 0.001))),
        disturbed("cause_found", cause("rotor_lag")),
        judge(
            LAG, hidden_in(LAG, 0.6), InformedFit(1, 1, 5, 5, {"rotor_lag": None}, {}, {}), None, 3.0, "boom"
        ),
    ]
    back = [Row.read(json.loads(json.dumps(asdict(judged)))) for judged in rows]
    assert back == rows
    assert text(back) == text(rows)


TEMPLATE = Row("c", "one", 1, ("rotor_lag",), {"rotor_lag": 50.0}, "cause_found", (), (), (), {}, {}, 1.0)


def cases_of_confidence(sure: float, right: int, wrong: int) -> list[Row]:
    """So many causes of one confidence, each in a case of its own."""
    return [
        replace(TEMPLATE, named=(name,), confidence=(sure,), alternatives=((),))
        for name in ["rotor_lag"] * right + ["axis_tilt"] * wrong
    ]


def test_there_are_five_bins_and_each_cause_is_in_one() -> None:
    rows = [row for sure in (0.0, 0.5, 0.7, 0.85, 0.95, 1.0) for row in cases_of_confidence(sure, 1, 0)]
    curve = reliability(rows)
    assert len(curve) == len(BINS) - 1 == 5
    assert [bin_["causes"] for bin_ in curve] == [1, 1, 1, 1, 2]


def test_wrong_names_count_wherever_they_are_given() -> None:
    off = replace(cases_of_confidence(0.97, 0, 1)[0], kind="off_list", hidden=("off-draught",))
    nothing = replace(off, kind="nothing", hidden=())
    (curve,) = [
        bin_ for bin_ in reliability([off, nothing, *cases_of_confidence(0.99, 1, 0)]) if bin_["causes"]
    ]
    assert (curve["causes"], curve["right"]) == (3, 1)


@pytest.mark.parametrize(("right", "within"), [(20, True), (19, True), (15, True), (14, False)])
def test_a_bin_that_boasts_lies_outside_its_bounds(right: int, within: bool) -> None:
    # 20 causes of 0.9: a binomial distribution gives 14 or fewer in 1 of 88 runs, 15 or fewer in 1 of 23.
    (curve,) = [bin_ for bin_ in reliability(cases_of_confidence(0.9, right, 20 - right)) if bin_["causes"]]
    assert holds(curve) is within


def test_a_bin_that_is_too_timid_lies_outside_too() -> None:
    rows = cases_of_confidence(0.6, 20, 0)
    assert goals(rows)["confidence: bins within their binomial bounds"]["reached"] is False


def test_the_diagram_is_drawn(tmp_path: Path) -> None:
    draw(reliability(cases_of_confidence(0.9, 9, 1)), tmp_path / "r.png")
    assert coloured_share(tmp_path / "r.png") > 0.0
