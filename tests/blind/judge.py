"""Compares what a diagnosis says with what was hidden."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.blind.cases import Case
from tests.blind.oracle import Told
from tests.blind.truth import Hidden

VISIBLE = 3.0
"""Standard errors of its size, in the fit told the answer, below which an effect need not be named."""
VISIBLE_OFF_LIST = 1.05
"""Normalised error of the refitted baseline from which on an effect outside the catalogue must be noticed."""
MOST_STD = 3.0
_LEAST_STD_SHARE = 1e-3


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
    visible : tuple of str
        Those of the catalogue that are significant in a fit that is told the answer.
    significance : Mapping[str, float | None]
        Their sizes in standard errors, by that fit.
    verdict : str
        The diagnosis' verdict.
    named : tuple of str
        Causes given, first one first.
    confidence : tuple of float
        Of each.
    ambiguous_with : tuple of str
        Alternatives of the first cause.
    parameters : Mapping[str, tuple]
        Value, standard error and truth of each parameter that the generator defines as the catalogue does.
    errors : Mapping[str, float]
        Normalised errors: ``baseline``, ``found`` and ``told``, held out, and the same with ``_train``.
    seconds : float
        Time that the diagnosis took.
    failure : str
        Error that ended the diagnosis; empty when there was none.
    """

    case: str
    kind: str
    seed: int
    hidden: tuple[str, ...]
    visible: tuple[str, ...]
    significance: Mapping[str, float | None]
    verdict: str
    named: tuple[str, ...]
    confidence: tuple[float, ...]
    ambiguous_with: tuple[str, ...]
    parameters: Mapping[str, tuple[float, float, float]]
    errors: Mapping[str, float]
    seconds: float
    failure: str = ""

    @property
    def fair(self) -> bool:
        """Whether there is something to be found, or nothing to be said."""
        if self.kind == "off_list":
            return max(self.errors["baseline"], self.errors["baseline_train"]) >= VISIBLE_OFF_LIST
        return self.kind == "nothing" or bool(self.visible)

    @property
    def first_right(self) -> bool:
        """Whether the first cause is hidden, or is one of two of which one is."""
        if not self.named:
            return False
        among = {self.named[0], *self.ambiguous_with}
        return self.named[0] in self.hidden or (len(among) <= 2 and bool(among & set(self.hidden)))

    @property
    def right(self) -> bool:
        """Whether the answer is the right one."""
        if self.kind == "nothing":
            return self.verdict == "explained" and not self.named
        if self.kind == "off_list":
            return self.verdict == "unexplained"
        return self.first_right

    @property
    def spurious(self) -> tuple[str, ...]:
        """Causes that are not there."""
        return tuple(name for name in self.named if name not in self.hidden)

    @property
    def missed(self) -> tuple[str, ...]:
        """Visible causes that were not named."""
        return tuple(name for name in self.visible if name not in self.named)

    @property
    def within(self) -> dict[str, bool]:
        """Whether each parameter lies within its error of the truth."""
        return {
            name: abs(value - truth) <= MOST_STD * max(std, _LEAST_STD_SHARE * abs(truth) / MOST_STD)
            for name, (value, std, truth) in self.parameters.items()
        }

    @property
    def answer(self) -> str:
        """The first cause named, or the verdict where there is none."""
        return self.named[0] if self.named and self.verdict != "unexplained" else self.verdict


def judged(
    case: Case,
    hidden: Sequence[Hidden],
    told: Told,
    result: Mapping[str, Any] | None,
    seconds: float,
    failure: str = "",
) -> Row:
    """Judge a diagnosis.

    Parameters
    ----------
    case : Case
        The case.
    hidden : sequence of Hidden
        What is hidden, in the catalogue's parameters.
    told : Told
        The fit that was told the answer.
    result : Mapping[str, Any] or None
        The diagnosis' JSON; None when it failed.
    seconds : float
        Time that it took.
    failure : str
        Error that ended it.

    Returns
    -------
    Row
        The judgement.
    """
    if result is None:
        result = {"verdict": "died", "causes": [], "residual": {"normalised": {}}}
    causes = {cause["effect"]: cause["parameters"] for cause in reversed(result["causes"])}
    first = result["causes"][0] if result["causes"] else {"ambiguous_with": ()}
    parameters: dict[str, tuple[float, float, float]] = {}
    for one in hidden:
        found = causes.get(one.id, {})
        for name, truth in one.scalars.items():
            if name in found and found[name]["std"] > 0.0:
                parameters[name] = (found[name]["value"], found[name]["std"], truth)
        for pair, truth in one.amplitudes.items():
            if all(name in found for name in pair):
                parameters[f"{pair[0]}, {pair[1]}"] = (*_length([found[name] for name in pair]), truth)
    normalised = result["residual"]["normalised"]
    z = told.significance
    return Row(
        case.name,
        case.kind,
        case.seed,
        (*(one.id for one in hidden), *(f"off-{name}" for name, _ in case.off_list)),
        tuple(one.id for one in hidden if _visible(z[one.id])),
        z,
        result["verdict"],
        tuple(cause["effect"] for cause in result["causes"]),
        tuple(cause["confidence"] for cause in result["causes"]),
        tuple(first["ambiguous_with"]),
        parameters,
        {
            "baseline": told.nothing_held_out,
            "found": normalised.get("held_out_after", math.inf),
            "told": told.held_out,
            "baseline_train": told.nothing_train,
            "found_train": normalised.get("after", math.inf),
            "told_train": told.train,
        },
        seconds,
        failure,
    )


def _visible(significance: float | None) -> bool:
    return significance is None or significance >= VISIBLE


def _length(pair: Sequence[Mapping[str, float]]) -> tuple[float, float]:
    values, stds = (np.array([one[key] for one in pair], float) for key in ("value", "std"))
    length = float(np.hypot(*values))
    return length, float(np.hypot(*(values * stds))) / max(length, 1e-12)
