"""A run on a Dask cluster gives the answers of a run on one machine."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import pytest
from heli_benchmark.cluster import run_on_cluster
from heli_benchmark.cluster.run import answer_case
from heli_benchmark.entries import RunLimits, read_run, run_method
from heli_benchmark.entries.method import find_method
from heli_benchmark.errors import BenchmarkError
from heli_lab.errors import CampaignError

from tests.benchmark.small_split import make
from tests.campaign.killer import Cluster, free_port

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limits of a process")

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


@pytest.mark.medium
def test_without_a_scheduler_the_run_ends_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heli_lab.apps.campaign.run.CONNECT_s", 0.5)
    split, address = make(tmp_path / "small", cases=1), f"tcp://127.0.0.1:{free_port()}"
    with pytest.raises(CampaignError, match="no scheduler answers at"):
        run_method(split, "base_rates", tmp_path / "run", distribute=partial(run_on_cluster, address))
    assert not (tmp_path / "run" / "case-001.json").exists()


def test_a_worker_with_another_version_of_the_method_refuses_the_case() -> None:
    method = find_method("base_rates")
    with pytest.raises(BenchmarkError, match=r"base_rates.py differs on this worker"):
        answer_case({"method": method.text, "digest": "other"})
