"""Errors of heli_lab, a branch of heli_sim's tree.

::

    HeliError                   cause, remedy and exit code
    └── SimError                what goes wrong in the simulation
        └── IdentifyError       a flight and a model from which nothing can be identified
            └── NotExcited      a sound flight in which nothing flew, or nothing that could be learned from
"""

from __future__ import annotations

from heli_sim.errors import SimError


class IdentifyError(SimError):
    """A flight and a model from which nothing can be identified."""


class NotExcited(IdentifyError):
    """A sound flight in which nothing flew, or nothing that could be learned from."""
