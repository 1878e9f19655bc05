"""A public top-level name means one thing in a package."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    "due_emulator": "sim/due",
    "heli_host": "host",
    "heli_sim": "sim",
    "heli_lab": "sim",
    "heli_benchmark": "sim",
}
INTERFACES = {
    "ENTRY_POINT_GROUP": "each file that looks up plug-ins states its group",
    "SPEC": "each file of effects states what it is",
    "SPECS": "the same, for several effects in a file",
    "main": "each module that can be run with python -m has one",
    "diagnose": "a work of campaigns and the function that it runs have the name of the analysis",
    "identify": "the same",
}
"""Names that every implementation of an interface has, and why."""


def names_of(path: Path) -> Iterator[str]:
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from (target.id for target in targets if isinstance(target, ast.Name))


def ambiguous(folder: Path) -> dict[str, set[str]]:
    """Public names that more than one module defines; modules of verbs are named as their commands."""
    where = defaultdict(set)
    for path in folder.rglob("*.py"):
        if "verbs" not in path.parts:
            for name in names_of(path):
                if not name.startswith("_"):
                    where[name].add(str(path.relative_to(folder)))
    return {name: places for name, places in where.items() if len(places) > 1 and name not in INTERFACES}


@pytest.mark.medium
@pytest.mark.parametrize("package", PACKAGES)
def test_a_public_name_is_defined_in_one_module_of_a_package(package: str) -> None:
    assert ambiguous(ROOT / PACKAGES[package] / package) == {}


def test_the_same_name_in_two_modules_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("class Law: ...\n_LIMIT = 1\n")
    (tmp_path / "b.py").write_text("Law: int = 2\n_LIMIT = 2\n")
    assert ambiguous(tmp_path) == {"Law": {"a.py", "b.py"}}
