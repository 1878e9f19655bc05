"""Diagnosis from beginning to end: flights in, causes and an extended model out."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from heli_host.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.effects import EffectKind, catalogue
from heli_sim.rig import Rig

from heli_lab.diagnose.absent_terms import AbsentTerm, absent_terms
from heli_lab.diagnose.detectability import undetectable_effects, unidentifiable_parameters
from heli_lab.diagnose.equation_discovery import ProposedTerm, propose_term
from heli_lab.diagnose.error_reduction import ErrorReduction, judgement
from heli_lab.diagnose.estimate_cache import EstimateCache, fingerprint
from heli_lab.diagnose.experiment_design import (
    ExperimentDesign,
    Pair,
    compose_experiment,
    discriminating_experiment,
    informative_experiment,
)
from heli_lab.diagnose.free_run import calibration_s, free_runs
from heli_lab.diagnose.model_comparison import Hypothesis, ModelComparison
from heli_lab.diagnose.prediction import Prediction, predict
from heli_lab.diagnose.residual_analysis import ResidualAnalysis, residual_analysis
from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.screening import Screening
from heli_lab.diagnose.search import search
from heli_lab.diagnose.search_record import Search
from heli_lab.diagnose.spline_curve import spline_curve_of
from heli_lab.diagnose.spline_term import SplineTerm
from heli_lab.diagnose.thresholds import AMBIGUOUS, MANY_UNDETECTABLE, SHORT_s
from heli_lab.diagnose.verdict import Verdict, judge
from heli_lab.errors import IdentifyError, NotExcited
from heli_lab.identify import Record, prepare
from heli_lab.threads import using_threads


def diagnose(
    model: Model,
    rig: Rig,
    flights: Iterable[Flight | Record],
    validation: Iterable[Flight | Record] = (),
    *,
    kinds: Mapping[str, EffectKind] | None = None,
    labels: Sequence[str] | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    seed: int = 0,
    refits: float = math.inf,
    calibrate_s: float | None = None,
    threads: int | None = None,
    resume: Path | None = None,
    say: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Find what a model lacks.

    Parameters
    ----------
    model : Model
        The model, with effects that are known beforehand.
    rig : Rig
        Start values and priors of its parameters.
    flights, validation : iterable of Flight or Record
        Flights to fit, and others to judge. They are taken one by one, and of each only the record is kept.
    kinds : Mapping[str, EffectKind], optional
        The catalogue; the package's own where not given.
    labels : sequence of str, optional
        Names of the flights, those to fit first; others are numbered.
    start_s, stop_s : float, optional
        Use only this part of the flights to fit.
    seed : int
        Seed of the bootstrap behind the intervals.
    refits : float
        Limit of the work: refits after which no further cause is looked for; the result says whether
        everything was tried.
    calibrate_s : float, optional
        Free flight of each validation flight that its zeros and torques are estimated from before the rest is
        judged, at most a third of it; `CALIBRATE_s` where not given.
    threads : int, optional
        Threads for candidates, windows and disturbances; `default_thread_count` where not given. The
        result does not depend on it.
    resume : Path, optional
        File that keeps what was worked out; a search that ended early goes on from it, and ends as one that
        never stopped.
    say : callable, optional
        Called with what is being done, and the share of the work that is done, 0 to 1.

    Raises
    ------
    NotExcited
        When nothing flies in the flights to fit; `insufficient_excitation` makes the result for it.
    IdentifyError
        When a flight cannot be used, or is given both to fit and to validate, or `calibrate_s` leaves
        nothing of one to judge, or the file to `resume` is of
        another search.
    """
    with using_threads(threads):
        started_s = time.perf_counter()
        tell = say or (lambda _what, _share: None)
        every = catalogue() if kinds is None else dict(kinds)
        given = tuple(labels or ())
        names = itertools.chain(given, (f"flight {n}" for n in itertools.count(1 + len(given))))
        train, lost = _ready(flights, names, rig, start_s, stop_s)
        if not train:
            raise lost[0]
        held_out, lost_held = _ready(validation, names, rig, None, None)
        _refuse_twins(train, held_out)
        for record in held_out:
            calibration_s(record, calibrate_s)
        kept = EstimateCache(resume, fingerprint(model, rig, [*train, *held_out])) if resume else None
        comparison = ModelComparison(model, rig, train, held_out, seed=seed, kept=kept)
        known = {effect.name for effect in model.effects}
        tried = {id_: kind for id_, kind in every.items() if _candidate(kind, model, known)}
        reached = _searched(comparison, tried, every, every.values(), tell, refits)
        if reached.verdict.label == "unexplained" and any(
            cause.candidate.id in every and every[cause.candidate.id].override
            for cause in reached.verdict.causes
        ):
            # What is missing takes the place of a term that the rig states closely: where something is, no
            # such term is said to be absent.
            reached = _searched(comparison, tried, every, (), tell, refits)
        search_result, verdict = reached.search, reached.verdict
        before, after = reached.before, reached.after
        undetectable = undetectable_effects(search_result.rounds[-1].screened, every)
        runs_before = free_runs(before.fit, held_out, calibrate_s)
        runs_after = runs_before if after is before else free_runs(after.fit, held_out, calibrate_s)
        spline_gains: Mapping[str, ErrorReduction] = {}
        if verdict.unlisted:
            final = predict(search_result.final.candidates, search_result.final.estimate, train, held_out)
            spline_gains = judgement(runs_before, free_runs(final.fit, held_out, calibrate_s), seed).horizons[
                "2"
            ]
        proposed: ProposedTerm | None = None
        if verdict.label == "unexplained" and comparison.fits < refits:
            tell("looking for the law of what is missing", 0.92)
            curve = search_result.final if verdict.unlisted else None
            proposed = propose_term(
                comparison, reached.extended, curve, tried, runs_before, calibrate_s, seed, refits, tell
            )
        return Diagnosis(
            search_result,
            verdict,
            reached.remaining,
            reached.extended,
            before,
            after,
            judgement(runs_before, runs_after, seed),
            spline_gains,
            reached.absent,
            every,
            undetectable,
            tuple(unidentifiable_parameters(search_result.baseline.estimate)),
            tuple(str(loss) for loss in (*lost, *lost_held)),
            _next(comparison, verdict, search_result, reached.extended, every, undetectable),
            time.perf_counter() - started_s,
            calibrate_s,
            comparison.fits,
            proposed,
        )


@dataclass(frozen=True)
class _Reached:
    """What a search found, and what the verdict rests on."""

    search: Search
    remaining: ResidualAnalysis
    extended: Hypothesis
    before: Prediction
    after: Prediction
    absent: tuple[AbsentTerm, ...]
    verdict: Verdict


def _searched(
    comparison: ModelComparison,
    tried: Mapping[str, EffectKind],
    every: Mapping[str, EffectKind],
    removable: Iterable[EffectKind],
    tell: Callable[[str, float], None],
    refits: float,
) -> _Reached:
    search_result = search(comparison, tried, removable=tuple(removable), say=tell, refits=refits)
    tell("looking at what remains", 0.9)
    train, held_out = comparison.train, comparison.held_out
    # Numbers from a few seconds are too uncertain to be held against another flight.
    enough = bool(held_out) and sum(record.used_s for record in train) > SHORT_s
    judged = [Screening(comparison.held_out_estimate(search_result.final))] if enough else []
    remaining = residual_analysis([search_result.screening, *judged])
    extended = _extended(comparison, search_result)
    before = predict((), search_result.baseline.estimate, train, held_out)
    after = (
        before
        if extended is search_result.baseline
        else predict(extended.candidates, extended.estimate, train, held_out)
    )
    absent = tuple(absent_terms(after.fit, comparison.rig, every))
    verdict = judge(search_result, remaining, after, every, bool(absent))
    return _Reached(search_result, remaining, extended, before, after, absent, verdict)


def _candidate(kind: EffectKind, model: Model, known: set[str]) -> bool:
    """Whether an effect is searched for; a removed term whose parameter is free shows in the fit itself."""
    if not kind.suits(model) or kind.id in known or kind.noise_inputs:
        return False
    return not kind.baseline or (not kind.override and model.name != "multibody")


def _next(
    comparison: ModelComparison,
    verdict: Verdict,
    search_result: Search,
    extended: Hypothesis,
    kinds: Mapping[str, EffectKind],
    undetectable: Sequence[str],
) -> ExperimentDesign | None:
    """The experiment that would tell more, where these flights left something open."""
    pair = _pair(comparison, verdict, search_result, extended) if verdict.label == "ambiguous" else None
    if pair is not None:
        return discriminating_experiment(pair, comparison, kinds, AMBIGUOUS)
    if verdict.label == "unexplained":
        on = {cause.candidate.id.rpartition(":")[2] for cause in verdict.unlisted}
        parts = {part for part in ("travel", "elevation", "time") if any(part in name for name in on)}
        parts |= {"motors"} if any("thrust" in name for name in on) or not on else set()
        curves = [
            spline_curve_of(effect, search_result.final.estimate)
            for effect in (cause.candidate.effect for cause in verdict.unlisted)
            if isinstance(effect, SplineTerm)
        ]
        covered = " and ".join(
            f"{curve.on} only from {curve.place[0]:.3g} to {curve.place[-1]:.3g} {curve.place_unit}"
            for curve in curves
        )
        reason = "What is missing should be seen over a wider range"
        return compose_experiment(
            f"{reason}: these flights have {covered}." if covered else f"{reason}.", parts
        )
    seconds = sum(record.used_s for record in comparison.train)
    if seconds < SHORT_s or len(undetectable) > MANY_UNDETECTABLE:
        which = ", ".join(undetectable) or "small effects"
        return informative_experiment(
            f"{seconds:.0f} s of free flight show too little to tell about {which}.",
            undetectable,
            search_result.baseline,
            kinds,
        )
    return None


def _pair(
    comparison: ModelComparison, verdict: Verdict, search_result: Search, extended: Hypothesis
) -> Pair | None:
    """The least certain cause and its closest alternative, both fitted in the place of the same effect."""
    unclear = [cause for cause in verdict.causes if cause.ambiguous_with]
    if not unclear:
        return None
    least_certain = min(unclear, key=lambda cause: cause.alternatives[0].log_likelihood_ratio)
    alternative = least_certain.alternatives[0]
    refit = next(
        (
            refit
            for tried in search_result.rounds
            if tried.taken == least_certain.candidate.id
            for refit in tried.refits
            if refit.candidate.id == alternative.id
        ),
        None,
    )
    if refit is None:
        return None
    rest = [candidate for candidate in extended.candidates if candidate.id != least_certain.candidate.id]
    second = refit.hypothesis
    if rest:
        second = comparison.refit([*rest, refit.candidate], second.values, extended)
    return Pair(
        extended, second, (least_certain.candidate.id, alternative.id), alternative.log_likelihood_ratio
    )


def _extended(comparison: ModelComparison, search_result: Search) -> Hypothesis:
    """The final model without spline terms, which no simulator flies."""
    named = [candidate for candidate in search_result.final.candidates if not candidate.is_spline]
    if len(named) == len(search_result.final.candidates):
        return search_result.final
    if not named:
        return search_result.baseline
    return comparison.refit(named, None, search_result.final)


def _ready(
    flights: Iterable[Flight | Record],
    labels: Iterator[str],
    rig: Rig,
    start_s: float | None,
    stop_s: float | None,
) -> tuple[list[Record], list[NotExcited]]:
    """Flights that can be fitted, and what is wrong with those without excitation."""
    records, lost = [], []
    for flight, label in zip(flights, labels, strict=False):
        if isinstance(flight, Record):
            records.append(flight)
            continue
        try:
            records.append(prepare(flight, rig, label, start_s=start_s, stop_s=stop_s))
        except NotExcited as nothing:
            lost.append(nothing)
    return records, lost


def _refuse_twins(train: Sequence[Record], held_out: Sequence[Record]) -> None:
    for record in train:
        for other in held_out:
            if np.array_equal(record.angles_rad, other.angles_rad):
                raise IdentifyError(
                    f"{other.label} is both fitted and validated on", "give another flight to --validate"
                )
