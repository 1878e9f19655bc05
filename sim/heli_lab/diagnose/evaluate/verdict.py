"""Verdict and confidence of a diagnosis, from the evidence of the search and of the residual analysis."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from heli_sim.model.effect import Effect
from heli_sim.model.effects import EffectSpec
from heli_sim.model.parts import AXES

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.evaluate.prediction import Prediction
from heli_lab.diagnose.evaluate.reported import CauseParameter, FamilyNumber, cause_parameters, family_number
from heli_lab.diagnose.evaluate.residual_analysis import ResidualAnalysis
from heli_lab.diagnose.search import Cause, Search
from heli_lab.identify import Fit


@dataclass(frozen=True)
class NamedCause(Cause):
    """A cause that the verdict names; its attributes have the names of the JSON.

    Parameters
    ----------
    candidate, train, held_out, penalty, alternatives
        As in `Cause`, which also has ``effect`` and ``ambiguous_with``.
    parameters : Mapping[str, CauseParameter]
        By full name, such as ``rotor_lag_s``: ``value``, ``std`` and ``unit``.
    confidence : float
        Probability that the cause is named correctly, 0 to 1.
    sentence : str
        The cause with its parameters in a sentence, without its full stop.
    equation : str
        The term that the effect adds to the model, in LaTeX.
    family : FamilyNumber or None
        The number that it shares with effects that may replace it.
    """

    parameters: Mapping[str, CauseParameter]
    confidence: float
    sentence: str
    equation: str
    family: FamilyNumber | None = None


@dataclass(frozen=True)
class SmallEffect:
    """A significant effect that is too small to matter.

    Parameters
    ----------
    cause : NamedCause
        The effect with its evidence.
    change_counts : float
        Root mean square change of the 2 s open-loop prediction, encoder counts.
    """

    cause: NamedCause
    change_counts: float


@dataclass(frozen=True)
class Verdict:
    """Verdict of a diagnosis.

    Parameters
    ----------
    label : str
        ``explained``, ``cause_found``, ``ambiguous`` or ``unexplained``.
    causes : tuple of NamedCause
        Effects of the catalogue, the strongest first.
    unlisted : tuple of Cause
        Spline terms in the place of causes that the catalogue lacks, the strongest first.
    random_torque : bool
        Whether a random torque acts about a single axis, unlike the disturbances that every rig has.
    small : tuple of SmallEffect
        Significant effects that are too small to matter.
    """

    label: str
    causes: tuple[NamedCause, ...]
    unlisted: tuple[Cause, ...]
    random_torque: bool
    small: tuple[SmallEffect, ...] = ()


def judge(
    search: Search,
    residual: ResidualAnalysis,
    after: Prediction,
    kinds: Mapping[str, EffectSpec],
    absent: bool,
    small: tuple[SmallEffect, ...] = (),
) -> Verdict:
    """Decide the verdict.

    Parameters
    ----------
    search : Search
        Causes and spline terms of the final model.
    residual : ResidualAnalysis
        Analysis of the residuals of the final model.
    after : Prediction
        Free runs of the extended model. If their errors are at the quantisation, whatever remains is too
        small to matter, however significant it is.
    absent : bool
        Whether the fit estimated a term of the baseline as zero, which is a cause too.
    small : tuple of SmallEffect
        Effects that are not causes, because they are too small to matter.
    """
    small_ids = {effect.cause.effect for effect in small}
    splines = tuple(cause for cause in search.causes if cause.candidate.is_spline)
    is_above_quantisation = max(after.train.total, after.held_out.total) > thresholds.NOISE_FLOOR
    is_predictable = bool(splines or residual.dependences)
    is_unexplained = is_above_quantisation and is_predictable
    random_torque = is_above_quantisation and not is_predictable and has_random_torque(residual, kinds)
    causes = tuple(
        _named_cause(cause, kinds, after.fit, is_unexplained)
        for cause in search.causes
        if not cause.candidate.is_spline and cause.effect not in small_ids
    )
    if is_unexplained:
        return Verdict("unexplained", causes, unlisted=splines, random_torque=False, small=small)
    if any(cause.ambiguous_with for cause in causes):
        label = "ambiguous"
    elif causes or random_torque or absent:
        label = "cause_found"
    else:
        label = "explained"
    return Verdict(label, causes, unlisted=(), random_torque=random_torque, small=small)


def with_confirmation(verdict: Verdict, unconfirmed: Collection[str]) -> Verdict:
    """Lower the confidence of causes that are not confirmed; names and label stay.

    Parameters
    ----------
    verdict : Verdict
        Verdict of `judge`, which does not depend on the confirmation.
    unconfirmed : collection of str
        Ids of the causes that are not confirmed.
    """

    def confirmed(cause: NamedCause) -> NamedCause:
        if cause.effect not in unconfirmed:
            return cause
        return replace(cause, confidence=unconfirmed_confidence(cause.confidence))

    return replace(verdict, causes=tuple(map(confirmed, verdict.causes)))


def small_effects(
    search: Search, changes: Mapping[str, float], kinds: Mapping[str, EffectSpec], fit: Fit
) -> tuple[SmallEffect, ...]:
    """Describe effects that are too small to matter.

    Parameters
    ----------
    search : Search
        Evidence of the effects.
    changes : Mapping[str, float]
        Change of the prediction by each of them, encoder counts, by id.
    kinds : Mapping[str, EffectSpec]
        Catalogue by effect id.
    fit : Fit
        Parameters of the model that has them.
    """
    return tuple(
        SmallEffect(_named_cause(cause, kinds, fit, unexplained=False), changes[cause.effect])
        for cause in search.causes
        if cause.effect in changes
    )


def _named_cause(cause: Cause, kinds: Mapping[str, EffectSpec], fit: Fit, unexplained: bool) -> NamedCause:
    """Return a cause with its parameters, confidence and description.

    `unexplained` states whether something unexplained remains, which lowers the confidence.
    """
    kind = kinds[cause.effect]
    parameters = cause_parameters(fit, kind, cause.candidate.effect.values)
    description = kind.describe(
        {name: parameter.value for name, parameter in parameters.items()},
        {name: parameter.std for name, parameter in parameters.items()},
    )
    return NamedCause(
        **vars(cause),
        parameters=parameters,
        confidence=confidence(cause, unexplained),
        sentence=description + _moments_text(cause.candidate.effect),
        equation=kind.equation,
        family=family_number(fit, kind, kinds, parameters, cause.ambiguous_with),
    )


def _moments_text(effect: Effect) -> str:
    """State the flight of an event, and its moments in other flights; empty without an event."""
    if not effect.flight:
        return ""
    others = (f", and at {at_s:.2f} s in {label}" for label, at_s in effect.other_moments_s.items())
    return f" in {effect.flight}{''.join(others)}"


def has_random_torque(residual: ResidualAnalysis, kinds: Mapping[str, EffectSpec]) -> bool:
    """Whether the fast disturbance is significant about one axis only, and of notable size and correlation
    time; `kinds` is the catalogue, which has its typical size. A thrust that varies disturbs all axes.
    """
    sorted_gains, axis = np.sort(residual.gains), AXES.index(residual.axis)
    kind = kinds.get(f"random_torque.{residual.axis}")
    min_Nm = thresholds.RANDOM_TORQUE_MIN_SHARE * kind.typical[kind.size[0]] if kind else math.inf
    return bool(
        not residual.thrust_gains.size
        and sorted_gains[-1] > thresholds.RANDOM_TORQUE_NATS > sorted_gains[-2]
        and residual.disturbances.fast_std[axis] > min_Nm
        and residual.disturbances.correlation_time_s[axis] > thresholds.RANDOM_TORQUE_MIN_CORRELATION_s
    )


def confidence(cause: Cause, unexplained: bool = False) -> float:
    """Return the probability, 0 to 1, that a cause is named correctly.

    It grows with the lead over no cause and over the closest alternative, and with the log-likelihood ratio
    on the held-out flights.

    Parameters
    ----------
    unexplained : bool
        Whether something unexplained remains, which the cause may imitate; the confidence is less then.
    """
    leads = [alternative.log_likelihood_ratio for alternative in cause.alternatives]
    margin = min([cause.train - cause.penalty, *leads])
    probability = 1.0 - 0.5 * math.exp(-max(margin, 0.0) / thresholds.CONFIDENCE_NATS)
    if cause.held_out is not None:
        # A ratio of 0 nats on flights that had no part in the choice: by these alone, even odds.
        probability *= 1.0 / (1.0 + math.exp(-cause.held_out / thresholds.HELD_OUT_NATS))
    factor = thresholds.CONFIDENCE_FACTOR_UNEXPLAINED if unexplained else 1.0
    return float(min(thresholds.MAX_CONFIDENCE, probability) * factor)


def unconfirmed_confidence(probability: float) -> float:
    """Return the confidence of a cause that is not confirmed: limited, because one direction is the evidence.

    Parameters
    ----------
    probability : float
        Its confidence if it were confirmed, 0 to 1.
    """
    return min(probability, thresholds.MAX_CONFIDENCE_UNCONFIRMED)
