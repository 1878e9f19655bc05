"""What a diagnosis found as lists, dicts and numbers, which its JSON holds and its sentences are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from heli_sim.model.parts import AXES

from heli_lab.diagnose.error_reduction import ErrorReduction
from heli_lab.diagnose.residual_analysis import ResidualAnalysis, correlates
from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.thresholds import CONFIDENCE_BESIDE_UNKNOWN, CONFIDENCE_GUST


def causes(found: Diagnosis) -> list[dict[str, Any]]:
    """Effect, parameters, confidence, sentence, equation, evidence and alternatives of each cause, strongest
    first.
    """
    causes: list[dict[str, Any]] = []
    beside = CONFIDENCE_BESIDE_UNKNOWN if found.verdict.label == "unexplained" else 1.0
    for one in found.verdict.causes:
        causes.append(
            {
                "effect": one.effect,
                "parameters": {name: asdict(number) for name, number in one.parameters.items()},
                "confidence": round(one.confidence, 3),
                "sentence": one.sentence,
                "equation": one.equation,
                "evidence": {
                    "log_likelihood_ratio_train": one.train,
                    "log_likelihood_ratio_held_out": one.held_out,
                    "penalty": one.penalty,
                    "alternatives": {other.id: other.log_likelihood_ratio for other in one.alternatives},
                },
                "ambiguous_with": list(one.ambiguous_with),
            }
        )
    if found.verdict.gust:
        id_ = f"random_torque.{found.residual_analysis.axis}"
        causes.append(
            {
                "effect": id_,
                "parameters": _parameters(found.random_torque),
                "confidence": CONFIDENCE_GUST,
                "sentence": found.kinds[id_].describe(
                    {key: value for key, (value, _, _) in found.random_torque.items()},
                    {key: std for key, (_, std, _) in found.random_torque.items()},
                ),
                "equation": found.kinds[id_].equation,
                "evidence": {
                    "log_likelihood_ratio": float(found.residual_analysis.gains.max()),
                },
                "ambiguous_with": [],
            }
        )
    for term in found.absent:
        kind = found.kinds[term.id]
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


def unexplained(found: Diagnosis) -> dict[str, Any] | None:
    """Axis, correlates and share of what no effect explains; None when nothing is."""
    if found.verdict.label != "unexplained":
        return None
    if not found.verdict.off_list:
        # A quantity may stand there as a curve and as a straight line.
        named = list(dict.fromkeys(one.what for one in found.residual_analysis.dependences))
        channel = named[0].split(" on ")[0].rpartition(".")[2]
        axis = channel if channel in AXES else found.residual_analysis.axis
        return {
            "axis": axis,
            "correlates_with": named,
            "share_of_variance": round(found.residual_analysis.share_foretold, 4),
            "log_likelihood_gain": found.residual_analysis.dependences[0].log_likelihood_gain,
        }
    strongest = found.verdict.off_list[0]
    _, channel, on = strongest.candidate.id.split(":")
    first = next(r for r in found.search.rounds if r.taken == strongest.candidate.id)
    others = [name for name in correlates(first.splines) if name != f"{channel} on {on}"]
    where = channel.rpartition(".")[2]
    axis = where if where in AXES else ("pitch" if where == "difference" else "elevation")
    return {
        "axis": axis,
        "channel": channel,
        "correlates_with": [f"{channel} on {on}", *others],
        "share_of_variance": round(max(0.0, 1.0 - found.spline_gains[axis].ratio ** 2), 4),
        "log_likelihood_gain": strongest.train,
        "splines": [one.candidate.id.removeprefix("spline:") for one in found.verdict.off_list],
        "gain_with_splines": gains(found.spline_gains),
    }


def weather(left: ResidualAnalysis) -> dict[str, dict[str, float]]:
    """Torques by chance about each axis: size and memory of gusts, size of the drift, evidence."""
    weather = left.weather
    return {
        axis: {
            "gust_Nm": float(weather.gust_Nm[i]),
            "memory_s": float(weather.memory_s[i]),
            "drift_Nm": float(weather.drift_Nm[i]),
            "log_likelihood_ratio": float(left.gains[i]),
        }
        for i, axis in enumerate(AXES)
    }


def gains(measured: Mapping[str, ErrorReduction]) -> dict[str, dict[str, Any]]:
    """Free-run errors before and after, ratio and interval95 of each axis."""
    return {
        axis: {
            "before": one.before_deg,
            "after": one.after_deg,
            "ratio": one.ratio,
            "interval95": list(one.interval95),
        }
        for axis, one in measured.items()
    }


def _parameters(values: Mapping[str, tuple[float, float, str]]) -> dict[str, dict[str, float | str]]:
    return {name: {"value": value, "std": std, "unit": unit} for name, (value, std, unit) in values.items()}
