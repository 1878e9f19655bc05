"""Methods run in processes with limits; a run that was interrupted continues."""

from __future__ import annotations

import json
import re
import sys
import textwrap
from functools import partial
from pathlib import Path

import pytest
from heli_lab.errors import CampaignError

from heli_benchmark.entries import (
    RunLimits,
    answer_case,
    find_method,
    read_run,
    run_method,
    run_on_cluster,
)
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.tests.small_split import make
from tests.campaign.killer import Cluster, free_port

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
    assert ended[0][1] == ""
    assert ended[1][1] == "ValueError: no root"
    assert ended[2][1].startswith("the process ended with code -")
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
    there, here = (read_run(tmp_path / name, split) for name in ("cluster", "here"))
    for name, result in here.items():
        assert there[name]["answer"] == result["answer"]
        assert there[name]["failure"] == result["failure"]
        assert there[name]["cpu_s"] > 0.0


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
