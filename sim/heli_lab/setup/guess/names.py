"""Find the role of a column from its name."""

from __future__ import annotations

import itertools
import re
import unicodedata
from typing import Final

from heli_host.data.tables.table import split_unit

ROLES: Final = ("elevation", "pitch", "travel", "front", "back", "sum", "difference")
VOLTAGE_ROLES: Final = ROLES[3:]

_WORDS: Final = {
    "elevation": (
        *("elevation", "elev", "theta", "epsilon", "eps", "el", "e"),
        *("elevasjon", "hoyde", "hoydevinkel", "hohe", "hohenwinkel", "elevacion", "altura", "高度", "升降"),
    ),
    "pitch": (
        *("pitch", "phi", "rho", "p", "tilt"),
        *("helling", "stigning", "nick", "nickwinkel", "neigung", "tangage", "cabeceo", "俯仰"),
    ),
    "travel": (
        *("travel", "trav", "psi", "lambda", "lam", "lamda", "yaw", "azimuth", "heading", "tr"),
        *("vandring", "dreh", "drehwinkel", "gier", "gierwinkel", "azimut", "lacet", "rotation", "giro"),
        *("desplazamiento", "deplacement", "旋转", "巡航"),
    ),
    "front": (
        *("front", "vf", "uf", "forward", "fwd", "mf", "f"),
        *("foran", "fremme", "vorne", "vorn", "avant", "delantero", "前"),
    ),
    "back": (
        *("back", "rear", "vb", "ub", "aft", "mb", "b"),
        *("bak", "bakre", "hinten", "arriere", "trasero", "后"),
    ),
    "sum": ("sum", "vs", "us", "collective", "coll", "total", "vsum", "summe", "somme", "suma"),
    "difference": (
        *("difference", "diff", "vd", "ud", "differential", "vdiff", "delta"),
        *("differanse", "differenz", "diferencia"),
    ),
}
"""Words for each role, without accents: English, Greek letters, Norwegian, German, French, Spanish and
Chinese."""
_HALVES: Final = frozenset({"mean", "avg", "average", "half", "mid", "middle"})
"""Words of half a sum, or half a difference, of two voltages."""
_DERIVED_SIGNALS: Final = frozenset(
    {
        *("ref", "reference", "setpoint", "set", "sp", "des", "desired", "cmd", "command", "target", "goal"),
        *("rate", "dot", "vel", "velocity", "speed", "acc", "acceleration", "gyro", "omega", "err", "error"),
        *("hat", "est", "estimate", "filtered", "integral", "int", "star", "opt", "c", "r", "d1", "state"),
        *("fault", "flags", "count2", "temp", "temperature", "battery", "current", "amps"),
    }
)
_NO_VOLTAGES: Final = frozenset(
    {
        *("ref", "reference", "setpoint", "sp", "des", "desired", "rate", "dot", "vel", "velocity"),
        *("gyro", "hat", "est", "estimate", "acc", "acceleration"),
    }
)
"""Words of signals that are never a motor's voltage; commands are voltages before their limit."""
_TIMES: Final = frozenset(
    {
        *("t", "time", "times", "timestamp", "stamp", "tid", "zeit", "temps", "tiempo", "tempo", "时间"),
        *("millis", "micros", "clock", "tout", "seconds", "elapsed"),
    }
)
_SPLIT: Final = re.compile(r"[^a-z0-9\u4e00-\u9fff]+|(?<=[a-z])(?=\d)|(?<=\d)(?=[a-z])")
_CAMEL: Final = re.compile(r"(?<=[a-z])(?=[A-Z])")


_CHINESE: Final = tuple(
    word for known in (*_WORDS.values(), _TIMES) for word in known if word and word[0] >= "\u4e00"
)


def words_of(name: str) -> list[str]:
    """Split a column's `name`, without its unit, into lower-case words."""
    bare = _CAMEL.sub("_", split_unit(name)[0])
    without_accents = "".join(
        char
        for char in unicodedata.normalize("NFKD", bare.lower().replace("ø", "o"))
        if not unicodedata.combining(char)
    )
    words = [word for word in _SPLIT.split(without_accents) if word]
    # Chinese writes no spaces between words.
    words += [word for word in _CHINESE if word in without_accents]
    # In v_f, v s and u_d the letter of the voltage belongs to the next word.
    joined_pairs = [a + b for a, b in itertools.pairwise(words) if a in {"v", "u", "m"} and len(b) == 1]
    return words + joined_pairs


def _is_distinctive(word: str) -> bool:
    """Whether a word rarely has another meaning; one or two letters, such as ``p``, often have one."""
    return len(word) > 2 or word in _CHINESE


def role_of(name: str) -> str:
    """Return the role, one of `ROLES`, that a column's `name` states."""
    words = words_of(name)
    if _DERIVED_SIGNALS.intersection(words):
        return ""
    stated = {role for role, known in _WORDS.items() if any(word in known for word in words)}
    distinctive = {
        role for role in stated if any(word in _WORDS[role] and _is_distinctive(word) for word in words)
    }
    candidates = distinctive or stated
    # Next to another role, the letter p means something else, such as a position.
    if "pitch" in candidates and len(candidates) > 1 and not distinctive:
        candidates.discard("pitch")
    return candidates.pop() if len(candidates) == 1 else ""


def is_half(name: str) -> bool:
    """Whether a `name` means half of the sum, or half of the difference, of two voltages."""
    return bool(_HALVES.intersection(words_of(name)))


def is_derived_signal(name: str) -> bool:
    """Whether a `name` means a signal other than a measured angle or a voltage, such as a setpoint."""
    return bool(_DERIVED_SIGNALS.intersection(words_of(name)))


def is_no_voltage(name: str) -> bool:
    """Whether a `name` means a setpoint, a rate or an estimate, which is never a motor's voltage."""
    return bool(_NO_VOLTAGES.intersection(words_of(name)))


def is_time(name: str) -> bool:
    """Whether a `name` means the time."""
    return bool(_TIMES.intersection(words_of(name)))
