"""The command `heli-host diagnose`: the files that it writes, and its one-line errors."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from heli_host.data.log.table import write_csv
from heli_sim.rig import load_rig, write_rig

from tests.cli.terminal import Terminal
from tests.diagnose.hidden import flights
from tests.diagnose.test_causes import diagnosed
from tests.running.long import LONG

pytestmark = pytest.mark.diagnosis


@pytest.fixture
def tables(tmp_path: Path) -> tuple[Path, Path]:
    """Two flights as files."""
    paths = tmp_path / "a.csv.gz", tmp_path / "b.csv.gz"
    for flight, path in zip(flights(), paths, strict=True):
        write_csv(flight, path)
    return paths


def test_command_writes_numbers_rig_and_page(
    terminal: Terminal, tables: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    fit, held_out = tables
    diagnosis = diagnosed()
    # test_causes has done this diagnosis already; here only its files are tested.
    monkeypatch.setattr("heli_lab.explain.diagnose", lambda *_args, **_more: diagnosis)
    files = ("--report", "why", "--json", "why.json", "--save-rig", "extended.toml")
    result = terminal("diagnose", fit, "--validate", held_out, "--rig", "makki2024", *files)
    assert result.code == 0, result.err
    assert result.out.count("explained: ") == 1
    numbers = json.loads(Path("why.json").read_text())
    assert {"verdict", "causes", "residual", "gain", "unexplained", "next_flight"} <= numbers.keys()
    assert set(numbers["gain"]["axis"]) == {"elevation", "pitch", "travel"}
    assert load_rig("extended.toml").effects == {}
    assert Path("why/index.html").stat().st_size > 100_000


@pytest.mark.skipif(not LONG, reason="test_short asks this of 3 s; this one runs in make long")
def test_short_part_of_a_flight_gets_a_proposal_for_the_next_flight(
    terminal: Terminal, tables: tuple[Path, Path]
) -> None:
    fit, held_out = tables
    result = terminal(
        "diagnose",
        fit,
        "--validate",
        held_out,
        "--from",
        "12",
        "--to",
        "17",
        "--json",
        "-",
        "--report",
        "why",
    )
    assert result.code == 0, result.err
    # Standard output has the numbers and nothing else; words go to standard error.
    numbers = json.loads(result.out)
    assert numbers["sentence"] in result.err
    assert "files: why/index.html" in result.err
    assert numbers["causes"] == []
    assert numbers["undetectable"]
    assert tomllib.loads(numbers["next_flight"]["plan"])["segment"]


@pytest.mark.parametrize("verb", ["diagnose", "identify"])
def test_model_that_the_rig_names_is_the_one_that_is_fitted(
    terminal: Terminal, tables: tuple[Path, Path], verb: str
) -> None:
    write_rig(replace(load_rig("makki2024"), model="nobodys"), "mine.toml")
    result = terminal(verb, tables[0], "--rig", "mine.toml")
    assert result.code != 0
    assert "unknown model 'nobodys'" in result.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("missing.csv",), "missing.csv"),
        (("a.csv.gz", "--rig", "nobodys"), "unknown rig 'nobodys'"),
        (("a.csv.gz", "--model", "none"), "unknown model 'none'"),
        (("a.csv.gz", "--validate", "a.csv.gz"), "both fitted and validated on"),
        (("a.csv.gz", "--validate", "b.csv.gz", "--calibrate", "-1"), "--calibrate"),
        (("a.csv.gz", "--validate", "b.csv.gz", "--calibrate", "nan"), "--calibrate"),
        (("a.csv.gz", "--validate", "b.csv.gz", "--calibrate", "30"), "or less to --calibrate"),
        (("a.csv.gz", "--effect-file", "mine.py"), "mine.py cannot be read"),
        (("a.csv.gz", "--json", "a.csv.gz/why.json"), "a.csv.gz"),
    ],
)
def test_impossible_request_gives_a_one_line_error_with_a_remedy(
    terminal: Terminal, tables: tuple[Path, Path], arguments: tuple[str, ...], words: str
) -> None:
    result = terminal("diagnose", *arguments)
    assert result.code != 0
    assert len(result.err.strip().splitlines()) == 1
    assert words in result.err
