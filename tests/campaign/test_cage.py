"""A case that crashes, hangs or runs away is said by name, and the next one is done."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest
from heli_lab.apps.campaign import Case, JobResult
from heli_lab.apps.campaign.worker_process import Limits, WorkerProcess

from tests.campaign.killer import PATIENCE_s, kill_all, start_program

pytestmark = pytest.mark.medium

BAD = "tests.campaign.works:bad"
PAIR = "return (row, detail): a dict by column, and anything that JSON holds"
LIMITS = Limits(cpu_s=1.0, wait_s=60.0)
FINE = Case("fine", "tests.campaign.works:count", {"number": 3})


@pytest.fixture(scope="module")
def cage() -> Iterator[WorkerProcess]:
    with WorkerProcess(LIMITS) as process:
        yield process


def done(cage: WorkerProcess, how: str) -> JobResult:
    return cage.run(Case(how, "tests.campaign.works:bad", {"how": how}), "key")


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


def test_a_case_that_waits_for_ever_is_ended_by_the_clock() -> None:
    with WorkerProcess(Limits(cpu_s=60.0, wait_s=0.5)) as cage:
        assert done(cage, "hangs").failure == "no answer within 0.5 s"


def test_work_that_does_not_exist_is_the_failure_of_its_case(cage: WorkerProcess) -> None:
    assert "no_such" in cage.run(Case("a", "tests.no_such:work"), "key").failure
    assert "no_such" in cage.run(Case("a", "tests.campaign.works:no_such"), "key").failure


def test_good_cases_share_a_process(cage: WorkerProcess) -> None:
    pids = {cage.run(FINE, "key").detail["pid"] for _ in range(3)}
    assert len(pids) == 1
    assert pids != {os.getpid()}


def test_a_process_does_not_outlive_its_parent() -> None:
    program = """
import sys, time
from heli_lab.apps.campaign import Case
from heli_lab.apps.campaign.worker_process import Limits, WorkerProcess
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
