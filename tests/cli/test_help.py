"""Help reads as one language: an imperative verb, an object, at most 80 characters, ordinary words."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from heli_host.ui.cli.entry import command_line

from tests.cli.terminal import Terminal

pytestmark = pytest.mark.medium

LONGEST = 80
OPENERS = {
    *("a", "an", "all", "also", "as", "at", "file", "flights", "folder", "for", "how", "if", "its", "more"),
    *(
        "no",
        "not",
        "of",
        "one",
        "only",
        "other",
        "others",
        "so",
        "the",
        "this",
        "to",
        "until",
        "what",
        "when",
    ),
    *("where", "whether", "which", "with", "without"),
    *("say", "says", "tell", "tells", "told", "does", "is"),
}
"""First words that are no imperative verb, or one that table B of the style guide excludes."""
WORDS = re.compile(
    r"\b(tell|tells|told|foretell|foretold|foreseen|weather|draughty|windy|beside|stands in|lies in|anew"
    r"|as ever|of one's own|parted|dear|dearest|mend|mends|walk|room|tenant|seam|seat|likelier|surer|nats"
    r"|at once|the make|of a make|machines of|nobody|somebody|whoever)\b",
    re.IGNORECASE,
)
"""Words of table B in the style guide, as far as help could use them."""


def commands() -> Iterator[tuple[str, Any]]:
    """Every verb and sub-verb that is listed, by name."""
    waiting = [("", command_line())]
    while waiting:
        name, command = waiting.pop()
        yield name or "heli-host", command
        for part, below in getattr(command, "commands", {}).items():
            if not below.hidden:
                waiting.append((f"{name} {part}".strip(), below))


def help_lines() -> list[tuple[str, str]]:
    lines = []
    for name, command in commands():
        lines.append((name, (command.help or "").partition("\n")[0]))
        for parameter in command.params:
            text = getattr(parameter, "help", None)
            if text and parameter.name not in ("help", "install_completion", "show_completion"):
                lines.append((f"{name} {parameter.opts[0]}", text.partition("  [default:")[0]))
    return lines


def paragraphs(command: Any) -> list[str]:
    return [" ".join(part.split()) for part in (command.help or "").split("\n\n")]


@pytest.mark.parametrize(("where", "line"), help_lines(), ids=[where for where, _ in help_lines()])
def test_a_line_of_help_is_a_short_instruction_in_ordinary_words(where: str, line: str) -> None:
    assert len(line) <= LONGEST, len(line)
    assert ";" not in line
    assert line.endswith(".")
    assert line.split(maxsplit=1)[0].strip(".,").lower() not in OPENERS
    assert line[0].isupper()
    assert not WORDS.search(line)


@pytest.mark.parametrize(("name", "command"), commands(), ids=[name for name, _ in commands()])
def test_help_has_a_purpose_side_effects_and_an_example(name: str, command: Any) -> None:
    parts = paragraphs(command)
    assert not any(WORDS.search(part) for part in parts), WORDS.findall(" ".join(parts))
    assert not any(";" in part for part in parts)
    if getattr(command, "commands", None):
        if name != "heli-host":
            assert (
                f"heli-host {name} COMMAND --help" in parts[-1]
                or f"heli-host {name} COMMAND --help" in parts[-2]
            )
        return
    assert len(parts) >= 3, "a first line, a paragraph on defaults and side effects, and an example"
    assert parts[-1].startswith("Example: `heli-host ")
    for part in parts[1:-1]:
        for sentence in re.split(r"(?<=[.:]) ", part):
            assert len(sentence.split()) <= 25, sentence


@pytest.mark.parametrize("name", [name for name, _ in commands()])
def test_what_is_printed_has_every_word_of_the_help(name: str, terminal: Terminal) -> None:
    """The renderer drops what looks like a tag, such as a placeholder in angle brackets."""
    command = dict(commands())[name]
    words = [] if name == "heli-host" else name.split()
    shown = re.sub(r"[\s│╭╮╰╯─]", "", terminal(*words, "--help").out)
    for part in paragraphs(command):
        assert re.sub(r"[\s`]", "", part) in shown
