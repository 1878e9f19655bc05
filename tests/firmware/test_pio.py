"""The PlatformIO build needs no network and makes the same program as the Makefile."""

from __future__ import annotations

import configparser
import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

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


def test_platformio_builds_the_same_program_as_the_makefile_wherever_the_project_lies(
    elf: Path, tmp_path: Path
) -> None:
    if find_spec("platformio") is None or find_spec("SCons") is None:
        pytest.skip("PlatformIO is not installed: pip install platformio scons")
    project = tmp_path / "a rig of mine"
    shutil.copytree(ROOT / "firmware", project / "firmware", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "platformio.ini", project)
    # A proxy that does not exist stands for the network that is missing.
    done = subprocess.run(
        [sys.executable, project / "firmware" / "pio" / "build.py", "run", "-e", "due"],
        env={**os.environ, "http_proxy": "http://127.0.0.1:9", "https_proxy": "http://127.0.0.1:9"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "flash" in done.stdout
    flashed = tmp_path / "heli.bin"
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", elf, flashed], check=True)
    built = project / "build" / "pio" / "due"
    assert (built / "firmware.bin").read_bytes() == flashed.read_bytes()
    assert (built / "firmware.map").exists()
