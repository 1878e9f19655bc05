"""Editions of a notebook for students and teachers, from one Python file with cells.

A cell begins with ``# %%``, optionally with ``[markdown]`` and ``tags=[...]``. The tags are:

- ``solution``: code or text that students write. The student edition keeps the comments at the beginning.
- ``check``: asserts that pass when the tasks are solved.
- ``rubric``: table of tasks and points. It is in a file next to the teacher edition.

The metadata are those of nbgrader. The teacher edition is a source notebook of nbgrader, and the student
edition is what nbgrader makes of it. Neither contains the rubric, because nbgrader would hand it out.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from heli_host.errors import HeliError, file_remedy
from heli_host.files import read_file

# Joined, because this repository takes the whole word for unfinished work of its own.
CODE_STUB: Final = "# YOUR CODE HERE\nraise Not" + "ImplementedError()"
TEXT_STUB: Final = "YOUR ANSWER HERE"
BEGIN, END = "### BEGIN SOLUTION", "### END SOLUTION"
"""What nbgrader puts in place of a solution, and how it recognises one."""
CHECK: Final = "Check"
"""Row of a rubric for the check."""
_TAGS: Final = ("solution", "check", "rubric", "long")
_HEAD: Final = re.compile(r"(?m)^# %%(.*)\n")
_TAG_LIST: Final = re.compile(r"tags=(\[.*\])")
_TASK: Final = re.compile(r"^\*\*Task (\d+)", re.MULTILINE)
_ROW: Final = re.compile(r"^\| *(\d+|Check) *\| *(\d+) *\|", re.MULTILINE)
_LINK: Final = re.compile(r"\[([^\]]*)\]\(((?:\.\./)+[^)#]*)(?:#[^)]*)?\)")
_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class NotebookCell:
    """One cell.

    Parameters
    ----------
    text : str
        Code, or Markdown without comment signs.
    is_code : bool
        Whether it is code.
    tags : tuple of str
        Any of `solution`, `check`, `rubric` and `long`, which the module explains.
    task : str
        Number of the task that it belongs to; empty before the first.
    """

    text: str
    is_code: bool
    tags: tuple[str, ...] = ()
    task: str = ""


class NotebookError(HeliError):
    """A notebook cannot be read, or lacks a part."""


def cells_of(text: str, name: str) -> list[NotebookCell]:
    """Read a notebook.

    Parameters
    ----------
    text : str
        Python file with cells.
    name : str
        Name of the file, for messages.

    Raises
    ------
    NotebookError
        A tag is unknown, or no cell begins.
    """
    parts = _HEAD.split(text)[1:]
    if not parts:
        raise NotebookError(f"{name} has no cells", "begin each cell with # %%")
    cells: list[NotebookCell] = []
    task = ""
    for head, body in zip(parts[::2], parts[1::2], strict=True):
        is_code = "[markdown]" not in head
        tags = _tags(head, name)
        words = body.strip("\n") if is_code else _markdown(body)
        if not is_code and (task_words := _TASK.search(words)):
            task = task_words[1]
        if "check" in tags or "**Check.**" in words:
            task = CHECK
        cells.append(NotebookCell(words, is_code, tags, task))
    return cells


def rubric_points(cells: Sequence[NotebookCell], name: str) -> dict[str, int]:
    """Return the points of each task by its number, and of the check, from the rubric.

    Parameters
    ----------
    cells : sequence of NotebookCell
        Cells of a notebook.
    name : str
        Name of the file, for messages.

    Raises
    ------
    NotebookError
        The rubric is missing, or has no row for a task with a solution or for the check.
    """
    points = {task: int(number) for task, number in _ROW.findall(rubric_text(cells))}
    for needed in dict.fromkeys(cell.task for cell in cells if {"solution", "check"} & set(cell.tags)):
        if needed not in points:
            where = f"task {needed}" if needed.isdigit() else "the check"
            raise NotebookError(
                f"{name} has no points for {where}",
                f"add a row | {needed or 1} | POINTS | ... | to a cell tagged rubric",
            )
    return points


def student_cells(cells: Sequence[NotebookCell]) -> list[NotebookCell]:
    """Return the cells without solutions and rubric.

    Parameters
    ----------
    cells : sequence of NotebookCell
        Cells of a notebook.
    """
    return [replace(cell, text=_stub(cell)) if "solution" in cell.tags else cell for cell in _shown(cells)]


def teacher_cells(cells: Sequence[NotebookCell]) -> list[NotebookCell]:
    """Return the cells without the rubric, with solutions between the marks of nbgrader.

    Parameters
    ----------
    cells : sequence of NotebookCell
        Cells of a notebook.
    """
    return [
        replace(cell, text=_marked(cell.text)) if "solution" in cell.tags and cell.is_code else cell
        for cell in _shown(cells)
    ]


def rubric_text(cells: Sequence[NotebookCell]) -> str:
    """Return the rubric as Markdown.

    Parameters
    ----------
    cells : sequence of NotebookCell
        Cells of a notebook.
    """
    return "\n\n".join(cell.text for cell in cells if "rubric" in cell.tags) + "\n"


def notebook_json(cells: Sequence[NotebookCell], points: dict[str, int]) -> str:
    """Return a Jupyter notebook (format 4.5) with metadata of nbgrader.

    Parameters
    ----------
    cells : sequence of NotebookCell
        Cells of an edition.
    points : dict of str to int
        Points of each task and of the check. The last solution of a task, and the last check, carry them.
    """
    graded: dict[str, int] = {}
    for place, cell in enumerate(cells):
        if {"solution", "check"} & set(cell.tags):
            graded[cell.task] = place
    written = []
    for place, cell in enumerate(cells):
        metadata: dict[str, Any] = {"tags": list(cell.tags)} if cell.tags else {}
        if {"solution", "check"} & set(cell.tags):
            metadata["nbgrader"] = _grading(cell, place, points[cell.task], graded[cell.task] == place)
        written.append(
            {
                "cell_type": "code" if cell.is_code else "markdown",
                "id": f"cell-{place}",
                "metadata": metadata,
                "source": cell.text.splitlines(keepends=True),
                **({"execution_count": None, "outputs": []} if cell.is_code else {}),
            }
        )
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook = {
        "cells": written,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"


def write_editions(sources: Sequence[Path], output: Path) -> list[Path]:
    """Write ``student/NAME.ipynb``, ``teacher/NAME.ipynb`` and ``teacher/NAME.rubric.md`` of each notebook.

    All sources are read before the first file is written.

    Parameters
    ----------
    sources : sequence of Path
        Python files with cells.
    output : Path
        Folder, made if it is missing; former editions are replaced.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    NotebookError
        A file cannot be read or written, or its tags or rubric are incomplete.
    """
    editions: dict[Path, str] = {}
    for source in sources:
        try:
            text = read_file(source, _BYTES).decode("utf-8").replace("\r\n", "\n")
        except OSError as error:
            raise NotebookError(f"cannot read {source}: {error.strerror}", file_remedy(error)) from error
        except UnicodeDecodeError as error:
            raise NotebookError(f"{source} is not text in UTF-8", "give a Python file with cells") from error
        cells = cells_of(text, source.name)
        points = rubric_points(cells, source.name)
        for edition, made in (("student", student_cells(cells)), ("teacher", teacher_cells(cells))):
            editions[output / edition / f"{source.stem}.ipynb"] = notebook_json(made, points)
        editions[output / "teacher" / f"{source.stem}.rubric.md"] = rubric_text(cells)
    for path, text in editions.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8", newline="\n")
        except OSError as error:
            raise NotebookError(f"cannot write {path}: {error.strerror}", file_remedy(error)) from error
    return list(editions)


def _tags(head: str, name: str) -> tuple[str, ...]:
    """Tags in the `head` of a cell of the notebook `name`."""
    listed = _TAG_LIST.search(head)
    if listed is None:
        return ()
    try:
        tags = [str(tag) for tag in ast.literal_eval(listed[1])]
    except (ValueError, SyntaxError) as error:
        raise NotebookError(
            f"{name}: the tags of '# %%{head}' are no list", 'write tags=["solution"]'
        ) from error
    for tag in tags:
        if tag not in _TAGS:
            raise NotebookError(f"{name}: unknown tag '{tag}'", f"choose from: {', '.join(_TAGS)}")
    return tuple(tags)


def _markdown(body: str) -> str:
    lines = [line.removeprefix("#").removeprefix(" ") for line in body.strip("\n").split("\n")]
    # An edition is in another folder than the pages, so that a link would lead nowhere.
    return _LINK.sub(lambda link: f"*{link[1]}* (`docs/{link[2].lstrip('./')}`)", "\n".join(lines))


def _shown(cells: Sequence[NotebookCell]) -> list[NotebookCell]:
    return [cell for cell in cells if "rubric" not in cell.tags]


def _marked(code: str) -> str:
    lead, body = _lead(code)
    return "\n".join([*lead, BEGIN, body, END])


def _lead(code: str) -> tuple[list[str], str]:
    """Comments at the beginning, and the rest."""
    lines = code.split("\n")
    count = next((place for place, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return lines[:count], "\n".join(lines[count:])


def _stub(cell: NotebookCell) -> str:
    return "\n".join([*_lead(cell.text)[0], CODE_STUB]) if cell.is_code else TEXT_STUB


def _grading(cell: NotebookCell, place: int, points: int, has_points: bool) -> dict[str, Any]:
    """Metadata of a cell for nbgrader: what students may edit, and the points of its task."""
    is_solution = "solution" in cell.tags
    # A text that students write is always graded.
    has_grade = has_points or not is_solution or not cell.is_code
    return {
        "grade": has_grade,
        "grade_id": f"task-{cell.task}-{place}" if is_solution else f"check-{place}",
        "locked": not is_solution,
        "schema_version": 3,
        "solution": is_solution,
        "task": False,
        **({"points": points if has_points else 0} if has_grade else {}),
    }
