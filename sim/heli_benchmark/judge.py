"""Comparison of a diagnosis with the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from heli_benchmark.cases.clean import Case
from heli_benchmark.task import PARTS, of_parts
from heli_benchmark.truth import InformedFit, TrueEffect

MIN_SIGNIFICANCE = 3.0
"""Size in standard errors, in the fit with the true causes, from which an effect must be named."""
MIN_NOTICEABLE_ERROR = 1.05
"""Normalised error of the refitted baseline from which an unlisted effect must be noticed."""
MIN_VISIBILITY_STD = 15.0
"""Visibility in standard deviations from which a cause counts under disturbances.

Below it, a method that must choose among thirty causes and estimate the disturbances may miss a cause for
good reasons. With a higher limit only obvious cases would count.
"""
MIN_BORDERLINE_STD = 8.0
"""Visibility from which a case counts as borderline; below it, even the best test would need luck."""
MAX_STD = 2.0
"""Standard errors within which an estimate counts as right: 95 % of them, if the errors are right."""
_MIN_STD_SHARE = 1e-3
"""Tolerance of an estimate as a share of the truth: two simulation engines agree no better."""
RANDOM_TORQUE = "random_torque"
"""Effect that describes disturbances: never a false name in a disturbed case."""
LISTED_SINCE = {"off-pitch_drag_quadratic": "pitch_drag_quadratic"}
"""Effects that were unlisted when their cases were drawn, and their present name."""


@dataclass(frozen=True)
class NamedCause:
    """A cause that a diagnosis named."""

    name: str  # Effect of the catalogue
    is_hidden: bool
    """Whether the effect is hidden in the flights, or is one of two that the diagnosis does not distinguish.
    """
    confidence: float  # Confidence of the diagnosis


@dataclass(frozen=True)
class Row:
    """Result of one case."""

    case: str  # case, kind: Name and kind of the case
    kind: str
    seed: int
    hidden: tuple[str, ...]  # Ids of the hidden effects; unlisted ones begin with ``off-``
    significance: Mapping[str, float | None]
    """Their sizes in standard errors of the fit with the true causes; under disturbances their visibility."""
    verdict: str  # Verdict of the diagnosis
    named: tuple[str, ...]  # Causes in the order of the diagnosis
    confidence: tuple[float, ...]  # Confidence of each cause
    alternatives: tuple[tuple[str, ...], ...]  # Effects that each cause is ambiguous with
    parameters: Mapping[str, tuple[float, float, float]]
    """Value, standard error and truth of each parameter that the generator defines as the catalogue does."""
    errors: Mapping[str, float]
    """Normalised errors on the validation flight: ``found`` of the diagnosis and, on clean flights,
    ``baseline`` and ``informed`` of the reference fits; the same on the training flight with ``_train``."""
    seconds: float  # seconds, cpu_seconds: Elapsed time and CPU time of the diagnosis
    cpu_seconds: float = 0.0
    failure: str = ""  # Error that ended the diagnosis; empty when there was none
    disturbances: Mapping[str, Any] = field(default_factory=dict)
    """Rig, rate, controller and disturbances; empty on clean flights."""
    too_small: tuple[str, ...] = ()
    """Effects that the diagnosis lists as significant, but too small to matter."""

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> Row:
        """Create a row from `content`, its JSON form."""
        fields = {name: content[name] for name in cls.__dataclass_fields__}
        # JSON has lists only.
        for name in ("hidden", "named", "confidence", "too_small"):
            fields[name] = tuple(fields[name])
        fields["alternatives"] = tuple(tuple(alternative) for alternative in fields["alternatives"])
        fields["parameters"] = {name: tuple(numbers) for name, numbers in fields["parameters"].items()}
        return cls(**fields)

    @property
    def visible(self) -> tuple[str, ...]:
        """Hidden effects that are large enough to be named; under disturbances, also unlisted ones."""
        threshold = MIN_VISIBILITY_STD if self.disturbances else MIN_SIGNIFICANCE
        z = self.significance
        return tuple(name for name in self.hidden if name in z and _is_at_least(z[name], threshold))

    @property
    def least_visibility_std(self) -> float:
        """Smallest visibility of the effects that must be named; infinite without any."""
        # In a case with an unlisted effect, only the unlisted ones must be noticed.
        required = [name for name in self.hidden if name.startswith("off-") or self.kind != "off_list"]
        values = [z for name, z in self.significance.items() if name in required and z is not None]
        return min(values, default=math.inf)

    @property
    def counts(self) -> bool:
        """Whether the case counts: its effects are visible, or nothing is hidden."""
        if self.disturbances:
            return self.least_visibility_std >= MIN_VISIBILITY_STD
        if self.kind == "off_list":
            return max(self.errors["baseline"], self.errors["baseline_train"]) >= MIN_NOTICEABLE_ERROR
        return self.kind == "nothing" or bool(self.visible)

    @property
    def is_borderline(self) -> bool:
        """Whether only a very good test would detect its effects under the disturbances."""
        return (
            bool(self.disturbances) and MIN_BORDERLINE_STD <= self.least_visibility_std < MIN_VISIBILITY_STD
        )

    @property
    def named_correctly(self) -> tuple[str, ...]:
        """Hidden effects that the diagnosis named, alone or as one of two that it does not distinguish."""
        return tuple(
            name for name in self.hidden if any(self._stands_for(i, name) for i in range(len(self.named)))
        )

    @property
    def first_right(self) -> bool:
        """Whether the first named cause, or the one effect that it is ambiguous with, is hidden."""
        return bool(self.named) and any(self._stands_for(0, name) for name in self.hidden)

    @property
    def listed_as_too_small(self) -> bool:
        """Whether no cause is named, and each hidden effect is listed as too small to matter."""
        return not self.named and bool(self.hidden) and set(self.hidden) <= set(self.too_small)

    @property
    def right(self) -> bool:
        """Whether the answer is right, by the rule for the kind of the case."""
        # Nothing hidden: explained, without a name. An unlisted effect: unexplained, or its name if the
        # catalogue lists it by now. Otherwise all hidden effects must be named, or, on clean flights, the
        # first name must be right.
        if self.kind == "nothing":
            return self.verdict == "explained" and not self.false_names
        if self.kind == "off_list":
            return self.verdict == "unexplained" or (self.first_right and self.named[0] in self._listed_since)
        if self.disturbances:
            return set(self.named_correctly) == set(self.hidden)
        return self.first_right or self.listed_as_too_small

    @property
    def false_names(self) -> tuple[str, ...]:
        """Named causes that are not hidden."""
        return tuple(cause.name for cause in self.answers if not cause.is_hidden)

    @property
    def answers(self) -> tuple[NamedCause, ...]:
        """All named causes; in a disturbed case, without those that describe the disturbances."""
        return tuple(
            NamedCause(name, any(self._stands_for(i, effect) for effect in self.hidden), confidence)
            for i, (name, confidence) in enumerate(zip(self.named, self.confidence, strict=True))
            if not (self.disturbances and name.startswith(RANDOM_TORQUE))
        )

    @property
    def missed(self) -> tuple[str, ...]:
        """Visible causes that were not named."""
        return tuple(
            name for name in self.visible if not name.startswith("off-") and name not in self.named_correctly
        )

    @property
    def within(self) -> dict[str, bool]:
        """Whether each estimate agrees with the truth within its error."""
        return {
            name: abs(value - truth) <= MAX_STD * max(std, _MIN_STD_SHARE * abs(truth) / MAX_STD)
            for name, (value, std, truth) in self.parameters.items()
        }

    @property
    def answer(self) -> str:
        """First cause named, or the verdict if there is none."""
        return self.named[0] if self.named and self.verdict != "unexplained" else self.verdict

    @property
    def _listed_since(self) -> set[str]:
        """Present names of hidden effects that the catalogue did not list when the case was drawn."""
        return {LISTED_SINCE[name] for name in self.hidden if name in LISTED_SINCE}

    def _stands_for(self, i: int, hidden: str) -> bool:
        """Whether the `i`-th named cause stands for the effect `hidden`."""
        # It does if it is that effect, if it combines that effect with others that are all hidden, or if the
        # diagnosis does not distinguish it from that effect alone.
        named = self.named[i]
        hidden = LISTED_SINCE.get(hidden, hidden)
        if hidden == named:
            return True
        if hidden in PARTS.get(named, ()):
            return all(part in self.hidden for part in PARTS[named])
        indistinguishable = {named, *self.alternatives[i]}
        return len(indistinguishable) <= 2 and hidden in indistinguishable


def judge(
    case: Case,
    hidden: Sequence[TrueEffect],
    reference: InformedFit | Mapping[str, float],
    result: Mapping[str, Any] | None,
    seconds: float,
    failure: str = "",
    *,
    cpu_seconds: float = 0.0,
    disturbances: Mapping[str, Any] | None = None,
) -> Row:
    """Judge a diagnosis; `disturbances` are those of a disturbed case."""
    if result is None:
        result = {"verdict": "failed", "causes": [], "residual": {"normalised": {}}}
    # The numbers are null if nothing was excited.
    normalised = result["residual"].get("normalised") or {}
    errors = {
        "found": _or_infinite(normalised.get("held_out_after")),
        "found_train": _or_infinite(normalised.get("after")),
    }
    if isinstance(reference, InformedFit):
        errors |= {"baseline": reference.nothing_held_out, "baseline_train": reference.nothing_train}
        errors |= {"informed": reference.held_out, "informed_train": reference.train}
    return Row(
        case.name,
        case.kind,
        case.seed,
        (*(effect.id for effect in hidden), *(f"off-{name}" for name, _ in case.unlisted)),
        reference.significance if isinstance(reference, InformedFit) else reference,
        result["verdict"],
        named=tuple(cause["effect"] for cause in result["causes"]),
        confidence=tuple(cause["confidence"] for cause in result["causes"]),
        alternatives=tuple(tuple(cause["ambiguous_with"]) for cause in result["causes"]),
        parameters=_estimates_and_truths(hidden, result["causes"]),
        errors=errors,
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        failure=failure,
        disturbances=disturbances or {},
        too_small=tuple(effect["effect"] for effect in result.get("too_small", ())),
    )


def _is_at_least(significance: float | None, threshold: float) -> bool:
    """Whether an effect must be named; one without a size parameter (None) always must."""
    return significance is None or significance >= threshold


def _or_infinite(value: float | None) -> float:
    return math.inf if value is None else value


def _estimates_and_truths(
    hidden: Sequence[TrueEffect], causes: Sequence[Mapping[str, Any]]
) -> dict[str, tuple[float, float, float]]:
    """Return estimate, standard error and true value of the parameters of hidden effects that were named."""
    # Reversed, so that the first of two causes with the same part counts.
    estimates_by_effect = {
        effect: estimates
        for cause in reversed(causes)
        for effect, estimates in of_parts(cause["effect"], cause["parameters"]).items()
    }
    parameters: dict[str, tuple[float, float, float]] = {}
    for effect in hidden:
        estimates = estimates_by_effect.get(effect.id, {})
        for name, truth in effect.scalars.items():
            if name in estimates and estimates[name]["std"] > 0.0:
                parameters[name] = (estimates[name]["value"], estimates[name]["std"], truth)
        for (sine, cosine), truth in effect.amplitudes.items():
            if sine in estimates and cosine in estimates:
                amplitude, std = _amplitude_and_error((estimates[sine], estimates[cosine]))
                parameters[f"{sine}, {cosine}"] = (amplitude, std, truth)
    return parameters


def _amplitude_and_error(pair: Sequence[Mapping[str, float]]) -> tuple[float, float]:
    """Return the amplitude of a sine and a cosine estimate, and its standard error to first order."""
    values, stds = (np.array([estimate[key] for estimate in pair], float) for key in ("value", "std"))
    amplitude = float(np.hypot(*values))
    return amplitude, float(np.hypot(*(values * stds))) / max(amplitude, 1e-12)
