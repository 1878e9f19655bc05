"""Who installs the project gets what flies, and nothing that only its tests use."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Literal

import pytest

pytest.importorskip("scikit_build_core", reason="the build backend is not installed: make setup")

from scikit_build_core.settings.skbuild_model import ScikitBuildSettings
from scikit_build_core.settings.skbuild_read_settings import SettingsReader

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
SETUP = ROOT / ".ci" / "setup"
WITHOUT_TESTS = "HELI_WITHOUT_TESTS"
TARGETS = ["_native", "_due", "_due_board", "_kalman", "_expression_vm"]


def settings(state: Literal["wheel", "editable"]) -> ScikitBuildSettings:
    return SettingsReader.from_file(ROOT / "pyproject.toml", state=state).settings


@pytest.fixture(autouse=True)
def _nothing_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(WITHOUT_TESTS, raising=False)


def test_a_wheel_has_nothing_for_tests() -> None:
    wheel = settings("wheel")
    assert wheel.build.targets == TARGETS
    assert wheel.install.components == ["python"]
    assert wheel.wheel.packages is not None
    assert not [package for package in wheel.wheel.packages if "test" in package]


def test_who_edits_the_sources_has_the_tests_extension_too() -> None:
    editable = settings("editable")
    assert editable.build.targets == [*TARGETS, "heli_test_native"]
    assert editable.install.components == ["python", "tests"]


def test_to_fly_needs_no_compiling_for_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WITHOUT_TESTS, "1")
    editable = settings("editable")
    assert editable.build.targets == TARGETS
    assert editable.install.components == ["python"]
    assert f"export {WITHOUT_TESTS}=1" in SETUP.read_text()


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


def test_the_simulation_carries_no_bindings_for_tests() -> None:
    native = pytest.importorskip("heli_sim._native", reason="the simulation is not built: make setup")
    public = {name for name in vars(native) if not name.startswith("_")}
    assert public == {
        "PlantStep", "CompiledStep", "CallbackStep", "World", "SimBoard", "NativeBoard", "greet", "identity"
    }  # fmt: skip


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
        "heli_lab/report/identification/report.html",
    ):
        assert file in files
    assert not [file for file in files if Path(file).name.startswith(("test_", "conftest", "heli_test_"))]


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


def test_the_build_of_a_container_gets_every_source_of_the_wheel() -> None:
    lines = (ROOT / ".devcontainer/Containerfile.dockerignore").read_text().split()
    assert lines[0] == "*"
    sent = {line.removeprefix("!") for line in lines[1:]}
    assert all((ROOT / name).exists() for name in sent)
    wheel = settings("wheel")
    assert wheel.wheel.packages is not None
    needed = {package.partition("/")[0] for package in wheel.wheel.packages}
    assert needed | {"pyproject.toml", "CMakeLists.txt", "README.md", "LICENSE", "firmware"} <= sent
