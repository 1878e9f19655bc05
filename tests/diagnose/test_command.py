"""The command `heli-host diagnose`: the files that it writes, and its one-line errors."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_host.fly.plan import Plan
from heli_lab.explain import experiment_design
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig, write_rig

from tests.cli.terminal import Ended, Terminal
from tests.diagnose.hidden import flights, hovering
from tests.diagnose.schema import conforms
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
    options = ("--from", "12", "--to", "17", "--json", "-", "--report", "why")
    result = terminal("diagnose", fit, "--validate", held_out, *options)
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


def part(flight: Flight, start_s: float, stop_s: float) -> Flight:
    """Cut a part out of a flight; its time starts at 0."""
    rows = slice(*np.searchsorted(flight.t_s, [start_s, stop_s]))
    return Flight(
        flight.t_s[rows] - flight.t_s[rows.start],
        flight.front_V[rows],
        flight.back_V[rows],
        *flight.angles_rad[rows].T,
    )


def on_table() -> Flight:
    """Make twenty seconds at rest on the table, with motors off."""
    rows = 10_000
    still = np.zeros(rows)
    return Flight(np.arange(rows) / 500.0, still, still, np.full(rows, -0.48), still, still)


def answered(terminal: Terminal, *arguments: str | Path, drawn: bool = LONG) -> tuple[Ended, dict[str, Any]]:
    """Run `heli-host diagnose`; return its output and its JSON."""
    # `drawn` states whether it also writes the page, which takes two seconds.
    page = ("--report", "why") if drawn else ()
    result = terminal("diagnose", *arguments, "--json", "why.json", *page, "--save-rig", "found.toml")
    assert result.code == 0, result.err
    numbers: dict[str, Any] = json.loads(Path("why.json").read_text())
    assert Path("why/index.html").exists() is drawn
    conforms(numbers, silent=not numbers["flights"])
    return result, numbers


@pytest.fixture
def short_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a sine of a proposed flight last one period, and a pause 20 s, except in `make long`."""
    if not LONG:
        shorter = {
            key: (
                purpose,
                re.sub(r"(period_s = )(\d+)\nduration_s = \d+", r"\1\2\nduration_s = \2", plan).replace(
                    "duration_s = 60", "duration_s = 20"
                ),
            )
            for key, (purpose, plan) in experiment_design._SEGMENTS.items()
        }
        monkeypatch.setattr(experiment_design, "_SEGMENTS", shorter)


@pytest.mark.usefixtures("short_plans")
def test_three_seconds_of_flight_name_no_cause_and_list_hidden_effects(terminal: Terminal) -> None:
    fit, held_out = flights("rotor_lag=0.06")
    write_csv(part(fit, 10.0, 13.0), "a.csv")
    write_csv(held_out, "b.csv")
    ended, numbers = answered(terminal, "a.csv", "--validate", "b.csv")
    assert {"cable_spring.elevation", "thrust_fade"} <= set(numbers["undetectable"])
    assert numbers["unidentifiable"]
    # Even three seconds show the lag, which the held-out flight confirms. Nothing else may be named.
    assert {cause["effect"] for cause in numbers["causes"]} <= {"rotor_lag"}
    next_flight = numbers["next_flight"]
    assert "3 s of free flight are too short" in next_flight["why"]
    assert "Simulated on this rig, it shows" in next_flight["why"]
    Plan.parse(next_flight["plan"], "plan").check()
    assert "next flight: " in ended.out


@pytest.mark.skipif(not LONG, reason="a flight on the table is asked the same; this one runs in make long")
def test_hovering_still_names_no_cause_and_asks_for_motion(terminal: Terminal) -> None:
    write_csv(hovering(10.0), "a.csv")
    _, numbers = answered(terminal, "a.csv")
    assert numbers["causes"] == []
    assert len(numbers["undetectable"]) > 10
    assert "show too little" in numbers["next_flight"]["why"]
    assert any("no flight was held out" in caution for caution in numbers["cautions"])


@pytest.mark.parametrize("which", ["table", "asked for"])
def test_log_without_flight_gets_an_answer_and_no_rig_file(terminal: Terminal, which: str) -> None:
    write_csv(on_table() if which == "table" else flights()[0], "a.csv")
    begin = ("--from", "500") if which == "asked for" else ()
    ended, numbers = answered(terminal, "a.csv", *begin, drawn=LONG or which == "table")
    assert numbers["verdict"] == "ambiguous"
    assert numbers["causes"] == []
    assert "rotor_lag" in numbers["undetectable"]
    assert set(numbers["undetectable"]) < set(catalogue())
    assert "thrust_gain" in numbers["unidentifiable"]
    Plan.parse(numbers["next_flight"]["plan"], "plan").check()
    assert ended.out.startswith("rig: makki2024 (the default of --rig)\nmodel: multibody\n")
    assert "\nambiguous: These flights do not show what the model lacks" in ended.out
    assert not Path("found.toml").exists()


def test_validation_flight_that_shows_nothing_is_skipped_with_a_caution(terminal: Terminal) -> None:
    write_csv(flights()[0], "a.csv")
    write_csv(on_table(), "b.csv")
    _, numbers = answered(terminal, "a.csv", "--validate", "b.csv")
    assert numbers["verdict"] == "explained"
    assert [caution.partition(":")[0] for caution in numbers["cautions"]] == [
        "not used",
        "no flight was held out",
    ]
    assert "fitted flights" in numbers["gain"]["metric"]


def test_short_validation_flight_is_used_with_a_caution(terminal: Terminal) -> None:
    fit, held_out = flights()
    write_csv(fit, "a.csv")
    write_csv(part(held_out, 10.0, 13.0), "b.csv")
    _, numbers = answered(terminal, "a.csv", "--validate", "b.csv")
    assert numbers["verdict"] == "explained"
    assert any("only 3 s were held out" in caution for caution in numbers["cautions"])
    assert any("calibrated on 1.0 s of it, not on 8" in caution for caution in numbers["cautions"])


def test_copy_of_the_flight_is_no_validation_flight(terminal: Terminal) -> None:
    write_csv(flights()[0], "a.csv")
    write_csv(flights()[0], "b.csv")
    result = terminal("diagnose", "a.csv", "--validate", "b.csv")
    assert result.code == 2
    assert "b.csv is both fitted and validated on" in result.err
