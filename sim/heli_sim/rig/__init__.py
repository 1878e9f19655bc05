"""Rigs as data: each parameter with its unit, tolerance and source."""

from __future__ import annotations

from heli_sim.rig.rig import Number, Rig, load_rig, rig_names, rig_text, write_rig
from heli_sim.rig.schema import RIG_QUANTITIES, Prior, Quantity

__all__ = [
    "RIG_QUANTITIES",
    "Number",
    "Prior",
    "Quantity",
    "Rig",
    "load_rig",
    "rig_names",
    "rig_text",
    "write_rig",
]
