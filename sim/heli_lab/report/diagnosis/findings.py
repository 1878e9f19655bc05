"""Findings of a diagnosis as lists, dicts and numbers, for its JSON and its sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from heli_sim.model.effect import NEVER_s
from heli_sim.model.parts import AXES

from heli_lab.explain.evaluate.error_reduction import ErrorReduction
from heli_lab.explain.evaluate.kicks import Kicks
from heli_lab.explain.evaluate.reported import CauseParameter
from heli_lab.explain.evaluate.residual_analysis import ResidualAnalysis, correlates
from heli_lab.explain.evaluate.verdict import NamedCause
from heli_lab.explain.result import Diagnosis
from heli_lab.explain.thresholds import CONFIDENCE_FACTOR_UNEXPLAINED, CONFIDENCE_RANDOM_TORQUE
from heli_lab.explain.wording import dependence_in_words


def causes(result: Diagnosis) -> list[dict[str, Any]]:
    """List the causes, the strongest first, each as a JSON object.

    A cause has an effect, parameters, confidence, a sentence, an equation, evidence, and alternatives.
    """
    return [*_effect_causes(result), *_random_torque_causes(result), *_absent_term_causes(result)]


def _effect_causes(result: Diagnosis) -> list[dict[str, Any]]:
    """Return the causes that are effects of the catalogue."""
    return [
        {
            "effect": cause.effect,
            "parameters": _parameter_entries(cause.parameters),
            "confidence": round(cause.confidence, 3),
            "sentence": cause.sentence,
            "equation": cause.equation,
            "evidence": {
                "log_likelihood_ratio_train": cause.train,
                "log_likelihood_ratio_held_out": cause.held_out,
                "penalty": cause.penalty,
                "alternatives": {other.id: other.log_likelihood_ratio for other in cause.alternatives},
            },
            "ambiguous_with": list(cause.ambiguous_with),
            **_replication_of_cause(cause, result),
            **_event_times(cause, result),
            **_family_and_remark(cause),
        }
        for cause in result.verdict.causes
    ]


def too_small_effects(result: Diagnosis) -> list[dict[str, Any]]:
    """List significant effects that are too small to matter, each as a JSON object.

    ``change_counts`` is by how many encoder counts an effect changes the open-loop prediction.
    """
    return [
        {
            "effect": effect.cause.effect,
            "parameters": _parameter_entries(effect.cause.parameters),
            "sentence": effect.cause.sentence,
            "change_counts": effect.change_counts,
            "log_likelihood_ratio": effect.cause.train,
        }
        for effect in result.verdict.small
    ]


def small_remainder(result: Diagnosis) -> list[dict[str, Any]]:
    """List significant dependences that no effect explains and that are too small to matter, each as a JSON
    object.
    """
    return [
        {
            "dependence": dependence.what,
            "sentence": dependence_in_words(dependence.what),
            "change_counts": dependence.change_counts,
            "log_likelihood_gain": dependence.log_likelihood_gain,
        }
        for dependence in result.verdict.remainder
    ]


def _replication_of_cause(cause: NamedCause, result: Diagnosis) -> dict[str, Any]:
    """Return whether a cause is confirmed, its ratios in both directions, and the reason if it is not."""
    replication = result.replication.causes[cause.effect]
    return {
        "confirmed": replication.confirmed,
        "replication": {
            "log_likelihood_ratio": {"forward": replication.forward, "reverse": replication.reverse},
            "why_not": replication.why_not or None,
        },
    }


def _family_and_remark(cause: NamedCause) -> dict[str, dict[str, Any]]:
    """Return the number of a cause's family, with a remark if its members are not distinguished."""
    family = cause.family
    if family is None:
        return {}
    unclear = bool({*cause.ambiguous_with} & {*family.members})
    text = f"{family.sentence}; {family.unclear}" if unclear else family.sentence
    return {
        "family": {
            "name": family.name,
            "value": family.value,
            "std": family.std,
            "unit": family.unit,
            "members": list(family.members),
            "sentence": text,
        }
    }


def _event_times(cause: NamedCause, result: Diagnosis) -> dict[str, dict[str, float | None]]:
    """Return the times of an effect that begins during a flight, as the entry ``moments_s`` of the cause:
    time [s] by label of the flight, None in a flight in which it does not begin. Empty for other effects.
    """
    effect = cause.candidate.effect
    if not effect.flight:
        return {}
    after = result.assessment.after
    records = [
        *after.fit.problem.records,
        *(after.held_out_fit.problem.records if after.held_out_fit else ()),
    ]
    values = {name: number.value for name, number in cause.parameters.items()}
    times_s = {record.label: effect.values_in(record.label, values)[effect.moment] for record in records}
    return {"moments_s": {label: None if at_s == NEVER_s else at_s for label, at_s in times_s.items()}}


def _random_torque_causes(result: Diagnosis) -> list[dict[str, Any]]:
    """Return the cause of a random torque about a single axis, if the verdict has one."""
    return [
        {
            "effect": id_,
            "parameters": _parameter_entries(values),
            "confidence": CONFIDENCE_RANDOM_TORQUE,
            "sentence": result.kinds[id_].describe(
                {key: number.value for key, number in values.items()},
                {key: number.std for key, number in values.items()},
            ),
            "equation": result.kinds[id_].equation,
            "evidence": {"log_likelihood_ratio": float(result.assessment.residual_analysis.gains.max())},
            "ambiguous_with": [],
        }
        for id_, values in result.random_torque.items()
    ]


def _absent_term_causes(result: Diagnosis) -> list[dict[str, Any]]:
    """Return the causes that are absent terms of the baseline."""
    factor = CONFIDENCE_FACTOR_UNEXPLAINED if result.label == "unexplained" else 1.0
    absent_causes = []
    for term in result.assessment.absent:
        kind = result.kinds[term.id]
        (name,) = kind.size
        absent_causes.append(
            {
                "effect": term.id,
                "parameters": _parameter_entries({name: CauseParameter(term.share, term.std, "1")}),
                "confidence": round(term.confidence * factor, 3),
                "sentence": kind.describe({name: term.share}, {name: term.std}),
                "equation": kind.equation,
                "evidence": {
                    "standard_errors_from_zero": term.z_from_zero,
                    "standard_errors_from_rig": term.z_from_rig,
                },
                "ambiguous_with": [],
            }
        )
    return absent_causes


def unexplained(result: Diagnosis) -> dict[str, Any] | None:
    """Describe the dependence that no effect explains; None if everything is explained.

    The description has the axis, the dependences, and the share of the variance.
    """
    if result.missing is None:
        return None
    axis, quantity = result.missing
    residual = result.assessment.residual_analysis
    if not result.verdict.unlisted:
        # The same quantity may be listed as a spline and as a linear term.
        dependence_names = list(dict.fromkeys(dependence.what for dependence in residual.dependences))
        return {
            "axis": axis,
            "correlates_with": dependence_names,
            "share_of_variance": round(residual.predictable_share, 4),
            "log_likelihood_gain": residual.dependences[0].log_likelihood_gain,
        }
    strongest = result.verdict.unlisted[0]
    channel, _ = strongest.candidate.dependence
    round_of_term = next(
        round_ for round_ in result.search.rounds if round_.accepted_id == strongest.candidate.id
    )
    others = [name for name in correlates(round_of_term.splines) if name != f"{channel} on {quantity}"]
    reductions = result.held_out.splines
    return {
        "axis": axis,
        "channel": channel,
        "correlates_with": [f"{channel} on {quantity}", *others],
        "share_of_variance": round(max(0.0, 1.0 - reductions[axis].ratio ** 2), 4),
        "log_likelihood_gain": strongest.train,
        "splines": [cause.candidate.id.removeprefix("spline:") for cause in result.verdict.unlisted],
        "gain_with_splines": reductions_json(reductions),
    }


def disturbances(analysis: ResidualAnalysis) -> dict[str, dict[str, float]]:
    """Write the disturbances about each axis.

    They have size and correlation time of the fast part, size of the slow part, a log-likelihood ratio, and
    kicks.
    """
    estimated, none = analysis.disturbances, Kicks(0, 0.0)
    return {
        axis: {
            "fast_std_Nm": float(estimated.fast_std[i]),
            "correlation_time_s": float(estimated.correlation_time_s[i]),
            "slow_std_Nm": float(estimated.slow_std[i]),
            "log_likelihood_ratio": float(analysis.gains[i]),
            "kicks": analysis.kicks.get(axis, none).count,
            "largest_kick_Nms": analysis.kicks.get(axis, none).largest_Nms,
        }
        for i, axis in enumerate(AXES)
    }


def thrust_noise(analysis: ResidualAnalysis) -> dict[str, dict[str, float]] | None:
    """Write how much the thrusts vary at random; None if torques suffice as disturbances.

    ``supply`` is a relative variation of both thrusts together, ``difference`` one of the rotors against
    each other.
    """
    estimated = analysis.disturbances
    if not estimated.gains:
        return None
    return {
        name: {
            "std": gain.std,
            "correlation_time_s": gain.correlation_time_s,
            "log_likelihood_ratio": float(ratio),
        }
        for name, gain, ratio in zip(
            ("supply", "difference"), estimated.gains, analysis.thrust_gains, strict=True
        )
    }


def reductions_json(reductions: Mapping[str, ErrorReduction]) -> dict[str, dict[str, Any]]:
    """Write error `reductions` by axis: errors before and after in degrees, ratio and its 95 % interval."""
    return {
        axis: {
            "before": reduction.before_deg,
            "after": reduction.after_deg,
            "ratio": reduction.ratio,
            "interval95": list(reduction.interval95),
        }
        for axis, reduction in reductions.items()
    }


def _parameter_entries(parameters: Mapping[str, CauseParameter]) -> dict[str, dict[str, float | str]]:
    """Write parameters by name: value, standard error and unit."""
    return {name: asdict(parameter) for name, parameter in parameters.items()}
