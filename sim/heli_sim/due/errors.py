"""Errors of heli_sim.due, a branch of heli_sim's tree.

::

    HeliError                   cause, remedy and exit code
    └── SimError                what goes wrong in the simulation
        └── DueError            anything that goes wrong with the emulated board
            ├── FirmwareError   the flight code's ELF is missing, unreadable, or for another link
            └── BoardStopped    the emulator stopped the firmware: it does what the chip does not promise
"""

from __future__ import annotations

from heli_sim.errors import SimError


class DueError(SimError):
    """Anything that goes wrong with the emulated board."""


class FirmwareError(DueError):
    """The flight code's ELF is missing, unreadable, or for another version of the link."""


class BoardStopped(DueError):
    """The emulator stopped the firmware: it does what the chip does not promise."""
