"""Free runs of a model over another flight: calibration on its beginning, and prediction after that.

Encoders are zeroed and cables are laid again before each flight. Encoder zeros and one constant torque per
axis are therefore calibrated on the first seconds of the flight. The remaining flight is predicted in windows
of 2 s, and in their halves and quarters, so that all horizons have the same samples.

Each window starts from the state that fits it best, so the prediction is not a forecast. A forecast would
start from a state that is estimated from the past alone. Rates are not measured, so this state would contain
the model's errors over the past: on measured flights, such errors are 2 to 17 times as large. With fitted
initial states, the error is that of the model within the horizon.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.rig import Prior, Rig

from heli_lab.errors import IdentifyError
from heli_lab.explain.search.folds import split
from heli_lab.explain.thresholds import CALIBRATE_SHARE, CALIBRATE_s
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.identification import trace
from heli_lab.fit.problem import Fit, Problem, flight_constants
from heli_lab.fit.records import Record
from heli_lab.fit.shooting import solve
from heli_lab.fit.thresholds import MIN_SEGMENT_S

HORIZONS: Final[Mapping[str, int]] = {"0.5": 4, "1": 2, "2": 1}
"""Horizons [s], as the JSON names them, and into how many parts each divides a window of 2 s."""

_WINDOW_s: Final = 2.0
_STEP_s: Final = 0.004
"""Integration step. With 10 ms, fits of effects that change within milliseconds, such as dry friction,
fail."""


@dataclass(frozen=True)
class WindowErrors:
    """Squared errors of free runs at one horizon, summed over each window of 2 s.

    The windows are the same at all horizons, because a bootstrap must resample nearly independent units.
    """

    squares_rad2: Floats  # (w, 3): Sum of squared errors of each axis
    rows: Floats  # (w,): Number of samples of each window

    @property
    def rms_deg(self) -> Floats:
        """Root mean square error of each axis, shape (3,)."""
        result: Floats = np.rad2deg(np.sqrt(self.squares_rad2.sum(axis=0) / self.rows.sum()))
        return result


@dataclass(frozen=True)
class FreeRun:
    """Prediction of a flight by a model, after constants of the flight were calibrated on its beginning."""

    label: str  # Name of the flight
    calibrated_s: float
    """calibrated_s, evaluated_s: Duration of free flight used for the calibration, and predicted after it."""
    evaluated_s: float
    constants: Mapping[str, tuple[float, float]]
    """Calibrated zeros and torques by parameter name: value and standard error, in the rig file's units;
    empty if nothing was calibrated."""
    priors: Mapping[str, Prior]  # Priors of the constants
    errors: Mapping[str, WindowErrors]  # Errors by horizon, a key of `HORIZONS`
    fit: Fit
    """The predicted part in windows of 2 s, for `heli_lab.fit.trace`; only initial states were
    fitted."""


def free_run(
    model: Model,
    rig: Rig,
    values: Mapping[str, float],
    record: Record,
    calibrate_s: float = CALIBRATE_s,
    threads: int | None = None,
    horizons: Sequence[str] = tuple(HORIZONS),
) -> FreeRun:
    """Calibrate constants of a flight on its beginning, and predict the flight after that."""
    parameters = {**_mean_by_name(model, [model.parameter_values(rig)]), **values}
    calibration, prediction = split(record, calibrate_s)
    priors = flight_constants(model, rig, parameters)
    constants: dict[str, tuple[float, float]] = {}
    if calibration.segments:
        problem = windows_problem(model, rig, parameters, [calibration], priors, threads)
        fit = solve(problem, robust=False, scatter=False, warm_start=True)
        constants = {name: (value, fit.std[name]) for name, value in fit.values.items()}
        parameters |= fit.values
    # Equal bounds fix the constants: with the same free parameters the compiled kernel is reused.
    fixed_priors = {
        name: Prior(parameters[name], prior.std, parameters[name], parameters[name])
        for name, prior in priors.items()
    }
    problem = windows_problem(model, rig, parameters, [prediction], fixed_priors, threads)
    window_rows = [rows for _, rows in problem.windows(0)]
    fits = {}
    for key in horizons:
        runs = problem.with_split_windows(HORIZONS[key])
        fits[key] = solve(runs, robust=False, scatter=False, warm_start=True)
    return FreeRun(
        label=record.label,
        calibrated_s=calibration.used_s,
        evaluated_s=prediction.used_s,
        constants=constants,
        priors=priors if constants else {},
        errors={key: _window_errors(fit, window_rows) for key, fit in fits.items()},
        fit=fits[horizons[-1]],
    )


def estimated_free_runs(
    estimate: Estimate, flights: Sequence[Record], calibrate_s: float | None, horizons: Sequence[str]
) -> tuple[FreeRun, ...]:
    """Predict `flights` with an `estimate` of other flights in innovations form, each after a calibration."""
    vector = estimate.parameter_vector
    parameters = [vector.parameters(estimate.theta, index) for index in range(len(estimate.references))]
    values = _mean_by_name(vector.model, parameters)
    requested_s = CALIBRATE_s if calibrate_s is None else calibrate_s
    runs = []
    for record in flights:
        duration_s = min(requested_s, CALIBRATE_SHARE * record.used_s)
        runs.append(free_run(vector.model, vector.rig, values, record, duration_s, horizons=horizons))
    return tuple(runs)


def free_runs(
    fit: Fit, validation: Sequence[Record], calibrate_s: float | None = None
) -> tuple[FreeRun, ...]:
    """Predict flights with fitted parameters."""
    problem = fit.problem
    parameters = [problem.parameters(fit.theta, index) for index in range(len(problem.records))]

    def run(flights: Sequence[Floats], record: Record, duration_s: float) -> FreeRun:
        """Predict a flight with the means of the parameters of `flights`."""
        values = _mean_by_name(problem.model, flights)
        return free_run(problem.model, problem.rig, values, record, duration_s, problem.threads)

    if not validation:
        runs = zip(parameters, problem.records, strict=True)
        return tuple(run([flight_values], record, 0.0) for flight_values, record in runs)
    # The prior mean of a constant of another flight is its mean over the fitted flights.
    return tuple(run(parameters, record, calibration_s(record, calibrate_s)) for record in validation)


def calibration_s(record: Record, requested_s: float | None = None) -> float:
    """Limit the duration of a calibration to `CALIBRATE_SHARE` of a flight's free flight."""
    max_s = CALIBRATE_SHARE * record.used_s
    if requested_s is None:
        return min(CALIBRATE_s, max_s)
    if not requested_s >= 0.0:
        raise IdentifyError(f"{requested_s:g} s of calibration is not possible", "give --calibrate 0 or more")
    if requested_s > record.used_s - MIN_SEGMENT_S:
        raise IdentifyError(
            f"{requested_s:g} s of calibration leave no time of the {record.used_s:.3g} s of free flight in "
            f"{record.label}",
            f"give {max_s:.2g} or less to --calibrate, or a longer flight to --validate",
        )
    return min(requested_s, max_s)


def _mean_by_name(model: Model, parameters: Sequence[Floats]) -> dict[str, float]:
    """Return the mean of parameter vectors of a model, shape (p,) each, by name."""
    names = model.parameter_names
    return dict(zip(names, np.mean(parameters, axis=0).tolist(), strict=True))


def windows_problem(
    model: Model,
    rig: Rig,
    values: Mapping[str, float],
    records: Sequence[Record],
    priors: Mapping[str, Prior],
    threads: int | None,
) -> Problem:
    """Return the problem of simulating flights in windows of 2 s, in which the constants of each flight that
    are in `priors` are free.
    """
    return Problem(
        model,
        rig,
        records,
        free=tuple(priors),
        per_flight=tuple(priors),
        window_s=_WINDOW_s,
        step_s=_STEP_s,
        priors=priors,
        values=values,
        threads=threads,
    )


def _window_errors(fit: Fit, window_rows: Sequence[int]) -> WindowErrors:
    """Sum the squared errors of a fit over windows of `window_rows` rows each, whatever its horizon."""
    simulated = trace(fit)
    squares_rad2 = (simulated.residual * simulated.sigma_rad) ** 2
    first_rows = np.concatenate(([0], np.cumsum(window_rows)[:-1]))
    return WindowErrors(np.add.reduceat(squares_rad2, first_rows, axis=0), np.array(window_rows, float))
