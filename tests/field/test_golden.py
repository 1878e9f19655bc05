"""Golden results: what counts as a difference, and that every case has one."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from typing import Any

import pytest

from tests.field.cases import NO_DATA
from tests.field.golden import FILE, differences, runs

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
