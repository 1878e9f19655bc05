"""Diagnosis from beginning to end: flights in; causes, an extended model and its gain out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from heli_host.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.effects import EffectKind, catalogue
from heli_sim.rig import Rig

from heli_lab.diagnose.absent_terms import absent_terms
from heli_lab.diagnose.detectability import undetectable_effects
from heli_lab.diagnose.error_reduction import gain
from heli_lab.diagnose.experiment_design import (
    ExperimentDesign,
    Pair,
    flight_that_separates,
    flight_that_shows,
    next_flight,
)
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis
from heli_lab.diagnose.residual_analysis import residual_analysis
from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.search import AMBIGUOUS, search
from heli_lab.diagnose.search_record import Search
from heli_lab.diagnose.spline_curve import spline_curve_of
from heli_lab.diagnose.spline_term import SplineTerm
from heli_lab.diagnose.verdict import Verdict, ambiguous_with, judge, remains
from heli_lab.errors import IdentifyError, NotExcited
from heli_lab.identify import Record, prepare

_SHORT_s: Final = 15.0
_MANY_UNSEEN: Final = 12
_LEAST_FOR_PLANS_s, _MOST_FOR_PLANS_s = 5.0, 25.0
"""Time for rehearsing plans: at least one is, however much of the budget is gone."""


def diagnose(
    model: Model,
    rig: Rig,
    flights: Sequence[Flight | Record],
    validation: Sequence[Flight | Record] = (),
    *,
    kinds: Mapping[str, EffectKind] | None = None,
    labels: Sequence[str] | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    seed: int = 0,
    seconds: float = float("inf"),
    say: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Find what a model lacks.

    Parameters
    ----------
    model : Model
        The model, with effects that are known beforehand.
    rig : Rig
        Start values and priors of its numbers.
    flights, validation : sequence of Flight or Record
        Flights to fit, and flights to judge on.
    kinds : Mapping[str, EffectKind], optional
        The catalogue; the package's own where not given.
    labels : sequence of str, optional
        Names of all flights, those to fit first.
    start_s, stop_s : float, optional
        Use only this part of the flights to fit.
    seed : int
        Seed of the resampling behind the intervals.
    seconds : float
        Most time; what could not be tried is said.
    say : callable, optional
        Told what is being done, and which share of the work is.

    Returns
    -------
    Diagnosis
        The result.

    Raises
    ------
    NotExcited
        When nothing flies in the flights to fit; `insufficient_excitation` is the answer to it.
    IdentifyError
        When a flight is not sound, or is to be fitted and judged on at once.
    """
    started_s = time.perf_counter()
    tell = say or (lambda _what, _share: None)
    every = catalogue() if kinds is None else dict(kinds)
    names = list(labels or [f"flight {i + 1}" for i in range(len(flights) + len(validation))])
    train, lost = _ready(flights, names[: len(flights)], rig, start_s, stop_s)
    if not train:
        raise lost[0]
    held, lost_held = _ready(validation, names[len(flights) :], rig, None, None)
    _refuse_twins(train, held)
    comparison = Comparison(model, rig, train, held, seed=seed)
    known = {effect.name for effect in model.effects}
    tried = {id_: kind for id_, kind in every.items() if _candidate(kind, model, known)}
    left_s = seconds - (time.perf_counter() - started_s)
    found = search(comparison, tried, removable=tuple(every.values()), say=tell, seconds=left_s)
    tell("looking at what remains", 0.9)
    left = residual_analysis(found.final, found.last, found.chance if remains(found) else None)
    extended = _extended(comparison, found)
    removed = absent_terms(extended.fit, rig, every)
    verdict = judge(found, left, bool(removed))
    unseen = undetectable_effects(found.rounds[-1].screened, every)
    return Diagnosis(
        found,
        verdict,
        left,
        extended,
        gain(found.baseline, extended, seed),
        gain(found.baseline, found.final, seed) if verdict.off_list else {},
        removed,
        every,
        unseen,
        tuple(str(one) for one in (*lost, *lost_held)),
        _next(comparison, verdict, found, extended, every, unseen, started_s + seconds),
        time.perf_counter() - started_s,
    )


def _candidate(kind: EffectKind, model: Model, known: set[str]) -> bool:
    """Whether an effect is searched for; numbers of the rig that vanish are seen in the fit itself."""
    if not kind.suits(model) or kind.id in known or kind.noise_inputs:
        return False
    return not kind.baseline or (not kind.override and model.name != "multibody")


def _next(
    comparison: Comparison,
    verdict: Verdict,
    found: Search,
    extended: Hypothesis,
    kinds: Mapping[str, EffectKind],
    unseen: Sequence[str],
    until_s: float,
) -> ExperimentDesign | None:
    """The flight that would tell more, where these left something open."""
    pair = _pair(comparison, verdict, found, extended) if verdict.word == "ambiguous" else None
    if pair is not None:
        # What it may still take is as open as the question: a part of the budget, but not nothing.
        stop_s = max(until_s, time.perf_counter() + _LEAST_FOR_PLANS_s)
        stop_s = min(stop_s, time.perf_counter() + _MOST_FOR_PLANS_s)
        return flight_that_separates(pair, comparison, kinds, AMBIGUOUS, lambda: time.perf_counter() < stop_s)
    if verdict.word == "unexplained":
        on = {one.candidate.id.rpartition(":")[2] for one in verdict.off_list}
        parts = {part for part in ("travel", "elevation", "time") if any(part in name for name in on)}
        parts |= {"motors"} if any("thrust" in name for name in on) or not on else set()
        curves = [
            spline_curve_of(effect, found.final.fit)
            for effect in (one.candidate.effect for one in verdict.off_list)
            if isinstance(effect, SplineTerm)
        ]
        seen = " and ".join(
            f"{one.on} only from {one.place[0]:.3g} to {one.place[-1]:.3g} {one.place_unit}" for one in curves
        )
        reason = "What is missing should be seen over a wider range"
        return next_flight(f"{reason}: these flights have {seen}." if seen else f"{reason}.", parts)
    seconds = sum(record.used_s for record in found.baseline.fit.problem.records)
    if seconds < _SHORT_s or len(unseen) > _MANY_UNSEEN:
        which = ", ".join(unseen) or "small effects"
        return flight_that_shows(
            f"{seconds:.0f} s of free flight show too little to tell about {which}.",
            unseen,
            found.baseline,
            kinds,
        )
    return None


def _pair(comparison: Comparison, verdict: Verdict, found: Search, extended: Hypothesis) -> Pair | None:
    """The cause that is least sure and its closest rival, both fitted in the place of the same effect."""
    unclear = [one for one in verdict.causes if ambiguous_with(one)]
    if not unclear:
        return None
    one = min(unclear, key=lambda cause: cause.rivals[0].behind)
    rival = one.rivals[0]
    step = next(
        (
            step
            for tried in found.rounds
            if tried.taken == one.candidate.id
            for step in tried.steps
            if step.candidate.id == rival.id
        ),
        None,
    )
    if step is None:
        return None
    rest = [candidate for candidate in extended.candidates if candidate.id != one.candidate.id]
    second = step.hypothesis
    if rest:
        second = comparison.refit([*rest, step.candidate], {**extended.fit.values, **second.fit.values})
    return Pair(extended, second, (one.candidate.id, rival.id), rival.behind)


def _extended(comparison: Comparison, found: Search) -> Hypothesis:
    """The final model without patterns, which no simulator flies."""
    named = [candidate for candidate in found.final.candidates if not candidate.is_spline]
    if len(named) == len(found.final.candidates):
        return found.final
    if not named:
        return found.baseline
    return comparison.refit(named, found.final.fit.values)


def _ready(
    flights: Sequence[Flight | Record],
    labels: Sequence[str],
    rig: Rig,
    start_s: float | None,
    stop_s: float | None,
) -> tuple[list[Record], list[NotExcited]]:
    """Flights that can be fitted, and what is wrong with those that show nothing."""
    records, lost = [], []
    for flight, label in zip(flights, labels, strict=True):
        if isinstance(flight, Record):
            records.append(flight)
            continue
        try:
            records.append(prepare(flight, rig, label, start_s=start_s, stop_s=stop_s))
        except NotExcited as nothing:
            lost.append(nothing)
    return records, lost


def _refuse_twins(train: Sequence[Record], held: Sequence[Record]) -> None:
    for one in train:
        for other in held:
            if np.array_equal(one.angles_rad, other.angles_rad):
                raise IdentifyError(
                    f"{other.label} is both fitted and validated on; give another flight to --validate"
                )
