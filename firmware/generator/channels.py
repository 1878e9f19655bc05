"""Names that a telemetry channel has outside the wire, derived from its name and unit.

A channel ``front`` in V is the column ``front_V`` of samples and tables, and the field ``front_volt`` of a log,
where capitals are not taken. A channel in ``count`` is an encoder's: its column is the axis' angle in radians.
"""

from __future__ import annotations

import re
from typing import Any

Table = dict[str, Any]

COUNT = "count"
# Units whose symbol, without its capital, would say something else or nothing.
WORDS = {"V": "volt", "A": "ampere", "W": "watt", "N": "newton", "K": "kelvin", "J": "joule"}


def suffix(unit: str) -> str:
    """What a unit adds to a name: ``rad_s`` for rad/s, nothing for numbers, enumerations and bits."""
    if unit.startswith(("enum ", "bits ")):
        return ""
    return re.sub(r"[^A-Za-z0-9]+", "_", unit).strip("_")


def stem(channel: Table) -> str:
    """The channel's name without its unit, should it end in it."""
    name: str = channel["name"]
    end = suffix(channel["unit"])
    return name.removesuffix(f"_{end}") if end else name


def axis_of(channel: Table) -> str | None:
    """Axis whose encoder the channel counts, None for any other channel."""
    return stem(channel) if channel["unit"] == COUNT else None


def column(channel: Table) -> str:
    """The channel's name in samples, flights and tables."""
    axis, end = axis_of(channel), suffix(channel["unit"])
    if axis is not None:
        return f"{axis}_rad"
    return f"{stem(channel)}_{end}" if end else stem(channel)


def field(channel: Table) -> str:
    """The channel's name in a log."""
    end = suffix(channel["unit"])
    return f"{stem(channel)}_{WORDS.get(end, end.lower())}" if end else stem(channel)


def fields(channel: Table) -> list[str]:
    """All fields of a log that the channel fills: an encoder's count has its angle beside it."""
    return [field(channel)] if axis_of(channel) is None else [field(channel), column(channel)]


def numbers_of(channel: Table) -> str | None:
    """The enumeration or the set of bits that the channel's numbers are of, None for plain numbers."""
    kind, _, name = channel["unit"].partition(" ")
    return name if kind in ("enum", "bits") else None
