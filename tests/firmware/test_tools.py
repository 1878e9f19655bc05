"""Tools around the firmware: the PlatformIO build, the uploader on an emulated chip, the debugger."""

from __future__ import annotations

import binascii
import configparser
import json
import os
import re
import select
import shutil
import socket
import struct
import subprocess
import sys
import threading
import tty
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import pytest
from due_emulator import Due, new_due
from heli_host.board.flashing import find_bossac, read_image, write_image
from heli_host.declaration import FIRMWARE_VERSION
from heli_host.errors import FlashError, ImageError
from heli_host.link.session import Session
from heli_sim.sil.transport import SilProcess

from firmware.due.report import Image
from tests.cli.uploader import Uploader
from tests.firmware.built import ROOT
from tests.firmware.desk import Board
from tests.running.long import LONG

pytestmark = pytest.mark.emulated

VERSION: Final = b"v1.1 Dec 15 2010 19:25:04\n\r"
RAM, RAM_SIZE = 0x2000_0000, 0x1_0000
FLASH, FLASH_SIZE = 0x0008_0000, 0x8_0000
RSTC_CR: Final = 0x400E_1A00
BLOCK: Final = 128
SOH, EOT, ACK, START = b"\x01", b"\x04", b"\x06", b"C"
# Where a program that was started returns to.
RETURN: Final = RAM + RAM_SIZE - 4
_COMMAND = re.compile(rb"([A-Za-z])([0-9A-Fa-f]*)(?:,([0-9A-Fa-f]*))?#")


# Addresses that an uploader reads to identify chips, and that the strict emulated chip does not have. They
# are the ROM's vector at 0, which is no branch as on an ARM7, and the places where other chips have their
# identity.
ELSEWHERE: Final = {0: 0x2000_1000, 0x400E_0740: 0}


class RomLoader:
    """Answers one uploader, in a thread of its own; a context manager."""

    def __init__(self, due: Due) -> None:
        self._due = due
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.port = os.ttyname(self._theirs)
        self._waiting = bytearray()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        unicorn: Any = pytest.importorskip("unicorn", reason="unicorn is missing: pip install unicorn")
        self._names: Any = pytest.importorskip("unicorn.arm_const")
        self._core = self._processor(unicorn)
        self.problem: Exception | None = None

    def __enter__(self) -> RomLoader:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        os.close(self._ours)
        os.close(self._theirs)
        if self.problem is not None:
            raise self.problem

    def _serve(self) -> None:
        try:
            # The last command of the uploader before it ended is still obeyed.
            while not self._ended.is_set() or self._receive():
                self._receive()
                while (command := _COMMAND.search(bytes(self._waiting))) is not None:
                    del self._waiting[: command.end()]
                    self._due.run_us(20.0)
                    self._obey(command[1], _hex(command[2]), _hex(command[3]))
        except Exception as problem:  # noqa: BLE001 - it is raised where the block ends
            self.problem = problem

    def _receive(self) -> bool:
        """Take what has come, waiting a moment for it; whether anything had."""
        if not select.select([self._ours], [], [], 0.01)[0]:
            return False
        self._waiting += os.read(self._ours, 4096)
        return True

    def _take(self, count: int) -> bytes:
        while len(self._waiting) < count and not self._ended.is_set():
            self._receive()
        data = bytes(self._waiting[:count])
        del self._waiting[:count]
        return data

    def _say(self, data: bytes) -> None:
        os.write(self._ours, data)

    def _obey(self, command: bytes, address: int, value: int) -> None:
        due = self._due
        if command == b"N":
            self._say(b"\n\r")
        elif command == b"V":
            self._say(VERSION)
        elif command == b"w":
            self._say(struct.pack("<I", self._word(address)))
        elif command == b"W":
            due.write_word(address, value)
        elif command == b"S":
            due.poke(address, self._xmodem_in(value))
        elif command == b"R":
            self._xmodem_out(due.peek(address, value))
        elif command == b"G":
            self._run(address)
        else:
            raise AssertionError(f"the loader knows no command {command!r}")

    def _word(self, address: int) -> int:
        return ELSEWHERE[address] if address in ELSEWHERE else self._due.read_word(address)

    def _xmodem_in(self, size: int) -> bytes:
        received = b""
        self._say(START)
        while (head := self._take(1)) == SOH:
            number, inverse, *_ = self._take(2)
            data, check = self._take(BLOCK), self._take(2)
            assert number ^ inverse == 0xFF
            assert binascii.crc_hqx(data, 0) == int.from_bytes(check, "big")
            received += data
            self._say(ACK)
        assert head == EOT, head
        self._say(ACK)
        return received[:size]

    def _xmodem_out(self, data: bytes) -> None:
        assert self._take(1) == START
        for at in range(0, len(data), BLOCK):
            block = data[at : at + BLOCK].ljust(BLOCK, b"\0")
            number = (at // BLOCK + 1) & 0xFF
            check = binascii.crc_hqx(block, 0).to_bytes(2, "big")
            self._say(SOH + bytes((number, 0xFF - number)) + block + check)
            assert self._take(1) == ACK
        self._say(EOT)
        assert self._take(1) == ACK

    def _run(self, address: int) -> None:
        """Start a program by its own vectors, as the ROM does, and wait until it returns."""
        stack, entry = struct.unpack("<II", self._due.peek(address, 8))
        core = self._core
        core.mem_write(RAM, self._due.peek(RAM, RAM_SIZE))
        core.reg_write(self._names.UC_ARM_REG_SP, stack)
        core.reg_write(self._names.UC_ARM_REG_LR, RETURN | 1)
        core.emu_start(entry | 1, RETURN, count=1_000_000)
        self._due.poke(RAM, bytes(core.mem_read(RAM, RAM_SIZE)))

    def _processor(self, uc: Any) -> Any:
        """A processor whose loads and stores of flash are the emulated chip's."""
        core: Any = uc.Uc(uc.UC_ARCH_ARM, uc.UC_MODE_THUMB | uc.UC_MODE_MCLASS)
        core.mem_map(RAM, RAM_SIZE)
        core.mem_map(FLASH, FLASH_SIZE)

        def load(_core: Any, _kind: int, at: int, size: int, _value: int, _data: Any) -> None:
            core.mem_write(at, self._due.peek(at, size))

        def store(_core: Any, _kind: int, at: int, size: int, value: int, _data: Any) -> None:
            assert size == 4
            self._due.write_word(at, value & 0xFFFF_FFFF)

        core.hook_add(uc.UC_HOOK_MEM_READ, load, begin=FLASH, end=FLASH + FLASH_SIZE - 1)
        core.hook_add(uc.UC_HOOK_MEM_WRITE, store, begin=FLASH, end=FLASH + FLASH_SIZE - 1)
        return core


def _hex(digits: bytes | None) -> int:
    return int(digits, 16) if digits else 0


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
        for attempts_to_come in (2, 1, 0):
            try:
                write_image(find_bossac(Path(path)), loader.port, binary)
                break
            except FlashError:
                # bossac waits for an answer by the wall clock; a busy machine may answer later.
                if not attempts_to_come:
                    raise
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
