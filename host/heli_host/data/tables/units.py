"""Units as people write them, in headers and in profiles."""

from __future__ import annotations

import math
import re
from typing import Final

ANGLE_UNITS: Final = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "turn": 2.0 * math.pi}
"""Radians in one of each; a count depends on the encoder."""
TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
"""Seconds in one of each."""
VOLTAGE_UNITS: Final = {"V": 1.0, "mV": 1e-3}
"""Volts in one of each; shares of the supply are in `SHARES`."""
SHARES: Final = {"duty": 1.0, "percent": 100.0, "pwm": 255.0}
"""Number in the column that means full supply voltage; a profile may state another number for `pwm`."""
COUNT: Final = "count"

_SPELLINGS: Final = {
    "rad": ("rad", "radian", "radians"),
    "mrad": ("mrad",),
    "deg": ("deg", "degs", "degree", "degrees", "°", "grad", "grader", "º"),
    "turn": ("turn", "turns", "rev", "revs", "revolution", "revolutions"),
    "count": ("count", "counts", "cnt", "cnts", "ticks", "tick", "pulses", "steps", "enc", "lsb"),
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "millis", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "micros", "microseconds"),
    "ns": ("ns", "nsec", "nanoseconds"),
    "min": ("min", "minutes"),
    "V": ("v", "volt", "volts"),
    "mV": ("mv", "millivolt", "millivolts"),
    "duty": ("duty", "1", "-", "p.u.", "pu"),
    "percent": ("%", "percent", "pct"),
    "pwm": ("pwm",),
    "deg/s": ("deg/s", "°/s", "dps", "degrees/s"),
    "rad/s": ("rad/s", "rad/sec", "radps"),
    "rad/s2": ("rad/s2", "rad/s^2"),
}
_UNIT_OF: Final = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}
_BRACKETS: Final = re.compile(r"^(.*?)[\s_]*[\[(<{]\s*([^\])>}]*)\s*[\])>}]\s*$")
_SLASH: Final = re.compile(r"^(.*\S)\s+(?:/|in)\s*(\S+)\s*$")
_TAIL: Final = re.compile(r"^(.*[^_\s])[_\s]([^_\s]+)$")
_BARE_TAILS: Final = frozenset(
    {
        *("rad", "mrad", "deg", "degrees", "radians", "turns", "count", "counts", "cnt", "ticks"),
        *("sec", "°", "%", "ms", "us", "ns", "volt", "volts", "mv", "duty", "pct", "percent", "pwm"),
    }
)
_BEFORE_S: Final = frozenset({"t", "time", "timestamp", "stamp", "clock", "elapsed"})


def unit_of(text: str) -> str:
    """Return the unit that a `text` spells, or an empty string."""
    return _UNIT_OF.get(text.strip().lower(), "")


def split_unit(name: str) -> tuple[str, str]:
    """Split the unit off a column's `name`: `pitch [deg]`, `pitch (deg)`, `pitch / deg`, `pitch_deg`."""
    for pattern in (_BRACKETS, _SLASH):
        match = pattern.match(name)
        # In y[1] and u(1) the number is an index. After a space it is the unit 1, of a share.
        is_index = match is not None and match.group(2) == "1" and name[len(match.group(1))] in "[({<"
        if match and unit_of(match.group(2)) and not is_index:
            return match.group(1).strip(), unit_of(match.group(2))
    match = _TAIL.match(name)
    # V_s is a sum of voltages and pitch_v is a speed, so that "s" and "v" are units in some names only.
    is_one_letter_unit = match is not None and (
        (match.group(2) == "s" and match.group(1).lower() in _BEFORE_S) or match.group(2) == "V"
    )
    if match and (is_one_letter_unit or match.group(2).lower() in _BARE_TAILS):
        return match.group(1), unit_of(match.group(2))
    return name, ""
