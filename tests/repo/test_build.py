"""Installation, targets of the Makefile, a release, and the run of all tests next to the checks."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Final, Literal

import pytest
from heli_web.compiler import built_board
from scikit_build_core.settings.skbuild_model import ScikitBuildSettings
from scikit_build_core.settings.skbuild_read_settings import SettingsReader

from tests.page.page_server import SHORT_PLAN

pytest.importorskip("scikit_build_core", reason="the build backend is not installed: make setup")


ROOT = Path(__file__).resolve().parents[2]
SETUP = ROOT / ".ci" / "setup"
WITHOUT_TESTS = "HELI_WITHOUT_TESTS"
EXTENSIONS = ["_native", "_due", "_due_board", "_kalman", "_expression_vm"]


def settings(state: Literal["wheel", "editable"]) -> ScikitBuildSettings:
    return SettingsReader.from_file(ROOT / "pyproject.toml", state=state).settings


@pytest.fixture(autouse=True)
def _nothing_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(WITHOUT_TESTS, raising=False)


@pytest.mark.slow
def test_a_wheel_has_nothing_for_tests() -> None:
    wheel = settings("wheel")
    assert wheel.build.targets == EXTENSIONS
    assert wheel.install.components == ["python"]
    assert wheel.wheel.packages is not None
    assert not [package for package in wheel.wheel.packages if "test" in package]


@pytest.mark.slow
def test_who_edits_the_sources_has_the_tests_extension_too() -> None:
    editable = settings("editable")
    assert editable.build.targets == [*EXTENSIONS, "heli_test_native"]
    assert editable.install.components == ["python", "tests"]


@pytest.mark.slow
def test_to_fly_needs_no_compiling_for_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WITHOUT_TESTS, "1")
    editable = settings("editable")
    assert editable.build.targets == EXTENSIONS
    assert editable.install.components == ["python"]
    assert f"export {WITHOUT_TESTS}=1" in SETUP.read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("purpose", "tools", "wanted"),
    [("fly", False, False), ("fly", True, True), ("docs", True, True), ("quick", False, True)],
)
def test_flying_leaves_tests_able_to_run(purpose: str, tools: bool, wanted: bool, tmp_path: Path) -> None:
    function = re.search(r"^tests_wanted\(\) \{.*?^\}$", SETUP.read_text(), re.MULTILINE | re.DOTALL)
    assert function is not None
    if tools:
        (tmp_path / "stamp-test").touch()
    script = f"purpose={purpose} venv={tmp_path}\n{function[0]}\ntests_wanted"
    assert (subprocess.run(["bash", "-c", script], check=False).returncode == 0) is wanted


@pytest.mark.slow
def test_only_the_tests_component_installs_the_tests_extension() -> None:
    rules = [
        line
        for path in (
            ROOT / "CMakeLists.txt",
            *ROOT.glob("sim/*/CMakeLists.txt"),
            *ROOT.glob("tests/*/CMakeLists.txt"),
        )
        for line in path.read_text().splitlines()
        if "install(" in line and "heli_test_native" in line
    ]
    assert len(rules) == 1
    assert rules[0].endswith("COMPONENT tests)")


@pytest.mark.slow
def test_the_simulation_carries_no_bindings_for_tests() -> None:
    native = pytest.importorskip("heli_sim._native", reason="the simulation is not built: make setup")
    public = {name for name in vars(native) if not name.startswith("_")}
    assert public == {
        "PlantStep", "CompiledStep", "CallbackStep", "World", "SimBoard", "NativeBoard", "greet", "identity"
    }  # fmt: skip


@pytest.mark.slow
def test_a_wheel_has_pages_rigs_and_plans_and_no_tests(tmp_path: Path) -> None:
    from scikit_build_core.build._pathutil import packages_to_file_mapping

    wheel = settings("wheel").wheel
    assert isinstance(wheel.packages, list)
    mapping = packages_to_file_mapping(
        packages={Path(package).name: str(ROOT / package) for package in wheel.packages},
        platlib_dir=tmp_path,
        include=[],
        src_exclude=[],
        target_exclude=wheel.exclude,
        build_dir="build",
        mode="default",
    )
    files = {str(Path(target).relative_to(tmp_path)) for target in mapping.values()}
    for file in (
        "due_emulator/py.typed",
        "heli_host/ui/page/static/index.html",
        "heli_host/ui/page/static/vendor/three.js.gz",
        "heli_host/fly/plans/hover.toml",
        "heli_host/py.typed",
        "heli_sim/rig/quanser-course.toml",
        "heli_sim/fmu/sources/rig.c",
        "heli_lab/report/diagnosis/report.html",
        "heli_lab/report/identification.html",
    ):
        assert file in files
    assert not [file for file in files if Path(file).name.startswith(("test_", "conftest", "heli_test_"))]


@pytest.mark.slow
def test_the_container_file_has_the_image_that_editors_build_and_the_packages_of_the_readme() -> None:
    folder = ROOT / ".devcontainer"
    container = (folder / "Containerfile").read_text()
    build = json.loads((folder / "devcontainer.json").read_text())["build"]
    assert build["dockerfile"] == "Containerfile" and f"AS {build['target']}\n" in container
    (listed,) = re.findall(r"`sudo apt-get install ([^`]+)`", (ROOT / "README.md").read_text())
    develop = container.partition("\nFROM develop")[0].split()
    assert set(listed.split()) <= set(develop)
    # The image to fly has no compiler, and copies only from the image that compiles.
    fly = container.rpartition("\nFROM ")[2]
    assert fly.startswith("debian:") and "g++" not in fly and "COPY --from=build" in fly


@pytest.mark.slow
def test_the_build_of_a_container_gets_every_source_of_the_wheel() -> None:
    lines = (ROOT / ".devcontainer/Containerfile.dockerignore").read_text().split()
    assert lines[0] == "*"
    sent = {line.removeprefix("!") for line in lines[1:]}
    assert all((ROOT / name).exists() for name in sent)
    wheel = settings("wheel")
    assert wheel.wheel.packages is not None
    needed = {package.partition("/")[0] for package in wheel.wheel.packages}
    assert needed | {"pyproject.toml", "CMakeLists.txt", "README.md", "LICENSE", "firmware"} <= sent


MAKEFILE: Final = ROOT / "Makefile"
TARGETS: Final = re.findall(r"^([a-z]+):(?!=)", MAKEFILE.read_text(), re.MULTILINE)
FEW_TESTS: Final = "tests/running/test_order.py"


@dataclass(frozen=True)
class Small:
    """A small run of a target."""

    variables: tuple[str, ...]  # Variables of the Makefile that make it small
    says: str  # Pattern of what it prints
    statuses: tuple[int, ...] = (0,)  # Exit statuses of make that are good


SMALL: Final = {
    "help": Small((), r"make mutants +list small changes"),
    "fly": Small(("PLANS=short.toml", "SPEED=max", "BOARD=native"), r"completed"),
    "quick": Small((f"TESTS={FEW_TESTS}",), r"\d+ passed"),
    "long": Small((f"TESTS={FEW_TESTS}",), r"\d+ passed"),
    "bench": Small(("PARTS=line",), r"bytes"),
    "mutants": Small(("FILES=link/parser.cpp", "TESTS=tests/link/test_core_link", "COUNT=1"), r"1/1 "),
    # Its status also judges the machine: one that is busy loses samples.
    "soak": Small(("MINUTES=0.03",), r"^\| statuses \| [1-9]", statuses=(0, 2)),
    "attack": Small(("KINDS=logs", "COUNT=1"), r"damaged logs \| 20 \| 0 "),
    "prove": Small(
        ("CLAIMS=parser:step_cobs",), r"parser:step_cobs: proved, \d+ properties, 1 mutants refuted"
    ),
    "release": Small(("CHECKS=citation",), r"ok +CITATION.cff is valid"),
    "clean": Small((), r"rm -rf \.venv"),
}

ELSEWHERE: Final = {
    "setup": (".ci/test", ".ci/setup test"),
    "test": (".ci/run", "make --no-print-directory test"),
    "check": (".ci/test", ".ci/check"),
    "fuzz": (".ci/test", ".ci/fuzz"),
    "blind": ("sim/heli_benchmark/tests/test_blind.py", "As `make blind` does"),
    "docs": ("tests/repo/test_site.py", "def test_the_site_builds_without_a_warning"),
    "web": ("tests/web/pages.py", "write_page(output, "),
    "firmware": ("tests/firmware/test_tools.py", "def test_platformio_builds_the_same_program"),
}
"""Targets that a step of `make test` or another test runs, because they take a minute: file and words."""


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with links to what a clone has, and to .venv: what a target makes is made here."""
    folder = tmp_path_factory.mktemp("clone")
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in {line.partition("/")[0] for line in tracked.splitlines()} | {".venv"}:
        (folder / name).symlink_to(ROOT / name)
    (folder / "short.toml").write_text(SHORT_PLAN)
    return folder


def made(target: str, folder: Path, *variables: str) -> subprocess.CompletedProcess[str]:
    """Run a target; its step that sets up does nothing, because `make test` has done it."""
    outer = ("PYTEST_", "MAKE", "MFLAGS", "HELI_LONG")
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(outer)}
    return subprocess.run(
        ["make", "--no-print-directory", target, *variables],
        cwd=folder,
        # The results of these few tests are not those of the next run's order.
        env={**inherited, "HELI_IS_SET_UP": "1", "PYTEST_ADDOPTS": "-p no:cacheprovider"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )


def test_each_target_runs_here_or_is_run_elsewhere() -> None:
    assert sorted((*SMALL, *ELSEWHERE)) == sorted(TARGETS)
    for target, (file, words) in ELSEWHERE.items():
        assert words in (ROOT / file).read_text(), target


@pytest.mark.slow
@pytest.mark.parametrize("target", SMALL)
def test_a_small_run_of_a_target_ends_well(target: str, clone: Path) -> None:
    small = SMALL[target]
    ended = made(target, clone, *small.variables)
    assert ended.returncode in small.statuses, ended.stdout[-3000:]
    assert re.search(small.says, ended.stdout, re.MULTILINE), ended.stdout[-3000:]
    assert "Traceback" not in ended.stdout, ended.stdout[-3000:]


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
        for name in (
            *(f"{name}.so" for name in release.EXTENSIONS),
            "heli.elf",
            "board.wasm",
            "tests/test_plan.py",
        ):
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
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("skipped: no compiler for WebAssembly: make setup")
    built_board(print)
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


PARTS = {"tests": ".venv/bin/python", "checks": ".ci/check", "fuzzer": ".ci/fuzz"}
SUMMARY = "3 passed in 1.00s"


def run_with(failing: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run `.ci/test` in a folder whose tests, checks and fuzzer are one line each."""
    for name in (".ci/setup", *PARTS.values()):
        script = folder / name
        script.parent.mkdir(parents=True, exist_ok=True)
        says = f"echo progress; echo '{SUMMARY}'" if name == PARTS["tests"] else f"echo ran {name}"
        script.write_text(f"#!/bin/sh\n{says}\nexit {int(name == PARTS.get(failing))}\n")
        script.chmod(0o755)
    shutil.copy(ROOT / ".ci" / "test", folder / ".ci" / "test")
    return subprocess.run([".ci/test"], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("failing", ["nothing", *PARTS])
def test_the_run_fails_if_a_part_fails(failing: str, tmp_path: Path) -> None:
    done = run_with(failing, tmp_path)
    assert bool(done.returncode) == (failing != "nothing")


@pytest.mark.parametrize("failing", ["nothing", "checks"])
def test_the_last_line_is_the_summary_of_pytest(failing: str, tmp_path: Path) -> None:
    lines = run_with(failing, tmp_path).stdout.splitlines()
    assert "progress" in lines
    assert lines[-1] == SUMMARY
    assert {"ran .ci/check", "ran .ci/fuzz"} <= set(lines)
