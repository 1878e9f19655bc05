"""Read the name of a column: it may state a role, such as pitch, or another quantity, such as a setpoint."""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from heli_host.data.tables.table import ANGLE_UNITS, COUNT, SHARES, VOLTAGE_UNITS, split_unit

AXES: Final = ("elevation", "pitch", "travel")
PAIR: Final = ("front", "back")
SUMS: Final = ("sum", "difference")
VOLTAGE_ROLES: Final = (*PAIR, *SUMS)
ROLES: Final = (*AXES, *VOLTAGE_ROLES)

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
_OTHER_QUANTITIES: Final = {
    "a setpoint": (
        *("ref", "reference", "setpoint", "set", "sp", "des", "desired", "cmd", "command", "target", "goal"),
        *("star", "opt", "c", "r"),
    ),
    "a rate": ("rate", "dot", "vel", "velocity", "speed", "gyro", "omega", "d1"),
    "an acceleration": ("acc", "acceleration"),
    "an estimate": ("hat", "est", "estimate", "estimated", "filtered", "filt", "smoothed"),
    "an error": ("err", "error"),
    "an integral": ("integral", "int"),
    "a feed-forward": ("ff", "feedforward"),
    "a current": ("current", "amps", "ampere", "i"),
    "another quantity": (
        *("state", "fault", "flags", "count2", "temp", "temperature", "battery", "rpm", "thrust", "torque"),
    ),
}
"""Words of quantities that are neither a measured angle nor a motor's voltage."""
_LETTERS: Final = frozenset({"c", "i"})
"""Words of `_OTHER_QUANTITIES` that only count next to a role, as in ``e_c``."""
_COMMANDS: Final = frozenset({"set", "cmd", "command", "target", "goal", "opt", "star", "c"})
"""Words of setpoints that a motor's voltage may have: commands are voltages before their limit."""
_MEASURED: Final = frozenset({"measured", "meas", "real", "actual", "act", "encoder", "enc", "raw", "true"})
_VOLTAGES: Final = frozenset({"u", "v", "m", "motor", "volt", "voltage", "input", "pwm", "duty"})
"""Words of the voltage of a motor that is not named, as in ``u1`` or ``motor_2``."""
_HALVES: Final = frozenset({"mean", "avg", "average", "half", "mid", "middle"})
"""Words of half a sum, or half a difference, of two voltages."""
_TIMES: Final = frozenset(
    {
        *("t", "time", "times", "timestamp", "stamp", "tid", "zeit", "temps", "tiempo", "tempo", "时间"),
        *("millis", "micros", "clock", "tout", "seconds", "elapsed"),
    }
)
_RATE_UNITS: Final = {"deg/s": "a rate", "rad/s": "a rate", "rad/s2": "an acceleration"}
_SPLIT: Final = re.compile(r"[^a-z0-9\u4e00-\u9fff]+|(?<=[a-z])(?=\d)|(?<=\d)(?=[a-z])")
_INDEX: Final = re.compile(r"\d+")
_CAMEL: Final = re.compile(r"(?<=[a-z])(?=[A-Z])")
_CHINESE: Final = tuple(
    word for known in (*_WORDS.values(), _TIMES) for word in known if word and word[0] >= "\u4e00"
)


@dataclass(frozen=True)
class ColumnMeaning:
    """Role or quantity that the name and the unit of a column state."""

    role: str = ""  # One of `ROLES`; empty if they state none
    quantity: str = ""
    """The quantity, such as ``a setpoint``, if it is no measured angle and no voltage; otherwise empty."""
    is_measured: bool = False  # Whether the name states that the value was measured
    possible_roles: tuple[str, ...] = ()  # Roles that name and unit permit


def meanings_of(units: Mapping[str, str]) -> dict[str, ColumnMeaning]:
    """Return the meanings of the columns of a table, from their names and the units that the file states.

    The name of a single matrix, in ``data[1]`` and ``data[2]``, states nothing about its columns.
    """
    if len(units) > 1 and len({_INDEX.sub("", name) for name in units}) == 1:
        return {name: ColumnMeaning(possible_roles=ROLES) for name in units}
    return {name: meaning_of(name, unit) for name, unit in units.items()}


def meaning_of(name: str, unit: str = "") -> ColumnMeaning:
    """Return what the name of a column, and the `unit` that the file states, mean."""
    words = words_of(name)
    unit = unit or split_unit(name)[1]
    role = _stated_role(words)
    quantity = _RATE_UNITS.get(unit, "") or _stated_quantity(words, role)
    if quantity:
        return ColumnMeaning(role, quantity)
    if unit in VOLTAGE_UNITS or unit in SHARES:
        possible: tuple[str, ...] = VOLTAGE_ROLES
    elif unit in ANGLE_UNITS or unit == COUNT:
        possible = AXES
    else:
        possible = ROLES
    if role in possible:
        return ColumnMeaning(role, "", bool(_MEASURED.intersection(words)), (role,))
    bare = {word for word in words if not any(char.isdigit() for char in word)}
    if possible == ROLES and bare and bare <= _VOLTAGES:
        possible = VOLTAGE_ROLES
    return ColumnMeaning("", "", bool(_MEASURED.intersection(words)), possible)


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


def _stated_role(words: list[str]) -> str:
    """Return the role that the words of a name state; a longer word counts more than a single letter."""
    stated = {role for role, known in _WORDS.items() if any(word in known for word in words)}
    # One or two letters, such as p, often have another meaning.
    distinctive = {
        role
        for role in stated
        if any(word in _WORDS[role] and (len(word) > 2 or word in _CHINESE) for word in words)
    }
    candidates = distinctive or stated
    # Next to another role, the letter p means something else, such as a position.
    if "pitch" in candidates and len(candidates) > 1 and not distinctive:
        candidates.discard("pitch")
    return candidates.pop() if len(candidates) == 1 else ""


def _stated_quantity(words: list[str], role: str) -> str:
    """Return the quantity other than an angle or a voltage that the words state; empty if they state none."""
    for quantity, known in _OTHER_QUANTITIES.items():
        stating = {word for word in words if word in known and (role or word not in _LETTERS)}
        if role in VOLTAGE_ROLES:
            stating -= _COMMANDS
        if stating:
            return quantity
    return ""


def is_half(name: str) -> bool:
    """Whether a `name` means half of the sum, or half of the difference, of two voltages."""
    return bool(_HALVES.intersection(words_of(name)))


def is_time(name: str) -> bool:
    """Whether a `name` means the time."""
    return bool(_TIMES.intersection(words_of(name)))
