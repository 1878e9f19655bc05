"""A campaign stores complete results, cages its cases, and uses only workers of its own code."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from heli_lab.apps.campaign import Campaign, Case, JobResult, Store, campaign_results, run_campaign
from heli_lab.apps.campaign.cases import Limits
from heli_lab.apps.campaign.run import CampaignProgress
from heli_lab.apps.campaign.worker import CodeMismatchError, Job, WorkerProcess, code_difference, run_job
from heli_lab.code_digest import code_digest
from heli_lab.errors import CampaignError

from tests.campaign.killer import Cluster, PATIENCE_s, free_port, kill_all, start_program

CASES = tuple(Case(f"case {n}", "tests.campaign.works:count", {"number": n}) for n in range(4))
CAMPAIGN = Campaign("squares", CASES, Limits(30.0, 300.0))


def run(folder: Path) -> list[dict[str, object]]:
    return run_campaign(CAMPAIGN, Store(folder), code="test", processes=2)


def logged(folder: Path, log: Path) -> Campaign:
    cases = tuple(Case(c.name, c.work, {**c.settings, "log": str(log)}) for c in CASES)
    return Campaign("squares", cases, Limits(30.0, 300.0))


@pytest.mark.medium
def test_a_result_that_was_torn_is_computed_again_and_no_other_is(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    campaign = logged(tmp_path, log)
    store = Store(tmp_path / "out")
    complete = run_campaign(campaign, store, code="test")
    assert sorted(log.read_text().split()) == ["0", "1", "2", "3"]
    torn, gone = (store.path(case.key("test")) for case in campaign.cases[1:3])
    torn.write_text(torn.read_text()[:40])
    gone.unlink()
    again = run_campaign(campaign, store, code="test")
    assert sorted(log.read_text().split()[4:]) == ["1", "2"]
    assert [row["square"] for row in again] == [row["square"] for row in complete] == [0, 1, 4, 9]


@pytest.mark.medium
def test_results_arrive_as_cases_end_and_those_of_an_earlier_run_do_not(tmp_path: Path) -> None:
    store = Store(tmp_path)
    arrived = list(campaign_results(CAMPAIGN, store, code="test", processes=2))
    assert sorted((result.name, result.row["square"]) for result in arrived) == [
        (f"case {n}", n * n) for n in range(4)
    ]
    assert list(campaign_results(CAMPAIGN, store, code="test")) == []


@pytest.mark.medium
def test_an_error_of_the_campaign_is_raised_where_results_are_waited_for(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.locked(), pytest.raises(CampaignError, match="another campaign is writing"):
        list(campaign_results(CAMPAIGN, store, code="test"))


@pytest.mark.medium
def test_cases_are_repeated_on_request(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    store = Store(tmp_path / "out")
    run_campaign(logged(tmp_path, log), store, code="test")
    run_campaign(logged(tmp_path, log), store, code="test", again=lambda answer: answer.row["square"] == 4)
    assert log.read_text().split()[4:] == ["2"]


def test_the_table_follows_from_the_results(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    store = Store(tmp_path)
    for number, case in enumerate(CASES):
        store.write(JobResult(case.name, case.key("test"), {"square": number**2}))
    # Nothing is left to do: a campaign that was killed before it wrote the table makes it from the results.
    rows = run(tmp_path)
    assert [row["square"] for row in rows] == [0, 1, 4, 9]
    table = pq.read_table(tmp_path / "cases.parquet").to_pydict()
    assert table["case"] == [case.name for case in CASES]
    assert table["number"] == [0, 1, 2, 3]


@pytest.mark.medium
def test_rows_are_in_the_order_of_the_numbers_in_their_names(tmp_path: Path) -> None:
    names = ["rig seed 100", "rig seed 2", "lag=0.05 seed 10", "rig seed 10", "lag=0.5 seed 1", "rig"]
    ordered = ["lag=0.05 seed 10", "lag=0.5 seed 1", "rig", "rig seed 2", "rig seed 10", "rig seed 100"]
    store = Store(tmp_path)
    store.write_table([{"case": name, "key": name} for name in names])
    assert [row["case"] for row in store.rows()] == ordered
    cases = tuple(Case(str(n), "tests.campaign.works:count", {"number": n}) for n in (100, 1, 10, 2))
    rows = run_campaign(Campaign("squares", cases), Store(tmp_path / "run"), code="test")
    assert [row["number"] for row in rows] == [1, 2, 10, 100]


@pytest.mark.parametrize("package", ["distributed", "pyarrow"])
def test_a_missing_package_names_the_extra_of_campaigns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(CampaignError, match=package) as caught:
        Store(tmp_path / "out")
    assert caught.value.remedy == "in your checkout of heli-lab, run: pip install -e '.[campaign]'"
    assert not (tmp_path / "out").exists()


def test_columns_may_differ_from_case_to_case(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write_table(
        [
            {"case": "a", "x": 1, "said": "yes"},
            {"case": "b", "x": math.inf},
            {"case": "c", "x": 0.5, "said": 3},
            {"case": "d", "x": None},
        ]
    )
    assert store.rows() == [
        {"case": "a", "x": 1.0, "said": "yes"},
        {"case": "b"},
        {"case": "c", "x": 0.5, "said": "3"},
        {"case": "d"},
    ]


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(CampaignError, match="results cannot be saved"):
        Store(tmp_path / "file")


BAD = "tests.campaign.works:bad"
PAIR = "return (row, detail): a dict by column, and anything that JSON holds"
CASE_LIMITS = Limits(cpu_s=1.0, wait_s=60.0)
FINE = Case("fine", "tests.campaign.works:count", {"number": 3})


@pytest.fixture(scope="module")
def cage() -> Iterator[WorkerProcess]:
    with WorkerProcess(CASE_LIMITS) as process:
        yield process


def done(cage: WorkerProcess, how: str) -> JobResult:
    return cage.run(Case(how, "tests.campaign.works:bad", {"how": how}), "key")


@pytest.mark.medium
@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("crashes", "its process crashed: SIGSEGV"),
        ("leaves", "its process crashed: exit status 7"),
        pytest.param("runs away", "the case used more than 1 s of CPU", marks=pytest.mark.slow),
        ("raises", "ValueError: seven lines of it"),
        ("refuses", "no such thing; ask for another"),
        ("returns a dict", f"{BAD} returned a dict; {PAIR}"),
        ("returns three", f"{BAD} returned 3 values; {PAIR}"),
        ("returns a list as its row", f"{BAD} returned a list for its row; {PAIR}"),
        ("returns a row by number", f"{BAD} returned a row with columns that are no texts; {PAIR}"),
        ("returns no JSON", "its result is no JSON: set is no JSON"),
    ],
)
def test_what_a_case_does_wrong_is_said_in_a_line_and_the_next_is_done(
    cage: WorkerProcess, how: str, message: str
) -> None:
    answer = done(cage, how)
    assert (answer.failure, answer.row, answer.name) == (message, {}, how)
    after = cage.run(FINE, "other")
    assert (after.failure, dict(after.row)) == ("", {"square": 9})


@pytest.mark.medium
def test_a_case_that_waits_for_ever_is_ended_by_the_clock() -> None:
    with WorkerProcess(Limits(cpu_s=60.0, wait_s=0.5)) as cage:
        assert done(cage, "hangs").failure == "no answer within 0.5 s"


@pytest.mark.medium
def test_good_cases_share_a_process(cage: WorkerProcess) -> None:
    pids = {cage.run(FINE, "key").detail["pid"] for _ in range(3)}
    assert len(pids) == 1
    assert pids != {os.getpid()}


@pytest.mark.medium
def test_a_process_does_not_outlive_its_parent() -> None:
    program = """
import sys, time
from heli_lab.apps.campaign import Case
from heli_lab.apps.campaign.cases import Limits
from heli_lab.apps.campaign.worker import WorkerProcess
case = Case("fine", "tests.campaign.works:count", {"number": 3})
cage = WorkerProcess(Limits())
print(cage.run(case, "key").detail["pid"], flush=True)
cage.run(Case("long", "tests.campaign.works:count", {"number": 3, "nap_s": 3600}), "key")
"""
    parent = start_program("-c", program)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    # Killed alone: nobody else ends the process that it started.
    parent.kill()
    until_s = time.monotonic() + PATIENCE_s
    while os.path.exists(f"/proc/{pid}") and time.monotonic() < until_s:  # noqa: PTH110 - a process, no file
        time.sleep(0.02)
    assert not os.path.exists(f"/proc/{pid}")  # noqa: PTH110
    kill_all(parent)


WORKS = ("tests.campaign.works:count",)


def squares(count: int) -> Campaign:
    cases = tuple(Case(f"{number}", WORKS[0], {"number": number}) for number in range(count))
    return Campaign("squares", cases, Limits(30.0, 300.0))


@pytest.mark.medium
@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:{port}", "nonsense://x", "tcp://no.such.host.invalid:1"]
)
def test_an_address_that_does_not_answer_is_said_so(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heli_lab.apps.campaign.run.CONNECT_s", 0.5)
    address = address.format(port=free_port())
    with pytest.raises(CampaignError, match="no scheduler answers at") as caught:
        run_campaign(squares(1), Store(tmp_path), scheduler=address)
    assert address in caught.value.cause


@pytest.mark.slow
def test_a_worker_of_other_code_is_named_and_the_others_do_its_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    states: list[CampaignProgress] = []
    # One file differs on the path of the second worker, as after an upgrade of one machine.
    other = tmp_path / "other" / "tests" / "campaign"
    other.mkdir(parents=True)
    for folder in (other, other.parent):
        (folder / "__init__.py").touch()
    (other / "works.py").write_text("def count(settings):\n    return {'square': -1}, None\n")
    with Cluster(workers=1) as cluster:
        monkeypatch.setenv("PYTHONPATH", "")
        cluster.add_worker(path=other.parents[1])
        cluster.wait_for_workers(2)
        rows = run_campaign(
            squares(12), Store(tmp_path / "out"), scheduler=cluster.address, on_progress=states.append
        )
    assert [row["square"] for row in rows] == [number**2 for number in range(12)]
    (note,) = [state.note for state in states if state.note]
    assert "is not used: its code has the digest" in note
    assert code_digest(WORKS) in note


def test_a_worker_of_other_code_refuses_also_what_it_gets_later(tmp_path: Path) -> None:
    store = Store(tmp_path)
    order = Job(
        Case("a", WORKS[0], {"number": 1}), "k", "other", WORKS, Limits(), str(store.cases), store.token
    )
    with pytest.raises(CodeMismatchError, match="the campaign's has other"):
        run_job(order)
    assert not list(store.cases.iterdir())


def test_a_worker_without_the_package_says_so() -> None:
    assert code_difference(code_digest(WORKS), WORKS) == ""
    assert "no_such_package" in code_difference("x", ("no_such_package.module:work",))
