"""Errors of heli_sim, one tree.

::

    SimError                what goes wrong in the simulation; str() is one line, cause and remedy
    ├── RigError            a rig file is missing, incomplete or holds something it may not
    ├── PlantError          the plant cannot be put together, compiled or loaded
    ├── EndpointError       the simulated serial port cannot be opened or did not appear
    ├── EffectError         an effect that is unknown, badly written or has a value it may not have
    ├── IdentifyError       a flight and a model from which nothing can be identified
    │   └── ShowsNothing    a sound flight in which nothing flew, or nothing that could be learned from
    └── OptionError         an option of a sil:// address or of the server is unknown or out of range
"""

from __future__ import annotations


class SimError(Exception):
    """Anything that goes wrong in the simulation."""


class RigError(SimError):
    """A rig file is missing, incomplete or holds something it may not."""


class PlantError(SimError):
    """The plant cannot be put together, compiled or loaded."""


class EndpointError(SimError):
    """The simulated serial port cannot be opened or did not appear."""


class OptionError(SimError):
    """An option of a ``sil://`` address or of the server is unknown or out of range."""


class IdentifyError(SimError):
    """A flight and a model from which nothing can be identified."""


class ShowsNothing(IdentifyError):
    """A sound flight in which nothing flew, or nothing that could be learned from."""


class EffectError(SimError):
    """An effect that is unknown, badly written or has a value it may not have."""
