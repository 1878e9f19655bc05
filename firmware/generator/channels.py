"""Names of a telemetry channel in samples, tables and logs, derived from its name and unit.

A channel ``front`` in V is the column ``front_V`` of samples and tables. In a log, which permits no capitals, it
is the field ``front_volt``. A channel in ``count`` belongs to an encoder: its column is the angle in rad.
"""

from __future__ import annotations

import re
from typing import Any

Table = dict[str, Any]

COUNT = "count"
# Names of units whose symbol would be unclear in lower case.
WORDS = {"V": "volt", "A": "ampere", "W": "watt", "N": "newton", "K": "kelvin", "J": "joule"}


def suffix(unit: str) -> str:
    """Return the end of a name for a unit: ``rad_s`` for rad/s; empty for numbers, enumerations and bits."""
    if unit.startswith(("enum ", "bits ")):
        return ""
    return re.sub(r"[^A-Za-z0-9]+", "_", unit).strip("_")


def stem(channel: Table) -> str:
    """Return the name of a channel without its unit."""
    name: str = channel["name"]
    unit_suffix = suffix(channel["unit"])
    return name.removesuffix(f"_{unit_suffix}") if unit_suffix else name


def axis_of(channel: Table) -> str | None:
    """Return the axis whose encoder the channel counts; None for another channel."""
    return stem(channel) if channel["unit"] == COUNT else None


def column(channel: Table) -> str:
    """Return the name of a channel in samples, flights and tables."""
    axis, unit_suffix = axis_of(channel), suffix(channel["unit"])
    if axis is not None:
        return f"{axis}_rad"
    return f"{stem(channel)}_{unit_suffix}" if unit_suffix else stem(channel)


def field(channel: Table) -> str:
    """Return the name of a channel in a log."""
    unit_suffix = suffix(channel["unit"])
    return f"{stem(channel)}_{WORDS.get(unit_suffix, unit_suffix.lower())}" if unit_suffix else stem(channel)


def fields(channel: Table) -> list[str]:
    """Return all fields of a log that come from a channel: for an encoder, its count and its angle."""
    return [field(channel)] if axis_of(channel) is None else [field(channel), column(channel)]


def numbers_of(channel: Table) -> str | None:
    """Return the enumeration or set of bits of a channel's numbers; None for plain numbers."""
    kind, _, name = channel["unit"].partition(" ")
    return name if kind in ("enum", "bits") else None
