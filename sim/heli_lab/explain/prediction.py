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
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.rig import Prior, Rig

from heli_lab.errors import IdentifyError
from heli_lab.explain.comparison import split
from heli_lab.explain.thresholds import CALIBRATE_SHARE, OUTSIDE_SHARE, VOLTAGE_TAIL, CALIBRATE_s
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.identification import trace
from heli_lab.fit.parameters import ValueAndStd
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
    """Squared errors of free runs at one horizon, summed over each window of 2 s."""

    # The windows are the same at all horizons, because a bootstrap must resample nearly independent units.

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
    constants: Mapping[str, ValueAndStd]
    """Calibrated zeros and torques by parameter name, in the rig file's units; empty if nothing was
    calibrated."""
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
    constants: dict[str, ValueAndStd] = {}
    if calibration.segments:
        problem = windows_problem(model, rig, parameters, [calibration], priors, threads)
        fit = solve(problem, robust=False, scatter=False, warm_start=True)
        constants = {name: ValueAndStd(value, fit.std[name]) for name, value in fit.params.items()}
        parameters |= fit.params
    # Equal bounds fix the constants: with the same free parameters the compiled kernel is reused.
    fixed_priors = {
        name: Prior(mean=parameters[name], std=prior.std, low=parameters[name], high=parameters[name])
        for name, prior in priors.items()
    }
    problem = windows_problem(model, rig, parameters, [prediction], fixed_priors, threads)
    window_rows = [rows for _, rows in problem.windows(index=0)]  # `prediction` is the only record
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
    """Predict the `validation` flights with fitted parameters; without any, the fitted flights, each with its
    own parameters and without calibration.
    """
    problem = fit.problem
    # Each fitted flight has constants of its own, and so a parameter vector.
    parameters = [problem.parameters(fit.theta, index) for index in range(len(problem.records))]

    def run(vectors: Sequence[Floats], record: Record, duration_s: float) -> FreeRun:
        """Predict a flight with the mean of parameter `vectors`, after a calibration of so many seconds."""
        values = _mean_by_name(problem.model, vectors)
        return free_run(problem.model, problem.rig, values, record, duration_s, problem.threads)

    if not validation:
        runs = zip(parameters, problem.records, strict=True)
        return tuple(run([vector], record, 0.0) for vector, record in runs)
    # The prior mean of a constant of another flight is its mean over the fitted flights.
    return tuple(run(parameters, record, calibration_s(record, calibrate_s)) for record in validation)


def calibration_s(record: Record, requested_s: float | None = None) -> float:
    """Limit the duration of a calibration, `CALIBRATE_s` by default, to `CALIBRATE_SHARE` of a flight's free
    flight.
    """
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


@dataclass(frozen=True)
class NormalisedError:
    """Root mean square free-run error, in standard deviations of the encoders' quantisation."""

    # It is 1 if the model is right.

    total: float  # Over all axes
    axes: Floats  # (3,): By axis: elevation, pitch, travel


@dataclass(frozen=True, eq=False)
class Prediction:
    """Free runs of a model whose parameters are estimated, and their errors."""

    fit: Fit  # Parameters with their covariance, and free runs over the fitted flights
    held_out_fit: Fit | None
    """Free runs over the held-out flights, for which only encoder zeros, constant torques and initial states
    were estimated; None if no flight is held out."""
    train: NormalisedError
    """train, held_out: Errors on the fitted and on the held-out flights; the same if no flight is held out.
    """
    held_out: NormalisedError


def predict(estimate: Estimate, train: Sequence[Record], held_out: Sequence[Record]) -> Prediction:
    """Simulate flights in free runs of 2 s with the parameters of an estimate in innovations form."""
    # Quantities that differ from flight to flight (encoder zeros, a constant torque about each axis) are
    # estimated from the free runs themselves, because innovations carry little information about constants.
    fit = _free_run(estimate, train, own_calibration=True)
    held_out_fit = _free_run(estimate, held_out, own_calibration=False) if held_out else None
    train_error = normalised_error(fit)
    held_out_error = normalised_error(held_out_fit) if held_out_fit else train_error
    return Prediction(fit, held_out_fit, train_error, held_out_error)


def normalised_error(fit: Fit) -> NormalisedError:
    """Measure the errors of a fit over every sample of its flights."""
    samples = normalised_samples(fit)
    return NormalisedError(float(np.sqrt(np.mean(samples**2))), np.sqrt(np.mean(samples**2, axis=0)))


def normalised_samples(fit: Fit) -> Floats:
    """Return the open-loop errors of a fit at every sample of its flights, shape (n, 3)."""
    # The unit is the standard deviation of each encoder's quantisation.
    return np.concatenate(
        [fit.problem.residual(index, fit.theta, states, fine=True) for index, states in enumerate(fit.states)]
    )


def _free_run(estimate: Estimate, records: Sequence[Record], own_calibration: bool) -> Fit:
    """Simulate `records` in free runs with the parameters of an estimate."""
    # Only zeros, constant torques and initial states are fitted. `own_calibration` states whether the records
    # are those of the estimate; the result then has the parameters and the covariance of the estimate.
    parameter_vector = estimate.parameter_vector
    flight_priors = {
        parameter.quantity: parameter.prior for parameter in parameter_vector.free if not parameter.is_shared
    }
    values = parameter_vector.shared_by_name(estimate.theta)
    problem = windows_problem(
        parameter_vector.model, parameter_vector.rig, values, records, flight_priors, None
    )
    fit = solve(problem, robust=False, scatter=False, warm_start=True)
    return _with_estimate(fit, estimate) if own_calibration else fit


def _with_estimate(fit: Fit, estimate: Estimate) -> Fit:
    """Put parameters and covariance of an `estimate` into a `fit` of the same flights."""
    vector = estimate.parameter_vector
    calibrated = {
        (parameter.quantity, parameter.record): value
        for parameter, value in zip(fit.problem.free, fit.theta, strict=True)
    }
    low, high = vector.bounds
    return replace(
        fit,
        problem=fit.problem.with_free(vector.free),
        theta=np.array(
            [
                value if parameter.is_shared else calibrated[parameter.quantity, parameter.record]
                for parameter, value in zip(vector.free, estimate.theta, strict=True)
            ]
        ),
        covariance=estimate.covariance,
        information=np.asarray(np.linalg.inv(estimate.covariance) - np.diag(vector.std**-2.0), float),
        at_bound=tuple(np.array(vector.names)[(estimate.theta <= low) | (estimate.theta >= high)].tolist()),
    )


_RESAMPLES: Final = 2000
"""Bootstrap samples: 50 are beyond each end of a 95 % interval."""


@dataclass(frozen=True)
class ErrorReduction:
    """Free-run error of one axis before and after an extension."""

    before_deg: float
    """before_deg, after_deg: Root mean square error of the baseline and of the extended model."""
    after_deg: float
    interval95: tuple[float, float]
    """(float, float): 95 % interval of the ratio after/before, by a bootstrap over windows of 2 s."""

    @property
    def ratio(self) -> float:
        """Error after over error before; 1 if the axis never moved and there is no error."""
        return self.after_deg / self.before_deg if self.before_deg > 0.0 else 1.0


@dataclass(frozen=True)
class HeldOutComparison:
    """Free runs of two models on the same flights."""

    before: tuple[FreeRun, ...]
    """before, after: Free runs of the baseline and of the extended model, one per flight."""
    after: tuple[FreeRun, ...]
    horizons: Mapping[str, Mapping[str, ErrorReduction]]
    """Error reductions by horizon, a key of `HORIZONS`, and by axis."""


def compare_free_runs(
    before: Sequence[FreeRun], after: Sequence[FreeRun], seed: int = 0
) -> HeldOutComparison:
    """Compare the free runs of two models over the same flights."""
    return HeldOutComparison(
        tuple(before),
        tuple(after),
        {
            key: error_reduction(
                [run.errors[key] for run in before], [run.errors[key] for run in after], seed
            )
            for key in HORIZONS
        },
    )


def error_reduction(
    before: Sequence[WindowErrors], after: Sequence[WindowErrors], seed: int = 0
) -> dict[str, ErrorReduction]:
    """Compare the errors of two models by axis."""
    rows = np.concatenate([run.rows for run in before])
    squares_before = np.concatenate([run.squares_rad2 for run in before])
    squares_after = np.concatenate([run.squares_rad2 for run in after])
    count = len(rows)
    random = np.random.default_rng(seed)
    # How often each bootstrap sample contains each window, shape (resamples, windows).
    weights = random.multinomial(count, np.full(count, 1.0 / count), _RESAMPLES)
    resampled_before = weights @ squares_before
    resampled_after = weights @ squares_after
    has_error = resampled_before > 0.0
    ratios = np.sqrt(np.where(has_error, resampled_after, 1.0) / np.where(has_error, resampled_before, 1.0))
    low, high = np.quantile(ratios, [0.025, 0.975], axis=0)
    rms_before = np.rad2deg(np.sqrt(squares_before.sum(axis=0) / rows.sum()))
    rms_after = np.rad2deg(np.sqrt(squares_after.sum(axis=0) / rows.sum()))
    return {
        axis: ErrorReduction(float(rms_before[i]), float(rms_after[i]), (float(low[i]), float(high[i])))
        for i, axis in enumerate(AXES)
    }


_ROTORS: Final = ("front", "back")


@dataclass(frozen=True)
class Extrapolation:
    """Windows of a flight whose voltages are outside of those of the fitted flights."""

    label: str  # Name of the flight
    ranges_V: dict[str, tuple[float, float]]
    """Voltages of each rotor in the fitted flights, without the tails."""
    windows: int  # Number of windows of 2 s that are predicted
    spans_s: tuple[tuple[float, float], ...]
    """Begin and end of each window that has other voltages for more than `OUTSIDE_SHARE` of its time."""


def extrapolations(fitted: Sequence[Record], runs: Sequence[FreeRun]) -> tuple[Extrapolation, ...]:
    """Find the windows of free runs in which the model extrapolates."""
    voltages_V = np.concatenate(
        [record.voltages_V[start:stop] for record in fitted for start, stop in record.segments]
    )
    low_V, high_V = np.quantile(voltages_V, [VOLTAGE_TAIL, 1.0 - VOLTAGE_TAIL], axis=0)
    ranges_V = {
        rotor: (float(low), float(high)) for rotor, low, high in zip(_ROTORS, low_V, high_V, strict=True)
    }
    return tuple(_extrapolation(run, ranges_V, low_V, high_V) for run in runs)


def _extrapolation(
    run: FreeRun, ranges_V: dict[str, tuple[float, float]], low_V: Floats, high_V: Floats
) -> Extrapolation:
    """Find the windows of a free run whose voltages are outside of `low_V` and `high_V`, shape (2,) each."""
    (record,) = run.fit.problem.records
    windows = run.fit.problem.windows(0)
    spans_s = []
    for first, count in windows:
        rows = slice(first, first + count)
        voltages_V = record.voltages_V[rows]
        is_outside = ((voltages_V < low_V) | (voltages_V > high_V)).any(axis=1)
        if is_outside.mean() > OUTSIDE_SHARE:
            first_s, *_, last_s = record.t_s[rows].tolist()
            spans_s.append((first_s, last_s))
    return Extrapolation(run.label, ranges_V, len(windows), tuple(spans_s))
