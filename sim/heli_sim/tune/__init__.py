"""Gains for the control law on board."""

from __future__ import annotations

from heli_sim.tune.design import Design, find_gains
from heli_sim.tune.gains import PAPER_SETS, law_of, paper_gains
from heli_sim.tune.loops import LOOPS, Law, Margin, Pid, is_stable, margins
from heli_sim.tune.plants import Known, LinearPlant, Spread, known_of, linear_plant

__all__ = [
    "LOOPS",
    "PAPER_SETS",
    "Design",
    "Known",
    "Law",
    "LinearPlant",
    "Margin",
    "Pid",
    "Spread",
    "find_gains",
    "is_stable",
    "known_of",
    "law_of",
    "linear_plant",
    "margins",
    "paper_gains",
]
