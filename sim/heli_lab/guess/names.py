"""What columns' names say about what they are."""

from __future__ import annotations

import itertools
import re
from typing import Final

from heli_host.tables.units import split_unit

ROLES: Final = ("elevation", "pitch", "travel", "front", "back", "sum", "difference")

_WORDS: Final = {
    "elevation": ("elevation", "elev", "elevasjon", "theta", "epsilon", "eps", "el", "e"),
    "pitch": ("pitch", "phi", "rho", "p", "tilt"),
    "travel": ("travel", "trav", "psi", "lambda", "lam", "lamda", "yaw", "azimuth", "heading", "tr"),
    "front": ("front", "vf", "uf", "forward", "fwd", "mf", "f"),
    "back": ("back", "rear", "vb", "ub", "aft", "mb", "b"),
    "sum": ("sum", "vs", "us", "collective", "coll", "total", "vsum"),
    "difference": ("difference", "diff", "vd", "ud", "differential", "vdiff", "delta"),
}
_OTHERS: Final = frozenset(
    {
        *("ref", "reference", "setpoint", "set", "sp", "des", "desired", "cmd", "command", "target", "goal"),
        *("rate", "dot", "vel", "velocity", "speed", "acc", "acceleration", "gyro", "omega", "err", "error"),
        *("hat", "est", "estimate", "filtered", "integral", "int", "star", "opt", "c", "r", "d1", "state"),
        *("fault", "flags", "count2", "temp", "temperature", "battery", "current", "amps"),
    }
)
_TIMES: Final = frozenset(
    {
        *("t", "time", "times", "timestamp", "stamp", "tid", "zeit", "temps"),
        *("millis", "micros", "clock", "tout", "seconds", "elapsed"),
    }
)
_COUNTERS: Final = frozenset({"k", "n", "i", "index", "sample", "samples", "row", "tick", "ticks", "seq", ""})
_SPLIT: Final = re.compile(r"[^a-z0-9]+|(?<=[a-z])(?=\d)|(?<=\d)(?=[a-z])")
_CAMEL: Final = re.compile(r"(?<=[a-z])(?=[A-Z])")


def words_of(name: str) -> list[str]:
    """Take a column's `name` without its unit apart into words, lower case."""
    bare = _CAMEL.sub("_", split_unit(name)[0])
    words = [word for word in _SPLIT.split(bare.lower()) if word]
    # v_f, v s, u_d: the letter of a voltage belongs to the next word.
    joined = [a + b for a, b in itertools.pairwise(words) if a in {"v", "u", "m"} and len(b) == 1]
    return words + joined


def role_of(name: str) -> str:
    """Return the role that a column's `name` states, one of `ROLES`; empty where it states none, or says that
    it is something else, such as a setpoint or a rate.
    """
    words = words_of(name)
    if _OTHERS.intersection(words):
        return ""
    stated = {role for role, known in _WORDS.items() if any(word in known for word in words)}
    long = {role for role in stated if any(word in _WORDS[role] and len(word) > 2 for word in words)}
    found = long or stated
    if "pitch" in found and len(found) > 1 and not long:
        found.discard("pitch")
    return found.pop() if len(found) == 1 else ""


def is_other(name: str) -> bool:
    """Whether a `name` says that a column is no measured angle and no voltage."""
    return bool(_OTHERS.intersection(words_of(name)))


def is_time(name: str) -> bool:
    """Whether a `name` says that a column is the time."""
    return bool(_TIMES.intersection(words_of(name)))


def is_counter(name: str) -> bool:
    """Whether a `name` says that a column counts rows."""
    words = words_of(name)
    return not words or bool(_COUNTERS.intersection(words))
