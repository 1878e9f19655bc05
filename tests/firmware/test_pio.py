"""The PlatformIO build needs no network, makes the same program as the Makefile, and uploads it."""

from __future__ import annotations

import configparser
import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
from heli_sim.sil.process import SilProcess

from tests.cli.uploader import Uploader
from tests.firmware.built import ROOT

pytestmark = pytest.mark.emulated

PIO = ROOT / "firmware" / "pio"


def test_the_stand_in_answers_to_the_platform_that_is_pinned() -> None:
    project = configparser.ConfigParser()
    project.read(ROOT / "platformio.ini")
    platform = json.loads((PIO / "platform.json").read_text())
    assert project["env:due"]["platform"] == f"platformio/{platform['name']}@{platform['version']}"
    packages = [f"platformio/{name}@{package['version']}" for name, package in platform["packages"].items()]
    assert project["env:due"]["platform_packages"].split() == packages


def test_flags_are_in_one_place() -> None:
    for path in (ROOT / "platformio.ini", PIO / "flags.py", PIO / "builder.py"):
        assert "-mcpu" not in path.read_text(), path.name


@dataclass(frozen=True)
class Uploaded:
    """A copy of the project in a folder with spaces in its name, built and uploaded in one go."""

    project: Path  # The copy
    printed: str  # By PlatformIO
    calls: list[list[str]]  # Words that the uploader, which is a stand-in, was called with


@pytest.fixture(scope="module")
def uploaded(tmp_path_factory: pytest.TempPathFactory) -> Uploaded:
    """Built once, which takes longer than all claims about it."""
    if find_spec("platformio") is None or find_spec("SCons") is None:
        pytest.skip("PlatformIO is not installed: pip install platformio scons")
    folder = tmp_path_factory.mktemp("pio")
    project = folder / "a rig of mine"
    shutil.copytree(ROOT / "firmware", project / "firmware", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "platformio.ini", project)
    uploader = Uploader(folder / "bin")
    with SilProcess(speed=None) as board:
        process = subprocess.run(
            [
                *(sys.executable, project / "firmware" / "pio" / "build.py", "run", "-e", "due"),
                *("-t", "upload", "--upload-port", board.url),
            ],
            env={
                **os.environ,
                "PATH": f"{uploader.folder}{os.pathsep}{os.environ['PATH']}",
                # A proxy that does not exist stands for the network that is missing.
                "http_proxy": "http://127.0.0.1:9",
                "https_proxy": "http://127.0.0.1:9",
            },
            capture_output=True,
            text=True,
            check=False,
        )
    assert process.returncode == 0, process.stdout[-2000:] + process.stderr[-2000:]
    return Uploaded(project, process.stdout, uploader.calls)


def test_platformio_builds_the_same_program_as_the_makefile_wherever_the_project_lies(
    uploaded: Uploaded, elf: Path, tmp_path: Path
) -> None:
    assert "flash" in uploaded.printed
    flashed = tmp_path / "heli.bin"
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", elf, flashed], check=True)
    built = uploaded.project / "build" / "pio" / "due"
    assert (built / "firmware.bin").read_bytes() == flashed.read_bytes()
    assert (built / "firmware.map").exists()


def test_platformio_builds_for_another_wiring_apart(uploaded: Uploaded, tmp_path: Path) -> None:
    project, pins = uploaded.project, tmp_path / "my.toml"
    pins.write_text((project / "firmware" / "pins.toml").read_text().replace('"D22"', '"D34"'))
    program = project / "firmware" / "pio" / "build.py"
    process = subprocess.run(
        [sys.executable, program, "--pins", pins], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stdout[-2000:] + process.stderr[-2000:]
    assert "| `FrontForwardEnable` | D34 | PC2 |" in (project / "build/pio-wiring/wiring.md").read_text()
    with_other_pins, with_default_pins = (
        project / "build" / name / "due" / "firmware.bin" for name in ("pio-pins", "pio")
    )
    assert with_other_pins.read_bytes() != with_default_pins.read_bytes()


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals on this system")
def test_upload_writes_the_image_that_was_built_over_heli_host_flash(uploaded: Uploaded) -> None:
    [call] = uploaded.calls
    image = uploaded.project / "build" / "pio" / "due" / "firmware.bin"
    assert (uploaded.project / call[-1]).resolve() == image.resolve()
    assert "flashed: simulated board" in uploaded.printed
