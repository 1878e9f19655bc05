"""The emulated Arduino Due: load a program, let time pass, look at pins, bytes and registers."""

from __future__ import annotations

from due_emulator._due import BareCore, Due, ExceptionStats, ProbeStats, Stop
from due_emulator.errors import EmulatorError, GdbError, ImageError
from due_emulator.image import Image, Symbol, read_image
from due_emulator.machine import Report, load_image, new_due, report_of

__all__ = [
    "BareCore",
    "Due",
    "EmulatorError",
    "ExceptionStats",
    "GdbError",
    "Image",
    "ImageError",
    "ProbeStats",
    "Report",
    "Stop",
    "Symbol",
    "load_image",
    "new_due",
    "read_image",
    "report_of",
]
