"""Reading one table of a plan: known keys only, units in their names, numbers that are numbers."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

from heli_host.declaration import AXES
from heli_host.errors import PlanError

MAX_SEGMENT_S = 3600.0


@dataclass(frozen=True)
class Number:
    """Numbers that are valid for a key."""

    least: float  # least, most: Bounds, both included
    most: float
    nonzero: bool = False  # Whether 0 is refused
    whole: bool = False  # Whether only whole numbers are taken


ANGLE = Number(-3600.0, 3600.0)
DURATION = Number(0.0, MAX_SEGMENT_S, nonzero=True)
PAUSE = Number(0.0, MAX_SEGMENT_S)
RATE = Number(0.1, 1000.0)
PERIOD = Number(0.2, MAX_SEGMENT_S)
FREQUENCY = Number(1.0 / MAX_SEGMENT_S, 5.0)
VOLTAGE = Number(-24.0, 24.0)
EXCITATION_HZ = Number(0.0, 500.0)
SEED = Number(0, 2**32 - 1, whole=True)

TARGETS = {f"{axis}_deg": ANGLE for axis in AXES}


class PlanTable:
    """One table of a plan, and its place in the file."""

    def __init__(self, values: Mapping[str, Any], where: str, known: Iterable[str]) -> None:
        self.values = values
        self.where = where
        names = list(known)
        for key in values:
            if key not in names:
                self.fail(f"unknown key {key!r}", _suggestion(key, names))

    def fail(self, what: str, remedy: str) -> NoReturn:
        """Raise the error of this table."""
        raise PlanError(f"{self.where}: {what}", remedy)

    def number(self, key: str, spec: Number, default: float | None = None) -> float:
        """Return a number.

        `default`: Value when the key is missing; without it the key must be there.
        """
        if key not in self.values:
            if default is None:
                self.fail(f"{key} is missing", f"add {key} = {_example_value(key, spec)}")
            return default
        value = self.values[key]
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.fail(
                f"{key} is {_shortened(value)}, not a number", f"write {key} = {_example_value(key, spec)}"
            )
        if not math.isfinite(value):
            self.fail(f"{key} is {value}", "give a finite number")
        if not spec.least <= value <= spec.most or (spec.nonzero and value == 0):
            more_than = "more than " if spec.nonzero and spec.least == 0 else ""
            self.fail(f"{key} is {value:g}", f"give {more_than}{spec.least:g} to {spec.most:g}")
        if spec.whole and value != int(value):
            self.fail(f"{key} is {value:g}", "give a whole number")
        return float(value)

    def optional(self, key: str, spec: Number) -> float | None:
        """Return a number, or None when its key is missing."""
        return self.number(key, spec) if key in self.values else None

    def text(self, key: str, default: str) -> str:
        """Return a text."""
        value = self.values.get(key, default)
        if not isinstance(value, str):
            self.fail(f"{key} is {_shortened(value)}, not a text", f'write {key} = "{default or "..."}"')
        return value

    def choice(self, key: str, choices: Iterable[str], default: str | None = None) -> str:
        """Return one of several words.

        `default`: Value when the key is missing; without it the key must be there.
        """
        words = list(choices)
        if key not in self.values and default is None:
            self.fail(f"{key} is missing", f"give one of {', '.join(words)}")
        value = self.values.get(key, default)
        if value not in words:
            similar_words = difflib.get_close_matches(str(value), words, n=1)
            hint = f"did you mean {similar_words[0]!r}? " if similar_words else ""
            self.fail(f"{key} is {_shortened(value)}", f"{hint}it takes {', '.join(words)}")
        return str(value)


def _example_value(key: str, spec: Number) -> str:
    if key.endswith("_s"):
        return "10"
    return f"{min(max(5.0, spec.least), spec.most):g}"


def _shortened(value: object) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else text[:37] + "..."


def _suggestion(key: str, names: list[str]) -> str:
    """Return the advice for an unknown key: the unit, a similar key, or all keys."""
    with_unit = [name for name in names if name.startswith(key + "_")]
    if with_unit:
        return f"name the unit: {' or '.join(with_unit)}"
    close = difflib.get_close_matches(key, names, n=1, cutoff=0.6)
    return f"did you mean {close[0]!r}?" if close else f"it takes {', '.join(names)}"
