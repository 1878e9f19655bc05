"""Every notebook of the course runs from its first cell to its check, which fails without the result."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.repo.typed import WORK, Typed
from tests.running.long import LONG

COURSE = Path(__file__).resolve().parents[2] / "docs" / "course"
NOTEBOOKS = sorted(COURSE.glob("*.py"))
PARTS = ("**Goals.**", "**Before.**", "**Task 1", "**Check.**", "**Common mistakes.**")
STRICTLY = "import warnings; warnings.filterwarnings('error', '', DeprecationWarning, '__main__'); "


def cells(path: Path) -> list[tuple[str, str]]:
    """Heads and texts of a notebook's cells."""
    parts = re.split(r"^# %%(.*)$", path.read_text(), flags=re.MULTILINE)[1:]
    return list(zip(parts[::2], parts[1::2], strict=True))


def script(path: Path) -> str:
    """The code of a notebook; each line keeps its number in the file."""
    return "".join("\n" * text.count("\n") if "[markdown]" in head else text for head, text in cells(path))


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
def test_all_notebooks_run_and_those_that_write_run_twice_in_one_folder(typed: Typed, tmp_path: Path) -> None:
    """Cells tagged long too, on a part of their flights but for `make long`."""

    def run(path: Path, attempt: str) -> None:
        words = ["python", "-c", STRICTLY + script(path)]
        code, output = typed.run(words, tmp_path, () if LONG else (WORK,))
        assert code == 0, f"{path.name}, {attempt} run: {output[-5000:]}"

    for path in NOTEBOOKS:
        run(path, "first")
    # No notebook writes where another one does.
    written = sorted(folder.relative_to(tmp_path).as_posix() for folder in tmp_path.glob("*/*"))
    assert written == ["course/02", "course/04", "course/05"]
    assert [folder.name for folder in tmp_path.iterdir()] == ["course"]
    # One that wrote nothing finds its folder as before; the second notebook stands for those that write.
    for path in NOTEBOOKS if LONG else NOTEBOOKS[1:2]:
        run(path, "second")
