"""Errors of heli_sim.due, a branch of heli_sim's tree.

::

    HeliError                   cause, remedy and exit code
    └── SimError                what goes wrong in the simulation
        └── DueError            anything that goes wrong with the emulated board
            ├── ImageError      the program cannot be read, or is none for the Due
            ├── FirmwareError   the flight code's ELF is missing, or speaks another version of the link
            ├── BoardStopped    the emulator found something that the chip does not promise to take
            └── GdbError        the debugger's port cannot be opened
"""

from __future__ import annotations

from heli_sim.errors import SimError


class DueError(SimError):
    """Anything that goes wrong with the emulated board."""


class ImageError(DueError):
    """The program cannot be read, or is none for the Due."""


class FirmwareError(DueError):
    """The flight code's ELF is missing, or speaks another version of the link."""


class BoardStopped(DueError):
    """The emulator found something that the chip does not promise to take."""


class GdbError(DueError):
    """The debugger's port cannot be opened."""
