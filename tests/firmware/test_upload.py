"""Tools that write the firmware: the check of its image, and the real uploader on an emulated chip."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from due_emulator import new_due
from heli_host.board.flash.bossac import find_bossac, write_image
from heli_host.board.flash.image import read_image
from heli_host.declaration import FIRMWARE_VERSION
from heli_host.errors import ImageError
from heli_host.link.session import Session

from firmware.due.report import Image
from tests.firmware.desk import Board
from tests.firmware.loader import RomLoader

pytestmark = pytest.mark.emulated


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
