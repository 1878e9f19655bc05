"""Errors of heli_lab, a branch of heli_sim's tree.

::

    HeliError                   cause, remedy and exit code
    └── SimError                what goes wrong in the simulation
        ├── CampaignError       a campaign that cannot be read, begun or gone on with
        ├── PoolError           diagnoses that cannot be pooled
        ├── TwinError           a twin that cannot be made, or a flight that it cannot fly beside
        ├── UnsureGuess         a file whose meaning nothing settles, nor was it told
        ├── LearningError       an environment, a domain or an episode that there is not
        └── IdentifyError       a flight and a model from which nothing can be identified
            ├── WrongSigns      a flight whose signs, zeros or units are not those that it should have
            └── NotExcited      a sound flight in which nothing flew, or nothing that could be learned from
"""

from __future__ import annotations

from heli_sim.errors import SimError


class CampaignError(SimError):
    """A campaign that cannot be read, begun or gone on with."""


class PoolError(SimError):
    """Diagnoses that cannot be pooled."""


class TwinError(SimError):
    """A twin that cannot be made, or a flight that it cannot fly beside."""


class UnsureGuess(SimError):
    """A file whose meaning nothing settles; what is open is in the text."""


class LearningError(SimError):
    """An environment, a domain or an episode of `heli_lab.gym` that there is not."""


class IdentifyError(SimError):
    """A flight and a model from which nothing can be identified."""


class WrongSigns(IdentifyError):
    """A flight whose signs, zeros or units are not those that it should have."""


class NotExcited(IdentifyError):
    """A sound flight in which nothing flew, or nothing that could be learned from."""
