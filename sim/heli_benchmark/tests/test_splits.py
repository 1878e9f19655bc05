"""The published benchmark: its format, its draws, its sealed splits, and a whole split from draw to table."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from heli_host.data.flight import Flight
from heli_host.errors import FlightAborted
from heli_host.ui.cli.entry import run

from heli_benchmark import scores, splits
from heli_benchmark.cases.published import LISTED_CAUSES, PublishedCase, base_rates, published_cases
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.leaderboard import summarise_runs
from heli_benchmark.scores import score_run
from heli_benchmark.splits import (
    MAX_ATTEMPTS,
    MAX_REDRAWS,
    Seal,
    causes_content,
    fly_case,
    make_split,
    read_seal,
)
from heli_benchmark.task import (
    NOTHING,
    UNLISTED,
    Answer,
    Causes,
    Split,
    answer_with,
    causes_of,
    check_answer,
    read_answer,
    read_case,
    read_split,
    write_answer,
)
from heli_benchmark.tests.leaks import accuracy, chance, file_features, labels_of
from heli_benchmark.tests.small_split import LAG, informed, make

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


def test_values_beyond_0_and_1_of_an_answer_are_clipped() -> None:
    clipped = answer_with(CAUSES, {"rotor_lag": 1.0, UNLISTED: 0.0})
    assert answer_with(CAUSES, {"rotor_lag": 3.0, UNLISTED: -1.0}) == clipped
    check_answer(answer_with(CAUSES, {NOTHING: 1.5}), CAUSES, "it")


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


SECRET = "00112233445566778899aabbccddeeff"
NAMES = ["case-001", "case-002"]


@pytest.fixture
def short_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases with flights of a second, and a lag as truth: what flies is the subject of other tests."""
    t_s = 0.01 * np.arange(100.0)
    flight = Flight(t_s, 1.5 + 0.0 * t_s, 1.5 + 0.0 * t_s, 0.1 * np.sin(t_s), 0.0 * t_s, 0.0 * t_s)

    def truth(case: Any, _flight: Flight) -> dict[str, Any]:
        return {"schema": 1, "case": case.name, "causes": LAG, "unlisted": {}}

    monkeypatch.setattr(splits, "fly_case", lambda case: (case, tuple(flight for _ in case.durations_s)))
    monkeypatch.setattr(splits, "truth_content", truth)
    monkeypatch.setattr(splits, "true_torque_Nm", lambda *_: (t_s, np.zeros((100, 3))))


@pytest.fixture
def sealed(tmp_path: Path) -> tuple[Path, Path]:
    """Folders of a sealed split and of its truths."""
    split, truths = tmp_path / "sealed", tmp_path / "truths"
    make_split(split, "sealed", Seal(SECRET), 2, truth_folder=truths)
    return split, truths


def answer_all(split: Path, truths: Path, runs: Path) -> None:
    runs.mkdir()
    for name in NAMES:
        write_answer(runs / f"{name}.json", informed(read_split(split, truths).truth(name)))


@pytest.mark.usefixtures("short_flights")
def test_a_sealed_split_has_no_truth_and_no_secret_in_its_folder(sealed: tuple[Path, Path]) -> None:
    split, truths = sealed
    texts = [
        path.read_text() for path in split.rglob("*") if path.suffix in (".json", ".md", ".toml", ".csv")
    ]
    salts = [json.loads((truths / f"{name}.json").read_text())["salt"] for name in NAMES]
    hidden = [SECRET, str(Seal(SECRET).seed), "visibility_std", *salts]
    assert not [word for word in hidden if any(word in text for text in texts)]
    assert not (split / "truth").exists()


@pytest.mark.usefixtures("short_flights")
def test_a_commitment_is_the_digest_that_sha256sum_prints(sealed: tuple[Path, Path]) -> None:
    split, truths = sealed
    digests = json.loads((split / "commitments.json").read_text())["sha256"]
    assert digests == {
        name: hashlib.sha256((truths / f"{name}.json").read_bytes()).hexdigest() for name in NAMES
    }


@pytest.mark.usefixtures("short_flights")
def test_equal_truths_have_different_commitments(sealed: tuple[Path, Path]) -> None:
    digests = json.loads((sealed[0] / "commitments.json").read_text())["sha256"]
    assert len(set(digests.values())) == 2


@pytest.mark.usefixtures("short_flights")
def test_a_truth_that_was_changed_after_the_answers_is_refused(
    sealed: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    split, truths = sealed
    answer_all(split, truths, tmp_path / "runs")
    words = ["benchmark", "score", str(split), str(tmp_path / "runs"), "--truth", str(truths)]
    assert run(words) == 0
    assert "100% (100% to 100%)" in capsys.readouterr().out
    file = truths / "case-002.json"
    file.write_text(file.read_text().replace("0.1", "0.2"))
    assert run(words) == 2
    assert "case-002.json is not the truth that the split committed to" in capsys.readouterr().err


@pytest.mark.usefixtures("short_flights")
def test_a_sealed_split_cannot_be_scored_without_its_truths(
    sealed: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    split, truths = sealed
    answer_all(split, truths, tmp_path / "runs")
    assert run(["benchmark", "score", str(split), str(tmp_path / "runs")]) == 2
    assert "give the folder of the truths with --truth" in capsys.readouterr().err


@pytest.mark.usefixtures("short_flights")
def test_no_method_runs_before_all_commitments_are_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fly = splits.fly_case

    def interrupt_at_second(case: Any) -> Any:
        if case.name == "case-002":
            raise KeyboardInterrupt
        return fly(case)

    monkeypatch.setattr(splits, "fly_case", interrupt_at_second)
    with pytest.raises(KeyboardInterrupt):
        make_split(tmp_path / "s", "sealed", Seal(SECRET), 2, truth_folder=tmp_path / "t")
    with pytest.raises(BenchmarkError, match=r"commitments.json.*it continues"):
        read_split(tmp_path / "s")
    monkeypatch.setattr(splits, "fly_case", fly)
    make_split(tmp_path / "s", "sealed", Seal(SECRET), 2, truth_folder=tmp_path / "t")
    assert [case.name for case in read_split(tmp_path / "s").cases] == NAMES


@pytest.mark.usefixtures("short_flights")
def test_the_same_secret_makes_the_same_commitments(sealed: tuple[Path, Path], tmp_path: Path) -> None:
    make_split(tmp_path / "again", "sealed", Seal(SECRET), 2, truth_folder=tmp_path / "truths-again")
    files = [folder / "commitments.json" for folder in (sealed[0], tmp_path / "again")]
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.usefixtures("short_flights")
def test_an_open_split_grows_and_a_sealed_one_does_not(sealed: tuple[Path, Path], tmp_path: Path) -> None:
    for count in (1, 3):
        make_split(tmp_path / "open", "public", 7, count)
    assert [case.name for case in read_split(tmp_path / "open").cases] == [*NAMES, "case-003"]
    with pytest.raises(BenchmarkError, match="contains another split"):
        make_split(tmp_path / "open", "public", 7, 2)
    with pytest.raises(BenchmarkError, match="contains another split"):
        make_split(sealed[0], "sealed", Seal(SECRET), 3, truth_folder=sealed[1])


@pytest.mark.usefixtures("short_flights")
@pytest.mark.parametrize("place", range(len(SECRET)))
def test_each_digit_of_the_secret_changes_the_cases_and_their_salts(place: int) -> None:
    digit = "0" if SECRET[place] == "f" else "f"
    other = Seal(SECRET[:place] + digit + SECRET[place + 1 :])
    drawn, drawn_by_other = (
        [case.seed for case in published_cases(seal.seed, 4)] for seal in (Seal(SECRET), other)
    )
    assert not set(drawn) & set(drawn_by_other)
    assert Seal(SECRET).salt("case-001") != other.salt("case-001")


@pytest.mark.usefixtures("short_flights")
def test_each_case_has_a_salt_of_its_own() -> None:
    assert len({Seal(SECRET).salt(f"case-{number:03d}") for number in range(1, 100)}) == 99


@pytest.mark.usefixtures("short_flights")
@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "can be guessed: 0 digits"),
        ("1234", "can be guessed: 4 digits"),
        ("0" * 64, "can be guessed: 64 digits"),
        ("a secret", "is not one line of hexadecimal digits"),
    ],
)
def test_a_secret_that_can_be_guessed_is_refused(content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text(content)
    with pytest.raises(BenchmarkError, match="openssl rand") as caught:
        read_seal(tmp_path / "secret.txt")
    assert words in str(caught.value)


@pytest.mark.usefixtures("short_flights")
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--secret", "no.txt", "--seed", "1"], "--seed and --secret exclude each other"),
        (["--secret", "no.txt"], "a sealed split stores its true answers in another folder"),
        (["--secret", "no.txt", "--truth", "t"], "cannot read no.txt"),
    ],
)
def test_wrong_options_of_a_sealed_split_are_one_line(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["benchmark", "make", str(tmp_path / "s"), *options]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


@pytest.mark.usefixtures("short_flights")
def test_truths_inside_the_folder_of_a_sealed_split_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match=r"is inside.*another folder with --truth"):
        make_split(tmp_path / "s", "sealed", Seal(SECRET), 2, truth_folder=tmp_path / "s" / "truth")


@pytest.mark.usefixtures("short_flights")
@pytest.mark.medium
def test_programs_that_know_croissant_load_the_flights_of_a_split(sealed: tuple[Path, Path]) -> None:
    croissant = pytest.importorskip("mlcroissant", reason="skipped: no mlcroissant")
    split, _ = sealed
    dataset = croissant.Dataset(str(split / "croissant.json"))
    rows = list(dataset.records("training-rows"))
    flights = len(list(split.glob("cases/*/training-*.csv")))
    assert len(rows) == 100 * flights
    assert rows[50]["training-rows/elevation_rad"] == pytest.approx(0.1 * np.sin(0.5), abs=1e-8)
    assert rows[0]["training-rows/file"].endswith(b"cases/case-001/training-1.csv")


@pytest.mark.usefixtures("short_flights")
def test_the_data_card_says_whether_the_truth_is_sealed(sealed: tuple[Path, Path], tmp_path: Path) -> None:
    make_split(tmp_path / "open", "public", 7, 1)
    assert "Seed 7 of heli-lab" in (tmp_path / "open" / "README.md").read_text()
    card = (sealed[0] / "README.md").read_text()
    assert Seal(SECRET).digest in card
    assert "| `front_V` | voltage of the front motor, in volts |" in card
    assert "{" not in card


COUNT = 24
SHORT_s = 1.0


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Split]:
    """A split whose flights last a second each; rigs, controllers, rates and causes are drawn as usual."""
    folder = tmp_path_factory.mktemp("whole") / "public"

    def short(seed: int, count: int) -> Iterator[PublishedCase]:
        for case in published_cases(seed, count):
            training, validation = ((SHORT_s,) * len(of) for of in (case.training_s, case.validation_s))
            yield replace(case, training_s=training, validation_s=validation)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(splits, "published_cases", short)
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
    # Flights of a second show no cause clearly.
    monkeypatch.setattr(scores, "MIN_VISIBILITY_STD", 0.0)

    def with_torques(truth: dict[str, Any]) -> Answer:
        return replace(informed(truth), equation_torques=split.unlisted_torques_Nm(truth["case"]))

    names = {case.name for case in split.cases if split.truth(case.name)["unlisted"]}
    assert {case.name for case in split.cases if split.unlisted_torques_Nm(case.name)} == names
    assert len(names) == COUNT // 6
    for name in names:
        strongest_Nm = max(abs(of.values).max() for of in split.unlisted_torques_Nm(name).values())
        assert 1e-3 < strongest_Nm < 1.0
    right = score_run(split, answers(split, tmp_path / "right", with_torques))
    correlations = {of.case: of.equation for of in right if of.equation is not None}
    assert correlations == pytest.approx(dict.fromkeys(names, 1.0))


@pytest.mark.slow
def test_names_and_formats_of_flown_files_give_no_hint_of_the_truth(split: Split) -> None:
    features = [file_features(case) for case in split.cases]
    assert chance(features, labels_of(split), permutations=39) > 0.05
