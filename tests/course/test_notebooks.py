"""Every notebook of the course runs from its first cell to its check, which fails without the result.

The editions for students and teachers come from one source, and nbgrader makes one of the other.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from heli_lab.apps.classroom.notebook import (
    BEGIN,
    CODE_STUB,
    END,
    TEXT_STUB,
    NotebookError,
    cells_of,
    rubric_points,
    write_editions,
)
from heli_sim.model.effects import catalogue

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


SMALL = (
    '# %% [markdown]\n# **Task 1.** Add.\n\n# %% tags=["solution"]\n# total: the sum\ntotal = 1 + 2\n\n'
    '# %% [markdown]\n# **Check.**\n\n# %% tags=["check"]\nassert total == 3\n\n'
    '# %% [markdown] tags=["rubric"]\n# | task | points | full points for |\n# |---|---|---|\n'
    "# | 1 | 2 | the sum |\n# | Check | 1 | the check |\n"
)


def edition(folder: Path, kind: str, name: str) -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads((folder / kind / f"{name}.ipynb").read_text())["cells"]
    return [{**cell, "source": "".join(cell["source"])} for cell in cells]


def released(cell: dict[str, Any]) -> dict[str, Any]:
    """The student version that nbgrader makes of a cell: a stub replaces each solution."""
    if not cell["metadata"].get("nbgrader", {}).get("solution"):
        return cell
    if cell["cell_type"] == "markdown":
        return {**cell, "source": TEXT_STUB}
    marked = re.compile(f"^{BEGIN}$.*?^{END}$", re.MULTILINE | re.DOTALL)
    assert len(marked.findall(cell["source"])) == 1
    return {**cell, "source": marked.sub(CODE_STUB, cell["source"])}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("editions")
    write_editions(NOTEBOOKS, folder)
    return folder


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_student_edition_is_what_nbgrader_hands_out(path: Path, made: Path) -> None:
    teacher, student = (edition(made, kind, path.stem) for kind in ("teacher", "student"))
    assert student == [released(cell) for cell in teacher]
    assert len({cell["id"] for cell in student}) == len(student)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_student_gets_no_solution_and_no_rubric(path: Path, made: Path) -> None:
    text = "\n".join(cell["source"] for cell in edition(made, "student", path.stem))
    hidden = [cell for cell in cells_of(path.read_text(), path.name) if "solution" in cell.tags]
    assert hidden
    for cell in hidden:
        # Its first lines may be comments that say what to compute.
        longest = max((line for line in cell.text.split("\n") if not line.startswith("#")), key=len)
        assert longest not in text
    assert "Rubric" not in text


def test_a_student_may_hide_any_effect(made: Path) -> None:
    """The fifth notebook lets each student choose, so no cell that students get may expect one."""
    cells = edition(made, "student", "5_hide_an_effect")
    code = "\n".join(cell["source"] for cell in cells if cell["cell_type"] == "code")
    given = code.replace('such as "rotor_lag=0.1"', "")
    assert not any(name in given for name in catalogue())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_teacher_edition_runs_the_code_of_the_source(path: Path, made: Path) -> None:
    code = [cell["source"] for cell in edition(made, "teacher", path.stem) if cell["cell_type"] == "code"]
    lines = [line for line in "\n".join(code).split("\n") if line.strip() and line not in (BEGIN, END)]
    assert lines == [line for line in script(path).split("\n") if line.strip()]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_each_notebook_has_ten_points_and_a_rubric(path: Path, made: Path) -> None:
    graded = [cell["metadata"].get("nbgrader", {}) for cell in edition(made, "student", path.stem)]
    assert sum(cell.get("points", 0) for cell in graded) == 10
    # The check is locked, and its points are in it.
    assert [cell["points"] for cell in graded if cell.get("locked")] == [3]
    rubric = (made / "teacher" / f"{path.stem}.rubric.md").read_text()
    assert sum(int(points) for points in re.findall(r"^\| \w+ \| (\d+) \|", rubric, re.MULTILINE)) == 10


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('tags=["solution"]', 'tags=["solutions"]', "unknown tag 'solutions'"),
        ('tags=["solution"]', "tags=[solution]", "are no list"),
        ("# | 1 | 2 | the sum |\n", "", "no points for task 1"),
        ("# | Check | 1 | the check |\n", "", "no points for the check"),
        ("# %%", "#", "has no cells"),
    ],
)
def test_a_source_with_a_missing_part_is_refused(old: str, new: str, reason: str) -> None:
    rubric_points(cells_of(SMALL, "small.py"), "small.py")
    text = SMALL.replace(old, new)
    with pytest.raises(NotebookError, match=reason) as refused:
        rubric_points(cells_of(text, "small.py"), "small.py")
    assert refused.value.remedy


def test_a_bad_source_leaves_no_edition(tmp_path: Path) -> None:
    (tmp_path / "good.py").write_text(SMALL)
    (tmp_path / "bad.py").write_text(SMALL.replace("| Check |", "| other |"))
    with pytest.raises(NotebookError):
        write_editions([tmp_path / "good.py", tmp_path / "bad.py"], tmp_path / "made")
    assert not (tmp_path / "made").exists()
