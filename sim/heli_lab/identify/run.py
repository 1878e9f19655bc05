"""Identification from beginning to end: flights in, a rig with uncertainties out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from heli_host.flight import Flight
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.identify.estimation_problem import Budget, FitProgress, Problem
from heli_lab.identify.estimation_problem.initial_states import initial_state_guess
from heli_lab.identify.free import estimated_names
from heli_lab.identify.record import Record, prepare
from heli_lab.identify.results import Identification, check, refuse_unexplained, trace, validate
from heli_lab.identify.shooting import solve
from heli_lab.identify.thresholds import FAR_RAD, SHORT_WINDOW_S


def identify(
    model: Model,
    rig: Rig,
    flights: Sequence[Flight | Record],
    *,
    validation: Sequence[Flight | Record] = (),
    free: Sequence[str] | None = None,
    fixed: Sequence[str] = (),
    labels: Sequence[str] | None = None,
    validation_labels: Sequence[str] | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    window_s: float = 2.0,
    seconds: float = float("inf"),
    threads: int | None = None,
    on_progress: Callable[[FitProgress], None] | None = None,
    as_is: bool = False,
) -> Identification:
    """Estimate a model's parameters from flights, and validate them on others.

    Parameters
    ----------
    free : sequence of str, optional
        Names of the free parameters; see `Problem`.
    fixed : sequence of str
        Names of parameters that stay as they are, though they would be free otherwise.
    labels, validation_labels : sequence of str, optional
        Names of the flights.
    start_s, stop_s : float, optional
        Fit only this part of each flight.
    window_s : float
        Length of the windows of the open-loop simulation.
    seconds : float
        Most time for the fit.
    threads : int, optional
        Threads of the predictions; see `Problem`.
    on_progress : callable, optional
        Called with the progress of the work.
    as_is : bool
        Accept flights whose motion the voltages do not explain, such as noise.

    Raises
    ------
    IdentifyError
        When nothing can be identified from the flights.
    NotExcited
        When the voltages do not explain a flight's motion; see `heli_lab.identify.results.explained`.
    """
    started_s = time.perf_counter()
    say = on_progress or (lambda _: None)
    say(FitProgress("finding the free flight", 0.0, 0.0))
    records = _prepared(flights, rig, labels, "flight", start_s, stop_s)
    others = _prepared(validation, rig, validation_labels, "validation", None, None)
    if any(record is other or record.label == other.label for record in records for other in others):
        raise IdentifyError("a flight is both fitted and validated on", "give another flight to --validate")
    say(FitProgress("compiling the model, once for each", 0.05, 0.0))
    names = estimated_names(model, rig, free, fixed)
    problem = Problem(model, rig, records, free=names, window_s=window_s, threads=threads)
    fit = solve(
        problem,
        start=_start_values(problem),
        budget=Budget(seconds=seconds - (time.perf_counter() - started_s)),
        on_progress=lambda p: say(FitProgress(p.stage, 0.1 + 0.7 * p.done, p.cost)),
    )
    say(FitProgress("checking", 0.85, fit.cost))
    held_out = validate(fit, others) if others else None
    count = range(len(records))
    seen = tuple(trace(fit, index) for index in count)
    seen_held_out = tuple(trace(held_out, index) for index in range(len(others))) if held_out else ()
    for sign in () if as_is else (*seen, *seen_held_out):
        refuse_unexplained(sign)
    return Identification(
        fit,
        tuple(check(fit, index) for index in count),
        tuple(check(held_out, index) for index in range(len(others))) if held_out else (),
        seen,
        seen_held_out,
    )


def _start_values(problem: Problem) -> dict[str, float] | None:
    """Start values from short windows, where those of the rig file are so far off that long ones diverge."""
    evaluations = zip(
        problem.records, initial_state_guess(problem, problem.parameter_vector.start), strict=True
    )
    for index, (record, states) in enumerate(evaluations):
        evaluation = problem.evaluation(index, problem.parameter_vector.start, states, derivatives=False)
        with np.errstate(all="ignore"):
            off_rad = np.sqrt(np.mean(evaluation.residual**2, axis=0)) * record.sigma_rad
        if not np.all(off_rad < FAR_RAD):
            short = problem.with_windows(SHORT_WINDOW_S)
            return solve(short, budget=Budget(evaluations=30), fine=False).values
    return None


def _prepared(
    flights: Sequence[Flight | Record],
    rig: Rig,
    labels: Sequence[str] | None,
    word: str,
    start_s: float | None,
    stop_s: float | None,
) -> list[Record]:
    names = labels if labels is not None else [f"{word} {number}" for number in range(1, len(flights) + 1)]
    return [
        flight if isinstance(flight, Record) else prepare(flight, rig, name, start_s=start_s, stop_s=stop_s)
        for flight, name in zip(flights, names, strict=True)
    ]
