"""The emulated Arduino Due: load an ELF, let time pass, look at pins, bytes and registers."""

from __future__ import annotations

from heli_sim.due.errors import DueError, GdbError, ImageError
from heli_sim.due.image import Image, Symbol, read_image
from heli_sim.due.machine import Report, new_due, report_of

__all__ = [
    "DueError",
    "GdbError",
    "Image",
    "ImageError",
    "Report",
    "Symbol",
    "new_due",
    "read_image",
    "report_of",
]
