"""Commands in the documents work.

In a fence ```console every line that starts with ``$`` is a command: its verb and options must exist. A fence
```console run, or ```python run, is run, each document in one empty folder from top to bottom. One with
```console long, or ```python long, is run as well, on shorter flights; in `make long` at its full length.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main
from heli_host.ui.cli import app

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
