"""The firmware, linked once for all tests, and what it is held against."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from firmware.due.report import Image, read_image
from tests.due import fetch_svd
from tests.firmware.description import Description, read_description

if TYPE_CHECKING:
    from tests.firmware.desk import Board

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The linked firmware."""
    for tool in ("arm-none-eabi-g++", "make"):
        if shutil.which(tool) is None:
            pytest.skip(
                f"{tool} is not installed; on Debian: apt-get install gcc-arm-none-eabi "
                "libnewlib-arm-none-eabi libstdc++-arm-none-eabi-dev make"
            )
    build = tmp_path_factory.mktemp("firmware")
    done = subprocess.run(
        ["make", "-s", "-j2", "-C", ROOT / "firmware" / "due", f"BUILD={build}", build / "heli.elf"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return build / "heli.elf"


@pytest.fixture(scope="session")
def image(elf: Path) -> Image:
    """The same, taken apart."""
    return read_image(elf)


@pytest.fixture
def board(elf: Path, image: Image) -> Board:
    """A board without an arm, powered."""
    from tests.firmware.desk import Board

    return Board(elf, image)


@pytest.fixture(scope="session")
def description() -> Description:
    """What the vendor says of the chip."""
    path = fetch_svd.find()
    if path is None:
        pytest.skip(fetch_svd.MISSING)
    return read_description(path)
