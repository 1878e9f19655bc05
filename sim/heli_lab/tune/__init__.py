"""Gains for the control law on board."""

from __future__ import annotations

from heli_lab.tune.design import Design, find_gains
from heli_lab.tune.gains import cascade_gains_of
from heli_lab.tune.loops import LOOPS, CascadeGains, Margin, Pid, is_stable, margins
from heli_lab.tune.plants import Known, LinearPlant, Spread, known_of, linear_plant

__all__ = [
    "LOOPS",
    "CascadeGains",
    "Design",
    "Known",
    "LinearPlant",
    "Margin",
    "Pid",
    "Spread",
    "cascade_gains_of",
    "find_gains",
    "is_stable",
    "known_of",
    "linear_plant",
    "margins",
]
