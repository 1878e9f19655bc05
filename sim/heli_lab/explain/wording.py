"""Channels and quantities in words, and display units."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

_DISPLAY_UNITS: Final = {
    "rad": (180.0 / np.pi, "deg"),
    "rad/s": (180.0 / np.pi, "deg/s"),
    "N m": (1e3, "mN m"),
    "1": (100.0, "%"),
}
"""Factor from an SI unit to the display unit, and its name."""

_EVIDENCE: Final = ((1.0, "hardly any evidence"), (3.0, "some evidence"), (5.0, "strong evidence"))
"""Upper limits of log-likelihood ratios in nats and their words. At 1 nat the data are 3 times as likely, at
3 nats 20 times and at 5 nats 150 times."""
_MOST_NATS: Final = 1000.0
"""Log-likelihood ratio above which the number says no more than the words."""
_CHANNELS: Final = {
    "thrust.both": "a share of both thrusts",
    "thrust.difference": "an imbalance of the thrusts",
}


def display_unit(unit: str) -> tuple[float, str]:
    """Return the factor from an SI `unit` to its display unit, and the name of that unit."""
    return _DISPLAY_UNITS.get(unit, (1.0, unit))


def capital(text: str) -> str:
    """Begin a `text` with a capital."""
    return text[:1].upper() + text[1:]


def evidence_in_words(log_likelihood_ratio: float) -> str:
    """Write a `log_likelihood_ratio` in nats in words, by the scale of Kass and Raftery (1995)."""
    # The number follows: ``very strong evidence (log-likelihood ratio 12 nats)``.
    words = next((text for limit, text in _EVIDENCE if log_likelihood_ratio < limit), "very strong evidence")
    return f"{words} (log-likelihood ratio {nats_in_words(log_likelihood_ratio)})"


def nats_in_words(log_likelihood_ratio: float) -> str:
    """Write a `log_likelihood_ratio` with its unit, and no digits that say nothing."""
    if log_likelihood_ratio < _EVIDENCE[0][0]:
        return "below 1 nat"
    if log_likelihood_ratio > _MOST_NATS:
        return f"above {_MOST_NATS:.0f} nats"
    return f"{log_likelihood_ratio:.0f} nats"


def channel_in_words(channel: str) -> str:
    """Write a `channel` such as ``torque.pitch`` in words: ``a torque about pitch``."""
    kind, _, axis = channel.partition(".")
    known = {"torque": f"a torque about {axis}", "measurement": f"an error of the {axis} encoder"}
    return _CHANNELS.get(channel) or known.get(kind, channel)


def quantity_in_words(quantity: str) -> str:
    """Write the name of a `quantity` such as ``travel_rate`` in words: ``travel rate``."""
    return re.sub(r"\btimes\b", "\N{MULTIPLICATION SIGN}", quantity.replace("_", " "))


def dependence_in_words(dependence: str) -> str:
    """Write a `dependence`, ``CHANNEL on QUANTITY``, in words."""
    # An example is ``a torque about pitch that depends on travel rate``.
    channel, _, quantity = dependence.partition(" on ")
    return f"{channel_in_words(channel)} that depends on {quantity_in_words(quantity)}"


def readable_id(candidate: str) -> str:
    """Write the id of a `candidate` in words."""
    # A spline term becomes ``any torque about pitch by travel rate``; the id of an effect is unchanged.
    kind, _, rest = candidate.partition(":")
    if kind != "spline":
        return candidate
    channel, _, quantity = rest.partition(":")
    words = channel_in_words(channel).removeprefix("a ").removeprefix("an ")
    return f"any {words} by {quantity_in_words(quantity)}"
