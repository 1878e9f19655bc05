"""The generated tables and pages are what firmware/link.toml says."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.medium

ROOT = Path(__file__).resolve().parents[2]
SOURCE = "firmware/link.toml"
GENERATED = (
    "firmware/core/link/declaration.hpp",
    "host/heli_host/declaration.py",
    "docs/reference/link.md",
    "docs/reference/faults.md",
    "docs/reference/parameters.md",
    "docs/matlab/heli_declaration.m",
)


def check(root: Path) -> int:
    command = [sys.executable, str(ROOT / "firmware/generate.py"), "--check", "--root", str(root)]
    return subprocess.run(command, capture_output=True, check=False).returncode


@pytest.fixture
def copy_of_tree(tmp_path: Path) -> Path:
    for name in (*GENERATED, SOURCE):
        target = tmp_path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, target)
    return tmp_path


def test_generated_files_are_fresh() -> None:
    assert check(ROOT) == 0, "run: python firmware/generate.py"


@pytest.mark.parametrize("name", GENERATED)
def test_an_edited_generated_file_is_noticed(copy_of_tree: Path, name: str) -> None:
    path = copy_of_tree / name
    path.write_text(path.read_text().replace("elevation", "altitude", 1))
    assert check(copy_of_tree) == 1


def test_a_changed_declaration_is_noticed(copy_of_tree: Path) -> None:
    path = copy_of_tree / SOURCE
    path.write_text(path.read_text().replace("default = 1.4", "default = 1.5", 1))
    assert check(copy_of_tree) == 1


def test_a_copy_is_as_fresh_as_the_tree(copy_of_tree: Path) -> None:
    assert check(copy_of_tree) == 0


@pytest.mark.parametrize("name", GENERATED)
def test_a_missing_generated_file_is_written_again(copy_of_tree: Path, name: str) -> None:
    (copy_of_tree / name).unlink()
    assert check(copy_of_tree) == 1
    command = [sys.executable, str(ROOT / "firmware/generate.py"), "--root", str(copy_of_tree)]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert output == f"{name}: written\n"
    assert (copy_of_tree / name).read_text() == (ROOT / name).read_text()
