"""Channels and quantities of a curve in words, and the units that people see them in."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

SHOWN: Final = {
    "rad": (180.0 / np.pi, "deg"),
    "rad/s": (180.0 / np.pi, "deg/s"),
    "N m": (1e3, "mN m"),
    "1": (100.0, "%"),
}
"""Factor from an SI unit to the one that is shown, and its name."""

_CHANNELS: Final = {
    "thrust.both": "a share of both thrusts",
    "thrust.difference": "an imbalance of the thrusts",
}


def channel_in_words(channel: str) -> str:
    """Write the `channel` that a curve changes, such as ``torque.pitch``, for people: ``a torque about
    pitch``.
    """
    kind, _, axis = channel.partition(".")
    known = {"torque": f"a torque about {axis}", "measurement": f"an error of the {axis} encoder"}
    return _CHANNELS.get(channel) or known.get(kind, channel)


def quantity_in_words(quantity: str) -> str:
    """Write the name of a `quantity`, such as ``travel_rate``, for people: ``travel rate``."""
    return re.sub(r"\btimes\b", "\N{MULTIPLICATION SIGN}", quantity.replace("_", " "))


def curve_in_words(what: str) -> str:
    """Write `what`, ``CHANNEL on QUANTITY``, for people, such as ``a torque about pitch that goes with travel
    rate``.
    """
    channel, _, quantity = what.partition(" on ")
    return f"{channel_in_words(channel)} that goes with {quantity_in_words(quantity)}"


def readable_id(candidate: str) -> str:
    """Write the id of a `candidate` for people: ``any torque about pitch by travel rate`` for a spline term,
    an effect's id as it is.
    """
    kind, _, rest = candidate.partition(":")
    if kind != "spline":
        return candidate
    channel, _, quantity = rest.partition(":")
    words = channel_in_words(channel).removeprefix("a ").removeprefix("an ")
    return f"any {words} by {quantity_in_words(quantity)}"
