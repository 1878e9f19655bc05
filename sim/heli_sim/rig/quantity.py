"""A named number with a unit, as models and rigs declare them."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True)
class Quantity:
    """Name, unit and meaning of a number.

    Parameters
    ----------
    name : str
        Name, as in the rig file or the state vector.
    unit : str
        Unit, spelled as in the rig file (``kg``, ``N m s/rad``); ``1`` for none.
    meaning : str
        One line in words.
    """

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Prior:
    """Knowledge of a parameter before a flight: a normal distribution within bounds.

    Parameters
    ----------
    mean : float
        Most likely value, in the number's unit.
    std : float
        Standard deviation.
    low, high : float
        Bounds.
    """

    mean: float
    std: float
    low: float = -inf
    high: float = inf
