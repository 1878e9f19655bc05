"""A diagnosis as JSON for other programs; docs/reference/json.md describes the keys."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from heli_sim.model.effect import AXES

from heli_lab.explain.candidates import QUANTITIES
from heli_lab.explain.experiment_design import InsufficientExcitation
from heli_lab.explain.prediction import HORIZONS, FreeRun
from heli_lab.explain.proposal import ProposedTerm, expression, latex
from heli_lab.explain.replication import WORSE_HORIZON
from heli_lab.explain.residuals import FailingRegions, RegionTest, ResidualAnalysis
from heli_lab.explain.result import Diagnosis, Proposal, widened
from heli_lab.explain.terms import CHANNELS, SYMBOLS
from heli_lab.explain.thresholds import FALSE_DISCOVERY_RATE
from heli_lab.explain.verdict import PriorConflict
from heli_lab.fit.identification import check
from heli_lab.report.diagnosis.text import (
    METRIC,
    cause_entries,
    cautions,
    disturbances,
    metric,
    reductions_json,
    small_remainder,
    summary,
    thrust_noise,
    too_small_effects,
    unexplained,
)
from heli_lab.watch.error_shares import ErrorShares, shares_json

_SCREENED, _SPLINES = 8, 3
"""Candidates of a round in the ranking: effects, then splines."""


def to_json(result: Diagnosis | InsufficientExcitation, shares: ErrorShares | None = None) -> dict[str, Any]:
    """Write a `result` as a JSON object; docs/reference/json.md describes its keys.

    Numbers are null if the flights excite nothing. `shares` are the parts of the forecast error.
    """
    if isinstance(result, InsufficientExcitation):
        return _insufficient_excitation_json(result)
    experiment = result.next_flight
    return {
        "verdict": result.label,
        "sentence": summary(result),
        "causes": [cause.to_json() for cause in cause_entries(result)],
        "too_small": too_small_effects(result),
        "small_remainder": small_remainder(result),
        "rig": rig_numbers(result),
        "residual": _residual_json(result),
        "disturbances": disturbances(result.assessment.residual_analysis),
        "thrust_noise": thrust_noise(result.assessment.residual_analysis),
        "gain": _error_reduction_json(result),
        "forecast_error": None if shares is None else shares_json(shares),
        "unexplained": unexplained(result),
        "proposed_term": proposal_json(result.proposal) if result.proposal else None,
        "failing_regions": _failing_regions_json(result.failing_regions),
        "next_flight": {"why": experiment.why, "plan": experiment.plan} if experiment else None,
        "undetectable": list(result.undetectable),
        "unidentifiable": list(result.unidentifiable),
        "prior_conflicts": [_prior_conflict_json(conflict) for conflict in result.prior_conflicts],
        "cautions": cautions(result),
        "flights": _flights_json(result),
        "ranking": _ranking_json(result),
        "refits": result.effort.refits,
        "seconds_taken": result.effort.seconds,
        "complete": result.search.complete,
        "converged": result.has_converged_estimate and result.has_converged_prediction,
    }


def _insufficient_excitation_json(result: InsufficientExcitation) -> dict[str, Any]:
    """Return the JSON object of flights that excite nothing; numbers of a diagnosis are None or empty."""
    unknown = {"before": None, "after": None}
    gains = {axis: {**unknown, "ratio": None, "interval95": None} for axis in AXES}
    return {
        "verdict": result.label,
        "sentence": summary(result),
        "causes": [],
        "too_small": [],
        "small_remainder": [],
        "rig": {"name": result.rig, "model": result.model},
        "residual": {"axis": dict.fromkeys(AXES, unknown), "normalised": unknown, "white": {}},
        "gain": {
            "metric": METRIC,
            "axis": gains,
            "horizons": {key: {"axis": gains} for key in HORIZONS},
            "calibration": [],
            "extrapolation": [],
            "worse": [],
        },
        "forecast_error": None,
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
        "converged": True,
    }


def rig_numbers(result: Diagnosis) -> dict[str, Any]:
    """Write the parameters of the extended rig."""
    # ``numbers`` are the parameters that all flights share, with their priors. ``constants`` are the means of
    # those that differ from flight to flight, such as encoder zeros.
    estimate = widened(result.replication.model.estimate, result.assessment.extended.estimate)
    std = estimate.covariance.diagonal() ** 0.5
    rig = result.rig("extended")
    per_flight_names = {
        parameter.quantity for parameter in estimate.parameter_vector.free if not parameter.is_shared
    }
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
            if parameter.is_shared
        },
        "constants": {
            # A tolerance in a rig file is two standard deviations.
            name: {"value": rig[name].value, "std": 0.5 * rig[name].tolerance, "unit": rig[name].unit}
            for name in sorted(per_flight_names)
        },
    }


def proposal_json(proposal: Proposal) -> dict[str, Any]:
    """Write a proposed equation with its evidence and its gain."""
    term, discovery, equation = proposal.term, proposal.term.discovery, proposal.term.equation
    symbols = {name for equation_term in equation.terms for name in equation_term.term.quantities}
    first, *further = (_channel_json(term, channel) for channel in equation.channels)
    return {
        "effect": discovery.effect.name,
        **first,
        "further_channels": further,
        "symbols": {name: str(SYMBOLS[name].unit) for name in sorted(symbols)},
        "latex": latex(equation),
        "numbers": {
            name: {"value": value, "std": std, "unit": unit}
            for name, (value, std, unit) in discovery.values.items()
        },
        "confidence": round(term.confidence, 3),
        "sentence": term.sentence,
        "evidence": {
            "log_likelihood_ratio_train": discovery.train_nats,
            "log_likelihood_ratio_held_out": discovery.held_out_nats,
            "log_likelihood_ratio_of_curves": discovery.curve_nats,
            "penalty": discovery.penalty,
            "terms_tried": discovery.tried,
        },
        "rivals": [
            {"term": rival.key, "log_likelihood_ratio": rival.log_likelihood_ratio}
            for rival in discovery.rivals
        ],
        "superfluous": list(discovery.superfluous),
        "matters": [
            {
                "channel": supported.channel,
                "rms": supported.rms,
                "largest": supported.largest,
                "share_of_time": supported.share,
                "ranges": {name: list(span) for name, span in supported.ranges.items()},
            }
            for supported in term.supported
        ],
        "gain": reductions_json(proposal.evaluation.reductions),
    }


def _channel_json(term: ProposedTerm, channel: str) -> dict[str, str]:
    """Return the terms of an equation on a channel, with names and with values of its parameters."""
    return {
        "channel": channel,
        "unit": CHANNELS[channel].unit,
        "expression": expression(term.equation, channel),
        "expression_with_numbers": expression(term.equation, channel, term.numbers),
    }


def _failing_regions_json(regions: FailingRegions) -> dict[str, Any]:
    """Return the cells of the plane in which the model fails, before and after the extension."""

    def cells_of(test: RegionTest) -> dict[str, Any]:
        """Return the share of time, the missing torque and the failing cells of a test."""
        return {
            "share_of_time": test.share,
            "missing_torque_rms_Nm": test.rms_Nm,
            "cells": [
                {
                    "x": [float(regions.x_edges[i]), float(regions.x_edges[i + 1])],
                    "y": [float(regions.y_edges[j]), float(regions.y_edges[j + 1])],
                    "standard_deviations": float(test.z[i, j]),
                }
                for i, j in zip(*test.fails.nonzero(), strict=True)
            ],
        }

    return {
        "axis": regions.axis,
        "x": regions.x,
        "y": regions.y,
        "units": [QUANTITIES[regions.x].unit, QUANTITIES[regions.y].unit],
        "false_discovery_rate": FALSE_DISCOVERY_RATE,
        "before": cells_of(regions.before),
        "after": cells_of(regions.after),
    }


def _prior_conflict_json(conflict: PriorConflict) -> dict[str, Any]:
    """Return a conflict of an estimate with its prior, and the estimate without the prior."""
    return {
        "parameter": conflict.name,
        "value": conflict.value,
        "std": conflict.std,
        "prior": {"value": conflict.prior.mean, "std": conflict.prior.std},
        "deviations": conflict.deviations,
        "unit": conflict.unit,
        "without_prior": asdict(conflict.freed) if conflict.freed else None,
    }


def _residual_json(result: Diagnosis) -> dict[str, Any]:
    """Return normalised errors before and after, by axis and in total, and whether they are white."""
    before, after = result.assessment.before, result.assessment.after
    white, correlation = {}, {}
    for role, before_fit, after_fit in (
        ("train", before.fit, after.fit),
        ("held_out", before.held_out_fit, after.held_out_fit),
    ):
        if before_fit is not None and after_fit is not None:
            checks = {"before": check(before_fit), "after": check(after_fit)}
            white[role] = {when: residuals.white for when, residuals in checks.items()}
            correlation[role] = {when: residuals.correlation for when, residuals in checks.items()}
    return {
        "axis": {
            axis: {"before": float(before.train.axes[i]), "after": float(after.train.axes[i])}
            for i, axis in enumerate(AXES)
        },
        "normalised": {
            "before": before.train.total,
            "after": after.train.total,
            "held_out_before": before.held_out.total,
            "held_out_after": after.held_out.total,
        },
        "white": white,
        "correlation": correlation,
        "innovations": _innovations_json(result.assessment.residual_analysis),
    }


def _innovations_json(analysis: ResidualAnalysis) -> dict[str, Any]:
    """Return the autocorrelation of the innovations, its bound for white noise, and the dependences."""
    return {
        "lags_s": list(analysis.lags_s),
        "autocorrelation": {axis: analysis.autocorrelation[:, i].tolist() for i, axis in enumerate(AXES)},
        "bound": analysis.bound,
        "predicted_by": [dependence.what for dependence in analysis.dependences],
    }


def _flights_json(result: Diagnosis) -> list[dict[str, Any]]:
    """Return for each flight the parts that were used, and the reasons why others were not."""
    flights = []
    before = result.assessment.before
    for role, fit in (("train", before.fit), ("held_out", before.held_out_fit)):
        for record in fit.problem.records if fit is not None else ():
            flights.append(
                {
                    "flight": record.label,
                    "role": role,
                    "seconds_used": record.used_s,
                    "used": [
                        [float(record.t_s[start]), float(record.t_s[stop - 1])]
                        for start, stop in record.segments
                    ],
                    "left_out": [
                        {"from_s": cut.start_s, "to_s": cut.stop_s, "why": cut.why} for cut in record.cuts
                    ],
                    "notes": list(record.notes),
                }
            )
    return flights


def _ranking_json(result: Diagnosis) -> list[dict[str, Any]]:
    """Return the best candidates of each round with scores, gains of refits, and penalties."""
    rows = []
    for number, round_ in enumerate(result.search.rounds, 1):
        refits = {refit.candidate.id: refit for refit in round_.refits}
        for scored in (*round_.screened[:_SCREENED], *round_.splines[:_SPLINES]):
            refit = refits.get(scored.candidate.id)
            rows.append(
                {
                    "round": number,
                    "candidate": scored.candidate.id,
                    "score": scored.log_likelihood_gain,
                    "train": refit.gain if refit else None,
                    "penalty": refit.penalty if refit else None,
                    "taken": scored.candidate.id == round_.accepted_id,
                }
            )
    return rows


def _error_reduction_json(result: Diagnosis) -> dict[str, Any]:
    """Return free-run errors before and after at each horizon, calibrated constants and extrapolations."""
    extension = result.held_out.extension
    return {
        "metric": metric(result),
        "axis": reductions_json(result.error_reductions),
        "horizons": {key: {"axis": reductions_json(horizon)} for key, horizon in extension.horizons.items()},
        "calibration": [
            {
                "flight": after.label,
                "calibrated_s": after.calibrated_s,
                "evaluated_s": after.evaluated_s,
                "before": _constants_json(before),
                "after": _constants_json(after),
            }
            for before, after in zip(extension.before, extension.after, strict=True)
        ],
        "extrapolation": [
            {
                "flight": flight.label,
                "windows": flight.windows,
                "fitted_V": {rotor: list(span) for rotor, span in flight.ranges_V.items()},
                "outside_s": [list(span) for span in flight.spans_s],
            }
            for flight in result.extrapolations
        ],
        "worse": [
            {
                "axis": worse.axis,
                "horizon_s": float(WORSE_HORIZON),
                "fitted": worse.fitted,
                "judged": worse.judged,
                "ratio": worse.reduction.ratio,
                "interval95": list(worse.reduction.interval95),
            }
            for worse in result.replication.worse
        ],
    }


def _constants_json(run: FreeRun) -> dict[str, dict[str, Any]]:
    """Return the calibrated zeros and torques by name: value, standard error, prior and unit."""
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
