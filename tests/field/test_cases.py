"""The cases outside of the project are read as they are written, and judged as their README demands."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.field.__main__ import main
from tests.field.cases import DATA, LAW_UNTOLD, NO_DATA, Case, cases, judged, read
from tests.field.golden import FILE, differences, runs

TRUTH = """hidden = ['rotor_lag', 'cable_spring.elevation']
# weather, standard deviations of elevation, pitch, travel in N m, memory in s: (0.02, 0.006, 0.012, 0.6)
# cable_spring.elevation: 0.6
# rotor_lag: 0.09
# rig changes: {'k': 0.5996, 'v0': 0.923}
"""
needs_data = pytest.mark.skipif(not cases(), reason=NO_DATA)


def case(folder: Path, text: str = TRUTH) -> Case:
    path = folder / "field" / "one" / "truth.toml"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    return read(path)


def answer(verdict: str, **causes: tuple[float, float]) -> dict[str, Any]:
    """Causes by the name of their first number: its value and standard error."""
    given = [
        {
            "effect": {"rotor_lag_s": "rotor_lag", "cable_spring_elevation_Nm_per_rad": SPRING}.get(
                name, name
            ),
            "confidence": 0.9,
            "parameters": {name: {"value": value, "std": std, "unit": "s"}},
        }
        for name, (value, std) in causes.items()
    ]
    return {"result": {"verdict": verdict, "causes": given}, "failure": "", "cpu_seconds": 1.0}


SPRING = "cable_spring.elevation"
BOTH = {"rotor_lag_s": (0.091, 0.001), "cable_spring_elevation_Nm_per_rad": (0.58, 0.02)}


def test_a_truth_file_gives_causes_and_their_numbers(tmp_path: Path) -> None:
    field_case = case(tmp_path)
    assert (field_case.name, field_case.verdict) == ("field/one", "cause_found")
    assert field_case.numbers() == {"rotor_lag_s": 0.09, "cable_spring_elevation_Nm_per_rad": 0.6}


def test_a_step_has_its_moment(tmp_path: Path) -> None:
    field_case = case(tmp_path, "hidden = ['thrust_step.front']\n# thrust_step.front: 0.1\n# at: 25.0\n")
    assert field_case.numbers() == {"thrust_step_front_share": 0.1, "thrust_step_front_at_s": 25.0}


def test_all_causes_with_their_sizes_and_nothing_else_is_right(tmp_path: Path) -> None:
    field_case = case(tmp_path)
    assert judged(field_case, answer("cause_found", **BOTH)).right
    assert judged(field_case, answer("cause_found", **BOTH, **{"random_torque.pitch": (0.01, 0.001)})).right
    assert not judged(field_case, answer("unexplained", **BOTH)).right
    assert judged(field_case, answer("cause_found", **{**BOTH, "axis_tilt": (0.0, 1.0)})).false_names == (
        "axis_tilt",
    )
    assert judged(field_case, answer("cause_found", rotor_lag_s=(0.091, 0.001))).missed == (SPRING,)


def test_a_size_is_wrong_from_three_standard_errors_on(tmp_path: Path) -> None:
    field_case = case(tmp_path)
    near, far = ({**BOTH, "rotor_lag_s": (0.09 + off, 0.001)} for off in (0.0029, 0.0031))
    assert judged(field_case, answer("cause_found", **near)).right
    assert not judged(field_case, answer("cause_found", **far)).right
    assert "2.9 standard errors off" in judged(field_case, answer("cause_found", **near)).line()


@pytest.mark.parametrize(("hidden", "verdict"), [("[]", "explained"), ("['unknown']", "unexplained")])
def test_nothing_is_explained_and_an_unknown_law_is_not(tmp_path: Path, hidden: str, verdict: str) -> None:
    field_case = case(tmp_path, f"hidden = {hidden}\n# unknown: 0.06\n")
    assert judged(field_case, answer(verdict)).right
    assert not judged(field_case, answer("cause_found")).right


def test_a_diagnosis_that_dies_is_wrong_and_says_why(tmp_path: Path) -> None:
    judgement = judged(case(tmp_path), {"result": None, "failure": "boom", "cpu_seconds": 1.0})
    assert not judgement.right
    assert "boom" in judgement.line()


def test_without_the_cases_it_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([], tmp_path) == 0
    assert capsys.readouterr().out.strip() == NO_DATA


@needs_data
def test_the_cases_are_all_there_and_each_number_is_understood() -> None:
    there = cases()
    assert len(there) == len(list(DATA.glob("practice/*/truth.toml"))) + len(
        list(DATA.glob("field/*/truth.toml"))
    )
    for listed_case in there:
        assert set(listed_case.listed) <= set(listed_case.sizes)
        assert len(listed_case.numbers()) >= len(set(listed_case.listed) - LAW_UNTOLD)


@needs_data
@pytest.mark.medium
def test_a_field_case_s_flights_can_be_read() -> None:
    first, second = next(
        listed_case for listed_case in cases() if listed_case.name.startswith("field/")
    ).flights()
    assert len(first) > len(second) > 1000


GOLDEN: dict[str, Any] = json.loads(FILE.read_text())
CASE = GOLDEN["field/lag"]


def worse_verdict(result: dict[str, Any]) -> None:
    result["verdict"] = "unexplained"


def other_cause(result: dict[str, Any]) -> None:
    result["causes"]["input_delay"] = result["causes"].pop("rotor_lag")


def other_size(result: dict[str, Any]) -> None:
    value, std = result["causes"]["rotor_lag"]["parameters"]["rotor_lag_s"]
    result["causes"]["rotor_lag"]["parameters"]["rotor_lag_s"] = [value + 0.1 * std, std]


def other_likelihood(result: dict[str, Any]) -> None:
    result["causes"]["rotor_lag"]["log_likelihood_ratio_nats"] += 0.2


def other_prediction(result: dict[str, Any]) -> None:
    result["error_ratios"]["2 s"]["pitch"] += 0.02


def test_a_result_does_not_differ_from_itself() -> None:
    assert all(not list(differences(result, copy.deepcopy(result))) for result in GOLDEN.values())


@pytest.mark.parametrize(
    "change", [worse_verdict, other_cause, other_size, other_likelihood, other_prediction]
)
def test_each_change_of_a_result_is_one_difference(change: Callable[[dict[str, Any]], None]) -> None:
    result = copy.deepcopy(CASE)
    change(result)
    assert len(list(differences(CASE, result))) == 1


@pytest.mark.skipif(not runs(), reason=NO_DATA)
def test_every_case_has_a_golden_result() -> None:
    assert set(runs()) == set(GOLDEN)
