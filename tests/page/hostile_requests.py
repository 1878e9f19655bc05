"""Every request that a page's server knows, and values that no honest client sends, from a seed."""

from __future__ import annotations

import math
import random
from typing import Any, Final

ARGUMENTS: Final = {
    "take_off": ("elevation_deg",),
    "fly": ("plans",),
    "land": (),
    "clear_fault": (),
    "zero": (),
    "setpoint": ("elevation_deg", "travel_deg"),
    "hold": (),
    "set": ("name", "value"),
    "undo": (),
    "save": (),
    "law": ("name",),
    "set_law": ("name", "value"),
    "record": ("on",),
    "mark": ("text",),
    "signal": ("name", "value"),
    "ask": (),
    "grant": (),
    "keep": (),
    "share": ("on",),
}
"""Arguments of the requests, by name."""
FAR: Final = (1e308, -1e308, 2**63, -(10**30), 5e-324)
ODD: Final = (
    *(*FAR, math.nan, math.inf, -math.inf, 10**400, -(10**309), "\ud800", "\0", "", "x" * 5000, None, True),
    *([], [[]], {}, {"a": {"b": math.nan}}, ["short"] * 400, "kp", "travel_kp", "up", -0.0, 1.5),
)


def hostile_request(chance: random.Random, harmless: bool = False) -> dict[str, Any]:
    """Return a request with odd arguments.

    Parameters
    ----------
    harmless : bool
        True leaves out requests that a sound client could send to end a flight.
    """
    ends = ("land", "take_off", "fly", "law", "grant", "ask") if harmless else ()
    name = chance.choice([one for one in (*ARGUMENTS, "stop it", "") if one not in ends])
    arguments = {argument: chance.choice(ODD) for argument in ARGUMENTS.get(name, ("x",))}
    more = {chance.choice(("do it", "id2", "\0")): chance.choice(ODD)} if chance.random() < 0.2 else {}
    return {**arguments, **more, "do": name}
