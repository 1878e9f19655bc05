"""The firmware, linked once for all tests, and its references."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from firmware.due.report import Image, read_image
from tests.firmware.built import built_elf

if TYPE_CHECKING:
    from heli_host.board.heli import Heli

    from tests.firmware.desk import Board


@pytest.fixture(scope="session")
def elf() -> Path:
    """The linked firmware."""
    return built_elf()


@pytest.fixture(scope="session")
def image(elf: Path) -> Image:
    """The same, taken apart."""
    return read_image(elf)


@pytest.fixture
def board(elf: Path, image: Image) -> Board:
    """A board without an arm, powered."""
    from tests.firmware.desk import Board

    return Board(elf, image)


@pytest.fixture
def heli(board: Board) -> Heli:
    """A host that is connected to it."""
    return board.connect()
