"""``--json FILE`` is the same option in every verb that has a result; ``-`` is standard output."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from heli_host.data import files
from heli_host.ui.cli.entry import command_line

from tests.cli.terminal import Terminal
from tests.cli.test_machine_readable import leaves

pytestmark = pytest.mark.medium

LAW = str(Path(__file__).resolve().parents[2] / "docs/laws/lqr.py")
SIL = ("--sil", "--speed", "max")
WITHOUT = {"course", "export", "flash", "motors", "watch", "sil", "dashboard"}
"""Verbs whose result is a file, a served board, or only what is shown live."""
WITHOUT_PARTS = {
    *(
        "benchmark make",
        "benchmark report",
        "benchmark run",
        "law export",
        "paper equations",
        "paper figures",
        "params dump",
        "params save",
    ),
    *("rig export", "rig from-board", "rig new", "rig to-board"),
}


def test_every_verb_with_a_result_takes_a_json_file() -> None:
    matches = set()
    for name, leaf in leaves(command_line()).items():
        options = [option for option in leaf.params if "--json" in option.opts]  # type: ignore[attr-defined]
        if not leaf.hidden and not options:  # type: ignore[attr-defined]
            matches.add(name)
        assert all(option.metavar == "FILE" and not option.is_flag for option in options), name
    assert matches == WITHOUT | WITHOUT_PARTS


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("params", "set", "hover_V", "1.5", "--sil"), "value"),
        (("record", *SIL, "--duration", "1", "-o", "a.mcap"), "ticks_logged"),
        (("setpoint", *SIL, "--take-off", "--elevation-deg", "2", "--duration", "1"), "elevation_deg"),
        (("fly", "short.toml", *SIL, "--log", "b.mcap"), "outcome"),
        pytest.param(
            *(("law", "fly", LAW, *SIL, "--duration", "2", "--log", "c.mcap"), "trial"),
            marks=pytest.mark.slow,
        ),
        (("rig", "check", "makki2024"), "rigs"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value[:2]),
)
def test_a_result_on_standard_output_is_json_alone(
    words: tuple[str, ...], key: str, terminal: Terminal
) -> None:
    Path("short.toml").write_text('[[segment]]\nkind = "hold"\nduration_s = 1\n')
    result = terminal(*words, "--json", "-")
    assert result.code == 0, result.err
    content: dict[str, Any] = json.loads(result.out)
    assert content["schema"] == 1
    assert key in content
    assert content.get("trial", {"taken_over": ""})["taken_over"] == ""


def test_law_fly_writes_its_result_once(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[str] = []
    write_bytes = files.write_bytes

    def noted(path: Path, content: bytes, **options: Any) -> None:
        written.append(Path(path).name)
        write_bytes(path, content, **options)

    monkeypatch.setattr(files, "write_bytes", noted)
    result = terminal("law", "fly", LAW, *SIL, "--duration", "1", "--log", "c.mcap", "--json", "c.json")
    assert result.code == 0, result.err
    assert written.count("c.json") == 1
    content = json.loads(Path("c.json").read_text())
    assert content["outcome"] == "completed" and content["law"] == "lqr" and content["trial"]


def test_a_result_in_a_file_leaves_the_text_where_it_was(terminal: Terminal) -> None:
    result = terminal("rig", "check", "makki2024", "--json", "new/rigs.json")
    assert "makki2024: " in result.out
    assert json.loads(Path("new/rigs.json").read_text())["rigs"][0]["can_fly"]


def test_the_old_names_of_record_and_dashboard_work_and_are_not_listed(terminal: Terminal) -> None:
    assert terminal("log", *SIL, "--duration", "0.2", "-o", "a.mcap").code == 0
    assert terminal("page", "--help").code == 0
    listed = terminal("--help").out
    assert "record" in listed and "dashboard" in listed
    assert not [line for line in listed.splitlines() if line.strip("│ ").startswith(("log ", "page "))]
