"""Writing a firmware image into the Due's flash, over its programming port and ``bossac``."""

from __future__ import annotations

from heli_host.board.flash.bossac import Bossac, find_bossac, write_image
from heli_host.board.flash.image import FirmwareImage, read_image
from heli_host.board.flash.other_link import saved_parameters
from heli_host.board.flash.touch import erase_chip, restart_chip

__all__ = [
    "Bossac",
    "FirmwareImage",
    "erase_chip",
    "find_bossac",
    "read_image",
    "restart_chip",
    "saved_parameters",
    "write_image",
]
