"""``heli-host course``: editions of the course's notebooks for students and teachers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from heli_host.ui.cli.say import say, say_files
from heli_host.ui.cli.verb import Verb


def course(
    notebooks: Annotated[
        list[Path],
        typer.Argument(metavar="NOTEBOOK.py...", help="Read these notebooks, or all in these folders."),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="DIR", help="Write student/ and teacher/ into this folder."),
    ],
) -> None:
    """Make student and teacher editions of notebooks, for Jupyter and nbgrader.

    A notebook is a Python file with cells, such as those in docs/course. The student edition has no
    solutions. The teacher edition has solutions, and is a source notebook of nbgrader. The rubric is a file
    next to it. Former editions in the folder are replaced.

    Example: `heli-host course docs/course --output editions`
    """
    from heli_lab.apps.classroom.notebook import NotebookError, write_editions

    sources: list[Path] = []
    for path in notebooks:
        sources += sorted(path.glob("*.py")) if path.is_dir() else [path]
    if not sources:
        raise NotebookError(f"{notebooks[0]} contains no notebook", "give Python files with cells")
    files = write_editions(sources, output)
    say(f"{len(sources)} notebooks, each for students and teachers")
    say_files(files)


VERB = Verb(course, "Laboratory")
