"""Errors of heli_sim, a branch of the host's tree.

::

    HeliError                   cause, remedy and exit code
    └── SimError                what goes wrong in the simulation
        ├── RigError            a rig file is missing, incomplete or holds something it may not
        ├── PlantError          the plant cannot be put together, compiled or loaded
        ├── EndpointError       the simulated serial port cannot be opened or did not appear
        ├── EffectError         an effect that is unknown, badly written or has a value it may not have
        ├── OptionError         an option of a sil:// address or of the server is unknown or out of range
        └── DueError            the emulated Due, see `heli_sim.errors`
"""

from __future__ import annotations

from heli_host.errors import HeliError


class SimError(HeliError):
    """An error of the simulation."""


class RigError(SimError):
    """A rig file is missing, incomplete or invalid."""


class PlantError(SimError):
    """The plant cannot be made, compiled or loaded."""


class EndpointError(SimError):
    """The simulated serial port cannot be opened or did not appear."""


class OptionError(SimError):
    """An option of a ``sil://`` address or of the server is unknown or out of range."""


class EffectError(SimError):
    """An effect is unknown, its file is wrong, or a value is out of range."""


class DueError(SimError):
    """An error of the emulated board."""


class FirmwareError(DueError):
    """The ELF of the flight code is missing, unreadable, or for another version of the link."""


class BoardStopped(DueError):
    """The emulator stopped the firmware, because it relies on behaviour that the chip does not promise."""
