"""Writing a firmware image into the Due's flash, over its programming port and ``bossac``."""

from __future__ import annotations

from heli_host.flash.bossac import Bossac, find_bossac, write_image
from heli_host.flash.erase import erase_chip
from heli_host.flash.image import FirmwareImage, read_image

__all__ = ["Bossac", "FirmwareImage", "erase_chip", "find_bossac", "read_image", "write_image"]
