"""The parts of a diagnosis as other programs read them: plain lists, names and numbers for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from heli_sim.model.parts import AXES

from heli_lab.diagnose.error_reduction import ErrorReduction
from heli_lab.diagnose.model_comparison import Errors
from heli_lab.diagnose.residual_analysis import correlates
from heli_lab.diagnose.verdict import CONFIDENCE_BESIDE_UNKNOWN, CONFIDENCE_CHANCE, ambiguous_with, confidence
from heli_lab.identify import check

if TYPE_CHECKING:
    from heli_lab.diagnose.result import Diagnosis


def causes(found: Diagnosis) -> list[dict[str, Any]]:
    """Spell the causes.

    Parameters
    ----------
    found : Diagnosis
        The result.

    Returns
    -------
    list of dict
        Effect, numbers, confidence, sentence, equation, evidence and rivals of each, strongest first.
    """
    causes: list[dict[str, Any]] = []
    unexplained = found.verdict.word == "unexplained"
    beside = CONFIDENCE_BESIDE_UNKNOWN if unexplained else 1.0
    for one in found.verdict.causes:
        causes.append(
            {
                "effect": one.candidate.id,
                "parameters": _spelled(found.values(one)),
                "confidence": round(confidence(one, found.search, unexplained), 3),
                "sentence": found.sentence(one),
                "equation": found.kinds[one.candidate.id].equation,
                "evidence": {
                    "log_likelihood_ratio_train": one.evidence.train,
                    "log_likelihood_ratio_held_out": one.evidence.held,
                    "held_out_5_percent": one.evidence.held_low,
                    "price": one.penalty,
                    "variance_drop": one.evidence.variance_reduction,
                    "rivals": {rival.id: rival.behind for rival in one.rivals},
                },
                "ambiguous_with": ambiguous_with(one),
            }
        )
    if found.verdict.chance:
        id_ = f"random_torque.{found.residual_analysis.axis}"
        causes.append(
            {
                "effect": id_,
                "parameters": _spelled(found.random_torque),
                "confidence": CONFIDENCE_CHANCE,
                "sentence": found.kinds[id_].describe(
                    {key: value for key, (value, _, _) in found.random_torque.items()},
                    {key: std for key, (_, std, _) in found.random_torque.items()},
                ),
                "equation": found.kinds[id_].equation,
                "evidence": {
                    "over_error": found.residual_analysis.over_error,
                    "log_likelihood_ratio": found.residual_analysis.gained,
                    "lost_against_all_axes": found.residual_analysis.lost,
                },
                "ambiguous_with": [],
            }
        )
    for term in found.removed:
        kind = found.kinds[term.id]
        (name,) = kind.size
        causes.append(
            {
                "effect": term.id,
                "parameters": _spelled({name: (term.share, term.std, "1")}),
                "confidence": round(term.confidence * beside, 3),
                "sentence": kind.describe({name: term.share}, {name: term.std}),
                "equation": kind.equation,
                "evidence": {
                    "standard_errors_from_nothing": term.from_nothing,
                    "standard_errors_from_the_rig": term.from_rig,
                },
                "ambiguous_with": [],
            }
        )
    return causes


def residual(found: Diagnosis) -> dict[str, Any]:
    """Spell the errors before and after.

    Parameters
    ----------
    found : Diagnosis
        The result.

    Returns
    -------
    dict
        Normalised errors by axis and of all, and how white they are.
    """
    before, after = found.search.baseline, found.extended
    white, correlation = {}, {}
    for role, before_fit, after_fit in (
        ("train", before.fit, after.fit),
        ("held_out", before.held_fit, after.held_fit),
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
            "held_out_before": before.held.normalised,
            "held_out_after": after.held.normalised,
        },
        "white": white,
        "correlation": correlation,
    }


def unexplained(found: Diagnosis) -> dict[str, Any] | None:
    """Spell what no effect explains.

    Parameters
    ----------
    found : Diagnosis
        The result.

    Returns
    -------
    dict or None
        Axis, what it goes with and its share; None when nothing is.
    """
    after = found.extended.train
    excess = float(1.0 - 1.0 / max(after.normalised**2, 1.0))
    if not found.verdict.off_list:
        if found.verdict.word in ("explained",) or excess < 0.1 or found.verdict.chance:
            return None
        named = [one.what for one in found.residual_analysis.depends] or correlates(
            found.search.last.splines()
        )
        return {
            "axis": found.residual_analysis.axis,
            "correlates_with": named,
            "share_of_variance": round(excess, 4),
            "size_Nm": found.residual_analysis.sigma_Nm,
        }
    strongest = found.verdict.off_list[0]
    _, channel, on = strongest.candidate.id.split(":")
    first = next(r for r in found.search.rounds if r.taken == strongest.candidate.id)
    others = [name for name in correlates(first.splines) if name != f"{channel} on {on}"]
    where = channel.rpartition(".")[2]
    axis = where if where in AXES else ("pitch" if where == "difference" else "elevation")
    base, final = found.search.baseline.train, found.search.final.train
    return {
        "axis": axis,
        "channel": channel,
        "correlates_with": [f"{channel} on {on}", *others],
        "share_of_variance": round(_share(base, final, axis), 4),
        "all": [one.candidate.id.removeprefix("pattern:") for one in found.verdict.off_list],
        "gain_with_curves": gains(found.curve_gains),
    }


def flights(found: Diagnosis) -> list[dict[str, Any]]:
    """Spell which parts of the flights were used.

    Parameters
    ----------
    found : Diagnosis
        The result.

    Returns
    -------
    list of dict
        One a flight.
    """
    flights = []
    held = found.search.baseline.held_fit
    for role, fit in (("train", found.search.baseline.fit), ("held_out", held)):
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


def ranking(found: Diagnosis) -> list[dict[str, Any]]:
    """Spell the candidates with their scores.

    Parameters
    ----------
    found : Diagnosis
        The result.

    Returns
    -------
    list of dict
        One a candidate and round.
    """
    rows = []
    for number, one in enumerate(found.search.rounds, 1):
        tried = {step.candidate.id: step for step in one.steps}
        for scored in (*one.screened[:8], *one.splines[:3]):
            step = tried.get(scored.candidate.id)
            rows.append(
                {
                    "round": number,
                    "candidate": scored.candidate.id,
                    "score": scored.answer.gain,
                    "train": step.evidence.train if step else None,
                    "held_out": step.evidence.held if step else None,
                    "price": step.penalty if step else None,
                    "taken": scored.candidate.id == one.taken,
                }
            )
    return rows


def _spelled(values: Mapping[str, tuple[float, float, str]]) -> dict[str, dict[str, float | str]]:
    return {name: {"value": value, "std": std, "unit": unit} for name, (value, std, unit) in values.items()}


def gains(measured: Mapping[str, ErrorReduction]) -> dict[str, dict[str, Any]]:
    """Spell free-run errors before and after.

    Parameters
    ----------
    measured : Mapping[str, ErrorReduction]
        By axis.

    Returns
    -------
    dict
        before, after, ratio and interval95 of each axis.
    """
    return {
        axis: {
            "before": one.before_deg,
            "after": one.after_deg,
            "ratio": one.ratio,
            "interval95": list(one.interval95),
        }
        for axis, one in measured.items()
    }


def _share(before: Errors, after: Errors, axis: str) -> float:
    i = AXES.index(axis)
    return float(max(0.0, 1.0 - after.variance[i] / before.variance[i]))
