"""A page for each verb of `heli-host`, with its help and options, read from the program itself.

The pages, reference/verbs/VERB.md, are written when the site is built. Each has one directive, `verb`.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from pathlib import Path
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


def shown_verbs() -> dict[str, Any]:
    """Verbs that the help lists, in alphabetical order."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined] - typer types no group
    return {name: commands[name] for name in sorted(commands) if not commands[name].hidden}


class Verb(Directive):
    """What follows the heading of a verb's page: its help, its options and its subcommands."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the contents of the section that the heading began."""
        (name,) = self.arguments
        _heading, *contents = described(name, shown_verbs()[name]).children
        return contents


def write_pages(sphinx: Any) -> None:
    """Write the page of each verb that has none yet, and remove pages of former verbs."""
    folder = Path(sphinx.srcdir) / "reference" / "verbs"
    if not (folder.parent / "command-line.md").exists():
        return
    folder.mkdir(exist_ok=True)
    texts = {f"{name}.md": f"# heli-host {name}\n\n```{{verb}} {name}\n```\n" for name in shown_verbs()}
    for page in folder.glob("*.md"):
        if page.name not in texts:
            page.unlink()
    for file, text in texts.items():
        page = folder / file
        if not page.exists() or page.read_text() != text:
            page.write_text(text)


def link_verbs(sphinx: Any, doctree: nodes.document, docname: str) -> None:
    """Link each verb of the table of the command line to its page."""
    if docname != "reference/command-line":
        return
    for row in doctree.findall(nodes.row):
        for literal in list(row.children[0].findall(nodes.literal))[:1]:
            verb = literal.astext()
            if f"reference/verbs/{verb}" in sphinx.env.found_docs:
                address = sphinx.builder.get_relative_uri(docname, f"reference/verbs/{verb}")
                link = nodes.reference("", "", literal.deepcopy(), internal=True, refuri=address)
                literal.replace_self(link)


def setup(sphinx: Any) -> dict[str, bool]:
    """Register the directive, and write its pages before Sphinx looks for pages."""
    sphinx.add_directive("verb", Verb)
    sphinx.connect("builder-inited", write_pages)
    sphinx.connect("doctree-resolved", link_verbs)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
