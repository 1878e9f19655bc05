"""Classes and chains of imports stay short, and the laboratory sets few constants by judgement."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.medium

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 300
"""Lines of a class without docstrings, comments and blank lines."""
LONGEST_FILE = 500
"""Lines of a file, with docstrings and comments."""
MAX_LEVELS = 6
"""Files in the longest chain of imports in a package."""
MAX_JUDGEMENTS = 80
"""Constants that no record of a measurement and no theory supports."""


def trees(folder: Path) -> Iterator[tuple[Path, str, ast.Module]]:
    for path in sorted(folder.rglob("*.py")):
        source = path.read_text()
        yield path.relative_to(ROOT), source, ast.parse(source)


def code_lines(source: str, node: ast.ClassDef) -> int:
    """Count the lines of a class without docstrings, comments and blank lines."""
    texts = {
        line
        for inner in ast.walk(node)
        if isinstance(inner, ast.Expr) and isinstance(inner.value, ast.Constant)
        for line in range(inner.lineno, (inner.end_lineno or inner.lineno) + 1)
    }
    lines = source.splitlines()[node.lineno - 1 : node.end_lineno]
    return sum(
        bool(line.strip()) and not line.strip().startswith("#") and number not in texts
        for number, line in enumerate(lines, node.lineno)
    )


def judgements(source: str, tree: ast.Module) -> list[str]:
    """Return the constants of a module that are set by judgement, as their types or texts state; a text
    belongs to all constants in the lines just above it.
    """
    matches: set[str] = set()
    above: list[ast.AnnAssign] = []
    for node in tree.body:
        above = above if above and node.lineno == (above[-1].end_lineno or 0) + 1 else []
        if isinstance(node, ast.AnnAssign):
            above.append(node)
            named, text = [node], ast.unparse(node.annotation)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            named, text = above, str(node.value.value)
        else:
            continue
        if "judgement" in text.lower():
            matches |= {ast.unparse(constant.target) for constant in named}
    return sorted(matches)


def test_no_class_is_longer_than_three_hundred_lines_of_code() -> None:
    long = []
    for folder in ("host/heli_host", "sim/heli_sim", "sim/heli_lab"):
        for path, source, tree in trees(ROOT / folder):
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef):
                    lines = code_lines(source, node)
                    if lines > LONGEST:
                        long.append(f"{path}: {node.name} has {lines} lines; split it by subject")
    assert not long, "\n".join(long)


def test_no_file_of_the_laboratory_is_longer_than_five_hundred_lines() -> None:
    files = (ROOT / "sim" / "heli_lab").rglob("*.py")
    assert not [path.name for path in files if len(path.read_text().splitlines()) > LONGEST_FILE]


def test_few_constants_of_the_laboratory_are_set_by_judgement() -> None:
    listed = [
        f"{path}: {name}"
        for path, source, tree in trees(ROOT / "sim" / "heli_lab")
        for name in judgements(source, tree)
    ]
    assert len(listed) <= MAX_JUDGEMENTS, "\n".join(
        [f"{len(listed)}; measure, merge or remove some:", *listed]
    )


def test_text_is_not_counted_as_code() -> None:
    source = 'class A:\n    """Text\n\n    more."""\n\n    # why\n    x = 1\n    """Text."""\n    y = 2\n'
    (node,) = ast.parse(source).body
    assert isinstance(node, ast.ClassDef)
    assert code_lines(source, node) == 3


def test_judgement_is_read_from_type_and_text() -> None:
    constants = [
        'A: J[JUDGEMENT] = 1\n"""Text."""',
        'X: Final = 0\n\nB: Final = 2\n"""Set by judgement."""',
        'C: Final = 3\n"""Text."""',
    ]
    source = "\n".join(constants)
    assert judgements(source, ast.parse(source)) == ["A", "B"]


def import_levels(package: str) -> int:
    """Count the files of the longest chain of imports in a package; a folder in it counts as one."""
    folder = ROOT / "sim" / Path(*package.split("."))
    imports: dict[str, set[str]] = {}
    for path, _, tree in trees(folder):
        parts = path.relative_to(folder.relative_to(ROOT)).with_suffix("").parts
        if parts[0] != "__init__":
            imports.setdefault(parts[0], set()).update(_imports_within(package, tree) - {parts[0]})

    def levels(name: str) -> int:
        return 1 + max((levels(lower) for lower in imports[name] & imports.keys()), default=0)

    return max(map(levels, imports))


def _imports_within(package: str, tree: ast.Module) -> set[str]:
    """Files and folders directly in a package that a module imports."""
    names = {
        f"{node.module}.{alias.name}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
    return {
        name.removeprefix(f"{package}.").split(".")[0] for name in names if name.startswith(f"{package}.")
    }


@pytest.mark.parametrize(
    "package",
    [
        ".".join(path.parent.relative_to(ROOT / "sim").parts)
        for path in sorted((ROOT / "sim" / "heli_lab").glob("*/**/__init__.py"))
    ],
)
def test_a_package_of_the_laboratory_has_at_most_six_levels_of_imports(package: str) -> None:
    assert import_levels(package) <= MAX_LEVELS
