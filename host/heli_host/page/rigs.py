"""Lengths and masses of a rig, for its picture; from whoever knows rigs.

Nothing here reads a rig's file: a package that does offers a function in the entry-point group
``heli_host.rigs``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from typing import Final

ENTRY_POINT_GROUP: Final = "heli_host.rigs"

Outline = Callable[[str], Mapping[str, float]]


def outline(rig: str) -> dict[str, float]:
    """Return lengths [m] and masses [kg] of a rig by the names of its file; empty where no package knows
    rigs.

    Parameters
    ----------
    rig : str
        Name, or path of its file.

    Raises
    ------
    HeliError
        There is no such rig, or its file is not one.
    """
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        found: Outline = entry.load()
        return dict(found(rig))
    return {}
