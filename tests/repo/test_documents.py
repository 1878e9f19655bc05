"""Commands in the documents work, and notebooks of the course run from the first cell to the check.

In a fence ```console every line that starts with ``$`` is a command: its verb and options must exist. A fence
```console run, or ```python run, is run, each document in one empty folder from top to bottom. One with
```console long, or ```python long, is run as well, on shorter flights; in `make long` at its full length.

A check of a notebook fails without its result. Notebooks run twice, all in one folder. Cells with the tag
`long` diagnose shorter flights, except in `make long`. The editions for students and teachers come from one
source, and nbgrader makes one of the other.
"""

import json
import re
import shlex
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main
from heli_host.ui.cli import app
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

from tests.repo.prose.texts import pages
from tests.repo.typed import PLANS, WORK, Typed
from tests.running.long import LONG

ROOT = Path(__file__).resolve().parents[2]
AT_THE_ROOT = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
DOCUMENTS = [*(ROOT / name for name in AT_THE_ROOT), *pages(ROOT)]
VERDICT = re.compile(r"^(?:explained|cause_found|ambiguous|unexplained): ", re.MULTILINE)
"""Begin of the line with which a diagnosis states its verdict."""
FENCE = re.compile(r"^```(\w+)(?: (run|long))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A fence of a document."""

    language: str  # Language of the block
    runs: bool  # Whether it is to be run
    is_long: bool  # Whether on shorter flights, but for `make long`
    text: str  # Its content

    @property
    def commands(self) -> list[list[str]]:
        lines = re.sub(r"\\\n", " ", self.text).splitlines()
        return [shlex.split(line[2:], comments=True) for line in lines if line.startswith("$ ")]


def name_of(path: Path) -> str:
    """A page as the folder of documents names it: how-to/flying.md."""
    folder = ROOT / "docs"
    return str(path.relative_to(folder if folder in path.parents else ROOT))


def blocks(path: Path) -> list[Block]:
    return [
        Block(match[1], bool(match[2]), match[2] == "long", match[3])
        for match in FENCE.finditer(path.read_text())
    ]


def commands() -> list[tuple[str, list[str]]]:
    return [
        (name_of(path), command)
        for path in DOCUMENTS
        for block in blocks(path)
        if block.language == "console"
        for command in block.commands
    ]


@cache
def program() -> Any:
    """Return the command line with all verbs, whose parsers are made once."""
    return typer.main.get_command(app)


@cache
def make_targets() -> set[str]:
    return set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def verbs() -> dict[str, Any]:
    return {name: command for name, command in program().commands.items() if not command.hidden}


def verb_table() -> set[str]:
    """Verbs in the first column of the table of the command line."""
    text = (ROOT / "docs" / "reference" / "command-line.md").read_text()
    return set(re.findall(r"^\| `(\w+)[^`]*` \|", text, re.MULTILINE))


def test_the_page_of_the_command_line_lists_every_verb() -> None:
    assert verb_table() == {name for name, command in verbs().items() if not command.hidden}


def test_the_readme_is_at_most_120_lines() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


@pytest.mark.medium
@pytest.mark.parametrize("verb", sorted(verbs()))
def test_every_verb_has_an_example(verb: str) -> None:
    command = verbs()[verb]
    parts = list(getattr(command, "commands", {}).values()) or [command]
    for part in parts:
        assert "Example" in (part.help or ""), f"{verb} {part.name}: --help has no example"


@pytest.mark.medium
@pytest.mark.parametrize(("document", "command"), commands(), ids=lambda value: str(value)[:60])
def test_command_in_a_document_exists(document: str, command: list[str]) -> None:
    words = command[: command.index("&")] if "&" in command else command
    name, *arguments = words
    if name == "make":
        targets = [word for word in arguments if "=" not in word]
        assert set(targets) <= make_targets(), f"{document}: make {' '.join(targets)}"
    elif Path(name).name == "heli-host":
        parse(arguments)


def parse(arguments: list[str]) -> None:
    """Parse a command line down to its verb, without running it."""
    command = program()
    name = "heli-host"
    context = None
    while True:
        context = command.make_context(name, list(arguments), parent=context)
        if not hasattr(command, "resolve_command"):
            return
        # A group keeps what it has not parsed under one name or another, depending on Typer's age.
        unparsed = [
            *(getattr(context, "protected_args", None) or getattr(context, "_protected_args", [])),
            *context.args,
        ]
        name, command, arguments = command.resolve_command(context, unparsed)


@pytest.mark.documents
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=name_of(path), marks=pytest.mark.xdist_group(f"document-{name_of(path)}"))
        for path in DOCUMENTS
        if any(block.runs for block in blocks(path))
    ],
)
def test_what_a_document_says_to_run_runs(path: Path, typed: Typed, tmp_path: Path) -> None:
    printed = ""
    for block in blocks(path):
        if block.language == "text" and (verdicts := VERDICT.findall(block.text)):
            assert VERDICT.findall(printed)[-1:] == verdicts, (
                f"{name_of(path)} states another verdict:\n{printed}"
            )
        if not block.runs:
            continue
        printed = ""
        shorter = (PLANS, WORK) if block.is_long and not LONG else ()
        is_python = block.language == "python"
        for words in [["python", "-c", block.text]] if is_python else block.commands:
            code, output = typed.run(words, tmp_path, shorter)
            assert code == 0, f"{words[-1] if is_python else shlex.join(words)}\n{output[-4000:]}"
            printed += output


def test_verdict_in_a_console_block_that_is_not_run_is_that_of_the_how_to() -> None:
    how_to = (ROOT / "docs" / "how-to" / "diagnosing.md").read_text()
    stated = [
        line
        for path in DOCUMENTS
        for block in blocks(path)
        if block.language == "console" and not block.runs
        for line in block.text.splitlines()
        if VERDICT.match(line)
    ]
    assert stated and all(f"\n{line}\n" in how_to for line in stated)


def anchors(path: Path) -> set[str]:
    """Anchors that GitHub makes of a document's headings."""
    headings = re.findall(r"^#+ (.+)$", path.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links() -> list[tuple[Path, str]]:
    pattern = re.compile(r"\]\(([^)\s]+)\)")
    return [
        (path, link) for path in DOCUMENTS for link in pattern.findall(path.read_text()) if "://" not in link
    ]


@pytest.mark.parametrize(("document", "link"), links(), ids=lambda value: str(value)[-40:])
def test_link_in_a_document_leads_somewhere(document: Path, link: str) -> None:
    name, _, anchor = link.partition("#")
    target = document.parent / name if name else document
    assert target.exists()
    if anchor:
        assert anchor in anchors(target)


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
