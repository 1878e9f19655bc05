"""A sealed split shows no truth, commits to each before any method runs, and scores only those truths."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_benchmark.cases.published import published_cases
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.splits import Seal, make, make_split, read_seal
from heli_benchmark.task import read_split, write_answer
from heli_host.data.flight import Flight
from heli_host.ui.cli.entry import run

from tests.benchmark.small_split import LAG, informed

SECRET = "00112233445566778899aabbccddeeff"
NAMES = ["case-001", "case-002"]


@pytest.fixture(autouse=True)
def short_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases with flights of a second, and a lag as truth: what flies is the subject of other tests."""
    t_s = 0.01 * np.arange(100.0)
    flight = Flight(t_s, 1.5 + 0.0 * t_s, 1.5 + 0.0 * t_s, 0.1 * np.sin(t_s), 0.0 * t_s, 0.0 * t_s)

    def truth(case: Any, _flight: Flight) -> dict[str, Any]:
        return {"schema": 1, "case": case.name, "causes": LAG, "unlisted": {}}

    monkeypatch.setattr(make, "fly_case", lambda case: (case, tuple(flight for _ in case.durations_s)))
    monkeypatch.setattr(make, "truth_content", truth)
    monkeypatch.setattr(make, "true_torque_Nm", lambda *_: (t_s, np.zeros((100, 3))))


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


def test_a_sealed_split_has_no_truth_and_no_secret_in_its_folder(sealed: tuple[Path, Path]) -> None:
    split, truths = sealed
    texts = [
        path.read_text() for path in split.rglob("*") if path.suffix in (".json", ".md", ".toml", ".csv")
    ]
    salts = [json.loads((truths / f"{name}.json").read_text())["salt"] for name in NAMES]
    hidden = [SECRET, str(Seal(SECRET).seed), "visibility_std", *salts]
    assert not [word for word in hidden if any(word in text for text in texts)]
    assert not (split / "truth").exists()


def test_a_commitment_is_the_digest_that_sha256sum_prints(sealed: tuple[Path, Path]) -> None:
    split, truths = sealed
    digests = json.loads((split / "commitments.json").read_text())["sha256"]
    assert digests == {
        name: hashlib.sha256((truths / f"{name}.json").read_bytes()).hexdigest() for name in NAMES
    }


def test_equal_truths_have_different_commitments(sealed: tuple[Path, Path]) -> None:
    digests = json.loads((sealed[0] / "commitments.json").read_text())["sha256"]
    assert len(set(digests.values())) == 2


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


def test_a_sealed_split_cannot_be_scored_without_its_truths(
    sealed: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    split, truths = sealed
    answer_all(split, truths, tmp_path / "runs")
    assert run(["benchmark", "score", str(split), str(tmp_path / "runs")]) == 2
    assert "give the folder of the truths with --truth" in capsys.readouterr().err


def test_no_method_runs_before_all_commitments_are_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fly = make.fly_case

    def interrupt_at_second(case: Any) -> Any:
        if case.name == "case-002":
            raise KeyboardInterrupt
        return fly(case)

    monkeypatch.setattr(make, "fly_case", interrupt_at_second)
    with pytest.raises(KeyboardInterrupt):
        make_split(tmp_path / "s", "sealed", Seal(SECRET), 2, truth_folder=tmp_path / "t")
    with pytest.raises(BenchmarkError, match=r"commitments.json.*it continues"):
        read_split(tmp_path / "s")
    monkeypatch.setattr(make, "fly_case", fly)
    make_split(tmp_path / "s", "sealed", Seal(SECRET), 2, truth_folder=tmp_path / "t")
    assert [case.name for case in read_split(tmp_path / "s").cases] == NAMES


def test_the_same_secret_makes_the_same_commitments(sealed: tuple[Path, Path], tmp_path: Path) -> None:
    make_split(tmp_path / "again", "sealed", Seal(SECRET), 2, truth_folder=tmp_path / "truths-again")
    files = [folder / "commitments.json" for folder in (sealed[0], tmp_path / "again")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_an_open_split_grows_and_a_sealed_one_does_not(sealed: tuple[Path, Path], tmp_path: Path) -> None:
    for count in (1, 3):
        make_split(tmp_path / "open", "public", 7, count)
    assert [case.name for case in read_split(tmp_path / "open").cases] == [*NAMES, "case-003"]
    with pytest.raises(BenchmarkError, match="contains another split"):
        make_split(tmp_path / "open", "public", 7, 2)
    with pytest.raises(BenchmarkError, match="contains another split"):
        make_split(sealed[0], "sealed", Seal(SECRET), 3, truth_folder=sealed[1])


@pytest.mark.parametrize("place", range(len(SECRET)))
def test_each_digit_of_the_secret_changes_the_cases_and_their_salts(place: int) -> None:
    digit = "0" if SECRET[place] == "f" else "f"
    other = Seal(SECRET[:place] + digit + SECRET[place + 1 :])
    drawn, drawn_by_other = (
        [case.seed for case in published_cases(seal.seed, 4)] for seal in (Seal(SECRET), other)
    )
    assert not set(drawn) & set(drawn_by_other)
    assert Seal(SECRET).salt("case-001") != other.salt("case-001")


def test_each_case_has_a_salt_of_its_own() -> None:
    assert len({Seal(SECRET).salt(f"case-{number:03d}") for number in range(1, 100)}) == 99


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


def test_truths_inside_the_folder_of_a_sealed_split_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match=r"is inside.*another folder with --truth"):
        make_split(tmp_path / "s", "sealed", Seal(SECRET), 2, truth_folder=tmp_path / "s" / "truth")


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


def test_the_data_card_says_whether_the_truth_is_sealed(sealed: tuple[Path, Path], tmp_path: Path) -> None:
    make_split(tmp_path / "open", "public", 7, 1)
    assert "Seed 7 of heli-lab" in (tmp_path / "open" / "README.md").read_text()
    card = (sealed[0] / "README.md").read_text()
    assert Seal(SECRET).digest in card
    assert "| `front_V` | voltage of the front motor, in volts |" in card
    assert "{" not in card
