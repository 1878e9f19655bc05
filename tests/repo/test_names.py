"""A name states what the thing is: adjectives and participles such as `found` or `own` are no nouns."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from tests.repo.test_tree import ROOT, tracked

NO_NOUNS = frozenset({"one", "found", "own", "taken", "told", "asked", "said", "usual"})
"""Words that name nothing: the reader has to find out what was found."""


def names_of(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and name of each variable, argument, field, function and class of a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr
        elif isinstance(node, ast.ExceptHandler) and node.name:
            yield node.lineno, node.name


def meaningless(source: str) -> list[tuple[int, str]]:
    """Line and name of each name that states nothing; `left` is a side if the file also has a `right`."""
    names = list(names_of(ast.parse(source)))
    sides = {"left", "right"}.issubset(name for _, name in names)
    words = NO_NOUNS if sides else NO_NOUNS | {"left"}
    return [(line, name) for line, name in names if name.strip("_") in words]


@pytest.mark.slow
def test_no_name_in_python_is_a_word_without_meaning() -> None:
    files = [path for path in tracked() if path.suffix == ".py"]
    assert len(files) > 1000
    places = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in files
        for line, name in meaningless(path.read_text(encoding="utf-8"))
    ]
    assert not places, "name the thing, such as `entry` for `found`:\n" + "\n".join(places)


def test_a_word_without_meaning_is_noticed_as_variable_argument_field_and_function() -> None:
    source = """
class A:
    found: int = 0

    def told(self, own):
        self._said = [one for one in own]
"""
    assert meaningless(source) == [(5, "told"), (3, "found"), (5, "own"), (6, "_said"), (6, "one")]
    assert meaningless("left = 3\n") == [(1, "left")]
    assert meaningless("left, right = 3, 4\n") == []
