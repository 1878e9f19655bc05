"""Tools around the firmware: the PlatformIO build, the uploader on an emulated chip, the debugger."""

from __future__ import annotations

import configparser
import json
import os
import re
import shutil
import socket
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
from due_emulator import new_due
from heli_host.board.flashing import find_bossac, read_image, write_image
from heli_host.declaration import FIRMWARE_VERSION
from heli_host.errors import ImageError
from heli_host.link.session import Session
from heli_sim.sil.transport import SilProcess

from firmware.due.report import Image
from tests.cli.uploader import Uploader
from tests.firmware.built import ROOT
from tests.firmware.desk import Board
from tests.firmware.loader import RomLoader
from tests.running.long import LONG

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


@pytest.mark.skipif(not LONG, reason="compiles all sources again: make long")
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


def flat_binary(elf: Path, folder: Path) -> Path:
    path = folder / "firmware.bin"
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", elf, path], check=True)
    return path


def test_the_firmware_that_is_built_passes_the_check_before_flashing(elf: Path, tmp_path: Path) -> None:
    binary = flat_binary(elf, tmp_path)
    assert read_image(binary).content == binary.read_bytes()
    with pytest.raises(ImageError, match="ELF"):
        read_image(elf)


def test_the_real_uploader_writes_an_emulated_chip_that_then_runs_and_answers(
    elf: Path, image: Image, tmp_path: Path
) -> None:
    path = shutil.which("bossac")
    if path is None:
        pytest.skip("bossac is not installed; on Debian: apt-get install bossa-cli")
    binary = flat_binary(elf, tmp_path)
    due = new_due()
    due.power_on()
    due.run_us(1000.0)
    assert due.in_rom
    with RomLoader(due) as loader:
        write_image(find_bossac(Path(path)), loader.port, binary)
    assert due.flash().startswith(binary.read_bytes())
    # The reset that the USB bridge makes of the opened port, and the loader is left.
    due.usb_line_coding(250000)
    due.usb_control_lines(True)
    due.run_us(400_000.0)
    assert not due.in_rom
    board = Board(elf, image)
    board.due = due
    with Session(board) as session:
        welcome = session.connect()
    version = f"{welcome.firmware_major}.{welcome.firmware_minor}.{welcome.firmware_patch}"
    assert version == FIRMWARE_VERSION


GDB = shutil.which("gdb-multiarch") or shutil.which("arm-none-eabi-gdb")


def test_a_breakpoint_in_the_tick_is_reached_and_stepped_on_from(elf: Path) -> None:
    from due_emulator import new_due, read_image
    from due_emulator.gdb import GdbServer

    image = read_image(elf)
    board = new_due(image)
    board.power_on()
    ask = GdbServer(board, image).answer
    address = image.address("tick_interrupt") & ~1
    assert ask(f"Z0,{address:x},2") == "OK"
    for _ in range(3):
        assert ask("c") == "S05"
        assert board.reg(15) == address
        before = board.instructions
        for _ in range(20):
            assert ask("s") == "S05"
        # A breakpoint is no instruction, and nothing is skipped.
        assert board.instructions - before == 20
    assert ask(f"z0,{address:x},2") == "OK"


@pytest.mark.skipif(GDB is None, reason="no GDB for ARM is installed: apt-get install gdb-multiarch")
def test_a_real_gdb_stops_in_the_tick_and_names_its_lines(elf: Path) -> None:
    assert GDB is not None
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "due_emulator", str(elf), "--gdb", str(port)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    assert "waiting" in server.stdout.readline()
    lines = [
        f"target remote :{port}",
        "break tick_interrupt",
        "continue",
        "stepi",
        "backtrace",
        "print heli::due::ticks",
        "x/1xw 0x40080010",
        "kill",
    ]
    script = [part for line in lines for part in ("-ex", line)]
    process = subprocess.run(
        [GDB, "-q", "-batch", *script, str(elf)], capture_output=True, text=True, check=False, timeout=120
    )
    server.wait(timeout=120)
    output = process.stdout + process.stderr
    assert "tick_interrupt" in process.stdout, output
    assert "main.cpp" in process.stdout, output
    # The timer's counter starts again with each tick: one register of the chip as the debugger reads it.
    counted = re.search(r"0x40080010:\t(0x[0-9a-f]{8})", process.stdout)
    assert counted is not None and int(counted[1], 16) < 42_000_000 // 1_000_000, output
