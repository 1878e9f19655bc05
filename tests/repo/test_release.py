"""`make release` finds what a release lacks, and the wheel of this tree flies where no compiler is."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = ("pyproject.toml", "CHANGELOG.md", "CITATION.cff")
DATED = "## Unreleased\n\n## 0.1.0 - 2026-12-01\n\n- Firmware.\n"


def load() -> ModuleType:
    specification = importlib.util.spec_from_file_location("release", ROOT / ".ci" / "release.py")
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules["release"] = module
    specification.loader.exec_module(module)
    return module


release = load()


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree that has what a release of 0.1.0 states."""
    for name in FILES:
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "CHANGELOG.md").write_text(DATED)
    return tmp_path


def problems(findings: Iterator[object]) -> str:
    return "; ".join(str(finding) for finding in findings if getattr(finding, "problem"))  # noqa: B009


def test_a_dated_changelog_of_this_version_is_good(tree: Path) -> None:
    assert not problems(release.check_changelog(tree))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (DATED.replace("0.1.0", "0.0.9"), "0.0.9 - 2026-12-01, not 0.1.0"),
        (DATED.replace(" - 2026-12-01", ""), "not 0.1.0 with a date"),
        (DATED.replace("Unreleased\n", "Unreleased\n\n- A verb.\n"), "entries under 'Unreleased': 1"),
        ("# Changelog\n", "newest release is none"),
    ],
)
def test_a_changelog_without_this_release_is_found(tree: Path, text: str, message: str) -> None:
    (tree / "CHANGELOG.md").write_text(text)
    assert message in problems(release.check_changelog(tree))


def test_a_citation_of_another_version_is_found(tree: Path) -> None:
    citation = tree / "CITATION.cff"
    citation.write_text(citation.read_text().replace("version: 0.1.0", "version: 0.2.0"))
    assert "it has 0.2.0; write 'version: 0.1.0'" in problems(release.check_citation(tree))


@pytest.mark.medium
def test_an_invalid_citation_is_found(tree: Path) -> None:
    pytest.importorskip("cffconvert", reason="cffconvert is not installed: make setup")
    assert not problems(release.check_citation(tree))
    citation = tree / "CITATION.cff"
    citation.write_text(citation.read_text().replace("cff-version: 1.2.0", "cff-version: 9"))
    assert "CITATION.cff is valid" in problems(release.check_citation(tree))


def test_changes_without_a_commit_are_found(tree: Path) -> None:
    assert "no Git checkout" in problems(release.check_clean(tree))
    subprocess.run(["git", "init", "--quiet"], cwd=tree, check=True)
    assert "3 files differ" in problems(release.check_clean(tree))


def test_a_wheel_without_the_board_or_with_tests_is_found(tmp_path: Path) -> None:
    wheel = tmp_path / "heli_host-0.1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as file:
        file.writestr("heli_sim/_native.so", "")
    assert "heli_sim/due/_due_board" in release.check_wheel(wheel).problem
    with zipfile.ZipFile(wheel, "w") as file:
        for name in (*(f"{name}.so" for name in release.EXTENSIONS), "heli.elf", "tests/test_plan.py"):
            file.writestr(name, "")
    assert release.check_wheel(wheel).problem == "it contains tests/test_plan.py"


def test_a_source_archive_with_a_flight_is_found(tmp_path: Path) -> None:
    archive = tmp_path / "heli_host-0.1.0.tar.gz"
    with tarfile.open(archive, "w:gz") as file:
        for name in (*release.SOURCES, "flights/hover.mcap"):
            file.addfile(tarfile.TarInfo(f"heli_host-0.1.0/{name}"))
    assert release.check_source_archive(archive).problem == "it contains flights/hover.mcap"


def test_archives_of_another_version_are_found(tmp_path: Path) -> None:
    assert "has nothing" in problems(release.check_archives(tmp_path, "0.1.0"))
    (tmp_path / "heli_host-0.0.9.tar.gz").write_bytes(b"")
    finding = next(iter(release.check_archives(tmp_path, "0.1.0")))
    assert "heli_host-0.0.9.tar.gz" in finding.problem


def test_a_program_that_does_not_fly_is_found(tmp_path: Path) -> None:
    finding = release.fly_from([sys.executable, "-c", "raise SystemExit('error: no board')"], tmp_path, {})
    assert finding.problem == "error: no board"


@pytest.mark.slow
def test_the_wheel_of_this_tree_flies_without_a_compiler(tmp_path: Path) -> None:
    pytest.importorskip("scikit_build_core", reason="the build backend is not installed: make setup")
    if shutil.which("arm-none-eabi-g++") is None:
        pytest.skip("skipped: no cross-compiler, so the wheel lacks the Due's firmware")
    words = ["wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(tmp_path), str(ROOT)]
    subprocess.run([sys.executable, "-m", "pip", *words], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert release.check_wheel(wheel).problem == ""
    installed = tmp_path / "installed"
    with zipfile.ZipFile(wheel) as file:
        file.extractall(installed)
    # Without `site`, the editable installation of this tree is not found; the packages it needs are.
    start = (
        "import sys; from importlib.util import find_spec; from heli_host.ui.cli import main; "
        f"assert find_spec('heli_sim').origin.startswith({str(installed)!r}); main()"
    )
    paths = f"{installed}:{sysconfig.get_path('purelib')}:{sysconfig.get_path('platlib')}"
    finding = release.fly_from([sys.executable, "-S", "-c", start], tmp_path, {"PYTHONPATH": paths})
    assert finding.problem == ""
    assert (tmp_path / "hover.mcap").stat().st_size > 100_000
