"""Lengths and masses of a rig, for the picture on the page.

A package that can read rig files provides them by a function in the entry-point group ``heli_host.rigs``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from heli_host.link.installation import plugins

ENTRY_POINT_GROUP: Final = "heli_host.rigs"

Outline = Callable[[str], Mapping[str, float]]


def outline(rig: str) -> dict[str, float]:
    """Return lengths [m] and masses [kg] of a rig by name; empty if no installed package can read rigs."""
    for entry in plugins(ENTRY_POINT_GROUP):
        read_outline: Outline = entry.load()
        return dict(read_outline(rig))
    return {}
