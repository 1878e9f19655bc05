"""Verdict and confidence of a diagnosis, from the evidence of the search and of the residual analysis."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effect import AXES, Effect
from heli_sim.model.effects import EffectSpec
from heli_sim.model.effects.spec import format_estimate

from heli_lab.explain import thresholds
from heli_lab.explain.candidates import ScoredCandidate
from heli_lab.explain.comparison import Cause
from heli_lab.explain.forward import limited_std
from heli_lab.explain.prediction import Prediction
from heli_lab.explain.residuals import ResidualAnalysis
from heli_lab.explain.stepwise import Search
from heli_lab.explain.thresholds import DETECTION_STD_ERRORS, PRIOR_CONFLICT_STD
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.estimator import estimate as estimated
from heli_lab.fit.parameters import PriorDistribution
from heli_lab.fit.problem import Fit
from heli_lab.fit.uncertainty import uninformed_parameters


@dataclass(frozen=True)
class CauseParameter:
    """An estimated parameter of a cause."""

    value: float  # value, std: Estimate and standard error, in `unit`
    std: float
    unit: str  # SI unit; ``1`` for a parameter without one


def cause_parameters(fit: Fit, kind: EffectSpec, start: Mapping[str, float]) -> dict[str, CauseParameter]:
    """Parameters of an effect by full name, as they are reported."""
    std = limited_std(kind, fit.params, fit.std, fit.problem.records[0])
    return {
        q.name: CauseParameter(fit.params.get(q.name, start[q.name]), std.get(q.name, 0.0), q.unit)
        for q in kind.parameters
    }


@dataclass(frozen=True)
class FamilyNumber:
    """The number that a cause shares with the effects that may replace it, such as the lag of the rotors."""

    name: str  # Name of the family
    value: float  # value, std: Estimate and standard error, in `unit`
    std: float
    unit: str  # SI unit
    sentence: str  # The number in words
    unclear: str  # Statement that flights do not distinguish its members
    members: tuple[str, ...]  # Ids of the family's effects


def family_number(
    fit: Fit,
    kind: EffectSpec,
    kinds: Mapping[str, EffectSpec],
    parameters: Mapping[str, CauseParameter],
    ambiguous_with: Collection[str] = (),
) -> FamilyNumber | None:
    """Compute the number that an effect shares with its family, such as the sum of a lag and a delay; None
    without one.
    """
    # The number is a weighted sum of the effect's parameters. Its standard error follows from their
    # covariance.
    family = kind.family
    if family is None or not family.sentence:
        return None
    members = tuple(other.id for other in kinds.values() if other.family == family)
    is_ambiguous = not {*members}.isdisjoint(ambiguous_with)
    if family.in_part and not is_ambiguous:
        return None  # the number has no meaning for this effect alone
    divisor = _value_of(kind.family_divisor, fit) if kind.family_divisor else 1.0
    weights = {kind.full(name): weight / divisor for name, weight in kind.family_numbers.items()}
    names = list(weights)
    weight_vector = np.array([weights[name] for name in names])
    value = float(weight_vector @ [parameters[name].value for name in names])
    variance = float(weight_vector @ _reported_covariance(names, parameters, fit) @ weight_vector)
    std = math.sqrt(max(variance, 0.0))
    return FamilyNumber(
        name=family.name,
        value=value,
        std=std,
        unit=family.unit,
        sentence=family.sentence.format(format_estimate(value, std, family.unit)),
        unclear=family.unclear,
        members=members,
    )


def _reported_covariance(names: Sequence[str], parameters: Mapping[str, CauseParameter], fit: Fit) -> Floats:
    """Return the covariance of reported parameters: that of the fit, with the variances of the report."""
    # The fit's covariances count, because a lag and a delay compensate each other.
    covariance = np.zeros((len(names), len(names)))
    free = [index for index, name in enumerate(names) if name in fit.problem.names]
    columns = [fit.problem.names.index(names[index]) for index in free]
    covariance[np.ix_(free, free)] = fit.covariance[np.ix_(columns, columns)]
    np.fill_diagonal(covariance, [parameters[name].std ** 2 for name in names])
    return covariance


def _value_of(name: str, fit: Fit) -> float:
    """Return the estimate of a rig parameter, or its value in the rig file if it was not estimated."""
    return float(fit.params.get(name, fit.problem.rig[name].value))


@dataclass(frozen=True)
class NamedCause(Cause):
    """A cause that the verdict names; its attributes have the names of the JSON."""

    parameters: Mapping[str, CauseParameter]
    """By full name, such as ``rotor_lag_s``: ``value``, ``std`` and ``unit``."""
    confidence: float  # Probability that the cause is named correctly, 0 to 1
    sentence: str  # The cause with its parameters in a sentence, without its full stop
    equation: str  # The term that the effect adds to the model, in LaTeX
    family: FamilyNumber | None = None
    """The number that this effect shares with effects that may replace it, such as the lag of the rotors."""


@dataclass(frozen=True)
class NegligibleEffect:
    """A significant effect that is too small to matter."""

    cause: NamedCause  # The effect with its evidence
    change_counts: float  # Root mean square change of the 2 s open-loop prediction, encoder counts


@dataclass(frozen=True)
class NegligibleDependence:
    """A significant dependence that no effect of the catalogue explains, and that is too small to matter."""

    what: str  # ``CHANNEL on QUANTITY``
    change_counts: float  # Root mean square change of the 2 s open-loop prediction, encoder counts
    log_likelihood_gain: float  # Log-likelihood ratio of the model with it to the model without it, nats


@dataclass(frozen=True)
class Verdict:
    """Verdict of a diagnosis."""

    label: str  # ``explained``, ``cause_found``, ``ambiguous`` or ``unexplained``
    causes: tuple[NamedCause, ...]  # Effects of the catalogue, the strongest first
    unlisted: tuple[Cause, ...]
    """Spline terms in the place of causes that the catalogue lacks, the strongest first."""
    random_torque: bool
    """Whether a random torque acts about a single axis, unlike the disturbances that every rig has."""
    negligible_effects: tuple[NegligibleEffect, ...] = ()  # Significant effects that are too small to matter
    negligible_dependences: tuple[NegligibleDependence, ...] = ()
    """Significant dependences that no effect explains, and that are too small to matter."""


def judge(
    search: Search,
    residual: ResidualAnalysis,
    after: Prediction,
    kinds: Mapping[str, EffectSpec],
    absent: bool,
    negligible_effects: tuple[NegligibleEffect, ...] = (),
    spline_counts: float = math.inf,
) -> Verdict:
    """Decide the verdict."""
    # The label is ``unexplained`` if something remains that a better model could predict, and that matters by
    # the measure of effects. Otherwise it is ``ambiguous`` if one of the causes has a close alternative,
    # ``cause_found`` if there is a cause, and ``explained`` if the baseline needs none.
    negligible_ids = {effect.cause.effect for effect in negligible_effects}
    splines = tuple(cause for cause in search.causes if cause.candidate.is_spline)
    is_above_quantisation = max(after.train.total, after.held_out.total) > thresholds.NOISE_FLOOR
    is_predictable = bool(splines or residual.dependences)
    dependences = _negligible_dependences(splines, spline_counts, residual, after)
    is_unexplained = is_above_quantisation and len(dependences) < len(splines) + len(residual.dependences)
    random_torque = is_above_quantisation and not is_predictable and has_random_torque(residual, kinds)
    causes = tuple(
        _named_cause(cause, kinds, after.fit, is_unexplained)
        for cause in search.causes
        if not cause.candidate.is_spline and cause.effect not in negligible_ids
    )
    if is_unexplained:
        return Verdict(
            "unexplained", causes, splines, random_torque=False, negligible_effects=negligible_effects
        )
    if any(cause.ambiguous_with for cause in causes):
        label = "ambiguous"
    elif causes or random_torque or absent:
        label = "cause_found"
    else:
        label = "explained"
    negligible_dependences = dependences if is_above_quantisation else ()
    return Verdict(
        label,
        causes,
        unlisted=(),
        random_torque=random_torque,
        negligible_effects=negligible_effects,
        negligible_dependences=negligible_dependences,
    )


def _negligible_dependences(
    splines: Sequence[Cause], spline_counts: float, residual: ResidualAnalysis, after: Prediction
) -> tuple[NegligibleDependence, ...]:
    """Return what remains significant but is too small to matter; empty in large disturbances, where every
    significant effect matters.
    """
    if after.train.total > thresholds.DISTURBED_STD:
        return ()
    negligible_splines = splines if spline_counts < thresholds.MATTERS_COUNTS else ()
    return (
        *(
            NegligibleDependence(" on ".join(s.candidate.dependence), spline_counts, s.train_nats)
            for s in negligible_splines
        ),
        *(
            NegligibleDependence(dependence.what, dependence.change_counts, dependence.log_likelihood_gain)
            for dependence in residual.dependences
            if not dependence.matters
        ),
    )


def with_confirmation(verdict: Verdict, unconfirmed: Collection[str]) -> Verdict:
    """Lower the confidence of causes that are not confirmed; names and label stay."""

    def with_limited_confidence(cause: NamedCause) -> NamedCause:
        """Return a cause with a limited confidence if it is not confirmed."""
        if cause.effect not in unconfirmed:
            return cause
        return replace(cause, confidence=unconfirmed_confidence(cause.confidence))

    return replace(verdict, causes=tuple(map(with_limited_confidence, verdict.causes)))


def describe_negligible_effects(
    search: Search, changes: Mapping[str, float], kinds: Mapping[str, EffectSpec], fit: Fit
) -> tuple[NegligibleEffect, ...]:
    """Describe effects that are too small to matter."""
    return tuple(
        NegligibleEffect(_named_cause(cause, kinds, fit, unexplained=False), changes[cause.effect])
        for cause in search.causes
        if cause.effect in changes
    )


def _named_cause(cause: Cause, kinds: Mapping[str, EffectSpec], fit: Fit, unexplained: bool) -> NamedCause:
    """Return a cause with its parameters, confidence and description."""
    # `unexplained` states whether something unexplained remains, which lowers the confidence.
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
    """State in which flight an event happened, and when it happened in other flights."""
    if not effect.flight:  # no event
        return ""
    others = (f", and at {at_s:.2f} s in {label}" for label, at_s in effect.other_moments_s.items())
    return f" in {effect.flight}{''.join(others)}"


def has_random_torque(residual: ResidualAnalysis, kinds: Mapping[str, EffectSpec]) -> bool:
    """Whether a random torque acts about a single axis, unlike the disturbances that every rig has."""
    # The fast disturbance must be significant about one axis only, and have a notable size and correlation
    # time. A thrust that varies at random disturbs all axes, so it excludes a random torque.
    if residual.thrust_gains.size:
        return False
    *_, second_nats, largest_nats = np.sort(residual.gains)
    is_about_one_axis = largest_nats > thresholds.RANDOM_TORQUE_NATS > second_nats
    axis = AXES.index(residual.axis)
    kind = kinds.get(f"random_torque.{residual.axis}")
    min_Nm = thresholds.RANDOM_TORQUE_MIN_SHARE * kind.typical[kind.size[0]] if kind else math.inf
    is_large = residual.disturbances.fast_std[axis] > min_Nm
    is_correlated = (
        residual.disturbances.correlation_time_s[axis] > thresholds.RANDOM_TORQUE_MIN_CORRELATION_s
    )
    return bool(is_about_one_axis and is_large and is_correlated)


def confidence(cause: Cause, unexplained: bool = False) -> float:
    """Return the probability, 0 to 1, that a cause is named correctly."""
    # The probability grows with the lead over the closest rival, which may be the model without the cause,
    # and with the log-likelihood ratio on the held-out flights.
    lead_over_no_cause = cause.train_nats - cause.penalty
    leads = [alternative.log_likelihood_ratio for alternative in cause.alternatives]
    margin = max(min([lead_over_no_cause, *leads]), 0.0)
    # Without a lead, the cause and its closest rival are equally likely.
    probability = 1.0 - 0.5 * math.exp(-margin / thresholds.CONFIDENCE_NATS)
    if cause.held_out_nats is not None:
        # Logistic function: 0 nats on flights that had no part in the choice mean even odds.
        probability *= 1.0 / (1.0 + math.exp(-cause.held_out_nats / thresholds.HELD_OUT_NATS))
    factor = thresholds.CONFIDENCE_FACTOR_UNEXPLAINED if unexplained else 1.0
    return float(min(thresholds.MAX_CONFIDENCE, probability) * factor)


def unconfirmed_confidence(probability: float) -> float:
    """Limit the confidence of a cause that is not confirmed, because its evidence comes from one
    direction.
    """
    if probability < thresholds.CLEAR_CONFIDENCE:
        return min(probability, thresholds.MAX_CONFIDENCE_UNCLEAR)
    return min(probability, thresholds.MAX_CONFIDENCE_UNCONFIRMED)


@dataclass(frozen=True)
class EstimateWithoutPrior:
    """Estimate of a parameter from the flights alone."""

    value: float
    """value, std: Estimate and standard error without the priors of this and all other conflicting
    parameters."""
    std: float
    log_likelihood_gain: float  # Gain of the flights' log-likelihood without all these priors, nats


@dataclass(frozen=True)
class PriorConflict:
    """A parameter of the rig whose estimate conflicts with its prior."""

    name: str  # name, unit: Name of the parameter, and its unit in rig files
    unit: str
    value: float  # value, std: Estimate and standard error
    std: float
    prior: PriorDistribution  # PriorDistribution from the rig file
    freed: EstimateWithoutPrior | None = None  # Estimate without the prior; None if it was not computed

    @property
    def deviations(self) -> float:
        """Distance of the estimate from the prior's mean, in standard deviations of the prior."""
        return (self.value - self.prior.mean) / self.prior.std


def prior_conflicts(fit: Fit) -> tuple[PriorConflict, ...]:
    """Find parameters of the rig whose estimate in a `fit` is far from the prior mean, the farthest first."""
    # The limit is `PRIOR_CONFLICT_STD` standard deviations of the prior. Parameters of effects are not
    # tested.
    effect_names = {name for effect in fit.problem.model.effects for name in effect.priors}
    conflicts = (
        PriorConflict(parameter.name, parameter.unit, float(value), fit.std[parameter.name], parameter.prior)
        for parameter, value in zip(fit.problem.free, fit.theta, strict=True)
        if parameter.quantity not in effect_names
    )
    significant = [conflict for conflict in conflicts if abs(conflict.deviations) > PRIOR_CONFLICT_STD]
    return tuple(sorted(significant, key=lambda conflict: -abs(conflict.deviations)))


def tried_without(conflicts: Sequence[PriorConflict], estimate: Estimate) -> tuple[PriorConflict, ...]:
    """Estimate a model again without the priors of conflicting parameters."""
    if not conflicts:
        return ()  # no refit is needed
    parameters = estimate.parameter_vector
    names = [conflict.name for conflict in conflicts]
    indices = [parameters.names.index(name) for name in names]
    without_priors = estimated(
        parameters.without_priors(names),
        estimate.references,
        estimate.functions,
        estimate.theta,
        estimate.disturbances,
    )
    # log_likelihood includes the priors: subtract the share of the priors that were dropped.
    deviations = estimate.prior_deviations
    gain = (
        without_priors.log_likelihood
        - estimate.log_likelihood
        - 0.5 * float(deviations[indices] @ deviations[indices])
    )
    std = np.sqrt(np.diag(without_priors.covariance))
    return tuple(
        replace(
            conflict, freed=EstimateWithoutPrior(float(without_priors.theta[index]), float(std[index]), gain)
        )
        for conflict, index in zip(conflicts, indices, strict=True)
    )


def undetectable_effects(
    screened: Sequence[ScoredCandidate], kinds: Mapping[str, EffectSpec]
) -> tuple[str, ...]:
    """Find the effects that would not be significant in these flights at their typical size."""
    undetectable = []
    for scored in screened:
        kind = kinds[scored.candidate.id]
        # Without linear parameters the only regressor is the effect at the size that was tried.
        name = kind.size[0]
        size_per_coefficient = (
            1.0 if scored.candidate.linear_parameters else scored.candidate.effect.values[name]
        )
        if scored.std[0] * abs(size_per_coefficient) * DETECTION_STD_ERRORS > abs(kind.typical[name]):
            undetectable.append(kind.id)
    return tuple(sorted(undetectable))


def unidentifiable_parameters(estimate: Estimate) -> tuple[str, ...]:
    """Find the parameters of the rig whose posterior is as wide as their prior; return their names."""
    parameter_vector = estimate.parameter_vector
    return tuple(uninformed_parameters(parameter_vector.names, estimate.covariance, parameter_vector.std))
