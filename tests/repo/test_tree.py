"""Nothing in the tree depends on the machine that it was written on, and every room says what lives there."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.medium

ROOT = Path(__file__).resolve().parents[2]
# Written so that this file does not hold what it looks for.
MACHINE_PATH = re.compile(
    r"(?<![\w.$}~>])/(?:" + "|".join(("work", "home", "root", "Users", "tmp")) + r")/\w"
)
TEXT_ENDS = {".py", ".md", ".toml", ".cpp", ".hpp", ".h", ".txt", ".sh", ".yml", ".yaml", ".json", ".ini", ""}
LARGEST_KIB = 300


def tracked() -> list[Path]:
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in names.splitlines() if (ROOT / name).is_file()]


def rooms() -> list[Path]:
    """Every folder with sources in it."""
    folders = {path.parent for path in tracked() if path.suffix in (".py", ".cpp", ".hpp", ".toml")}
    return sorted(folders - {ROOT})


def readme_of(room: Path) -> Path:
    """A folder's own README, or the one of the room that it is a corner of."""
    own = room / "README.md"
    return own if own.exists() or room.parent == ROOT else room.parent / "README.md"


def test_no_path_of_a_build_machine() -> None:
    found = []
    for path in tracked():
        if path.suffix not in TEXT_ENDS:
            continue
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
            if MACHINE_PATH.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert not found, "\n".join(found)


def skipped_by_mypy() -> list[str]:
    """Parts of libraries whose types mypy is told not to read."""
    overrides = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"]
    (skipped,) = (one["module"] for one in overrides if one.get("follow_imports") == "skip")
    return [name.removesuffix(".*") for name in skipped]


def imports(source: str, part: str) -> bool:
    """Whether a source imports a part of a library, or something of it."""
    library, _, last = part.rpartition(".")
    ways = [rf"(?:from|import) {re.escape(part)}\b"]
    ways += [rf"from {re.escape(library)} import [^\n]*\b{last}\b"] if library else []
    return part.partition(".")[0] in source and any(re.search(rf"^\s*{way}", source, re.M) for way in ways)


def test_nothing_is_used_whose_types_mypy_does_not_read() -> None:
    sources = {path: path.read_text() for path in tracked() if path.suffix == ".py"}
    for part in skipped_by_mypy():
        found = [path.relative_to(ROOT) for path, text in sources.items() if imports(text, part)]
        assert not found, f"{part}: {found}"


def test_no_large_file() -> None:
    large = [f"{path.relative_to(ROOT)}" for path in tracked() if path.stat().st_size > LARGEST_KIB * 1024]
    assert not large


@pytest.mark.parametrize("room", rooms(), ids=lambda room: str(room.relative_to(ROOT)))
def test_room_says_what_lives_there(room: Path) -> None:
    readme = readme_of(room)
    assert readme.exists(), f"{room.relative_to(ROOT)} has no README.md of about ten lines"
    assert 3 <= len(readme.read_text().splitlines()) <= 60


def test_nothing_is_left_unfinished() -> None:
    marks = re.compile("|".join(("TO" + "DO", "FIX" + "ME", "X" * 3, "Not" + "ImplementedError")))
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in tracked()
        if path.suffix in TEXT_ENDS
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1)
        if marks.search(line)
    ]
    assert not found
