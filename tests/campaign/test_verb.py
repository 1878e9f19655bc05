"""The command, end to end: results, its page, and what it says when cases fail."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.terminal import Terminal, terminal

__all__ = ["terminal"]
pytestmark = pytest.mark.slow

SQUARES = """
title = "Squares & <roots>"
work = "tests.campaign.works:count"
worst = "square"
[cases]
number = { from = 1, to = 12 }
nap_s = 0.0
"""
BAD = 'work = "tests.campaign.works:bad"\n[cases]\nhow = ["fine", "crashes", "raises"]\n'


def test_a_campaign_leaves_results_a_table_and_a_page(terminal: Terminal, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    file, out = tmp_path / "squares.toml", tmp_path / "out"
    file.write_text(SQUARES)
    said = terminal("campaign", str(file), "--out", str(out), "--workers", "2")
    assert said.code == 0, said.out
    assert "12 of 12 cases have ended, 0 of them without a result" in said.out
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
    said = terminal("campaign", str(file), "--out", str(out))
    assert said.code == 1
    assert "crashes: its process crashed: SIGSEGV" in said.out
    assert "raises: ValueError: seven lines of it" in said.out
    page = (out / "index.html").read_text()
    assert "Cases without a result" in page
    assert "its process crashed: SIGSEGV" in page
    again = terminal("campaign", str(file), "--out", str(out))
    assert "its process crashed" not in again.out
    retried = terminal("campaign", str(file), "--out", str(out), "--retry")
    assert "crashes: its process crashed: SIGSEGV" in retried.out


def test_a_file_that_is_no_campaign_is_one_line(terminal: Terminal, tmp_path: Path) -> None:
    said = terminal("campaign", str(tmp_path / "none.toml"))
    assert said.code != 0
    assert "No such file" in said.err and said.err.count("\n") == 1
    both = terminal("campaign", "a.toml", "--scheduler", "tcp://a:1", "--workers", "2")
    assert both.code == 2
