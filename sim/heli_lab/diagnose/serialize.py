"""A diagnosis as JSON for other programs; docs/diagnosing.md describes the keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from heli_sim.model.parts import AXES

from heli_lab.diagnose.error_reduction import ErrorReduction
from heli_lab.diagnose.free_run import HORIZONS, FreeRun
from heli_lab.diagnose.insufficient_excitation import InsufficientExcitation
from heli_lab.diagnose.residual_analysis import ResidualAnalysis, correlates
from heli_lab.diagnose.result import METRIC, Diagnosis
from heli_lab.diagnose.thresholds import CONFIDENCE_BESIDE_UNKNOWN, CONFIDENCE_GUST
from heli_lab.diagnose.verdict import ambiguous_with, confidence
from heli_lab.identify import check


def to_json(result: Diagnosis | InsufficientExcitation) -> dict[str, Any]:
    """Write a `result` as lists, dicts and numbers: verdict, causes, residual, gain, unexplained, next_flight
    and more; where nothing was excited, numbers are null.
    """
    if isinstance(result, InsufficientExcitation):
        return _of_insufficient_excitation(result)
    asked = result.next_flight
    return {
        "verdict": result.label,
        "causes": causes(result),
        "residual": _residual(result),
        "weather": weather(result.residual_analysis),
        "gain": _gain(result),
        "unexplained": unexplained(result),
        "next_flight": {"why": asked.why, "plan": asked.plan} if asked else None,
        "undetectable": list(result.undetectable),
        "unidentifiable": list(result.unidentifiable),
        "cautions": result.cautions,
        "flights": _flights(result),
        "ranking": _ranking(result),
        "seconds_taken": result.seconds,
        "complete": result.search.complete,
    }


def _of_insufficient_excitation(result: InsufficientExcitation) -> dict[str, Any]:
    unknown = {"before": None, "after": None}
    gains = {axis: {**unknown, "ratio": None, "interval95": None} for axis in AXES}
    return {
        "verdict": result.label,
        "causes": [],
        "residual": {"axis": dict.fromkeys(AXES, unknown), "normalised": unknown, "white": {}},
        "gain": {
            "metric": METRIC,
            "axis": gains,
            "horizons": {key: {"axis": gains} for key in HORIZONS},
            "calibration": [],
        },
        "unexplained": None,
        "next_flight": {"why": result.next_flight.why, "plan": result.next_flight.plan},
        "why": result.why,
        "undetectable": list(result.undetectable),
        "unidentifiable": list(result.unidentifiable),
        "cautions": [],
        "flights": [],
        "ranking": [],
        "complete": True,
    }


def causes(found: Diagnosis) -> list[dict[str, Any]]:
    """Effect, parameters, confidence, sentence, equation, evidence and alternatives of each cause, strongest
    first.
    """
    causes: list[dict[str, Any]] = []
    unexplained = found.verdict.label == "unexplained"
    beside = CONFIDENCE_BESIDE_UNKNOWN if unexplained else 1.0
    for one in found.verdict.causes:
        causes.append(
            {
                "effect": one.candidate.id,
                "parameters": _parameters(found.values(one)),
                "confidence": round(confidence(one, unexplained), 3),
                "sentence": found.sentence(one),
                "equation": found.kinds[one.candidate.id].equation,
                "evidence": {
                    "log_likelihood_ratio_train": one.train,
                    "log_likelihood_ratio_held_out": one.held_out,
                    "penalty": one.penalty,
                    "alternatives": {other.id: other.log_likelihood_ratio for other in one.alternatives},
                },
                "ambiguous_with": ambiguous_with(one),
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


def _residual(found: Diagnosis) -> dict[str, Any]:
    """Normalised errors before and after by axis and of all, and whether they are white."""
    before, after = found.before, found.after
    white, correlation = {}, {}
    for role, before_fit, after_fit in (
        ("train", before.fit, after.fit),
        ("held_out", before.held_out_fit, after.held_out_fit),
    ):
        if before_fit is not None and after_fit is not None:
            checks = {"before": check(before_fit), "after": check(after_fit)}
            white[role] = {when: one.white for when, one in checks.items()}
            correlation[role] = {when: one.correlation for when, one in checks.items()}
    return {
        "axis": {
            axis: {
                "before": float(before.train.axis_normalised[i]),
                "after": float(after.train.axis_normalised[i]),
            }
            for i, axis in enumerate(AXES)
        },
        "normalised": {
            "before": before.train.normalised,
            "after": after.train.normalised,
            "held_out_before": before.held_out.normalised,
            "held_out_after": after.held_out.normalised,
        },
        "white": white,
        "correlation": correlation,
        "innovations": _innovations(found.residual_analysis),
    }


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
        "gain_with_splines": _gains(found.spline_gains),
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


def _innovations(left: ResidualAnalysis) -> dict[str, Any]:
    """Autocorrelation of the innovations, its bound for white noise, and what foretells them."""
    return {
        "lags_s": list(left.lags_s),
        "autocorrelation": {axis: left.autocorrelation[:, i].tolist() for i, axis in enumerate(AXES)},
        "bound": left.bound,
        "foretold_by": [one.what for one in left.dependences],
    }


def _flights(found: Diagnosis) -> list[dict[str, Any]]:
    """Which parts of the flights were used."""
    flights = []
    held_out = found.before.held_out_fit
    for role, fit in (("train", found.before.fit), ("held_out", held_out)):
        for record in fit.problem.records if fit is not None else ():
            flights.append(
                {
                    "flight": record.label,
                    "role": role,
                    "seconds_used": record.used_s,
                    "used": [[float(record.t_s[a]), float(record.t_s[b - 1])] for a, b in record.segments],
                    "left_out": [{"from_s": c.start_s, "to_s": c.stop_s, "why": c.why} for c in record.cuts],
                    "notes": list(record.notes),
                }
            )
    return flights


def _ranking(found: Diagnosis) -> list[dict[str, Any]]:
    """The candidates of each round with their scores."""
    rows = []
    for number, one in enumerate(found.search.rounds, 1):
        tried = {refit.candidate.id: refit for refit in one.refits}
        for scored in (*one.screened[:8], *one.splines[:3]):
            refit = tried.get(scored.candidate.id)
            rows.append(
                {
                    "round": number,
                    "candidate": scored.candidate.id,
                    "score": scored.log_likelihood_gain,
                    "train": refit.gain if refit else None,
                    "penalty": refit.penalty if refit else None,
                    "taken": scored.candidate.id == one.taken,
                }
            )
    return rows


def _parameters(values: Mapping[str, tuple[float, float, str]]) -> dict[str, dict[str, float | str]]:
    return {name: {"value": value, "std": std, "unit": unit} for name, (value, std, unit) in values.items()}


def _gain(found: Diagnosis) -> dict[str, Any]:
    """Free-run errors before and after at each horizon, and what was calibrated for them."""
    judged = found.judgement
    return {
        "metric": found.metric,
        "axis": _gains(found.gains),
        "horizons": {key: {"axis": _gains(one)} for key, one in judged.horizons.items()},
        "calibration": [
            {
                "flight": after.label,
                "calibrated_s": after.calibrated_s,
                "judged_s": after.judged_s,
                "before": _constants(before),
                "after": _constants(after),
            }
            for before, after in zip(judged.before, judged.after, strict=True)
        ],
    }


def _constants(run: FreeRun) -> dict[str, dict[str, Any]]:
    """Zeros and torques that were calibrated: value, standard error, prior and unit of each."""
    units = {quantity.name: quantity.unit for quantity in run.fit.problem.model.parameters}
    return {
        name: {
            "value": value,
            "std": std,
            "prior": {"value": run.priors[name].mean, "std": run.priors[name].std},
            "unit": units[name],
        }
        for name, (value, std) in run.constants.items()
    }


def _gains(measured: Mapping[str, ErrorReduction]) -> dict[str, dict[str, Any]]:
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
