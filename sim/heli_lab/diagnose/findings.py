"""What a diagnosis found as lists, dicts and numbers, which its JSON holds and its sentences are made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from heli_sim.model.parts import AXES

from heli_lab.diagnose.error_reduction import ErrorReduction
from heli_lab.diagnose.residual_analysis import ResidualAnalysis, correlates
from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.thresholds import CONFIDENCE_BESIDE_UNKNOWN, CONFIDENCE_GUST
from heli_lab.diagnose.verdict import ambiguous_with, confidence


def causes(result: Diagnosis) -> list[dict[str, Any]]:
    """Effect, parameters, confidence, sentence, equation, evidence and alternatives of each cause, strongest
    first.
    """
    causes: list[dict[str, Any]] = []
    unexplained = result.verdict.label == "unexplained"
    beside = CONFIDENCE_BESIDE_UNKNOWN if unexplained else 1.0
    for cause in result.verdict.causes:
        causes.append(
            {
                "effect": cause.candidate.id,
                "parameters": _parameters(result.values(cause)),
                "confidence": round(confidence(cause, unexplained), 3),
                "sentence": result.sentence(cause),
                "equation": result.kinds[cause.candidate.id].equation,
                "evidence": {
                    "log_likelihood_ratio_train": cause.train,
                    "log_likelihood_ratio_held_out": cause.held_out,
                    "penalty": cause.penalty,
                    "alternatives": {other.id: other.log_likelihood_ratio for other in cause.alternatives},
                },
                "ambiguous_with": ambiguous_with(cause),
            }
        )
    if result.verdict.gust:
        id_ = f"random_torque.{result.residual_analysis.axis}"
        causes.append(
            {
                "effect": id_,
                "parameters": _parameters(result.random_torque),
                "confidence": CONFIDENCE_GUST,
                "sentence": result.kinds[id_].describe(
                    {key: value for key, (value, _, _) in result.random_torque.items()},
                    {key: std for key, (_, std, _) in result.random_torque.items()},
                ),
                "equation": result.kinds[id_].equation,
                "evidence": {
                    "log_likelihood_ratio": float(result.residual_analysis.gains.max()),
                },
                "ambiguous_with": [],
            }
        )
    for term in result.absent:
        kind = result.kinds[term.id]
        (name,) = kind.size
        causes.append(
            {
                "effect": term.id,
                "parameters": _parameters({name: (term.share, term.std, "1")}),
                "confidence": round(term.confidence * beside, 3),
                "sentence": kind.describe({name: term.share}, {name: term.std}),
                "equation": kind.equation,
                "evidence": {
                    "standard_errors_from_zero": term.z_from_zero,
                    "standard_errors_from_rig": term.z_from_rig,
                },
                "ambiguous_with": [],
            }
        )
    return causes


def unexplained(result: Diagnosis) -> dict[str, Any] | None:
    """Axis, correlates and share of what no effect explains; None when nothing is."""
    if result.verdict.label != "unexplained":
        return None
    if not result.verdict.unlisted:
        # A quantity may stand there as a curve and as a straight line.
        named = list(dict.fromkeys(dependence.what for dependence in result.residual_analysis.dependences))
        channel = named[0].split(" on ")[0].rpartition(".")[2]
        axis = channel if channel in AXES else result.residual_analysis.axis
        return {
            "axis": axis,
            "correlates_with": named,
            "share_of_variance": round(result.residual_analysis.share_foretold, 4),
            "log_likelihood_gain": result.residual_analysis.dependences[0].log_likelihood_gain,
        }
    strongest = result.verdict.unlisted[0]
    _, channel, on = strongest.candidate.id.split(":")
    first = next(r for r in result.search.rounds if r.taken == strongest.candidate.id)
    others = [name for name in correlates(first.splines) if name != f"{channel} on {on}"]
    where = channel.rpartition(".")[2]
    axis = where if where in AXES else ("pitch" if where == "difference" else "elevation")
    return {
        "axis": axis,
        "channel": channel,
        "correlates_with": [f"{channel} on {on}", *others],
        "share_of_variance": round(max(0.0, 1.0 - result.spline_gains[axis].ratio ** 2), 4),
        "log_likelihood_gain": strongest.train,
        "splines": [cause.candidate.id.removeprefix("spline:") for cause in result.verdict.unlisted],
        "gain_with_splines": gains(result.spline_gains),
    }


def disturbances(analysis: ResidualAnalysis) -> dict[str, dict[str, float]]:
    """Torques by chance about each axis: size and memory of gusts, size of the drift, evidence."""
    disturbances = analysis.disturbances
    return {
        axis: {
            "fast_std_Nm": float(disturbances.fast_std[i]),
            "correlation_time_s": float(disturbances.correlation_time_s[i]),
            "slow_std_Nm": float(disturbances.slow_std[i]),
            "log_likelihood_ratio": float(analysis.gains[i]),
        }
        for i, axis in enumerate(AXES)
    }


def gains(measured: Mapping[str, ErrorReduction]) -> dict[str, dict[str, Any]]:
    """Free-run errors before and after, ratio and interval95 of each axis."""
    return {
        axis: {
            "before": reduction.before_deg,
            "after": reduction.after_deg,
            "ratio": reduction.ratio,
            "interval95": list(reduction.interval95),
        }
        for axis, reduction in measured.items()
    }


def _parameters(values: Mapping[str, tuple[float, float, str]]) -> dict[str, dict[str, float | str]]:
    return {name: {"value": value, "std": std, "unit": unit} for name, (value, std, unit) in values.items()}
