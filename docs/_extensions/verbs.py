"""The directive `verbs`: the help and options of every verb of `heli-host`, read from the program itself."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from typing import Any

import typer.main
from docutils import nodes
from docutils.parsers.rst import Directive
from heli_host.ui.cli import app

EVERYWHERE = {"--help", "--quiet", "--force"}


def table(header: Sequence[str], rows: Sequence[Sequence[Sequence[nodes.Node]]]) -> nodes.table:
    """Make a table of cells that are given as nodes."""
    group = nodes.tgroup("", *(nodes.colspec(colwidth=1) for _ in header), cols=len(header))
    head = nodes.row("", *(nodes.entry("", nodes.paragraph("", word)) for word in header))
    body = [nodes.row("", *(nodes.entry("", nodes.paragraph("", "", *cell)) for cell in row)) for row in rows]
    group += [nodes.thead("", head), nodes.tbody("", *body)]
    return nodes.table("", group)


def words(text: str) -> Iterator[nodes.Node]:
    """Text, in which what is between backticks is code."""
    for position, part in enumerate(text.split("`")):
        if part:
            yield nodes.literal("", part) if position % 2 else nodes.Text(part)


def options(name: str, command: Any) -> Iterator[tuple[list[nodes.Node], list[nodes.Node]]]:
    """Arguments and options: how each is written, and its help."""
    context = command.make_context(name, [], resilient_parsing=True)
    for parameter in command.params:
        if EVERYWHERE & set(parameter.opts) or getattr(parameter, "hidden", False):
            continue
        written, text = parameter.get_help_record(context)
        # Of an argument the record has the type too: PLAN... <list[str]>.
        yield [nodes.literal("", written.partition(" <")[0])], list(words(" ".join(text.split())))


def described(title: str, command: Any) -> nodes.section:
    """A section about a verb, and one about each of its subcommands."""
    section = nodes.section(ids=[title.replace(" ", "-")], names=[title])
    section += nodes.title("", "", nodes.literal("", title))
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        section += nodes.paragraph("", "", *words(" ".join(paragraph.replace("\b", "").split())))
    rows = list(options(title, command))
    if rows and not getattr(command, "commands", None):
        section += table(("option", "meaning"), rows)
    for name, part in getattr(command, "commands", {}).items():
        if not part.hidden:
            section += described(f"{title} {name}", part)
    return section


class Verbs(Directive):
    """All verbs in alphabetical order."""

    def run(self) -> list[nodes.Node]:
        """Make a section of each."""
        commands = typer.main.get_command(app).commands  # type: ignore[attr-defined] - typer types no group
        return [described(name, commands[name]) for name in sorted(commands) if not commands[name].hidden]


def setup(sphinx: Any) -> dict[str, bool]:
    """Register the directive."""
    sphinx.add_directive("verbs", Verbs)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
