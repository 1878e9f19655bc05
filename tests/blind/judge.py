"""Compares what a diagnosis says with what was hidden."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.blind.cases import Case
from tests.blind.oracle import Told
from tests.blind.truth import PARTS, Hidden, of_parts

VISIBLE = 3.0
"""Standard errors of its size, in the fit told the answer, below which an effect need not be named."""
VISIBLE_OFF_LIST = 1.05
"""Normalised error of the refitted baseline from which on an effect outside the catalogue must be noticed."""
SEEN = 15.0
"""Standard deviations above the weather from which on a cause counts.

Lower, and a tool that has to find which of thirty causes it is, and the weather too, may miss it for good
reasons; higher, and only plain cases count.
"""
APART = 8.0
"""From here on a case is counted apart; below, the best of all tests would need luck."""
MAX_STD = 2.0
"""Standard errors within which a number counts as found: 95 % of them, if the errors are right."""
_MIN_STD_SHARE = 1e-3
"""Of the truth: the least error that a number is forgiven. Two engines do not agree better."""
CHANCE = "random_torque"
"""Weather by its name on the list: never false where there is weather."""
LISTED_SINCE = {"off-pitch_drag_quadratic": "pitch_drag_quadratic"}
"""Laws that were on no list when their cases were drawn, and the name that they may have today."""


@dataclass(frozen=True)
class Row:
    """A case, and the diagnosis of it judged.

    Parameters
    ----------
    case, kind : str
        Name and sort of the case.
    seed : int
        Its seed.
    hidden : tuple of str
        Ids of what is hidden; those outside the catalogue begin with ``off-``.
    significance : Mapping[str, float | None]
        Their sizes in standard errors by a fit that is told the answer; in weather, standard deviations above
        that.
    verdict : str
        The diagnosis' verdict.
    named : tuple of str
        Causes given, first one first.
    confidence : tuple of float
        Of each.
    alternatives : tuple of tuple of str
        What each is ambiguous with.
    parameters : Mapping[str, tuple]
        Value, standard error and truth of each parameter that the generator defines as the catalogue does.
    errors : Mapping[str, float]
        Normalised errors: ``found``, and where a fit was told the answer ``baseline`` and ``told``, held out,
        and the same with ``_train``.
    seconds, cpu_seconds : float
        Time that the diagnosis took, by the clock and of the processor.
    failure : str
        Error that ended the diagnosis; empty when there was none.
    disturbances : Mapping[str, Any]
        Rig, rate, controller and weather; empty on clean flights.
    """

    case: str
    kind: str
    seed: int
    hidden: tuple[str, ...]
    significance: Mapping[str, float | None]
    verdict: str
    named: tuple[str, ...]
    confidence: tuple[float, ...]
    alternatives: tuple[tuple[str, ...], ...]
    parameters: Mapping[str, tuple[float, float, float]]
    errors: Mapping[str, float]
    seconds: float
    cpu_seconds: float = 0.0
    failure: str = ""
    disturbances: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, kept: Mapping[str, Any]) -> Row:
        """Make a row of what `blind.json` keeps of it."""
        given = {name: kept[name] for name in cls.__dataclass_fields__}
        for name in ("hidden", "named", "confidence"):
            given[name] = tuple(given[name])
        given["alternatives"] = tuple(tuple(one) for one in given["alternatives"])
        given["parameters"] = {name: tuple(of) for name, of in given["parameters"].items()}
        return cls(**given)

    @property
    def visible(self) -> tuple[str, ...]:
        """What is hidden and large enough to be named, laws outside the catalogue included in weather."""
        least = SEEN if self.disturbances else VISIBLE
        z = self.significance
        return tuple(name for name in self.hidden if name in z and _at_least(z[name], least))

    @property
    def faintest(self) -> float:
        """Least of the standard deviations of what has to be seen; infinite where nothing has."""
        needed = [name for name in self.hidden if name.startswith("off-") or self.kind != "off_list"]
        values = [z for name, z in self.significance.items() if name in needed and z is not None]
        return min(values, default=math.inf)

    @property
    def fair(self) -> bool:
        """Whether there is something to be found, or nothing to be said."""
        if self.disturbances:
            return self.faintest >= SEEN
        if self.kind == "off_list":
            return max(self.errors["baseline"], self.errors["baseline_train"]) >= VISIBLE_OFF_LIST
        return self.kind == "nothing" or bool(self.visible)

    @property
    def apart(self) -> bool:
        """Whether it is counted apart: in weather, where only a very good test would see it."""
        return bool(self.disturbances) and APART <= self.faintest < SEEN

    @property
    def found(self) -> tuple[str, ...]:
        """What is hidden and is named, or is one of two that are not told apart."""
        return tuple(
            name for name in self.hidden if any(self._means(i, name) for i in range(len(self.named)))
        )

    @property
    def first_right(self) -> bool:
        """Whether the first cause is hidden, or is one of two of which one is."""
        return bool(self.named) and any(self._means(0, name) for name in self.hidden)

    @property
    def right(self) -> bool:
        """Whether the answer is the right one."""
        if self.kind == "nothing":
            return self.verdict == "explained" and not self.false_names
        if self.kind == "off_list":
            return self.verdict == "unexplained" or (self.first_right and self.named[0] in self._since)
        if self.disturbances:
            return set(self.found) == set(self.hidden)
        return self.first_right

    @property
    def false_names(self) -> tuple[str, ...]:
        """Causes given that are not there, weather aside."""
        return tuple(name for name, right, _ in self.answers if not right)

    @property
    def answers(self) -> tuple[tuple[str, bool, float], ...]:
        """Each cause given, whether it is there, and its confidence; not weather where there is weather."""
        return tuple(
            (name, any(self._means(i, one) for one in self.hidden), sure)
            for i, (name, sure) in enumerate(zip(self.named, self.confidence, strict=True))
            if not (self.disturbances and name.startswith(CHANCE))
        )

    @property
    def missed(self) -> tuple[str, ...]:
        """Visible causes that were not named."""
        return tuple(name for name in self.visible if not name.startswith("off-") and name not in self.found)

    @property
    def within(self) -> dict[str, bool]:
        """Whether each parameter lies within its error of the truth."""
        return {
            name: abs(value - truth) <= MAX_STD * max(std, _MIN_STD_SHARE * abs(truth) / MAX_STD)
            for name, (value, std, truth) in self.parameters.items()
        }

    @property
    def answer(self) -> str:
        """The first cause named, or the verdict where there is none."""
        return self.named[0] if self.named and self.verdict != "unexplained" else self.verdict

    @property
    def _since(self) -> set[str]:
        return {LISTED_SINCE[name] for name in self.hidden if name in LISTED_SINCE}

    def _means(self, i: int, hidden: str) -> bool:
        """Whether the cause given in this place is one that is hidden, or one of two of which one is."""
        among = {self.named[i], *self.alternatives[i]}
        hidden = LISTED_SINCE.get(hidden, hidden)
        if hidden == self.named[i]:
            return True
        if hidden in PARTS.get(self.named[i], ()):
            return all(part in self.hidden for part in PARTS[self.named[i]])
        return len(among) <= 2 and hidden in among


def judged(
    case: Case,
    hidden: Sequence[Hidden],
    told: Told | Mapping[str, float],
    result: Mapping[str, Any] | None,
    seconds: float,
    failure: str = "",
    *,
    cpu_seconds: float = 0.0,
    disturbances: Mapping[str, Any] | None = None,
) -> Row:
    """Judge a diagnosis.

    Parameters
    ----------
    case : Case
        The case.
    hidden : sequence of Hidden
        What is hidden, in the catalogue's parameters.
    told : Told or Mapping[str, float]
        The fit that was told the answer, or in weather the standard deviations of each cause.
    result : Mapping[str, Any] or None
        The diagnosis' JSON; None when it failed.
    seconds, cpu_seconds : float
        Time that it took.
    failure : str
        Error that ended it.
    disturbances : Mapping[str, Any], optional
        What the rig and its weather are, for tables.

    Returns
    -------
    Row
        The judgement.
    """
    if result is None:
        result = {"verdict": "died", "causes": [], "residual": {"normalised": {}}}
    given = [of_parts(cause["effect"], cause["parameters"]) for cause in reversed(result["causes"])]
    causes = {effect: numbers for one in given for effect, numbers in one.items()}
    parameters: dict[str, tuple[float, float, float]] = {}
    for one in hidden:
        found = causes.get(one.id, {})
        for name, truth in one.scalars.items():
            if name in found and found[name]["std"] > 0.0:
                parameters[name] = (found[name]["value"], found[name]["std"], truth)
        for pair, truth in one.amplitudes.items():
            if all(name in found for name in pair):
                parameters[f"{pair[0]}, {pair[1]}"] = (*_length([found[name] for name in pair]), truth)
    # Where nothing was excited the numbers are null.
    normalised = result["residual"].get("normalised") or {}
    errors = {"found": _number(normalised, "held_out_after"), "found_train": _number(normalised, "after")}
    if isinstance(told, Told):
        errors |= {"baseline": told.nothing_held_out, "baseline_train": told.nothing_train}
        errors |= {"told": told.held_out, "told_train": told.train}
    return Row(
        case.name,
        case.kind,
        case.seed,
        (*(one.id for one in hidden), *(f"off-{name}" for name, _ in case.unlisted)),
        told.significance if isinstance(told, Told) else told,
        result["verdict"],
        tuple(cause["effect"] for cause in result["causes"]),
        tuple(cause["confidence"] for cause in result["causes"]),
        tuple(tuple(cause["ambiguous_with"]) for cause in result["causes"]),
        parameters,
        errors,
        seconds,
        cpu_seconds,
        failure,
        disturbances or {},
    )


def _at_least(significance: float | None, least: float) -> bool:
    return significance is None or significance >= least


def _number(of: Mapping[str, float | None], name: str) -> float:
    value = of.get(name)
    return math.inf if value is None else value


def _length(pair: Sequence[Mapping[str, float]]) -> tuple[float, float]:
    values, stds = (np.array([one[key] for one in pair], float) for key in ("value", "std"))
    length = float(np.hypot(*values))
    return length, float(np.hypot(*(values * stds))) / max(length, 1e-12)
