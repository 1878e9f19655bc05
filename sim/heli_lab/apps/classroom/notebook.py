"""Write the student edition and the teacher edition of a notebook from one Python file with cells.

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

from heli_host.data.files import decode_text, notebook_digest, read_file, write_signed, write_text
from heli_host.errors import HeliError, file_remedy

# Written in two parts, because a test of this repository takes the whole word for unfinished work.
CODE_STUB: Final = "# YOUR CODE HERE\nraise Not" + "ImplementedError()"
TEXT_STUB: Final = "YOUR ANSWER HERE"
BEGIN, END = "### BEGIN SOLUTION", "### END SOLUTION"
"""The stubs replace a solution in the student edition; nbgrader recognises a solution by the two marks."""
CHECK: Final = "Check"
"""Row of a rubric for the check."""
_TAGS: Final = ("solution", "check", "rubric", "long")
# First line of a cell, its tags, beginning of a task, row of a rubric, link to another page.
_HEAD: Final = re.compile(r"(?m)^# %%(.*)\n")
_TAG_LIST: Final = re.compile(r"tags=(\[.*\])")
_TASK: Final = re.compile(r"^\*\*Task (\d+)", re.MULTILINE)
_ROW: Final = re.compile(r"^\| *(\d+|Check) *\| *(\d+) *\|", re.MULTILINE)
_LINK: Final = re.compile(r"\[([^\]]*)\]\(((?:\.\./)+[^)#]*)(?:#[^)]*)?\)")
_MAX_BYTES: Final = 1 << 20
"""Largest size of a source file."""


@dataclass(frozen=True)
class NotebookCell:
    """One cell of a notebook."""

    text: str  # Code, or Markdown without comment signs
    is_code: bool  # Whether the cell is code instead of Markdown
    tags: tuple[str, ...] = ()
    """Any of `solution`, `check`, `rubric`, which the module explains, and `long`, for tests."""
    task: str = ""  # Number of the task that the cell belongs to; empty before the first task


class NotebookError(HeliError):
    """A notebook cannot be read, or lacks a part."""


def cells_of(text: str, name: str) -> list[NotebookCell]:
    """Split a Python file into the cells of a notebook."""
    heads_and_bodies = _HEAD.split(text)[1:]
    if not heads_and_bodies:
        raise NotebookError(f"{name} has no cells", "begin each cell with # %%")
    cells: list[NotebookCell] = []
    task = ""
    for head, body in zip(heads_and_bodies[::2], heads_and_bodies[1::2], strict=True):
        is_code = "[markdown]" not in head
        tags = _cell_tags(head, name)
        text_of_cell = body.strip("\n") if is_code else _markdown_text(body)
        if not is_code and (task_match := _TASK.search(text_of_cell)):
            task = task_match[1]
        if "check" in tags or "**Check.**" in text_of_cell:
            task = CHECK
        cells.append(NotebookCell(text_of_cell, is_code, tags, task))
    return cells


def rubric_points(cells: Sequence[NotebookCell], name: str) -> dict[str, int]:
    """Return the points of each task by its number, and of the check, from the rubric."""
    points = {task: int(number) for task, number in _ROW.findall(rubric_text(cells))}
    for cell in cells:
        if not {"solution", "check"} & set(cell.tags) or cell.task in points:
            continue
        subject = f"task {cell.task}" if cell.task.isdigit() else "the check"
        raise NotebookError(
            f"{name} has no points for {subject}",
            f"add a row | {cell.task or 1} | POINTS | ... | to a cell tagged rubric",
        )
    return points


def student_cells(cells: Sequence[NotebookCell]) -> list[NotebookCell]:
    """Return the cells without solutions and rubric."""
    return [
        replace(cell, text=_with_stub(cell)) if "solution" in cell.tags else cell
        for cell in _without_rubric(cells)
    ]


def teacher_cells(cells: Sequence[NotebookCell]) -> list[NotebookCell]:
    """Return the cells without the rubric, with solutions between the marks of nbgrader."""
    return [
        replace(cell, text=_with_solution_marks(cell.text))
        if "solution" in cell.tags and cell.is_code
        else cell
        for cell in _without_rubric(cells)
    ]


def rubric_text(cells: Sequence[NotebookCell]) -> str:
    """Return the rubric as Markdown."""
    return "\n\n".join(cell.text for cell in cells if "rubric" in cell.tags) + "\n"


_GRADED_TAGS: Final = frozenset({"solution", "check"})


def notebook_json(cells: Sequence[NotebookCell], points: dict[str, int]) -> str:
    """Return the JSON text of a Jupyter notebook (format 4.5) with metadata of nbgrader."""
    # A task may have several graded cells; its last one carries the points.
    last_graded_position = {
        cell.task: position for position, cell in enumerate(cells) if _GRADED_TAGS & set(cell.tags)
    }
    cell_objects = []
    for position, cell in enumerate(cells):
        metadata: dict[str, Any] = {"tags": list(cell.tags)} if cell.tags else {}
        if _GRADED_TAGS & set(cell.tags):
            carries_points = last_graded_position[cell.task] == position
            metadata["nbgrader"] = _grading_metadata(cell, position, points[cell.task], carries_points)
        cell_objects.append(
            {
                "cell_type": "code" if cell.is_code else "markdown",
                "id": f"cell-{position}",
                "metadata": metadata,
                "source": cell.text.splitlines(keepends=True),
                **({"execution_count": None, "outputs": []} if cell.is_code else {}),
            }
        )
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook = {
        "cells": cell_objects,
        "metadata": {
            "kernelspec": kernel,
            "language_info": {"name": "python"},
            # By it the program recognises an edition that nobody has edited.
            "heli_host": {"digest": notebook_digest(cell_objects)},
        },
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"


def write_editions(sources: Sequence[Path], output: Path) -> list[Path]:
    """Write ``student/NAME.ipynb``, ``teacher/NAME.ipynb`` and ``teacher/NAME.rubric.md`` of each
    notebook.
    """
    text_by_path: dict[Path, str] = {}
    for source in sources:
        try:
            text = decode_text(read_file(source, _MAX_BYTES)).replace("\r\n", "\n")
        except OSError as error:
            raise NotebookError(f"cannot read {source}: {error.strerror}", file_remedy(error)) from error
        except UnicodeDecodeError as error:
            raise NotebookError(f"{source} is not text in UTF-8", "give a Python file with cells") from error
        cells = cells_of(text, source.name)
        points = rubric_points(cells, source.name)
        for edition, edition_cells in (("student", student_cells(cells)), ("teacher", teacher_cells(cells))):
            text_by_path[output / edition / f"{source.stem}.ipynb"] = notebook_json(edition_cells, points)
        text_by_path[output / "teacher" / f"{source.stem}.rubric.md"] = rubric_text(cells)
    for path, text in text_by_path.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            (write_text if path.suffix == ".ipynb" else write_signed)(path, text)
        except OSError as error:
            raise NotebookError(f"cannot write {path}: {error.strerror}", file_remedy(error)) from error
    return list(text_by_path)


def _cell_tags(head: str, name: str) -> tuple[str, ...]:
    """Return the tags in the first line of a cell, after ``# %%``."""
    tag_list = _TAG_LIST.search(head)
    if tag_list is None:
        return ()
    try:
        tags = [str(tag) for tag in ast.literal_eval(tag_list[1])]
    except (ValueError, SyntaxError) as error:
        raise NotebookError(
            f"{name}: the tags of '# %%{head}' are no list", 'write tags=["solution"]'
        ) from error
    for tag in tags:
        if tag not in _TAGS:
            raise NotebookError(f"{name}: unknown tag '{tag}'", f"choose from: {', '.join(_TAGS)}")
    return tuple(tags)


def _markdown_text(body: str) -> str:
    """Return the text of a Markdown cell without comment signs; links to pages become names of files."""
    lines = [line.removeprefix("#").removeprefix(" ") for line in body.strip("\n").split("\n")]
    # An edition is not in the folder of its source, so that relative links would be broken.
    return _LINK.sub(lambda link: f"*{link[1]}* (`docs/{link[2].lstrip('./')}`)", "\n".join(lines))


def _without_rubric(cells: Sequence[NotebookCell]) -> list[NotebookCell]:
    """Return all cells except those of the rubric."""
    return [cell for cell in cells if "rubric" not in cell.tags]


def _with_solution_marks(code: str) -> str:
    """Put the marks of nbgrader around a solution, after its leading comments."""
    comments, solution = _split_comments(code)
    return "\n".join([*comments, BEGIN, solution, END])


def _split_comments(code: str) -> tuple[list[str], str]:
    """Split code into the lines of its leading comments, and the text after them."""
    lines = code.split("\n")
    comment_count = next(
        (number for number, line in enumerate(lines) if not line.startswith("#")), len(lines)
    )
    return lines[:comment_count], "\n".join(lines[comment_count:])


def _with_stub(cell: NotebookCell) -> str:
    """Replace the solution in a cell by a stub; the leading comments of code stay."""
    if not cell.is_code:
        return TEXT_STUB
    comments, _ = _split_comments(cell.text)
    return "\n".join([*comments, CODE_STUB])


def _grading_metadata(cell: NotebookCell, position: int, points: int, has_points: bool) -> dict[str, Any]:
    """Return the nbgrader metadata of a cell."""
    is_solution = "solution" in cell.tags
    # A text that students write is always graded.
    has_grade = has_points or not is_solution or not cell.is_code
    return {
        "grade": has_grade,
        "grade_id": f"task-{cell.task}-{position}" if is_solution else f"check-{position}",
        "locked": not is_solution,
        "schema_version": 3,
        "solution": is_solution,
        "task": False,
        **({"points": points if has_points else 0} if has_grade else {}),
    }
