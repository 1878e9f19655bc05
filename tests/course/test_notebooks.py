"""Every notebook of the course runs from its first cell to its check, which fails without the result."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from tests.repo.typed import Typed

COURSE = Path(__file__).resolve().parents[2] / "docs" / "course"
NOTEBOOKS = sorted(COURSE.glob("*.py"))
LONG = os.environ.get("HELI_LONG") == "1"
PARTS = ("**Goals.**", "**Before.**", "**Task 1", "**Check.**", "**Common mistakes.**")
STRICTLY = "import warnings; warnings.filterwarnings('error', '', DeprecationWarning, '__main__'); "


def cells(path: Path) -> list[tuple[str, str]]:
    """Heads and texts of a notebook's cells."""
    found = re.split(r"^# %%(.*)$", path.read_text(), flags=re.MULTILINE)[1:]
    return list(zip(found[::2], found[1::2], strict=True))


def script(path: Path, *, long: bool = LONG) -> str:
    """The code of a notebook, line by line where it stands in the file, without what takes minutes."""
    kept = []
    for head, text in cells(path):
        runs = "[markdown]" not in head and (long or '"long"' not in head)
        kept.append(text if runs else "\n" * text.count("\n"))
    return "".join(kept)


def test_there_are_six() -> None:
    assert [path.name[0] for path in NOTEBOOKS] == list("123456")
    listed = (COURSE / "README.md").read_text()
    assert all(f"]({path.name})" in listed for path in NOTEBOOKS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_has_goals_tasks_a_check_and_common_mistakes(path: Path) -> None:
    text = path.read_text()
    places = [text.find(part) for part in PARTS]
    assert -1 not in places and places == sorted(places)
    assert "assert " in text[places[-2] :]


@pytest.mark.documents
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_its_check_holds(path: Path, typed: Typed, tmp_path: Path) -> None:
    code, said = typed.run(["python", "-c", STRICTLY + script(path)], tmp_path)
    assert code == 0, said[-5000:]
