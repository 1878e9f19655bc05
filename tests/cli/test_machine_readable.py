"""Output for other programs: JSON, tables on standard output, a version, completions for a shell."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_host.ui.cli.entry import command_line

from tests.cli.terminal import Terminal, process, refusal

pytestmark = pytest.mark.medium


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    t_s = np.linspace(0.0, 0.99, 100, dtype=np.float64)
    write_csv(Flight(t_s, t_s, t_s, t_s, t_s, t_s, meta={"rig": "mine"}), tmp_path / "a.csv")
    return tmp_path / "a.csv"


def test_what_is_listed_is_json_where_asked(terminal: Terminal, flight: Path) -> None:
    summary = json.loads(terminal("info", flight, "--json", "-").out)
    assert (summary["rows"], summary["notes"]) == (100, {"rig": "mine"})
    assert isinstance(json.loads(terminal("ports", "--json", "-").out)["ports"], list)
    params = json.loads(terminal("params", "list", "hover", "--sil", "--json", "-").out)
    assert params["parameters"]["hover_V"]["unit"] == "V"
    rig = json.loads(terminal("rig", "show", "makki2024", "dead_zone", "--json", "-").out)
    assert set(rig["numbers"]) == {"dead_zone"}
    assert rig["numbers"]["dead_zone"]["tolerance"] > 0.0


def test_rigs_are_json_where_asked(terminal: Terminal) -> None:
    listed = json.loads(terminal("rig", "list", "--json", "-").out)["rigs"]
    assert "makki2024" in [rig["name"] for rig in listed]
    (checked,) = json.loads(terminal("rig", "check", "makki2024", "--json", "-").out)["rigs"]
    assert checked["is_valid"]
    compared = json.loads(terminal("rig", "diff", "makki2024", "quanser-course", "--json", "-").out)
    assert {"name", "left", "right", "tolerances"} <= compared["numbers"][0].keys()


def test_rig_that_cannot_be_is_json_and_an_error(terminal: Terminal) -> None:
    result = terminal("rig", "check", "nobodys", "--json", "-")
    assert result.code != 0
    (checked,) = json.loads(result.out)["rigs"]
    assert not checked["is_valid"]
    assert checked["error"] in result.err


def test_one_parameter_is_json_with_its_unit(terminal: Terminal) -> None:
    parameter = json.loads(terminal("params", "get", "hover_V", "--sil", "--json", "-").out)
    assert (parameter["name"], parameter["unit"]) == ("hover_V", "V")


def leaves(command: object) -> dict[str, object]:
    """Every command behind a word, or two, of the command line."""
    commands: dict[str, object] = {}
    for name, subcommand in getattr(command, "commands", {}).items():
        below = leaves(subcommand)
        commands |= {f"{name} {behind}": leaf for behind, leaf in below.items()} or {name: subcommand}
    return commands


def test_every_verb_can_be_quiet_and_has_short_help() -> None:
    every = leaves(command_line())
    assert len(every) > 25
    for name, leaf in every.items():
        given = [option for parameter in leaf.params for option in parameter.opts]  # type: ignore[attr-defined]
        assert given.count("--quiet") == 1, name
        assert leaf.context_settings.get("help_option_names", ["-h"]) is not None, name  # type: ignore[attr-defined]


def test_quiet_leaves_results_and_takes_progress(terminal: Terminal) -> None:
    recorded = ("record", "--sil", "--speed", "max", "--duration", "6")
    loud = terminal(*recorded, "-o", "a.mcap")
    quiet = terminal(*recorded, "-o", "b.mcap", "-q")
    assert "log: b.mcap" in quiet.out
    assert "recording" in loud.out
    assert "recording" not in quiet.out
    # And not for the command after it.
    assert "recording" in terminal(*recorded, "-o", "c.mcap").out
    assert "files:" in terminal("plot", "a.mcap", "b.mcap").out
    assert "files:" not in terminal("--quiet", "plot", "a.mcap", "b.mcap").out


def test_shell_completes_verbs(tmp_path: Path) -> None:
    completion = {"_HELI_HOST_COMPLETE": "complete_bash", "COMP_WORDS": "heli-host pl", "COMP_CWORD": "1"}
    with process(tmp_path, prepare=lambda: os.environ.update(completion)) as running:
        out, _ = running.communicate(timeout=60)
    assert out.split() == ["plot"]


def test_setpoint_for_a_board_that_does_not_fly_is_an_error(terminal: Terminal) -> None:
    message = refusal(terminal("setpoint", "--sil", "--speed", "max", "--elevation-deg", "5"), code=2)
    assert "not flying" in message
    assert "--take-off" in message


def test_doctor_ends_alike_in_both_forms(terminal: Terminal) -> None:
    result = terminal("doctor", "--json", "-")
    report = json.loads(result.out)
    assert report["ready"] == (result.code == 0)
    assert {finding["verdict"] for finding in report["findings"]} <= {"good", "note", "bad"}


def test_a_table_goes_to_standard_output(flight: Path) -> None:
    with process(flight.parent, "export", flight, "--csv", "-o", "-") as running:
        out, _ = running.communicate(timeout=60)
    # There is no second file for the notes.
    assert out == "# rig: mine\n" + flight.read_text()
    assert running.returncode == 0


def test_a_log_that_is_no_log_is_refused_before_anything_is_recorded(terminal: Terminal) -> None:
    result = terminal("record", "--sil", "--duration", "1", "-o", "x.csv")
    assert result.code == 5
    assert "export --csv" in result.err
    assert not Path("x.csv").exists()


def test_version_and_short_help(terminal: Terminal) -> None:
    result = terminal("--version")
    assert result.code == 0
    assert result.out.startswith("heli-host ")
    assert terminal("-h").code == 0
    assert "Example" in terminal("rig", "show", "-h").out
    assert "--install-completion" in terminal("--help").out
