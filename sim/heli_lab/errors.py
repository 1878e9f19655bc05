"""Errors of heli_lab, a branch of heli_sim's error classes.

::

    HeliError                   cause, remedy and exit code
    └── SimError                an error in the simulation
        ├── CalibrationError    a calibration ended before its result; the motors are off
        ├── CampaignError       a campaign cannot be read, started or continued
        ├── PoolError           diagnoses cannot be pooled
        ├── TwinError           a twin cannot be built, or cannot follow a flight
        ├── UnsureGuess         a guessed profile of a file is ambiguous
        ├── LearningError       an invalid environment, domain or episode of heli_lab.apps.gym
        └── IdentifyError       parameters cannot be identified from a flight with a model
            ├── WrongSigns      a flight has wrong signs, zeros or units
            └── NotExcited      a valid flight without enough motion in the air
"""

from __future__ import annotations

from heli_sim.errors import SimError


class CalibrationError(SimError):
    """A calibration ended before its result; the motors are off."""

    exit_code = 4


class CampaignError(SimError):
    """A campaign cannot be read, started or continued."""


class PoolError(SimError):
    """Diagnoses cannot be pooled."""


class TwinError(SimError):
    """A twin cannot be built, or cannot follow a flight."""


class UnsureGuess(SimError):
    """A guessed profile of a file is ambiguous; the message lists the ambiguities."""


class LearningError(SimError):
    """An environment, domain or episode of `heli_lab.apps.gym` is invalid."""


class IdentifyError(SimError):
    """Parameters cannot be identified from a flight with a model."""


class WrongSigns(IdentifyError):
    """A flight has wrong signs, zeros or units."""


class NotExcited(IdentifyError):
    """A valid flight has too little motion in the air to estimate anything."""
