"""Measurements import no test: tests may import measurements, and packages import neither."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("host", "sim", "firmware", "docs")
NAMES_ITS_TESTS = {"tests/firmware/mutations.py", "tests/firmware/subtle_mutations.py"}
"""A mutation states which test has to fail for it."""


def imported(path: Path) -> Iterator[str]:
    """Modules and names that a file imports, in full."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def wrong_imports(root: Path) -> list[str]:
    """Imports of tests by measurements and helpers, and of anything in ``tests`` by packages."""
    mistakes = []
    for path in sorted((root / "tests").rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if not path.name.startswith(("test_", "conftest")) and name not in NAMES_ITS_TESTS:
            mistakes += [
                f"{name} imports {full}"
                for full in imported(path)
                if full.startswith("tests.") and any(part.startswith("test_") for part in full.split("."))
            ]
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            mistakes += [
                f"{path.relative_to(root).as_posix()} imports {full}"
                for full in imported(path)
                if full.split(".")[0] == "tests"
            ]
    return mistakes


@pytest.mark.medium
def test_no_measurement_imports_a_test_and_no_package_imports_from_tests() -> None:
    assert wrong_imports(ROOT) == []


def test_a_wrong_import_is_noticed(tmp_path: Path) -> None:
    for name, line in {
        "tests/bench/board.py": "from tests.link.test_core import frames",
        "tests/bench/test_parts.py": "from tests.link.test_core import frames",
        "tests/bench/page.py": "from tests.page.page_server import Served",
        "sim/heli_lab/link.py": "from tests import link",
        "sim/heli_lab/page.py": "import tests.page",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"{line}\n")
    assert wrong_imports(tmp_path) == [
        "tests/bench/board.py imports tests.link.test_core.frames",
        "sim/heli_lab/link.py imports tests.link",
        "sim/heli_lab/page.py imports tests.page",
    ]
