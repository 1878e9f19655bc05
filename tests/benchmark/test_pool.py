"""Scores of several splits are pooled: the result is that of one split with all their cases."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from heli_benchmark.leaderboard import pooled_scores, score_run, scores_content
from heli_benchmark.task import Answer, Split, read_split, write_answer
from heli_benchmark.task.json_file import write_json
from heli_host.ui.cli.entry import run

from tests.benchmark.small_split import informed, make


def part(whole: Split, folder: Path, name: str, numbers: slice) -> Split:
    """A split that has some cases of another one."""
    shutil.copytree(whole.folder, folder)
    for case in whole.cases:
        if case not in whole.cases[numbers]:
            shutil.rmtree(folder / "cases" / case.name)
    causes = json.loads((folder / "causes.json").read_text())
    (folder / "causes.json").write_text(json.dumps(causes | {"split": name}))
    return read_split(folder)


def written(split: Split, place: Path, *methods: str) -> Path:
    """Scores of a method that knows half of the truth and of base rates, as a file."""
    runs = {}
    for name in methods or ("informed", "base"):
        folder = place / f"{split.name}-{name}"
        folder.mkdir()
        for number, case in enumerate(split.cases):
            knows = name == "informed" and number % 2 == 0
            answer = informed(split.truth(case.name)) if knows else Answer(split.causes.base_rates)
            write_answer(folder / f"{case.name}.json", answer)
        runs[name] = score_run(split, folder)
    write_json(place / f"{split.name}.json", scores_content(split, runs))
    return place / f"{split.name}.json"


def without(content: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in content.items() if key not in keys}


@pytest.fixture
def splits(tmp_path: Path) -> tuple[Split, Split, Split]:
    complete = make(tmp_path / "whole")
    first = part(complete, tmp_path / "first", "first", slice(0, 4))
    return complete, first, part(complete, tmp_path / "second", "second", slice(4, None))


@pytest.mark.medium
def test_pooled_scores_equal_those_of_one_split_with_all_cases(
    splits: tuple[Split, Split, Split], tmp_path: Path
) -> None:
    whole, first, second = (written(split, tmp_path) for split in splits)
    pooled = pooled_scores([first, second])
    assert without(pooled, "splits") == without(pooled_scores([whole]), "splits")
    assert pooled["cases"] == 6
    # Intervals and pairs are those of all cases, not of one part.
    first_scores = pooled_scores([first])
    assert pooled["methods"]["informed"]["skill"] != first_scores["methods"]["informed"]["skill"]
    assert pooled["pairs"][0]["skill"]["cases"] == 6
    assert 0.0 < pooled["pairs"][0]["skill"]["low"] < pooled["pairs"][0]["skill"]["high"] <= 1.0


@pytest.mark.medium
def test_a_pooled_report_can_be_pooled_again(splits: tuple[Split, Split, Split], tmp_path: Path) -> None:
    _, first, second = (written(split, tmp_path) for split in splits)
    assert run(["benchmark", "report", str(first), str(second), "-o", str(tmp_path / "report")]) == 0
    assert "\nCases: 6, of 2 splits.\n" in (tmp_path / "report" / "table.md").read_text()
    assert pooled_scores([tmp_path / "report" / "scores.json"]) == pooled_scores([first, second])


@pytest.mark.medium
def test_a_split_counts_once_and_each_method_has_scores_on_all_splits(
    splits: tuple[Split, Split, Split], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = written(splits[1], tmp_path), written(splits[2], tmp_path, "base")
    for files, message in (
        ((first, first), "have scores of the same split; give each split once"),
        ((first, second), "second.json has no method 'informed'; score the same methods on each split"),
        ((second, first), "second.json has no method 'informed'; score the same methods on each split"),
    ):
        report = ["benchmark", "report", *map(str, files), "-o", str(tmp_path / "report")]
        assert run(report) == 2
        error = capsys.readouterr().err
        assert error.startswith("error: ") and error.count("\n") == 1
        assert message in error


@pytest.mark.medium
def test_invalid_scores_of_a_case_are_one_line(splits: tuple[Split, Split, Split], tmp_path: Path) -> None:
    file = written(splits[1], tmp_path)
    content = json.loads(file.read_text())
    broken: Any
    for broken in ({"base": [{"case": "case-001"}]}, {"base": []}, {}, {"base": 3}, []):
        file.write_text(json.dumps(content | {"case_scores": broken}))
        with pytest.raises(Exception, match=r"first\.json (has invalid scores|does not score all methods)"):
            pooled_scores([file])
