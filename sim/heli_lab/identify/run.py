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
from heli_lab.identify.results import (
    FreeRunErrors,
    Identification,
    Trace,
    check,
    refuse_unexplained,
    trace,
    validate,
)
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
    model : Model
        Equations of motion with their effects.
    rig : Rig
        Start values of the parameters, and their priors by its tolerances.
    flights, validation : sequence of Flight or Record
        Flights that are fitted, and flights that are only predicted.
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
    report = on_progress or (lambda _: None)
    report(FitProgress("finding the free flight", 0.0, 0.0))
    records = _prepared(flights, rig, labels, "flight", start_s, stop_s)
    held_out = _prepared(validation, rig, validation_labels, "validation", None, None)
    if any(record is other or record.label == other.label for record in records for other in held_out):
        raise IdentifyError("a flight is both fitted and validated on", "give another flight to --validate")
    report(FitProgress("compiling the model, once for each", 0.05, 0.0))
    names = estimated_names(model, rig, free, fixed)
    problem = Problem(model, rig, records, free=names, window_s=window_s, threads=threads)
    fit = solve(
        problem,
        start=_start_values(problem),
        budget=Budget(seconds=seconds - (time.perf_counter() - started_s)),
        on_progress=lambda p: report(FitProgress(p.stage, 0.1 + 0.7 * p.done, p.cost)),
    )
    report(FitProgress("checking", 0.85, fit.cost))
    training_traces = tuple(trace(fit, index) for index in range(len(records)))
    training = tuple(check(fit, index) for index in range(len(records)))
    validation_traces: tuple[Trace, ...] = ()
    validation_errors: tuple[FreeRunErrors, ...] = ()
    if held_out:
        held_out_fit = validate(fit, held_out)
        validation_traces = tuple(trace(held_out_fit, index) for index in range(len(held_out)))
        validation_errors = tuple(check(held_out_fit, index) for index in range(len(held_out)))
    if not as_is:
        for flight in (*training_traces, *validation_traces):
            refuse_unexplained(flight)
    return Identification(fit, training, validation_errors, training_traces, validation_traces)


def _start_values(problem: Problem) -> dict[str, float] | None:
    """Start values of the free parameters by name, from a fit of short windows; None if the values of the rig
    file are near enough for long windows.
    """
    start = problem.parameter_vector.start
    initial_states = initial_state_guess(problem, start)
    for index, record in enumerate(problem.records):
        evaluation = problem.evaluation(index, start, initial_states[index], derivatives=False)
        with np.errstate(all="ignore"):
            error_rad = np.sqrt(np.mean(evaluation.residual**2, axis=0)) * record.sigma_rad
        # An error that is not a number has diverged.
        if not np.all(error_rad < FAR_RAD):
            short_windows = problem.with_windows(SHORT_WINDOW_S)
            return solve(short_windows, budget=Budget(evaluations=30), fine=False).values
    return None


def _prepared(
    flights: Sequence[Flight | Record],
    rig: Rig,
    labels: Sequence[str] | None,
    role: str,
    start_s: float | None,
    stop_s: float | None,
) -> list[Record]:
    """Prepare those flights that are not prepared yet; without labels, each is named by its `role` and
    number.
    """
    names = labels if labels is not None else [f"{role} {number}" for number in range(1, len(flights) + 1)]
    return [
        flight if isinstance(flight, Record) else prepare(flight, rig, name, start_s=start_s, stop_s=stop_s)
        for flight, name in zip(flights, names, strict=True)
    ]
