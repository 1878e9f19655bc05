"""An answer of the published benchmark is checked, and a mistake is one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.splits.causes import causes_content
from heli_benchmark.task import (
    NOTHING,
    UNLISTED,
    Causes,
    answer_with,
    read_answer,
    read_case,
    read_split,
    write_answer,
)
from heli_benchmark.task.answer import check_answer
from heli_benchmark.task.split import causes_of

from tests.benchmark.small_split import make

CAUSES = causes_of({"causes": causes_content()})
GOOD: dict[str, Any] = {
    "schema": 1,
    "probabilities": {NOTHING: 0.1, "rotor_lag": 0.9},
    "parameters": {"rotor_lag_s": {"value": 0.1, "std": 0.01}},
}


FIRST = "validation-1"
TORQUES = {"t_s": [0.0, 0.1], "elevation_Nm": [0.0, 0.2], "pitch_Nm": [0, 1], "travel_Nm": [0.1, 0.0]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"schema": 2}, "schema is 2; set schema to 1"),
        ({"probability": {}}, "unknown key 'probability'"),
        ({"probabilities": {}}, "there are no probabilities"),
        ({"probabilities": {"lag": 0.5}}, "unknown cause 'lag'; choose from causes.json"),
        ({"probabilities": {"rotor_lag": 1.5}}, "the probability of 'rotor_lag' is 1.5"),
        ({"probabilities": {"rotor_lag": float("nan")}}, "the probability of 'rotor_lag' is nan"),
        ({"probabilities": {"rotor_lag": True}}, "the probability of 'rotor_lag' is True"),
        ({"probabilities": {NOTHING: 0.5, "rotor_lag": 0.6}}, "add up to more than 1"),
        ({"parameters": {"lag_s": {"value": 1.0, "std": 1.0}}}, "unknown parameter 'lag_s'"),
        ({"parameters": {"rotor_lag_s": 0.1}}, "'rotor_lag_s' needs a value and a std"),
        ({"parameters": {"rotor_lag_s": {"value": 0.1, "std": 0.0}}}, "positive std"),
        ({"equation": 3}, "the equation is not text"),
        ({"equation_torques": []}, "'equation_torques' is not an object"),
        ({"equation_torques": {"training-1": TORQUES}}, "unknown flight 'training-1'"),
        ({"equation_torques": {FIRST: TORQUES | {"t_s": [0.0, 0.1, 0.2]}}}, "lists of different lengths"),
        ({"equation_torques": {FIRST: TORQUES | {"t_s": [0.1, 0.0]}}}, "times that do not rise"),
        ({"equation_torques": {FIRST: TORQUES | {"pitch_Nm": [0.0, float("inf")]}}}, "not finite"),
        ({"equation_torques": {FIRST: TORQUES | {"pitch_Nm": ["a", "b"]}}}, "lists without numbers"),
        ({"equation_torques": {FIRST: TORQUES | {"pitch_Nm": [[1.0], [2.0]]}}}, "lists of different lengths"),
        ({"equation_torques": {FIRST: TORQUES | {"pitch_Nm": 0.0}}}, "lists without numbers"),
        ({"equation_torques": {FIRST: {key: [0.0] for key in TORQUES}}}, "has 1 rows"),
        ({"predicted_flights": {FIRST: TORQUES}}, "give t_s, elevation_rad, pitch_rad, travel_rad"),
    ],
)
def test_a_mistake_in_an_answer_is_one_line(change: dict[str, Any], words: str) -> None:
    check_answer(GOOD, CAUSES, "a.json")
    with pytest.raises(BenchmarkError, match=r"a\.json") as caught:
        check_answer(GOOD | change, CAUSES, "a.json")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_torques_and_predicted_flights_of_an_answer_survive_their_file(tmp_path: Path) -> None:
    angles = {key.replace("Nm", "rad"): values for key, values in TORQUES.items()}
    more = {"equation_torques": {FIRST: TORQUES}, "predicted_flights": {FIRST: angles}}
    write_answer(tmp_path / "a.json", check_answer(GOOD | more, CAUSES, "it"))
    answer = read_answer(tmp_path / "a.json", CAUSES)
    assert answer.equation_torques[FIRST].values.tolist() == [[0.0, 0.0, 0.1], [0.2, 1.0, 0.0]]
    middle, outside = answer.predicted_flights[FIRST].at(np.array([0.05, 0.11]))
    assert middle == pytest.approx([0.1, 0.5, 0.05])
    assert np.isnan(outside).all()


def test_an_answer_of_few_probabilities_is_completed_and_valid() -> None:
    for named in ({}, {"rotor_lag": 1.0}, {NOTHING: 0.95}, {"rotor_lag": 0.4, UNLISTED: 0.7}):
        answer = check_answer(answer_with(CAUSES, named), CAUSES, "it")
        assert set(answer.probabilities) == set(CAUSES.names)
        assert all(answer.probabilities[name] == value for name, value in named.items())


def test_base_rates_agree_with_the_kinds_of_cases() -> None:
    rates = CAUSES.base_rates
    assert rates[NOTHING] == pytest.approx(1 / 3, abs=1e-5)
    assert rates[UNLISTED] == pytest.approx(1 / 6, abs=1e-5)
    # Three of twelve cases have one listed cause, two have two, one has three, and one has one with an
    # unlisted.
    assert sum(rates[name] for name in CAUSES.listed) == pytest.approx(11 / 12, abs=1e-4)


def test_a_case_has_the_same_six_columns_in_both_formats(tmp_path: Path) -> None:
    folder = make(tmp_path / "small", cases=1).cases[0]
    case = read_case(folder)
    table = pyarrow.parquet.read_table(folder / "training-1.parquet")
    assert table.column_names == ["t_s", "front_V", "back_V", "elevation_rad", "pitch_rad", "travel_rad"]
    assert table.column("elevation_rad").to_pylist() == case.training[0].elevation_rad.tolist()
    assert case.rig["thrust_gain"].tolerance > 0.0


def test_a_folder_that_is_no_split_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match=r"causes.json: No such file.*benchmark make"):
        read_split(tmp_path)


@pytest.mark.parametrize("content", ["{}", '{"schema": 1, "split": "public", "seed": 1}'])
def test_a_split_that_lacks_a_key_is_one_line(content: str, tmp_path: Path) -> None:
    (tmp_path / "causes.json").write_text(content)
    with pytest.raises(BenchmarkError, match=r"causes\.json has no '(schema|causes)'; give a folder that"):
        read_split(tmp_path)


def test_causes_have_units_of_the_catalogue() -> None:
    assert isinstance(CAUSES, Causes)
    assert CAUSES.parameters["rotor_lag"] == {"rotor_lag_s": "s"}
