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
    """An error of the emulated board."""


class FirmwareError(DueError):
    """The ELF of the flight code is missing, unreadable, or for another version of the link."""


class BoardStopped(DueError):
    """The emulator stopped the firmware, because it relies on behaviour that the chip does not promise."""
