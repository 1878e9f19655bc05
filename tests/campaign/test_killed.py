"""A campaign that is killed goes on, ends with the same table, and does nothing twice that had ended."""

from __future__ import annotations

import os
import random
import signal
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from heli_lab.apps.campaign import Store

from tests.campaign.killer import CODE, Cluster, cases, children, gate_of, kill_all, start_program, wait_until
from tests.running.long import samples

pytestmark = pytest.mark.slow

COUNT, NAP_s = 60, 0.02
KILLS = samples(20, 2)
TAKEN = {"cpu_s", "seconds", "where"}


def table(folder: Path) -> list[dict[str, Any]]:
    return [{name: v for name, v in row.items() if name not in TAKEN} for row in Store(folder).rows()]


def ended(folder: Path) -> set[str]:
    return {path.stem for path in (folder / "cases").glob("*.json")}


def has_ended(folder: Path, count: int) -> bool:
    return len(ended(folder)) >= count


def begun(log: Path) -> Counter[str]:
    return Counter(log.read_text().split() if log.exists() else [])


def expected(folder: Path, log: Path) -> list[dict[str, Any]]:
    return [
        {
            "case": case.name,
            **case.settings,
            "square": case.settings["number"] ** 2,
            "failure": "",
            "key": case.key(CODE),
        }
        for case in cases(COUNT, NAP_s, str(log))
    ]


def test_killed_at_random_it_ends_with_the_same_table_and_nothing_is_done_twice(tmp_path: Path) -> None:
    chance = random.Random(5)
    folder, log = tmp_path / "out", tmp_path / "begun.txt"
    gate_of(log).touch()
    arguments = ("-m", "tests.campaign.killer", str(folder), str(log), str(COUNT), str(NAP_s))
    for number in range(KILLS):
        done, before = ended(folder), begun(log)
        program = start_program(*arguments)
        goal = len(done) + chance.randint(1, max(1, (COUNT - len(done)) // (KILLS - number + 1)))
        wait_until(partial(has_ended, folder, goal), program)
        if number % 2:
            # A worker's process first: the case in it is begun again, the others go on.
            for child in children(program)[:1]:
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
        kill_all(program)
        numbers = {case.key(CODE): str(case.settings["number"]) for case in cases(COUNT, NAP_s, str(log))}
        again = begun(log) - before
        assert not [key for key in done if again[numbers[key]]], "what had ended was begun again"
    last = start_program(*arguments)
    assert last.wait(300) == 0, last.stdout.read() if last.stdout else b""
    kill_all(last)
    assert table(folder) == expected(folder, log)


def test_a_cluster_loses_workers_and_its_scheduler_and_the_campaign_goes_on(tmp_path: Path) -> None:
    folder, log = tmp_path / "out", tmp_path / "begun.txt"
    arguments = ("-m", "tests.campaign.killer", str(folder), str(log), str(COUNT), str(NAP_s))
    with Cluster() as cluster:
        program = start_program(*arguments, cluster.address)
        wait_until(lambda: len(ended(folder)) >= 5, program)
        kill_all(cluster.parts.pop())
        cluster.add_worker()
        wait_until(lambda: len(ended(folder)) >= 15, program)
        kill_all(cluster.parts[0])
        output, _ = program.communicate(timeout=300)
        assert program.returncode != 0
        assert b"the scheduler has stopped" in output and b"run the same command again" in output
    done, before = ended(folder), begun(log)
    assert 15 <= len(done) < COUNT
    gate_of(log).touch()
    again = start_program(*arguments)
    assert again.wait(300) == 0
    kill_all(again)
    numbers = {case.key(CODE): str(case.settings["number"]) for case in cases(COUNT, NAP_s, str(log))}
    assert not [key for key in done if (begun(log) - before)[numbers[key]]]
    assert table(folder) == expected(folder, log)
