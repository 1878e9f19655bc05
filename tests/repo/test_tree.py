"""Nothing in the tree depends on the machine that it was written on; folders and files say what they are."""

from __future__ import annotations

import ast
import re
import subprocess
import tomllib
from pathlib import Path

import heli_host
import pytest

pytestmark = pytest.mark.medium

ROOT = Path(__file__).resolve().parents[2]
# Written so that this file does not hold what it looks for.
MACHINE_PATH = re.compile(
    r"(?<![\w.$}~>])/(?:" + "|".join(("work", "home", "root", "Users", "tmp")) + r")/\w"
)
TEXT_ENDS = {".py", ".md", ".toml", ".cpp", ".hpp", ".h", ".txt", ".sh", ".yml", ".yaml", ".json", ".ini", ""}
LARGEST_KIB = 300
TOP_LEVEL = {
    *("firmware", "host", "sim", "tests", "docs", ".ci", ".devcontainer"),
    *("README.md", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "SECURITY.md"),
    *("Makefile", "CMakeLists.txt", "platformio.ini", "pyproject.toml"),
    *(".clang-format", ".clang-tidy", ".gitignore"),
}


def tracked() -> list[Path]:
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in names.splitlines() if (ROOT / name).is_file()]


def folders() -> list[Path]:
    """Every folder with sources in it, but for those of the documents."""
    directories = {path.parent for path in tracked() if path.suffix in (".py", ".cpp", ".hpp", ".toml")}
    return sorted(folder for folder in directories - {ROOT} if ROOT / "docs" not in (folder, *folder.parents))


def purpose_of(folder: Path) -> str:
    """Purpose of a folder: its README or the docstring of its package; or those of its parent."""
    for place in (folder, folder.parent):
        for name in ("README.md", "__init__.py"):
            text = (place / name).read_text() if (place / name).exists() and place != ROOT else ""
            if name == "README.md" and text:
                return text
            if name == "__init__.py" and text:
                return ast.get_docstring(ast.parse(text)) or ""
    return ""


def test_no_path_of_a_build_machine() -> None:
    places = []
    for path in tracked():
        if path.suffix not in TEXT_ENDS:
            continue
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
            if MACHINE_PATH.search(line):
                places.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert not places, "\n".join(places)


def skipped_by_mypy() -> list[str]:
    """Parts of libraries whose types mypy does not read."""
    overrides = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"]
    (skipped,) = (override["module"] for override in overrides if override.get("follow_imports") == "skip")
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
        users = [path.relative_to(ROOT) for path, text in sources.items() if imports(text, part)]
        assert not users, f"{part}: {users}"


def test_the_top_level_has_no_results_of_a_command() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in tracked()} <= TOP_LEVEL


def test_no_large_file() -> None:
    large = [f"{path.relative_to(ROOT)}" for path in tracked() if path.stat().st_size > LARGEST_KIB * 1024]
    assert not large


@pytest.mark.parametrize("folder", folders(), ids=lambda folder: str(folder.relative_to(ROOT)))
def test_a_folder_says_what_it_is_for(folder: Path) -> None:
    assert 1 <= len(purpose_of(folder).splitlines()) <= 60


def first_words(path: Path) -> str:
    """Description of a source in its first lines."""
    text = path.read_text()
    if path.suffix == ".py":
        return (ast.get_docstring(ast.parse(text)) or "") if text.strip() else "empty"
    return text.partition("\n")[0].removeprefix("//") if text.startswith("//") else ""


@pytest.mark.slow
def test_a_source_file_says_first_what_it_is() -> None:
    sources = [
        path for path in tracked() if path.suffix in (".py", ".hpp", ".js") and "vendor" not in path.parts
    ]
    silent = [str(path.relative_to(ROOT)) for path in sources if len(first_words(path).strip()) < 5]
    # A test states its claim in its name, and a notebook its subject in its cells.
    allowed = ("tests/", "docs/course/", "docs/laws/")
    assert not [path for path in silent if not path.startswith(allowed)]


def test_the_version_is_the_same_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert heli_host.__version__ == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"({version})" in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.parametrize(
    "name", ["CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "SECURITY.md"]
)
def test_the_readme_leads_to_what_a_community_expects(name: str) -> None:
    assert (ROOT / name).is_file()
    assert f"]({name})" in (ROOT / "README.md").read_text()


def test_nothing_is_left_unfinished() -> None:
    marks = re.compile("|".join(("TO" + "DO", "FIX" + "ME", "X" * 3, "Not" + "ImplementedError")))
    unfinished = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in tracked()
        if path.suffix in TEXT_ENDS
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1)
        if marks.search(line)
    ]
    assert not unfinished
