"""A diagnosis from beginning to end: search, assessment, equation, evaluation on held-out flights, next
flight.
"""

from __future__ import annotations

import functools
import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.effects import EffectSpec, catalogue
from heli_sim.rig import Rig
from threadpoolctl import threadpool_limits

from heli_lab.errors import IdentifyError, NotExcited
from heli_lab.explain.assessment import (
    Assessment,
    assess,
    justified_thrust_noise,
    with_curves,
    with_likelier_advance,
    with_listed_remainder,
)
from heli_lab.explain.candidates import may_join
from heli_lab.explain.comparison import EstimateCache, ModelComparison, fingerprint
from heli_lab.explain.experiment_design import propose_experiment
from heli_lab.explain.prediction import calibration_s
from heli_lab.explain.proposal import proposed_term
from heli_lab.explain.regression import discover
from heli_lab.explain.replication import HeldOutEvaluation, evaluate_held_out, evaluate_hypothesis, replicate
from heli_lab.explain.result import Diagnosis, Effort, Proposal
from heli_lab.explain.stepwise import Search, search
from heli_lab.explain.verdict import undetectable_effects, unidentifiable_parameters
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.voltage_timing import sampled_advance
from heli_lab.threads import using_threads


def diagnose(
    model: Model,
    rig: Rig,
    flights: Iterable[Flight | Record],
    validation: Iterable[Flight | Record] = (),
    *,
    kinds: Mapping[str, EffectSpec] | None = None,
    labels: Sequence[str] | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    seed: int = 0,
    refits: float = math.inf,
    calibrate_s: float | None = None,
    threads: int | None = None,
    resume: Path | None = None,
    loop_Hz: float | None = None,
    say: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Find what a model lacks, and measure what an extension of the model gains.

    Parameters
    ----------
    model : Model
        The model, with effects that are known to be present.
    rig : Rig
        Start values and priors of its parameters.
    flights, validation : iterable of Flight or Record
        Flights to fit, and held-out flights for the evaluation. Flights are read one by one, and only the
        prepared record of each is kept.
    kinds : Mapping[str, EffectSpec], optional
        Catalogue by effect id; the package's own by default.
    labels : sequence of str, optional
        Names of the flights, fitted flights first. Flights without a name are numbered.
    start_s, stop_s : float, optional
        Part of the fitted flights to use.
    seed : int
        Seed of the bootstrap behind the intervals.
    refits : float
        Refits of the model after which no further cause is tried.
    calibrate_s : float, optional
        Duration of each held-out flight's beginning from which its zeros and constant torques are estimated,
        at most a third of its free flight; `CALIBRATE_s` by default.
    threads : int, optional
        Number of threads; `default_thread_count` by default. The result does not depend on it.
    resume : Path, optional
        File that keeps the estimates. A diagnosis that was interrupted continues from it, and has the same
        result as one that was not.
    loop_Hz : float, optional
        Rate of the control loop. If a log has fewer rows, its voltages are samples of those that acted. By
        default, the flights themselves show whether their log is slower than the loop.
    say : callable, optional
        Called with the present step in words, and with the share of the work that is done, 0 to 1.

    Returns
    -------
    Diagnosis
        `label` is the verdict:

        ``explained``
            These flights show nothing that the model lacks; only disturbances remain.

        ``cause_found``
            `verdict.causes` explain the errors of the baseline.

        ``ambiguous``
            Other effects fit equally well; `next_flight` is an experiment that distinguishes them.

        ``unexplained``
            No effect of the catalogue explains the errors. `curves` shows the missing terms as splines, and
            `proposal` is an equation for them, if one was confirmed.

        `error_reductions` has free-run errors before and after by axis, `held_out` at all horizons, both of
        the model with the confirmed causes. `replication` states which causes hold in both directions. `rig`
        makes the extended rig. `search` and `assessment` hold the evidence. `to_json`, `summary` and
        `heli_lab.report.diagnosis.page.write_report` write the result for programs and readers.

    Raises
    ------
    NotExcited
        If nothing flies in any of the flights to fit; `insufficient_excitation` makes a result for this case.
    IdentifyError
        If a flight cannot be used, or is given both to fit and to validate, if `calibrate_s` leaves nothing
        of a flight to evaluate, or if `resume` is a file of another search.
    """
    # The matrices are small, so that more threads of linear algebra (BLAS) only wait for each other: on two
    # busy cores, a diagnosis took 13 s of CPU time instead of 2.9 s (2026-11).
    with using_threads(threads), threadpool_limits(1, "blas"):
        started_s = time.perf_counter()
        report = say or (lambda _step, _share: None)
        available = catalogue() if kinds is None else dict(kinds)
        names = _labels_and_numbers(labels or ())
        train, skipped = _prepare_flights(flights, names, rig, start_s, stop_s)
        if not train:
            raise skipped[0]
        held_out, skipped_held_out = _prepare_flights(validation, names, rig, None, None)
        _refuse_duplicates(train, held_out)
        for record in held_out:
            calibration_s(record, calibrate_s)  # raises if the calibration would leave nothing to evaluate
        cache = EstimateCache(resume, fingerprint(model, rig, [*train, *held_out])) if resume else None
        comparison = ModelComparison(model, rig, train, held_out, seed=seed, cache=cache)
        known = {effect.name for effect in model.effects}
        tried = {id_: kind for id_, kind in available.items() if _is_candidate(kind, model, known, available)}
        if loop_Hz is not None:
            comparison = comparison.with_advance(functools.partial(sampled_advance, loop_Hz=loop_Hz))
        comparison, result, assessment = _explain(comparison, tried, available, report, refits, loop_Hz)
        undetectable = undetectable_effects(result.rounds[-1].screened, available)
        evaluation = evaluate_held_out(comparison, result, assessment, calibrate_s)
        report("judging the causes in the reverse direction", 0.91)
        replication = replicate(comparison, result, assessment, evaluation, calibrate_s)
        proposal = None
        if assessment.verdict.label == "unexplained" and comparison.fits < refits:
            report("searching for an equation of what is missing", 0.92)
            proposal = _propose_equation(
                comparison, result, assessment, evaluation, tried, calibrate_s, refits, report
            )
        curved = with_curves(comparison, result, assessment, available)
        next_flight = propose_experiment(comparison, result, assessment, available, undetectable)
        return Diagnosis(
            result,
            assessment,
            replication,
            available,
            undetectable=undetectable,
            unidentifiable=unidentifiable_parameters(result.baseline.estimate),
            skipped=tuple(str(why) for why in (*skipped, *skipped_held_out)),
            next_flight=next_flight,
            proposal=proposal,
            effort=Effort(comparison.fits, time.perf_counter() - started_s),
            curved=curved,
        )


def _labels_and_numbers(labels: Sequence[str]) -> Iterator[str]:
    """Yield the given `labels`, then ``flight N`` for further flights, where N counts all flights."""
    yield from labels
    yield from (f"flight {number}" for number in itertools.count(1 + len(labels)))


def _explain(
    comparison: ModelComparison,
    tried: Mapping[str, EffectSpec],
    available: Mapping[str, EffectSpec],
    report: Callable[[str, float], None],
    refits: float,
    loop_Hz: float | None,
) -> tuple[ModelComparison, Search, Assessment]:
    """Search for causes, and again with other assumptions on voltages and thrust if the flights need them;
    return the comparison with its assumptions, the search and its assessment.
    """
    # The arguments are as in `_search_and_assess`, `loop_Hz` as in `diagnose`. Another assumption must not
    # leave unexplained what was explained without it.

    def attempt(comparison: ModelComparison) -> tuple[Search, Assessment]:
        """Search with the assumptions of a comparison."""
        return _search_and_assess(comparison, tried, available, report, refits)

    result, assessment = attempt(comparison)
    timed_comparison = with_likelier_advance(
        comparison, [result.screening, *assessment.held_out_screenings], loop_Hz
    )
    if timed_comparison is not None:
        report("repeating the search with voltages that act early", 0.5)
        timed_result, timed_assessment = attempt(timed_comparison)
        was_unexplained = assessment.verdict.label == "unexplained"
        if was_unexplained or timed_assessment.verdict.label != "unexplained":
            comparison, result, assessment = timed_comparison, timed_result, timed_assessment
    noisy_comparison = justified_thrust_noise(comparison, result, assessment)
    if noisy_comparison is not None:
        noisy_result, noisy_assessment = attempt(noisy_comparison)
        if noisy_assessment.verdict.label != "unexplained":
            comparison, result, assessment = noisy_comparison, noisy_result, noisy_assessment
    if comparison.fits < refits:
        result, assessment = with_listed_remainder(comparison, result, assessment, tried, available)
    return comparison, result, assessment


def _search_and_assess(
    comparison: ModelComparison,
    tried: Mapping[str, EffectSpec],
    available: Mapping[str, EffectSpec],
    say: Callable[[str, float], None],
    refits: float,
) -> tuple[Search, Assessment]:
    """Search for causes, and assess the result."""
    # The search tries the effects `tried`, and the removal of terms of the baseline, which are in the
    # catalogue `available`. If it removes a term and something stays unexplained, it is repeated without
    # removals.

    def attempt(removable: Iterable[EffectSpec]) -> tuple[Search, Assessment]:
        """Search once, with these terms of the baseline that may be removed."""
        result = search(comparison, tried, removable=tuple(removable), say=say, refits=refits)
        say("analysing what remains", 0.9)
        return result, assess(comparison, result, available)

    result, assessment = attempt(available.values())
    ids = {cause.candidate.id for cause in assessment.verdict.causes}
    has_removed_term = any(id_ in available and available[id_].override for id_ in ids)
    if has_removed_term and assessment.verdict.label == "unexplained":
        # An unlisted cause may imitate the absence of a tightly specified term.
        return attempt(removable=())
    return result, assessment


def _propose_equation(
    comparison: ModelComparison,
    result: Search,
    assessment: Assessment,
    evaluation: HeldOutEvaluation,
    tried: Mapping[str, EffectSpec],
    calibrate_s: float | None,
    refits: float,
    say: Callable[[str, float], None],
) -> Proposal | None:
    """Search for an equation of the missing term, and evaluate the model with it; None without one."""
    discovery = discover(
        comparison,
        assessment.extended,
        curve=result.final if assessment.verdict.unlisted else None,
        kinds=tried,
        refits=refits,
        say=lambda step: say(step, 0.94),
    )
    if discovery is None:
        return None
    runs_before = evaluation.extension.before
    with_equation = evaluate_hypothesis(discovery.hypothesis, comparison, runs_before, calibrate_s)
    return Proposal(proposed_term(discovery), with_equation)


def _is_candidate(kind: EffectSpec, model: Model, known: set[str], every: Mapping[str, EffectSpec]) -> bool:
    """Whether the search tries to add an effect to a model that has the effects `known`."""
    # `every` is the catalogue. Most removals of a term are not tried, because the estimate of the term's
    # parameter shows its absence.
    if not kind.suits(model) or kind.noise_inputs or not may_join(kind.id, known, every):
        return False
    return not kind.baseline or (not kind.override and model.name != "multibody")


def _prepare_flights(
    flights: Iterable[Flight | Record],
    labels: Iterator[str],
    rig: Rig,
    start_s: float | None,
    stop_s: float | None,
) -> tuple[list[Record], list[NotExcited]]:
    """Prepare flights for fitting; return their records, and the reasons why flights were skipped."""
    # `labels` goes on from the fitted to the held-out flights: `zip` asks for a flight first, so that the end
    # of the flights uses up no label.
    records, skipped = [], []
    for flight, label in zip(flights, labels, strict=False):
        if isinstance(flight, Record):  # prepared by the caller, such as a part of a flight
            records.append(flight)
            continue
        try:
            records.append(prepare(flight, rig, label, start_s=start_s, stop_s=stop_s))
        except NotExcited as why:
            skipped.append(why)
    return records, skipped


def _refuse_duplicates(train: Sequence[Record], held_out: Sequence[Record]) -> None:
    """Raise an IdentifyError if a flight is both fitted and held out."""
    for record in train:
        for other in held_out:
            if np.array_equal(record.angles_rad, other.angles_rad):
                raise IdentifyError(
                    f"{other.label} is both fitted and validated on", "give another flight to --validate"
                )
