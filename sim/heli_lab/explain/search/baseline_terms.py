"""Terms of the baseline that may be absent although the rig file specifies their parameters tightly.

A parameter with a wide prior, such as a friction, is estimated as zero if its term is absent. A narrow
prior, such as that of a pendulum's length, prevents this: the model is refitted without the term, in
competition with the effects that may be tried in its place.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from heli_sim.model.effects import EffectSpec
from heli_sim.rig import Prior, Rig

from heli_lab.explain import thresholds
from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.screening import Screening

_ABSENT_PRIOR: Final = Prior(1.0, 0.03, 0.0, 1.0)
"""Prior of the share of a term that is absent: all of it. With a wider prior, a share of the term would
replace a parameter that is merely wrong."""
_SCORE_PRIOR: Final = Prior(0.0, 1.0, 0.0, 1.0)
_START_SHARE: Final = 0.99
"""Just inside the bound of that prior."""


@dataclass(frozen=True)
class RemovedTerm:
    """A term of the baseline that the model is to be refitted without."""

    candidate: Candidate  # The removal of the term as an effect
    start: Mapping[str, float]  # Parameter values to refit from, by full name
    log_likelihood_gain: float  # Gain that is expected of the refit, nats


def tightly_specified(kind: EffectSpec, rig: Rig) -> bool:
    """Whether a `rig` file gives the parameters of a term such narrow priors that no fit estimates them as
    zero; False if the rig does not have the term.
    """
    return bool(kind.override) and all(
        name in rig and 0.0 < rig[name].tolerance < thresholds.TIGHT_TOLERANCE * rig[name].value
        for name in kind.override
    )


def tightly_specified_terms(
    comparison: ModelComparison, kinds: Iterable[EffectSpec], screening: Screening
) -> list[RemovedTerm]:
    """Find tightly specified terms that the score test removes nearly as a whole, or whose parameters the fit
    has made much smaller than their priors allow.
    """
    present_names = {effect.name for effect in screening.estimate.parameter_vector.model.effects}
    removals = [
        kind
        for kind in kinds
        if kind.baseline
        and kind.id not in present_names
        and kind.suits(comparison.model)
        and tightly_specified(kind, comparison.rig)
    ]
    share_candidates = [
        Candidate(kind.id, replace(kind.make(), priors={kind.size[0]: _SCORE_PRIOR}), kind.size)
        for kind in removals
    ]
    low, high = thresholds.ABSENT_SHARE_RANGE
    removed_terms = []
    for kind, (score, coefficients, _) in zip(removals, screening.score(share_candidates), strict=True):
        removed_by_score = score if low < coefficients[0] < high else 0.0
        gain = max(removed_by_score, _shrunk_prior_nats(screening, kind))
        if gain < thresholds.ABSENT_MIN_NATS:
            continue
        (name,) = kind.size
        candidate = Candidate(kind.id, replace(kind.make({name: 1.0}), priors={name: _ABSENT_PRIOR}), (name,))
        start = {parameter: comparison.rig[parameter].value for parameter in kind.override}
        removed_terms.append(RemovedTerm(candidate, {**start, name: _START_SHARE}, gain))
    return removed_terms


def _shrunk_prior_nats(screening: Screening, kind: EffectSpec) -> float:
    """Return the log-likelihood that the priors of a term's parameters cost, because the fit has made them
    smaller than the rig file states, nats.

    Without the term, the parameters return to their priors, so that a refit gains this much.
    """
    estimate = screening.estimate
    deviations: dict[str, float] = estimate.parameter_vector.by_name(estimate.prior_deviations)
    shrunk = (min(deviations[name], 0.0) for name in kind.override if name in deviations)
    return 0.5 * sum(deviation**2 for deviation in shrunk)
