"""Verbs print names that others chose through ``say`` or ``printable``."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("host/heli_host/ui/cli", "sim/heli_sim/verbs", "sim/heli_lab/verbs")
SAFE = {"printable"}


def raw_prints(source: str) -> Iterator[int]:
    """Yield the lines that print something else than a constant or what `SAFE` returned."""
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id == "print"
            and not all(map(_is_safe, node.args))
        ):
            yield node.lineno
        # As a callback, it prints whatever it is given.
        if isinstance(node, ast.Call | ast.keyword):
            given = [node.value] if isinstance(node, ast.keyword) else node.args
            if any(isinstance(argument, ast.Name) and argument.id == "print" for argument in given):
                yield node.lineno if isinstance(node, ast.Call) else node.value.lineno


def _is_safe(value: ast.expr) -> bool:
    if isinstance(value, ast.JoinedStr):
        return all(map(_is_safe, value.values))
    if isinstance(value, ast.FormattedValue):
        return _is_safe(value.value)
    if isinstance(value, ast.Call):
        return isinstance(value.func, ast.Name) and value.func.id in SAFE
    return isinstance(value, ast.Constant)


@pytest.mark.parametrize("room", ROOMS)
def test_no_verb_prints_a_name_raw(room: str) -> None:
    files = [file for file in (ROOT / room).rglob("*.py") if file.name != "say.py"]
    assert len(files) > 2
    prints = [f"{file.relative_to(ROOT)}:{line}" for file in files for line in raw_prints(file.read_text())]
    assert not prints, f"print these with heli_host.ui.cli.say: {', '.join(prints)}"


@pytest.mark.parametrize(
    "line",
    [
        "print(path)",
        'print(f"{path}")',
        'print("a", path)',
        'print(f"{printable(cause)} {path}")',
        "listen(print)",
        "listen(answer=print)",
        "listen(partial(print, flush=True))",
        "print(*lines)",
    ],
)
def test_a_raw_print_is_seen(line: str) -> None:
    assert list(raw_prints(line)) == [1]


def test_constants_and_printable_text_are_let_through() -> None:
    for line in ("print()", 'print("a", end="")', 'print(f"b {printable(c)}")', "print(printable(d))"):
        assert not list(raw_prints(line))
