"""The command, end to end: results, its page, failed cases, and what follows when it is killed."""

import json
import os
import random
import re
import signal
import sys
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from heli_lab.apps.campaign import Store

from tests.campaign.killer import CODE, Cluster, cases, children, gate_of, kill_all, start_program, wait_until
from tests.cli.terminal import Terminal
from tests.running.long import samples

pytestmark = pytest.mark.slow


SQUARES = """
title = "Squares & <roots>"
work = "tests.campaign.works:count"
worst = "square"
[cases]
number = { from = 1, to = 12 }
nap_s = 0.0
"""
SHORT_PLAN = "[start]\nsettle_s = 2\n[[segment]]\nkind = 'hold'\nduration_s = 3\n"
BAD = 'work = "tests.campaign.works:bad"\n[cases]\nhow = ["fine", "crashes", "raises"]\n'


def test_a_campaign_leaves_results_a_table_and_a_page(terminal: Terminal, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    file, out = tmp_path / "squares.toml", tmp_path / "out"
    file.write_text(SQUARES)
    result = terminal("campaign", str(file), "--output", str(out), "--workers", "2")
    assert result.code == 0, result.out
    assert "12 of 12 cases have ended, 0 of them without a result" in result.out
    table = pq.read_table(out / "cases.parquet").to_pylist()
    assert {row["number"]: row["square"] for row in table} == {n: n**2 for n in range(1, 13)}
    page = (out / "index.html").read_text()
    assert "Squares &amp; &lt;roots&gt;" in page
    worst = re.findall(r'href="(cases/\w+\.json)">([^<]+)<', page)
    assert [name for _, name in worst][:3] == ["12", "11", "10"]
    assert json.loads((out / worst[0][0]).read_text())["row"] == {"square": 144}


def test_cases_that_fail_are_named_on_the_screen_and_on_the_page(terminal: Terminal, tmp_path: Path) -> None:
    file, out = tmp_path / "bad.toml", tmp_path / "out"
    file.write_text(BAD)
    result = terminal("campaign", str(file), "--output", str(out))
    assert result.code == 1
    assert "crashes: its process crashed: SIGSEGV" in result.out
    assert "raises: ValueError: seven lines of it" in result.out
    page = (out / "index.html").read_text()
    assert "Cases without a result" in page
    assert "its process crashed: SIGSEGV" in page
    again = terminal("campaign", str(file), "--output", str(out))
    assert "its process crashed" not in again.out
    retried = terminal("campaign", str(file), "--output", str(out), "--retry")
    assert "crashes: its process crashed: SIGSEGV" in retried.out


def test_flights_that_are_not_completed_are_counted_and_end_with_4(
    terminal: Terminal, tmp_path: Path
) -> None:
    import pyarrow.parquet as pq

    (tmp_path / "short.toml").write_text(SHORT_PLAN)
    file, out = tmp_path / "weak.toml", tmp_path / "out"
    file.write_text(
        'work = "fly"\n[cases]\nplan = "short.toml"\nseed = [1, 2, 10]\n'
        "[draw]\nthrust_gain = { range = [0.1, 1.1] }\nM_w = { share = 0.05 }\n"
    )
    result = terminal("campaign", str(file), "--output", str(out))
    rows = pq.read_table(out / "cases.parquet").to_pylist()
    assert [row["seed"] for row in rows] == [1, 2, 10]
    for number in ("thrust_gain", "M_w"):
        assert len({row[f"drawn_{number}"] for row in rows}) == 3
    ended = [row["outcome"] == "completed" for row in rows]
    assert 0 < sum(ended) < 3
    assert result.code == 4, result
    assert "0 of them without a result" in result.out
    assert f"{3 - sum(ended)} of 3 cases did not end as completed: " in result.out
    assert f"completed {sum(ended)}" in result.out and "aborted (landing_timeout) " in result.out
    page = (out / "index.html").read_text()
    assert f"{3 - sum(ended)} cases did not end as completed" in page
    again = terminal("campaign", str(file), "--output", str(out))
    assert again.code == 4


def test_a_case_without_a_result_has_what_was_drawn_in_the_table(terminal: Terminal, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    file, out = tmp_path / "broken.toml", tmp_path / "out"
    # The plan is looked for only by the case.
    file.write_text(
        'work = "fly"\n[cases]\nplan = "no-such-plan"\nseed = [1, 2]\n[draw]\nM_w = { share = 0.1 }\n'
    )
    assert terminal("campaign", str(file), "--output", str(out)).code == 1
    rows = pq.read_table(out / "cases.parquet").to_pylist()
    assert all("no-such-plan" in row["failure"] for row in rows)
    assert len({row["drawn_M_w"] for row in rows}) == 2


RESULT_COLUMNS = """
import helper_of_mine

def root(settings):
    value = settings["number"] ** 0.5 * helper_of_mine.SCALE
    return {"root": value}, {"squared": [settings["number"]]}

def wrong(settings):
    return {"root": 1.0}
"""


def test_a_function_in_a_module_next_to_the_file_is_a_work(
    terminal: Terminal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pyarrow.parquet as pq

    study = tmp_path / "study"
    study.mkdir()
    (study / "roots_of_mine.py").write_text(RESULT_COLUMNS)
    (study / "helper_of_mine.py").write_text("SCALE = 1.0\n")
    file, out = study / "roots.toml", tmp_path / "out"
    file.write_text('work = "roots_of_mine:root"\n[cases]\nnumber = [4, 9]\n')
    result = terminal("campaign", str(file), "--output", str(out))
    assert result.code == 0, result
    rows = pq.read_table(out / "cases.parquet").to_pylist()
    assert [row["root"] for row in rows] == [2.0, 3.0]
    # What is next to the module is part of the code, and other code gives other results.
    (study / "helper_of_mine.py").write_text("SCALE = 10.0\n")
    assert terminal("campaign", str(file), "--output", str(out)).code == 0
    assert [row["root"] for row in pq.read_table(out / "cases.parquet").to_pylist()] == [20.0, 30.0]
    with Cluster(workers=1) as cluster:
        there = terminal(
            "campaign", str(file), "--output", str(tmp_path / "c"), "--scheduler", cluster.address
        )
        assert there.code == 0, there
    assert [row["root"] for row in pq.read_table(tmp_path / "c" / "cases.parquet").to_pylist()] == [20, 30]
    assert "roots_of_mine" not in sys.modules
    file.write_text('work = "roots_of_mine:wrong"\n[cases]\nnumber = [4]\n')
    wrong = terminal("campaign", str(file), "--output", str(out))
    assert wrong.code == 1
    assert "roots_of_mine:wrong returned a dict; return (row, detail)" in wrong.out
    file.write_text('work = "roots_of_mine:no_such"\n[cases]\nnumber = [4]\n')
    assert "module roots_of_mine has no function no_such" in terminal("campaign", str(file)).out
    file.write_text('work = "no_such_module:root"\n[cases]\nnumber = [4]\n')
    missing = terminal("campaign", str(file), "--output", str(out))
    assert missing.code == 2 and missing.err.count("\n") == 1
    assert "there is no module no_such_module installed or in" in missing.err
    assert "report it" not in missing.err


def test_a_file_that_is_no_campaign_is_one_line(terminal: Terminal, tmp_path: Path) -> None:
    result = terminal("campaign", str(tmp_path / "none.toml"))
    assert result.code != 0
    assert "No such file" in result.err and result.err.count("\n") == 1
    both = terminal("campaign", "a.toml", "--scheduler", "tcp://a:1", "--workers", "2")
    assert both.code == 2


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
