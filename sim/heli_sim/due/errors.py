"""Errors of heli_sim.due, a branch of heli_sim's tree.

::

    SimError
    └── DueError            anything that goes wrong with the emulated board
        ├── ImageError      the program cannot be read, or is none for the Due
        └── GdbError        the debugger's port cannot be opened
"""

from __future__ import annotations

from heli_sim.errors import SimError


class DueError(SimError):
    """Anything that goes wrong with the emulated board."""


class ImageError(DueError):
    """The program cannot be read, or is none for the Due."""


class GdbError(DueError):
    """The debugger's port cannot be opened."""
