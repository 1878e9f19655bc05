"""Twenty-four cases from the draw to the table: flown by MuJoCo, answered, scored, and without leaks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from heli_benchmark.cases.published import PublishedCase, published_cases
from heli_benchmark.leaderboard import score, score_run, summarise_runs
from heli_benchmark.splits import make, make_split
from heli_benchmark.task import Answer, Split, read_split, write_answer

from tests.benchmark.leaks import chance, file_features, labels_of
from tests.benchmark.small_split import informed

COUNT = 24
SHORT_s = 2.0


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Split]:
    """A split whose flights last two seconds each; rigs, controllers, rates and causes are drawn as usual."""
    folder = tmp_path_factory.mktemp("whole") / "public"

    def short(seed: int, count: int) -> Iterator[PublishedCase]:
        for case in published_cases(seed, count):
            training, validation = ((SHORT_s,) * len(of) for of in (case.training_s, case.validation_s))
            yield replace(case, training_s=training, validation_s=validation)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(make, "published_cases", short)
        make_split(folder, "public", 34, COUNT)
    yield read_split(folder)


def answers(split: Split, folder: Path, method: Any) -> Path:
    folder.mkdir()
    for case in split.cases:
        write_answer(folder / f"{case.name}.json", method(split.truth(case.name)))
    return folder


@pytest.mark.slow
def test_a_third_hides_nothing_and_all_flights_have_their_length(split: Split) -> None:
    assert len(split.cases) == COUNT
    assert sum(not hidden for hidden in labels_of(split)) == COUNT // 3
    rows = [len((case / "training-1.csv").read_text().splitlines()) for case in split.cases]
    assert {round((count - 1) / SHORT_s, -1) for count in rows} == {100.0, 250.0, 500.0}


@pytest.mark.slow
def test_base_rates_have_skill_0_and_the_truth_skill_1_on_flown_cases(split: Split, tmp_path: Path) -> None:
    base = answers(split, tmp_path / "base", lambda truth: Answer(split.causes.base_rates))
    truth = answers(split, tmp_path / "truth", informed)
    methods = summarise_runs({"base": score_run(split, base), "truth": score_run(split, truth)})["methods"]
    assert methods["base"]["skill"]["value"] == 0.0
    assert methods["truth"]["skill"]["value"] == 1.0
    assert methods["truth"]["false_alarms"]["value"] == methods["truth"]["false_names"]["value"] == 0.0


@pytest.mark.slow
def test_the_true_torques_of_unlisted_causes_are_scored_as_a_right_equation(
    split: Split, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Flights of two seconds show no cause clearly.
    monkeypatch.setattr(score, "MIN_VISIBILITY_STD", 0.0)

    def with_torques(truth: dict[str, Any]) -> Answer:
        return replace(informed(truth), equation_torques=split.unlisted_torques_Nm(truth["case"]))

    names = {case.name for case in split.cases if split.truth(case.name)["unlisted"]}
    assert {case.name for case in split.cases if split.unlisted_torques_Nm(case.name)} == names
    assert len(names) == COUNT // 6
    for name in names:
        strongest_Nm = max(abs(of.values).max() for of in split.unlisted_torques_Nm(name).values())
        assert 1e-3 < strongest_Nm < 1.0
    scores = score_run(split, answers(split, tmp_path / "right", with_torques))
    correlations = {of.case: of.equation for of in scores if of.equation is not None}
    assert correlations == pytest.approx(dict.fromkeys(names, 1.0))


@pytest.mark.slow
def test_names_and_formats_of_flown_files_give_no_hint_of_the_truth(split: Split) -> None:
    features = [file_features(case) for case in split.cases]
    assert chance(features, labels_of(split), permutations=39) > 0.05
