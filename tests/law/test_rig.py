"""A law's file gets the rig that the user names, and its gains fit that rig."""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_lab.control.fence import FileLimits
from heli_lab.control.law_files import RIG_VARIABLE, load_law, load_limited
from heli_lab.law import law_rig
from heli_sim.rig import load_rig, write_rig

from tests.cli.terminal import Terminal, terminal
from tests.running.long import samples

__all__ = ["terminal"]

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = [path for path in sorted((ROOT / "docs/laws").glob("*.py")) if path.stem != "cascade"]
PRINTS_ITS_RIG = """
from heli_lab.law import Command, control_law, law_rig

@control_law(parameters={"weight": law_rig("quanser-course")["M_w"].value})
def law(now, state, parameter):
    return Command(parameter.weight, parameter.weight)

LAW = law
"""


def test_the_default_counts_where_no_rig_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(RIG_VARIABLE, raising=False)
    assert law_rig("quanser-course").name == "quanser-course"
    monkeypatch.setenv(RIG_VARIABLE, "makki2024-identified")
    assert law_rig("quanser-course").name == "makki2024-identified"


@pytest.mark.slow
def test_a_file_gets_a_rig_by_name_and_by_a_relative_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "student").mkdir()
    file = Path("student/law.py")
    file.write_text(PRINTS_ITS_RIG)
    write_rig(load_rig("makki2024").replace(M_w=1.7), Path("mine.toml"))
    assert load_law(file, rig="mine.toml").parameters["weight"] == 1.7
    assert load_law(file).parameters["weight"] == load_rig("quanser-course")["M_w"].value
    # A stranger's file runs in its own folder.
    fenced = load_limited(file, FileLimits(10.0), "mine.toml")
    assert fenced.words == load_law(file, rig="mine.toml").program.words


@pytest.mark.slow
@pytest.mark.parametrize("path", SHIPPED[:: samples(1, len(SHIPPED) - 1)], ids=lambda path: path.stem)
def test_each_shipped_law_is_another_on_another_rig(path: Path) -> None:
    programs = [load_law(path, rig=rig).program.words for rig in ("makki2024", "quanser-course")]
    assert list(programs[0]) != list(programs[1])


@pytest.mark.slow
def test_a_shipped_law_is_checked_for_the_rig_that_is_named(terminal: Terminal) -> None:
    checked = terminal("law", "check", ROOT / "docs/laws/lqi.py", "--rig", "quanser-course", "--rigs", 0)
    assert checked.code == 0 and "stable around level" in checked.out
