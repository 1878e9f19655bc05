"""A fast share of the blind cases: something is hidden in MuJoCo's flights, and the diagnosis has to find it.

All cases: `make blind`.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest
from heli_host.log.flight_file import read_flight
from heli_sim.rig import load_rig

from tests.blind.cases import every_case
from tests.blind.run import diagnosed

pytestmark = pytest.mark.diagnosis

NOTHING = ("nothing-6",)
ONE = {"rotor_lag-small": "rotor_lag", "cable_spring.travel-large": "cable_spring.travel"}
OFF_LIST = ("off-bumpy_pitch-large",)
Answers = dict[str, Future[dict[str, Any]]]


def answer(name: str, folder: Path) -> dict[str, Any]:
    case = next(case for case in every_case() if case.name == name)
    print(f"{name}: seed {case.seed}")
    train, held_out = (read_flight(path) for path in case.flights(folder))
    return diagnosed(load_rig("makki2024"), (train, held_out))


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Answers]:
    folder = tmp_path_factory.mktemp("blind")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        yield {name: pool.submit(answer, name, folder) for name in (*NOTHING, *ONE, *OFF_LIST)}


@pytest.mark.parametrize("name", NOTHING)
def test_a_rig_with_other_numbers_and_nothing_hidden_raises_no_alarm(answers: Answers, name: str) -> None:
    result = answers[name].result()
    assert (result["verdict"], result["causes"]) == ("explained", [])


@pytest.mark.parametrize("name", ONE)
def test_the_hidden_effect_is_named_with_its_size(answers: Answers, name: str) -> None:
    result = answers[name].result()
    case = next(case for case in every_case() if case.name == name)
    assert [cause["effect"] for cause in result["causes"]] == [ONE[name]]
    size = next(iter(result["causes"][0]["parameters"].values()))
    assert size["value"] == pytest.approx(case.truth()[ONE[name]]["size"], abs=3.0 * size["std"])
    assert result["residual"]["normalised"]["held_out_after"] < 1.05


@pytest.mark.parametrize("name", OFF_LIST)
def test_what_is_on_no_list_is_called_unexplained(answers: Answers, name: str) -> None:
    assert answers[name].result()["verdict"] == "unexplained"


def test_causes_given_with_confidence_0_9_are_the_hidden_ones(answers: Answers) -> None:
    cases = {case.name: {name for name, _ in case.effects} for case in every_case() if case.name in answers}
    sure = [
        (name, cause["effect"])
        for name, answer_of in answers.items()
        for cause in answer_of.result()["causes"]
        if cause["confidence"] >= 0.9
    ]
    assert {name for name, _ in sure} == set(ONE)
    assert all(effect in cases[name] for name, effect in sure)
