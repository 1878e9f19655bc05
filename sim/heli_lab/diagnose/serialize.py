"""A diagnosis as JSON for other programs; docs/diagnosing.md describes the keys."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from heli_sim.model.parts import AXES

from heli_lab.diagnose.findings import causes, disturbances, gains, unexplained
from heli_lab.diagnose.free_run import HORIZONS, FreeRun
from heli_lab.diagnose.insufficient_excitation import InsufficientExcitation
from heli_lab.diagnose.residual_analysis import ResidualAnalysis
from heli_lab.diagnose.result import METRIC, Diagnosis
from heli_lab.diagnose.summary import summary
from heli_lab.identify import check


def to_json(result: Diagnosis | InsufficientExcitation) -> dict[str, Any]:
    """Write a `result` as lists, dicts and numbers: verdict, causes, residual, gain, unexplained, next_flight
    and more; where nothing was excited, numbers are null.
    """
    if isinstance(result, InsufficientExcitation):
        return _of_insufficient_excitation(result)
    experiment = result.next_flight
    return {
        "verdict": result.label,
        "sentence": summary(result),
        "causes": causes(result),
        "rig": rig_numbers(result),
        "residual": _residual(result),
        "disturbances": disturbances(result.residual_analysis),
        "gain": _gain(result),
        "unexplained": unexplained(result),
        "proposed_term": result.proposed_term.to_json() if result.proposed_term else None,
        "failing_regions": result.failing.to_json(),
        "next_flight": {"why": experiment.why, "plan": experiment.plan} if experiment else None,
        "undetectable": list(result.undetectable),
        "unidentifiable": list(result.unidentifiable),
        "prior_conflicts": [
            {
                "parameter": pull.name,
                "value": pull.value,
                "std": pull.std,
                "prior": {"value": pull.prior.mean, "std": pull.prior.std},
                "deviations": pull.deviations,
                "unit": pull.unit,
                "without_prior": asdict(pull.freed) if pull.freed else None,
            }
            for pull in result.prior_conflicts
        ],
        "cautions": result.cautions,
        "flights": _flights(result),
        "ranking": _ranking(result),
        "refits": result.refits,
        "seconds_taken": result.seconds,
        "complete": result.search.complete,
    }


def _of_insufficient_excitation(result: InsufficientExcitation) -> dict[str, Any]:
    unknown = {"before": None, "after": None}
    gains = {axis: {**unknown, "ratio": None, "interval95": None} for axis in AXES}
    return {
        "verdict": result.label,
        "sentence": summary(result),
        "causes": [],
        "rig": None,
        "residual": {"axis": dict.fromkeys(AXES, unknown), "normalised": unknown, "white": {}},
        "gain": {
            "metric": METRIC,
            "axis": gains,
            "horizons": {key: {"axis": gains} for key in HORIZONS},
            "calibration": [],
        },
        "unexplained": None,
        "proposed_term": None,
        "failing_regions": None,
        "next_flight": {"why": result.next_flight.why, "plan": result.next_flight.plan},
        "why": result.why,
        "undetectable": list(result.undetectable),
        "unidentifiable": list(result.unidentifiable),
        "prior_conflicts": [],
        "cautions": [],
        "flights": [],
        "ranking": [],
        "complete": True,
    }


def rig_numbers(result: Diagnosis) -> dict[str, Any]:
    """Numbers of the extended rig that all flights share, with what was known of each beforehand."""
    estimate = result.extended.estimate
    std = estimate.covariance.diagonal() ** 0.5
    return {
        "name": estimate.parameter_vector.rig.name,
        "model": estimate.parameter_vector.model.name,
        "numbers": {
            parameter.name: {
                "value": float(value),
                "std": float(error),
                "prior": {"value": parameter.prior.mean, "std": parameter.prior.std},
                "unit": parameter.unit,
            }
            for parameter, value, error in zip(
                estimate.parameter_vector.free, estimate.theta, std, strict=True
            )
            if parameter.record is None
        },
    }


def _residual(result: Diagnosis) -> dict[str, Any]:
    """Normalised errors before and after by axis and of all, and whether they are white."""
    before, after = result.before, result.after
    white, correlation = {}, {}
    for role, before_fit, after_fit in (
        ("train", before.fit, after.fit),
        ("held_out", before.held_out_fit, after.held_out_fit),
    ):
        if before_fit is not None and after_fit is not None:
            checks = {"before": check(before_fit), "after": check(after_fit)}
            white[role] = {when: whiteness.white for when, whiteness in checks.items()}
            correlation[role] = {when: whiteness.correlation for when, whiteness in checks.items()}
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
        "innovations": _innovations(result.residual_analysis),
    }


def _innovations(analysis: ResidualAnalysis) -> dict[str, Any]:
    """Autocorrelation of the innovations, its bound for white noise, and what foretells them."""
    return {
        "lags_s": list(analysis.lags_s),
        "autocorrelation": {axis: analysis.autocorrelation[:, i].tolist() for i, axis in enumerate(AXES)},
        "bound": analysis.bound,
        "predicted_by": [dependence.what for dependence in analysis.dependences],
    }


def _flights(result: Diagnosis) -> list[dict[str, Any]]:
    """Which parts of the flights were used."""
    flights = []
    held_out = result.before.held_out_fit
    for role, fit in (("train", result.before.fit), ("held_out", held_out)):
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


def _ranking(result: Diagnosis) -> list[dict[str, Any]]:
    """The candidates of each round with their scores."""
    rows = []
    for number, round_ in enumerate(result.search.rounds, 1):
        tried = {refit.candidate.id: refit for refit in round_.refits}
        for scored in (*round_.screened[:8], *round_.splines[:3]):
            refit = tried.get(scored.candidate.id)
            rows.append(
                {
                    "round": number,
                    "candidate": scored.candidate.id,
                    "score": scored.log_likelihood_gain,
                    "train": refit.gain if refit else None,
                    "penalty": refit.penalty if refit else None,
                    "taken": scored.candidate.id == round_.taken,
                }
            )
    return rows


def _gain(result: Diagnosis) -> dict[str, Any]:
    """Free-run errors before and after at each horizon, and what was calibrated for them."""
    judged = result.judgement
    return {
        "metric": result.metric,
        "axis": gains(result.gains),
        "horizons": {key: {"axis": gains(horizon)} for key, horizon in judged.horizons.items()},
        "calibration": [
            {
                "flight": after.label,
                "calibrated_s": after.calibrated_s,
                "evaluated_s": after.evaluated_s,
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
