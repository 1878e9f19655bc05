"""Identify a rig: estimate its parameters with their uncertainties from flights, and check the result."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.fit.identify.estimation_problem import Budget, Fit, FitProgress, Problem
from heli_lab.fit.identify.estimation_problem.initial_states import initial_state_guess
from heli_lab.fit.identify.free import estimated_names
from heli_lab.fit.identify.record import Record, prepare_all
from heli_lab.fit.identify.results import (
    FreeRunErrors,
    Identification,
    Trace,
    check,
    refuse_unexplained,
    trace,
    validate,
)
from heli_lab.fit.identify.shooting import solve
from heli_lab.fit.identify.thresholds import FAR_RAD, SHORT_WINDOW_S

_SHORT_WINDOW_EVALUATIONS: Final = 30
"""Largest number of predictions of all flights in the fit of short windows, which only supplies start
values."""


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
    max_fit_s: float = float("inf"),
    threads: int | None = None,
    on_progress: Callable[[FitProgress], None] | None = None,
    skip_sign_check: bool = False,
) -> Identification:
    """Estimate a model's parameters from flights, and validate them on others."""
    started_s = time.perf_counter()
    report = on_progress or (lambda _: None)
    report(FitProgress("finding the free flight", 0.0, 0.0))
    records = prepare_all(flights, rig, labels, start_s=start_s, stop_s=stop_s)
    held_out = prepare_all(validation, rig, validation_labels, "validation")
    if any(record is other or record.label == other.label for record in records for other in held_out):
        raise IdentifyError("a flight is both fitted and validated on", "give another flight to --validate")
    report(FitProgress("compiling the model", 0.05, 0.0))
    names = estimated_names(model, rig, free, fixed)
    problem = Problem(model, rig, records, free=names, window_s=window_s, threads=threads)
    fit = solve(
        problem,
        start=_start_values(problem),
        budget=Budget(max_time_s=max_fit_s - (time.perf_counter() - started_s)),
        on_progress=lambda p: report(FitProgress(p.stage, 0.1 + 0.7 * p.done, p.cost)),
    )
    report(FitProgress("checking", 0.85, fit.cost))
    training_traces, training = _free_runs(fit)
    validated = validate(fit, held_out) if held_out else None
    validation_traces, validation_errors = _free_runs(validated) if validated is not None else ((), ())
    validation_converged = validated is None or validated.converged
    if not skip_sign_check:
        for flight in (*training_traces, *validation_traces):
            refuse_unexplained(flight)
    return Identification(
        fit, training, validation_errors, training_traces, validation_traces, validation_converged
    )


def _free_runs(fit: Fit) -> tuple[tuple[Trace, ...], tuple[FreeRunErrors, ...]]:
    """Return the free run (open-loop simulation) of each flight of a fit, and its errors."""
    flights = range(len(fit.problem.records))
    return tuple(trace(fit, index) for index in flights), tuple(check(fit, index) for index in flights)


def _start_values(problem: Problem) -> dict[str, float] | None:
    """Find start values of the free parameters from which long windows do not diverge."""
    start = problem.parameter_vector.start
    initial_states = initial_state_guess(problem, start)
    for index, record in enumerate(problem.records):
        residual = problem.residual(index, start, initial_states[index])
        with np.errstate(all="ignore"):
            error_rad = np.sqrt(np.mean(residual**2, axis=0)) * record.sigma_rad
        # An error that is not a number has diverged.
        if not np.all(error_rad < FAR_RAD):
            short_windows = problem.with_windows(SHORT_WINDOW_S)
            return solve(
                short_windows, budget=Budget(max_evaluations=_SHORT_WINDOW_EVALUATIONS), fine=False
            ).values
    return None
