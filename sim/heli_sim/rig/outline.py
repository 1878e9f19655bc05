"""Outline of a rig for its picture; the entry point ``heli_host.rigs``."""

from __future__ import annotations

from typing import Final

from heli_sim.rig.rig import load_rig

_SHOWN: Final = ("L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x", "M_f", "M_b", "M_w", "M_h", "M_l")


def outline(name_or_path: str) -> dict[str, float]:
    """Return lengths [m], masses [kg], and the elevation on the table [deg] of a rig, by the names of its
    file.
    """
    rig = load_rig(name_or_path)
    return {name: rig[name].value for name in (*_SHOWN, "elevation_min")}
