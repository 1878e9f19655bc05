"""Cases of the published benchmark: their kinds, and no hint of the truth in their conditions or files."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from heli_benchmark.cases.published import LISTED_CAUSES, PublishedCase, base_rates, published_cases
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.splits.causes import causes_content
from heli_benchmark.splits.make import MAX_ATTEMPTS, MAX_REDRAWS, fly_case
from heli_host.errors import FlightAborted

from tests.benchmark.leaks import accuracy, chance, file_features, labels_of
from tests.benchmark.small_split import make

CASES = list(published_cases(seed=7, count=240))
HIDDEN = [bool(case.effects or case.unlisted) for case in CASES]


def conditions(case: PublishedCase) -> dict[str, object]:
    return {
        "rate": case.rate_Hz,
        "controller": case.controller,
        "training": case.training_s,
        "validation": case.validation_s,
        "rig": case.rig_name,
        "weak": case.gentle,
        "number": int(case.name[-3:]) % 4,
        "disturbed": any(case.disturbances.gusts_Nm),
    }


def test_a_third_of_the_cases_hides_nothing_and_the_kinds_have_their_shares() -> None:
    counts = Counter((len(case.effects), len(case.unlisted)) for case in CASES)
    # A draw with causes that exclude each other is repeated, so that the counts are exact.
    assert counts == {(0, 0): 80, (1, 0): 60, (2, 0): 40, (3, 0): 20, (0, 1): 20, (1, 1): 20}
    assert {cause for case in CASES for cause, _ in case.effects} == set(LISTED_CAUSES)
    assert {case.rig_name for case in CASES} == {"makki2024", "quanser-course"}
    assert {case.rate_Hz for case in CASES} == {100, 250, 500}


def test_the_same_seed_draws_the_same_cases() -> None:
    assert list(published_cases(7, 240)) == CASES
    assert list(published_cases(8, 240)) != CASES


def test_a_larger_split_begins_with_the_cases_of_a_smaller_one() -> None:
    assert list(published_cases(7, 36)) == CASES[:36]
    assert Counter(HIDDEN[:36]) == {True: 24, False: 12}


@pytest.mark.medium
def test_hidden_causes_occur_as_often_as_the_base_rates_state() -> None:
    cases = [case for seed in range(5) for case in published_cases(seed, 240)]
    counts = Counter(cause for case in cases for cause, _ in case.effects)
    for name, rate in base_rates().items():
        if name in LISTED_CAUSES:
            # Five standard deviations of a binomial count.
            assert abs(counts[name] - rate * len(cases)) < 5.0 * (rate * len(cases)) ** 0.5, name


@pytest.mark.medium
def test_conditions_give_no_hint_of_the_truth() -> None:
    features = [conditions(case) for case in CASES[:72]]
    assert chance(features, HIDDEN[:72], permutations=19) > 0.05
    # The same classifier finds a hint if there is one.
    leaking = [
        case_features | {"rate": 100 if hidden else case_features["rate"]}
        for case_features, hidden in zip(features, HIDDEN, strict=False)
    ]
    assert chance(leaking, HIDDEN[:72], permutations=19) == 0.0


@pytest.mark.medium
def test_names_headers_and_formats_of_files_are_the_same_in_all_cases(tmp_path: Path) -> None:
    split = make(tmp_path / "small")
    features = [file_features(case) | {"number": 0} for case in split.cases]
    assert all(case_features == features[0] for case_features in features)
    assert accuracy(features, labels_of(split)) <= 4 / 6


def test_names_of_causes_show_no_truth() -> None:
    content = causes_content()
    assert {"nothing", "unlisted", *LISTED_CAUSES} == set(content)


@pytest.mark.parametrize("kind", ["nothing", "two", "unlisted and one"])
def test_a_rig_that_cannot_be_flown_is_drawn_again_with_the_same_kind(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = next(case for case in CASES if case.draw.kind == kind)
    unflyable, flown = case.rig(), []

    def fly(case: PublishedCase, flight: int, duration_s: float) -> tuple[str, None]:
        flown.append(case)
        if case.rig() == unflyable:
            raise FlightAborted("elevation left its range", "draw another")
        return f"flight {flight} of {duration_s:g} s", None

    monkeypatch.setattr(PublishedCase, "fly", fly)
    other, flights = fly_case(case)
    assert len(flown) == MAX_ATTEMPTS + len(other.durations_s)
    assert (other.name, other.draw.kind, len(flights)) == (case.name, kind, len(other.durations_s))
    assert (len(other.effects), len(other.unlisted)) == (len(case.effects), len(case.unlisted))
    assert other.seed != case.seed


def test_a_split_is_given_up_only_after_many_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    flown = []

    def fly(case: PublishedCase, flight: int, duration_s: float) -> None:
        flown.append(case)
        raise FlightAborted("elevation left its range", "draw another")

    monkeypatch.setattr(PublishedCase, "fly", fly)
    with pytest.raises(BenchmarkError, match="another seed"):
        fly_case(CASES[0])
    assert len(flown) == MAX_ATTEMPTS * (1 + MAX_REDRAWS)
    assert len({case.seed for case in flown}) == 1 + MAX_REDRAWS
