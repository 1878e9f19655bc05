"""Scores of the published benchmark: skill, names, false alarms, sizes, calibration, intervals."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_benchmark.leaderboard import score as score_module
from heli_benchmark.leaderboard.report import comparison_table, pair_lines
from heli_benchmark.leaderboard.score import (
    CaseScore,
    equation_correlation,
    score_answer,
    score_run,
    score_runs,
    scored_truth,
)
from heli_benchmark.leaderboard.summary import summarise_runs
from heli_benchmark.splits.causes import causes_content
from heli_benchmark.task import (
    NOTHING,
    UNLISTED,
    Answer,
    AxisSeries,
    BenchmarkCase,
    Estimate,
    read_case,
    write_answer,
)
from heli_benchmark.task.split import causes_of
from heli_host.data.arrays import Floats
from heli_host.ui.cli.entry import run

from tests.benchmark.small_split import TRUTHS, informed, make

CAUSES = causes_of({"causes": causes_content()})
CONTENTS = [{"causes": causes, "unlisted": unlisted} for causes, unlisted in TRUTHS]
EMPTY, LAG, TWO, WITH_FAINT, UNKNOWN, _ = CONTENTS


def scores(method: Callable[[dict[str, Any]], Answer], failure: str = "") -> list[CaseScore]:
    return [
        score_answer(f"case-{i}", method(content), scored_truth(content), CAUSES, failure=failure)
        for i, content in enumerate(CONTENTS)
    ]


def base_rates(_: dict[str, Any]) -> Answer:
    return Answer(CAUSES.base_rates)


def certain(name: str, probability: float = 1.0, **parameters: Estimate) -> Answer:
    return Answer({name: probability}, parameters)


def score(content: dict[str, Any], answer: Answer) -> CaseScore:
    return score_answer("case", answer, scored_truth(content), CAUSES)


def test_base_rates_have_skill_0_and_the_truth_has_skill_1() -> None:
    methods = summarise_runs({"base": scores(base_rates), "truth": scores(informed)})["methods"]
    assert methods["base"]["skill"] == {"value": 0.0, "low": 0.0, "high": 0.0, "cases": 6}
    assert methods["truth"]["skill"] == {"value": 1.0, "low": 1.0, "high": 1.0, "cases": 6}
    for name, best in (("first_right", 1.0), ("all_named", 1.0), ("false_names", 0.0), ("false_alarms", 0.0)):
        assert methods["truth"][name]["value"] == best
    assert methods["truth"]["sizes_within"]["value"] == methods["truth"]["sizes_given"]["value"] == 1.0


def test_a_share_of_few_cases_has_a_wide_interval() -> None:
    alarms = summarise_runs({"truth": scores(informed)})["methods"]["truth"]["false_alarms"]
    # Two cases hide nothing. No alarm in two of two is compatible with 84 %: 0.16 squared is 2.5 %.
    assert (alarms["value"], alarms["low"], alarms["cases"]) == (0.0, 0.0, 2)
    assert alarms["high"] == pytest.approx(1.0 - 0.025**0.5)


def test_a_wrong_certainty_costs_more_than_base_rates() -> None:
    always_lag = summarise_runs({"lag": scores(lambda _: certain("rotor_lag"))})["methods"]["lag"]
    assert always_lag["skill"]["value"] < 0.0
    assert always_lag["false_alarms"]["value"] == 1.0
    # One of the six cases has the lag alone, and one has it with a cause that is not visible.
    assert always_lag["all_named"]["value"] == pytest.approx(2 / 4)
    assert always_lag["first_right"]["value"] == pytest.approx(3 / 6)


def test_every_cause_must_be_named_and_each_false_name_counts() -> None:
    assert score(TWO, certain("rotor_lag")).all_named is False
    assert score(LAG, Answer({"rotor_lag": 0.6, "axis_tilt": 0.6, UNLISTED: 0.6})).false_names == 2
    assert score(LAG, Answer({"rotor_lag": 0.49})).all_named is False
    assert score(UNKNOWN, certain(UNLISTED)).all_named is True
    assert score(EMPTY, certain(NOTHING)).false_alarm is False
    assert score(EMPTY, certain(UNLISTED)).false_alarm is True


def test_a_cause_that_is_not_visible_is_not_scored() -> None:
    with_it = Answer({"rotor_lag": 1.0, "axis_tilt": 1.0})
    without = certain("rotor_lag")
    assert score(WITH_FAINT, with_it).log_loss == score(WITH_FAINT, without).log_loss == 0.0
    assert score(WITH_FAINT, with_it).false_names == 0
    assert score(LAG, with_it).false_names == 1
    only_axis_tilt = {"causes": {"axis_tilt": WITH_FAINT["causes"]["axis_tilt"]}, "unlisted": {}}
    assert (
        score(only_axis_tilt, certain(NOTHING)).log_loss
        == score(only_axis_tilt, certain("axis_tilt")).log_loss
        == 0.0
    )
    assert score(only_axis_tilt, certain(NOTHING)).false_alarm is None


def test_sizes_are_scored_by_their_intervals() -> None:
    near = score(LAG, certain("rotor_lag", rotor_lag_s=Estimate(0.11, 0.01))).sizes[0]
    sharp = score(LAG, certain("rotor_lag", rotor_lag_s=Estimate(0.11, 0.001))).sizes[0]
    # Twice 1.96 standard errors, relative to a true size of 0.1.
    assert near == (True, pytest.approx(0.391993, abs=1e-5))
    # The truth is 0.00804 outside, which costs 40 times as much.
    assert sharp == (False, pytest.approx((0.00391993 + 40.0 * 0.00804004) / 0.1, abs=1e-4))
    assert score(EMPTY, certain(NOTHING, rotor_lag_s=Estimate(0.1, 0.01))).sizes == ()


def test_a_failed_case_counts_as_base_rates_and_names_nothing() -> None:
    methods = summarise_runs({"failed": scores(base_rates, failure="it hangs")})["methods"]
    assert methods["failed"]["failed"] == 6
    assert methods["failed"]["skill"]["value"] == 0.0
    assert methods["failed"]["first_right"]["value"] == 0.0


def test_probabilities_that_are_too_high_show_as_calibration_error() -> None:
    half = summarise_runs({"half": scores(lambda _: certain("rotor_lag", 0.5))})["methods"]["half"]
    sure = summarise_runs({"sure": scores(lambda _: certain("rotor_lag", 1.0))})["methods"]["sure"]
    assert half["calibration_error"]["value"] == pytest.approx(0.0)
    assert sure["calibration_error"]["value"] == pytest.approx(0.5)


def test_methods_are_compared_on_the_same_cases() -> None:
    runs = {"truth": scores(informed), "base": scores(base_rates)}
    pair = summarise_runs(runs)["pairs"][0]
    assert (pair["first"], pair["second"]) == ("truth", "base")
    assert pair["skill"] == {"value": 1.0, "low": 1.0, "high": 1.0, "cases": 6}
    assert pair["all_named"]["value"] == 1.0
    assert summarise_runs(runs, seed=3) == summarise_runs(runs, seed=3)


def test_an_equation_is_scored_by_its_torques_where_an_unlisted_cause_is_visible() -> None:
    t_s: Floats = np.arange(200, dtype=np.float64) * 0.02
    # Pitch has the strongest torque, and decides.
    true_Nm = np.column_stack([0.01 * np.cos(t_s), np.sin(3.0 * t_s), np.zeros(200)])
    true = {"validation-1": AxisSeries(t_s, true_Nm)}

    def correlation(values: Floats, name: str = "validation-1", times_s: Floats = t_s) -> float | None:
        answer = Answer({UNLISTED: 1.0}, equation_torques={name: AxisSeries(times_s, values)})
        return equation_correlation(answer, true)

    assert correlation(0.2 * true_Nm) == pytest.approx(1.0)
    assert correlation(-true_Nm) == pytest.approx(-1.0)
    assert correlation(true_Nm[50:], times_s=t_s[50:]) == pytest.approx(1.0)
    assert correlation(true_Nm * np.array([1.0, 0.0, 1.0])) == 0.0
    assert correlation(true_Nm, name="validation-2") == 0.0
    assert correlation(true_Nm, times_s=t_s + 100.0) == 0.0
    assert correlation(np.ones((200, 3))) == 0.0
    assert equation_correlation(Answer({UNLISTED: 1.0}), true) == 0.0
    assert equation_correlation(Answer({UNLISTED: 1.0}), {}) is None


@pytest.mark.medium
def test_several_runs_read_each_case_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    split = make(tmp_path / "small")
    folders = [tmp_path / name for name in ("first", "second")]
    for folder in folders:
        folder.mkdir()
        for case in split.cases:
            write_answer(folder / f"{case.name}.json", informed(split.truth(case.name)))
    separate_scores = [score_run(split, folder) for folder in folders]
    read: list[str] = []

    def read_and_note(folder: Path) -> BenchmarkCase:
        read.append(folder.name)
        return read_case(folder)

    monkeypatch.setattr(score_module, "read_case", read_and_note)
    assert score_runs(split, folders) == separate_scores
    assert read == [case.name for case in split.cases]


@pytest.mark.medium
def test_answers_of_another_program_are_scored(tmp_path: Path) -> None:
    split = make(tmp_path / "small")
    folder = tmp_path / "theirs"
    folder.mkdir()
    for case in split.cases:
        write_answer(folder / f"{case.name}.json", informed(split.truth(case.name)))
    summary = summarise_runs({"theirs": score_run(split, folder)})
    assert summary["methods"]["theirs"]["skill"]["value"] == 1.0
    assert summary["methods"]["theirs"]["cpu_s"] is None
    assert "| theirs | 1.00 (1.00 to 1.00) | 100%" in comparison_table(summary)
    assert pair_lines(summary) == []


@pytest.mark.medium
def test_the_command_scores_reports_and_explains_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    split = make(tmp_path / "small", cases=2)
    folder, scores_file = tmp_path / "theirs", tmp_path / "scores.json"
    folder.mkdir()
    for case in split.cases:
        write_answer(folder / f"{case.name}.json", informed(split.truth(case.name)))
    score = ["benchmark", "score", str(split.folder), str(folder), "--json", str(scores_file)]
    assert run(score) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert [row.split(" | ")[0] for row in rows if "---" not in row] == ["| method", "| theirs"]
    assert run(["benchmark", "report", str(scores_file), "-o", str(tmp_path / "report")]) == 0
    assert (tmp_path / "report" / "table.md").read_text().splitlines()[2] == rows[2]
    assert "\nCases: 2, of one split.\n" in (tmp_path / "report" / "table.md").read_text()
    assert (tmp_path / "report" / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "report" / "scores.json").read_text()) == json.loads(
        scores_file.read_text()
    )
    (folder / "case-002.json").write_text('{"schema": 1, "probabilities": {"lag": 1.0}}')
    capsys.readouterr()
    assert run(score) != 0
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert "case-002.json: unknown cause 'lag'; choose from causes.json" in error


def test_a_report_of_another_file_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scores.json").write_text("{}")
    assert run(["benchmark", "report", str(tmp_path / "scores.json"), "-o", str(tmp_path / "report")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert "scores.json has no 'splits'; give a file of `heli-host benchmark score --json`" in error
    assert not (tmp_path / "report").exists()
