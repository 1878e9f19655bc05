"""Scores of the published benchmark, and the processes with limits in which methods run."""

import json
import re
import shutil
import sys
import textwrap
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.ui.cli.entry import run
from heli_lab.errors import CampaignError

from heli_benchmark import scores as score_module
from heli_benchmark.entries import RunLimits, answer_case, find_method, read_run, run_method, run_on_cluster
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.leaderboard import (
    comparison_table,
    pair_lines,
    pooled_scores,
    scores_content,
    summarise_runs,
)
from heli_benchmark.scores import (
    WORST_RATIO,
    CaseScore,
    equation_correlation,
    prediction_ratio,
    score_answer,
    score_run,
    score_runs,
    scored_truth,
    true_errors,
)
from heli_benchmark.splits import causes_content
from heli_benchmark.task import (
    NOTHING,
    UNLISTED,
    Answer,
    AxisSeries,
    BenchmarkCase,
    Causes,
    Estimate,
    Split,
    causes_of,
    read_case,
    read_split,
    write_answer,
    write_json,
)
from heli_benchmark.tests.small_split import TRUTHS, informed, make
from heli_benchmark.tests.test_methods import CAUSES as METHOD_CAUSES
from heli_benchmark.tests.test_methods import RIG, SPRING, STIFFNESS, flown
from tests.campaign.killer import Cluster, free_port

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


SIZE = 0.5
FLIGHT = flown(SIZE)
CASE = BenchmarkCase("case", rig=RIG, training=(FLIGHT,), validation=(FLIGHT,), causes=METHOD_CAUSES)
TRUTH: dict[str, Any] = {
    "causes": {SPRING: {"model_parameters": {STIFFNESS: SIZE}}},
    "unlisted": {},
    "rig": {},
}


def prediction_ratio_of(answer: Answer, *named: str) -> float:
    reference = true_errors(CASE, TRUTH)
    assert reference is not None
    return prediction_ratio(CASE, answer, named, reference)


def spring(value: float, **rig: float) -> Answer:
    numbers = {STIFFNESS: value, **rig}
    return Answer({SPRING: 1.0}, {name: Estimate(value, 0.1) for name, value in numbers.items()})


@pytest.mark.medium
def test_the_true_causes_and_sizes_predict_as_well_as_the_true_model() -> None:
    assert prediction_ratio_of(spring(SIZE), SPRING) == pytest.approx(1.0)


@pytest.mark.medium
def test_a_missing_cause_and_a_wrong_size_predict_worse() -> None:
    missing = prediction_ratio_of(Answer({"nothing": 1.0}))
    halved = prediction_ratio_of(spring(0.5 * SIZE), SPRING)
    assert 1.05 < halved < missing


@pytest.mark.medium
def test_the_rig_parameters_of_an_answer_are_used() -> None:
    gain = RIG["thrust_gain"].value
    assert prediction_ratio_of(spring(SIZE, thrust_gain=1.3 * gain), SPRING) > 1.2
    assert prediction_ratio_of(spring(SIZE, thrust_gain=-gain), SPRING) == WORST_RATIO


def predicted(angles_rad: Floats, t_s: Floats = FLIGHT.t_s) -> Answer:
    return Answer({SPRING: 1.0}, predicted_flights={"validation-1": AxisSeries(t_s, angles_rad)})


@pytest.mark.medium
def test_a_predicted_flight_is_scored_in_place_of_the_model() -> None:
    reference = true_errors(CASE, TRUTH)
    assert reference is not None
    # The errors of the true model on each axis, as a constant error.
    as_good = prediction_ratio_of(predicted(FLIGHT.angles_rad + reference), SPRING)
    assert as_good == pytest.approx(1.0)
    assert prediction_ratio_of(predicted(FLIGHT.angles_rad + 2.0 * reference), SPRING) == pytest.approx(2.0)
    assert prediction_ratio_of(predicted(FLIGHT.angles_rad), SPRING) < as_good


@pytest.mark.medium
def test_a_predicted_flight_that_ends_early_or_is_missing_counts_as_a_wrong_model() -> None:
    half = len(FLIGHT) // 2
    assert prediction_ratio_of(predicted(FLIGHT.angles_rad[:half], FLIGHT.t_s[:half]), SPRING) == WORST_RATIO
    other = Answer({}, predicted_flights={"validation-2": AxisSeries(FLIGHT.t_s, FLIGHT.angles_rad)})
    assert prediction_ratio_of(other, SPRING) == WORST_RATIO


@pytest.mark.medium
def test_the_true_model_of_a_quadratic_thrust_has_the_thrust_of_the_generator() -> None:
    size_per_V, share, pivot = 0.25, "thrust_quadratic_share", "thrust_quadratic_pivot_V"
    truth = TRUTH | {"causes": {"thrust_quadratic": {"model_parameters": {share: 0.2}}}}
    reference = true_errors(CASE, truth)
    assert reference is not None
    # k e (1 + 0.25 e), the thrust of the generator, about another voltage: at e = 2 V it is 1.5 k e.
    answer = Answer(
        {"thrust_quadratic": 1.0},
        {
            "thrust_gain": Estimate((1.0 + 2.0 * size_per_V) * RIG["thrust_gain"].value, 0.01),
            share: Estimate(2.0 * size_per_V / (1.0 + 2.0 * size_per_V), 0.01),
            pivot: Estimate(2.0, 0.01),
        },
    )
    causes = Causes(METHOD_CAUSES.base_rates, {"thrust_quadratic": {share: "1", pivot: "V"}})
    case = BenchmarkCase("case", rig=RIG, training=(FLIGHT,), validation=(FLIGHT,), causes=causes)
    assert prediction_ratio(case, answer, ["thrust_quadratic"], reference) == pytest.approx(1.0)


def test_a_case_without_a_true_model_in_the_catalogue_has_no_reference() -> None:
    assert true_errors(CASE, TRUTH | {"unlisted": {"draught": 20.0}}) is None
    periodic: dict[str, Any] = {"periodic_torque.pitch": {"model_parameters": {}}}
    assert true_errors(CASE, TRUTH | {"causes": periodic}) is None


ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "validation" / "benchmark.md"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limits of a process")
def test_a_run_goes_on_after_a_failed_case_and_continues(tmp_path: Path) -> None:
    split = make(tmp_path / "small", cases=3)
    example = textwrap.dedent(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[0])
    # The method of the page answers the first case; the others fail as a stranger's method may.
    wrong = (
        '\n\ndef entered(case):\n    if case.name == "case-002":\n        raise ValueError("no\\nroot")\n'
        '    while case.name == "case-003":\n        pass\n    return diagnose(case)\n'
    )
    method = tmp_path / "mine.py"
    method.write_text(example + wrong)
    ended: list[tuple[str, str]] = []

    def run(cpu_s: int = 2) -> None:
        limits = RunLimits(cpu_s, 4000)
        run_method(
            split,
            f"{method}:entered",
            tmp_path / "run",
            limits=limits,
            say=lambda case, failure: ended.append((case, failure)),
        )

    run()
    assert [case for case, _ in ended] == ["case-001", "case-002", "case-003"]
    failures = dict(ended)
    assert failures["case-001"] == ""
    assert failures["case-002"] == "ValueError: no root"
    assert failures["case-003"].startswith("the process ended with code -")
    results = read_run(tmp_path / "run", split)
    assert results["case-001"]["cpu_s"] > 0.0
    (tmp_path / "run" / "case-002.json").unlink()
    ended.clear()
    run()
    assert ended == [("case-002", "ValueError: no root")]
    with pytest.raises(BenchmarkError, match="has results with another limits; choose another folder"):
        run(cpu_s=3)
    method.write_text(method.read_text() + "\n")
    with pytest.raises(BenchmarkError, match="another method digest"):
        run()


def test_a_method_that_does_not_exist_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(
        BenchmarkError, match=r"unknown method 'our'; give FILE.py:FUNCTION, or one of base_r"
    ):
        find_method("our")
    with pytest.raises(BenchmarkError, match=r"mine.py, does not exist; check the path"):
        find_method(f"{tmp_path}/mine.py:diagnose")


@pytest.mark.medium
def test_answers_to_another_split_are_refused(tmp_path: Path) -> None:
    split = make(tmp_path / "small", cases=1)
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"split_digest": "other"}))
    with pytest.raises(BenchmarkError, match="has answers to another split; run the method on"):
        read_run(folder, split)


METHOD = """
from heli_benchmark.task import answer_with


def diagnose(case):
    if case.name == "case-002":
        raise ValueError("no root")
    return answer_with(case.causes, {"rotor_lag": float(case.name[-1]) / 10.0})
"""
LIMITS = RunLimits(20, 4000)


@pytest.mark.slow
def test_a_run_on_a_cluster_gives_the_same_answers_and_continues(tmp_path: Path) -> None:
    split = make(tmp_path / "small", cases=3)
    (tmp_path / "mine.py").write_text(METHOD)
    text = f"{tmp_path / 'mine.py'}:diagnose"
    ended: list[tuple[str, str]] = []
    with Cluster(workers=2) as cluster:
        cluster.wait_for_workers(2)
        for _ in range(2):
            run_method(
                split,
                text,
                tmp_path / "cluster",
                limits=LIMITS,
                distribute=partial(run_on_cluster, cluster.address),
                say=lambda case, failure: ended.append((case, failure)),
            )
    assert sorted(ended) == [("case-001", ""), ("case-002", "ValueError: no root"), ("case-003", "")]
    run_method(split, text, tmp_path / "here", limits=LIMITS)
    results_of_cluster, results = (read_run(tmp_path / name, split) for name in ("cluster", "here"))
    for name, result in results.items():
        result_of_cluster = results_of_cluster[name]
        assert result_of_cluster["answer"] == result["answer"]
        assert result_of_cluster["failure"] == result["failure"]
        assert result_of_cluster["cpu_s"] > 0.0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limits of a process")
@pytest.mark.medium
def test_without_a_scheduler_the_run_ends_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heli_lab.apps.campaign.run.CONNECT_s", 0.5)
    split, address = make(tmp_path / "small", cases=1), f"tcp://127.0.0.1:{free_port()}"
    with pytest.raises(CampaignError, match="no scheduler answers at"):
        run_method(split, "base_rates", tmp_path / "run", distribute=partial(run_on_cluster, address))
    assert not (tmp_path / "run" / "case-001.json").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limits of a process")
def test_a_worker_with_another_version_of_the_method_refuses_the_case() -> None:
    method = find_method("base_rates")
    with pytest.raises(BenchmarkError, match=r"base_rates.py differs on this worker"):
        answer_case({"method": method.text, "digest": "other"})
