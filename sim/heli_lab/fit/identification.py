"""Identify a rig: fit it to flights, check the fit on its own and on held-out flights, write it as a rig.

To test whether the voltages explain a flight, its motion is compared with the fit's free run, window by
window. A parabola is subtracted from both in each window, because initial states and constant torques give a
parabola with any voltages. The remaining motion of a rig resembles the free run, even if the model's gain is
wrong. The remaining motion of mere noise does not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.rig import Number, Rig

from heli_lab.errors import IdentifyError, NotExcited
from heli_lab.fit.parameters import ValueAndStd
from heli_lab.fit.problem import (
    PER_FLIGHT,
    Budget,
    Fit,
    FitProgress,
    Problem,
    estimated_names,
    initial_state_guess,
)
from heli_lab.fit.records import Record, prepare_all
from heli_lab.fit.shooting import solve
from heli_lab.fit.thresholds import (
    FAR_RAD,
    MIN_MOTION,
    REST_COUNTS,
    SHORT_WINDOW_S,
    STRONG_CORRELATION,
    UNEXPLAINED,
    WHITE_LAG_S,
)
from heli_lab.fit.uncertainty import (
    Combination,
    combinations,
    correlation_at,
    normalised,
    uninformed_parameters,
)
from heli_lab.fit.voltage_timing import sampled, slow_log_notes

_IDENTIFIED: Final = " as identified from "
"""Words between the names of the first rig and of the flights in the description of an identified rig."""


@dataclass(frozen=True)
class FreeRunErrors:
    """Free-run errors of a fit on one flight.

    Parameters
    ----------
    label : str
        The flight.
    window_s : float
        Mean length of the windows, each predicted from its own initial state.
    normalised : float
        Root mean square of all errors, in standard deviations of the quantisation.
    axis_normalised : dict of float
        The same for each axis, by its name.
    rms_deg : dict of float
        Root mean square error of each axis [deg].
    correlation : dict of float
        Autocorrelation of each axis' error at a lag of 0.1 s.
    white : dict of bool
        Whether the correlation is within three standard errors of that of white noise.
    seconds_used : float
        Free flight in all windows [s].
    """

    label: str
    window_s: float
    normalised: float
    axis_normalised: dict[str, float]
    rms_deg: dict[str, float]
    correlation: dict[str, float]
    white: dict[str, bool]
    seconds_used: float


@dataclass(frozen=True)
class Trace:
    """Measured and predicted angles of one flight; each window is predicted from its own initial state.

    Parameters
    ----------
    label : str
        The flight.
    t_s : ndarray (m,)
        Times.
    measured_rad, predicted_rad : ndarray (m, 3)
        Angles.
    residual : ndarray (m, 3)
        Measured minus predicted, in standard deviations of the quantisation.
    windows : tuple of slice
        Rows of each window.
    sigma_rad : ndarray (3,)
        Standard deviation of the quantisation.
    """

    label: str
    t_s: Floats
    measured_rad: Floats
    predicted_rad: Floats
    residual: Floats
    windows: tuple[slice, ...]
    sigma_rad: Floats


def trace(fit: Fit, index: int = 0) -> Trace:
    """Predict flight number `index` of a fit at every sample, window by window."""
    residual = fit.problem.residual(index, fit.theta, fit.states[index], fine=True)
    grid = fit.problem.grid(index, fine=True, theta=fit.theta)
    record = grid.record
    measured = grid.measured_rad
    return Trace(
        label=record.label,
        t_s=record.t_s[grid.rows],
        measured_rad=measured,
        predicted_rad=measured - residual * record.sigma_rad,
        residual=residual,
        windows=tuple(grid.slices),
        sigma_rad=record.sigma_rad,
    )


def check(fit: Fit, index: int = 0) -> FreeRunErrors:
    """Measure the free-run errors of a fit on its flight number `index`, and test whether they are white."""
    flight = trace(fit, index)
    step_s = fit.problem.records[index].step_s
    lag_rows = max(1, round(WHITE_LAG_S / step_s))
    correlation, bound = correlation_at(flight.residual, flight.windows, lag_rows)
    rms = np.sqrt(np.mean(flight.residual**2, axis=0))
    used_s = len(flight.t_s) * step_s
    return FreeRunErrors(
        label=flight.label,
        window_s=used_s / len(flight.windows),
        normalised=normalised(flight.residual),
        axis_normalised=_by_axis(rms),
        rms_deg=_by_axis(np.rad2deg(rms * flight.sigma_rad)),
        correlation=_by_axis(correlation),
        white={axis: bool(abs(value) < bound) for axis, value in zip(AXES, correlation, strict=True)},
        seconds_used=used_s,
    )


def validate(fit: Fit, flights: Sequence[Flight | Record]) -> Fit:
    """Apply a fit to held-out flights, with its shared parameters fixed.

    Only the quantities that differ from flight to flight are estimated: the initial states of the windows,
    and the encoders' zeros, which are set each time the board starts.

    Parameters
    ----------
    fit : Fit
        Estimates from other flights.
    flights : sequence of Flight or Record
        The held-out flights.

    Returns
    -------
    Fit
        The held-out flights with these parameters, for `check` and `trace`. The standard errors of the zeros
        do not include the effect of quantisation.
    """
    problem, vector = fit.problem, fit.problem.parameter_vector
    per_flight_priors = {
        parameter.quantity: parameter.prior for parameter in problem.free if not parameter.is_shared
    }
    held_out = Problem(
        problem.model,
        problem.rig,
        flights,
        free=tuple(per_flight_priors),
        per_flight=tuple(per_flight_priors),
        window_s=problem.grids.window_s,
        step_s=problem.grids.step_s,
        priors=per_flight_priors,
        values=vector.values_by_name | vector.shared_by_name(fit.theta),
        state_std=problem.state_std_by_name,
    )
    return solve(held_out, robust=False, scatter=False)


def _by_axis(values: Floats) -> dict[str, float]:
    """Return `values`, shape (3,), by the names of the axes."""
    return {axis: float(value) for axis, value in zip(AXES, values, strict=True)}


def unexplained_shares(flight: Trace) -> tuple[Floats, Floats]:
    """Measure the share of a flight's motion that its free run does not explain, and the size of the motion.
    Returns shape `shares` (3,), `motion` (3,).
    """
    # Sums over all windows, after the parabolas are subtracted.
    cross_sum, measured_sum, predicted_sum = (np.zeros(len(AXES)) for _ in range(3))
    for window in flight.windows:
        t = np.linspace(-1.0, 1.0, window.stop - window.start)
        # Orthonormal basis of all parabolas, shape (rows, 3).
        parabolas, _ = np.linalg.qr(np.column_stack((np.ones_like(t), t, t**2)))
        measured, predicted = (
            angles[window] - parabolas @ (parabolas.T @ angles[window])
            for angles in (flight.measured_rad, flight.predicted_rad)
        )
        cross_sum += np.sum(measured * predicted, axis=0)
        measured_sum += np.sum(measured**2, axis=0)
        predicted_sum += np.sum(predicted**2, axis=0)
    correlation = cross_sum / np.sqrt(np.maximum(measured_sum * predicted_sum, np.finfo(float).tiny))
    # A free run that diverged to nan explains nothing.
    correlation = np.clip(np.nan_to_num(correlation), 0.0, 1.0)
    return np.sqrt(1.0 - correlation**2), np.sqrt(measured_sum / len(flight.t_s)) / flight.sigma_rad


def unexcited_axes(flights: Sequence[Trace]) -> dict[str, float]:
    """Find the axes whose free runs show nothing about the model."""
    # Within each window, such an axis rests, or follows a parabola to within its encoder's quantisation. Any
    # model predicts that. The values are the ranges of the angles [deg], 0 at rest.
    motion = np.array([unexplained_shares(flight)[1] for flight in flights])
    range_rad = np.array([np.ptp(flight.measured_rad, axis=0) for flight in flights])
    count_rad = np.array([flight.sigma_rad for flight in flights]) * np.sqrt(12.0)
    range_rad[range_rad < (REST_COUNTS + 0.5) * count_rad] = 0.0
    is_unexcited = np.all(motion <= MIN_MOTION, axis=0)
    largest_deg = np.rad2deg(range_rad.max(axis=0))
    return {axis: float(largest_deg[i]) for i, axis in enumerate(AXES) if is_unexcited[i]}


def refuse_unexplained(flight: Trace) -> None:
    """Refuse a flight whose motion does not resemble the free run on any axis."""
    shares, motion = unexplained_shares(flight)
    moving = motion > MIN_MOTION
    if not moving.any():
        return  # nothing is to be explained
    best = int(np.argmin(np.where(moving, shares, np.inf)))
    if shares[best] > UNEXPLAINED:
        raise NotExcited(
            f"{flight.label}: the voltages do not explain the motion: they leave {100 * shares[best]:.0f} % "
            f"of {AXES[best]}, the best axis, unexplained (in a real flight at most "
            f"{100 * UNEXPLAINED:.0f} %)",
            "check that angles and voltages are of one flight of this rig (or fit it with --skip-sign-check)",
        )


@dataclass(frozen=True)
class Identification:
    """Result of an identification: a fit with its free runs.

    Parameters
    ----------
    fit : Fit
        Estimates from the training flights.
    training, validation : tuple of FreeRunErrors
        Errors of the free runs, one per fitted and per validation flight.
    training_traces, validation_traces : tuple of Trace
        Measured and predicted angles of the same flights.
    validation_converged : bool
        Whether the initial states and zeros of the validation flights are those with the smallest error.
    """

    fit: Fit
    training: tuple[FreeRunErrors, ...]
    validation: tuple[FreeRunErrors, ...]
    training_traces: tuple[Trace, ...]
    validation_traces: tuple[Trace, ...]
    validation_converged: bool = True

    @property
    def converged(self) -> bool:
        """Whether the fit has converged, and the initial states of the validation flights too."""
        return self.fit.converged and self.validation_converged

    @property
    def combinations(self) -> list[Combination]:
        """Combinations of parameters about which the flights contain less information than the priors."""
        problem = self.fit.problem
        return combinations(problem.names, self.fit.information, problem.parameter_vector.std)

    @property
    def uninformed_parameters(self) -> list[str]:
        """Parameters about which the flights contain no information."""
        problem = self.fit.problem
        return uninformed_parameters(problem.names, self.fit.covariance, problem.parameter_vector.std)

    def remark(self, name: str) -> str:
        """Remark on the free parameter `name`: "on its bound" or "uninformed"; empty if neither."""
        if name in self.fit.at_bound:
            return "on its bound"
        return "uninformed" if name in self.uninformed_parameters else ""

    @property
    def slow_log_notes(self) -> list[str]:
        """Limits of logs that are slower than the control loop, one note each."""
        return slow_log_notes(self.fit.problem.records)

    @property
    def strong_correlations(self) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose correlation exceeds `STRONG_CORRELATION`: both names and the correlation,
        strongest first.
        """
        names, correlation = self.fit.problem.names, self.fit.correlation
        pairs = [
            (names[i], names[j], float(correlation[i, j]))
            for i in range(len(names))
            for j in range(i)
            if abs(correlation[i, j]) > STRONG_CORRELATION
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))

    def rig(self, name: str) -> Rig:
        """Return the identified rig, called `name`.

        Identified parameters have twice their standard error as tolerance; everything else stays unchanged.
        The source of a parameter states if the flights do not inform it. The rig has the name and the effects
        of the fitted model. If a torque was estimated for each flight separately, the rig has the mean of
        these torques, and their scatter in the tolerance. If encoder zeros were estimated for each flight,
        the rig keeps its old zeros.
        """
        fitted_rig = self.fit.problem.rig
        labels = ", ".join(record.label for record in self.fit.problem.records)
        numbers = dict(fitted_rig.numbers)
        uninformed = set(self.uninformed_parameters)
        for quantity, estimates in self._estimates_by_quantity().items():
            prior_number = numbers[quantity]
            values, stds = np.array(estimates).T
            scatter = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            tolerance = 2.0 * math.hypot(float(np.sqrt(np.mean(stds**2))), scatter)
            origin = "not informed by" if quantity in uninformed else "identified from"
            source = f"{origin} {labels}; before: {prior_number.value:g} +- {prior_number.tolerance:g}"
            numbers[quantity] = Number(float(np.mean(values)), prior_number.unit, tolerance, source)
        description = f"{fitted_rig.name}{_IDENTIFIED}{labels}"
        return Rig(name, description, numbers, self._effect_numbers(), self.fit.problem.model.name)

    def _estimates_by_quantity(self) -> dict[str, list[ValueAndStd]]:
        """Collect the estimates of each rig parameter: one, or one per flight if flights differ in it."""
        fit, problem = self.fit, self.fit.problem
        several_flights = len(problem.records) > 1
        estimates: dict[str, list[ValueAndStd]] = {}
        for parameter, value, std in zip(problem.free, fit.theta, fit.std.values(), strict=True):
            of_one_flight = several_flights and parameter.quantity in PER_FLIGHT
            if parameter.quantity in problem.rig.numbers and not of_one_flight:
                estimates.setdefault(parameter.quantity, []).append(ValueAndStd(float(value), std))
        return estimates

    def _effect_numbers(self) -> dict[str, dict[str, Number]]:
        """Return the parameters of the model's effects as a rig file has them: by effect, then by short
        name.
        """
        problem = self.fit.problem
        values = problem.parameter_vector.values_by_name
        estimates, std = self.fit.params, self.fit.std
        labels = ", ".join(record.label for record in problem.records)
        effects: dict[str, dict[str, Number]] = {}
        for effect in problem.model.effects:
            numbers = effects.setdefault(effect.name, {})
            for parameter in effect.parameters:
                name = parameter.name
                if name in estimates:
                    value, tolerance, source = estimates[name], 2.0 * std[name], f"identified from {labels}"
                else:
                    value, tolerance, source = values[name], 0.0, "not estimated"
                short_name = name.removeprefix(f"{effect.name.replace('.', '_')}_")
                numbers[short_name] = Number(float(value), parameter.unit, tolerance, source)
        return effects

    def json(self) -> dict[str, Any]:
        """Return the result as the object that result.json contains.

        Its keys are parameters{NAME: {value, std, prior: {value, std}, unit}},
        normalised_residual{train, validation}, free_run_rms_deg{axis: ...}, correlations{NAME: {NAME: ...}},
        seconds_used, and more.
        """
        fit, problem = self.fit, self.fit.problem
        evaluated = self.validation or self.training
        return {
            "model": problem.model.name,
            "effects": [effect.name for effect in problem.model.effects],
            "rig": problem.rig.name,
            "parameters": {
                parameter.name: {
                    "value": float(value),
                    "std": std,
                    "unit": parameter.unit,
                    "prior": {"value": parameter.prior.mean, "std": parameter.prior.std},
                    "at_bound": parameter.name in fit.at_bound,
                }
                for parameter, value, std in zip(problem.free, fit.theta, fit.std.values(), strict=True)
            },
            "normalised_residual": {
                "train": _rms_normalised(self.training),
                "validation": _rms_normalised(self.validation) if self.validation else None,
            },
            "free_run_rms_deg": {
                axis: _rms_over_flights(evaluated, [errors.rms_deg[axis] for errors in evaluated])
                for axis in AXES
            },
            "free_run_s": problem.grids.window_s,
            "free_run_of": "validation" if self.validation else "train",
            "correlations": {
                name: {other: round(float(value), 4) for other, value in zip(problem.names, row, strict=True)}
                for name, row in zip(problem.names, fit.correlation, strict=True)
            },
            "unidentified_combinations": [
                {"change": combination.change, "std_over_prior": combination.std_over_prior}
                for combination in self.combinations
            ],
            "uninformed_parameters": self.uninformed_parameters,
            "flights": [self._flight_json(check, "train") for check in self.training]
            + [self._flight_json(check, "validation") for check in self.validation],
            "seconds_used": sum(check.seconds_used for check in self.training),
            "seconds_taken": fit.elapsed_s,
            "converged": self.converged,
        }

    def _flight_json(self, check: FreeRunErrors, role: str) -> dict[str, Any]:
        """Entry of one flight in the JSON."""
        records = {record.label: record for record in self.fit.problem.records}
        entry: dict[str, Any] = {
            "flight": check.label,
            "role": role,
            "seconds_used": check.seconds_used,
            "normalised_residual": check.normalised,
            "normalised_residual_axis": check.axis_normalised,
            "free_run_rms_deg": check.rms_deg,
            "white": check.white,
            "autocorrelation_0.1_s": check.correlation,
        }
        if role == "train":
            record = records[check.label]
            entry["left_out"] = [
                {"from_s": cut.start_s, "to_s": cut.stop_s, "why": cut.why} for cut in record.cuts
            ]
            entry["notes"] = [*slow_log_notes([record]), *record.notes]
        return entry


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name flights for reports by the `paths` of their files, with as many folders as make the names
    unique.
    """
    depth = 1
    while True:
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len(set(names)) == len(set(paths)) or depth > max(len(path.parts) for path in paths):
            return names
        depth += 1


def _rms_normalised(flights: Sequence[FreeRunErrors]) -> float:
    """Combine the normalised errors of all flights into one."""
    return _rms_over_flights(flights, [errors.normalised for errors in flights])


def _rms_over_flights(flights: Sequence[FreeRunErrors], values: Sequence[float]) -> float:
    """Return the root mean square of one value per flight, weighted by the length of the flights."""
    weights = np.array([errors.seconds_used for errors in flights])
    return float(np.sqrt(np.average(np.square(values), weights=weights)))


def rounded(number: float, std: float) -> str:
    """Format a `number` to two significant digits of its standard error `std`."""
    if not std > 0.0 or not np.isfinite(std):
        return f"{number:.6g}"  # a fixed parameter, or one without information
    digits = max(0, 1 - int(np.floor(np.log10(std))))
    return f"{number:.{digits}f}"


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
    loop_Hz: float | None = None,
    max_fit_s: float = float("inf"),
    threads: int | None = None,
    on_progress: Callable[[FitProgress], None] | None = None,
    accept_unexplained: bool = False,
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
        Fit only this part of each flight [s of its time column].
    window_s : float
        Length of the windows of the open-loop simulation [s].
    loop_Hz : float, optional
        Rate of the control loop [Hz]. If a log has fewer rows, its voltages are samples of those that acted.
        By default, every voltage acts from its row to the next.
    max_fit_s : float
        Longest time on this computer for preparation and fit [s].
    threads : int, optional
        Threads of the predictions; see `Problem`.
    on_progress : callable, optional
        Called with the progress of the work.
    accept_unexplained : bool
        Accept flights whose motion the voltages do not explain, such as noise.

    Raises
    ------
    IdentifyError
        If nothing can be identified from the flights.
    NotExcited
        If the voltages do not explain a flight's motion.
    """
    started_s = time.perf_counter()
    report = on_progress or (lambda _: None)
    report(FitProgress("finding the free flight", done=0.0, cost=0.0))
    records = prepare_all(flights, rig, labels, start_s=start_s, stop_s=stop_s)
    held_out = prepare_all(validation, rig, validation_labels, "validation")
    if loop_Hz is not None:
        records, held_out = sampled(records, loop_Hz), sampled(held_out, loop_Hz)
    if any(record is other or record.label == other.label for record in records for other in held_out):
        raise IdentifyError("a flight is both fitted and validated on", "give another flight to --validate")
    report(FitProgress("compiling the model", done=0.05, cost=0.0))
    names = estimated_names(model, rig, free, fixed)
    problem = Problem(model, rig, records, free=names, window_s=window_s, threads=threads)
    fit = solve(
        problem,
        start=_start_values(problem),
        budget=Budget(max_time_s=max_fit_s - (time.perf_counter() - started_s)),
        # The fit takes about 0.7 of the work, between preparation and free runs.
        on_progress=lambda p: report(FitProgress(p.stage, done=0.1 + 0.7 * p.done, cost=p.cost)),
    )
    report(FitProgress("checking", done=0.85, cost=fit.cost))
    training_traces, training = _free_runs(fit)
    validated = validate(fit, held_out) if held_out else None
    validation_traces, validation_errors = _free_runs(validated) if validated is not None else ((), ())
    validation_converged = validated is None or validated.converged
    if not accept_unexplained:
        for flight in (*training_traces, *validation_traces):
            refuse_unexplained(flight)
    return Identification(
        fit,
        training=training,
        validation=validation_errors,
        training_traces=training_traces,
        validation_traces=validation_traces,
        validation_converged=validation_converged,
    )


def _free_runs(fit: Fit) -> tuple[tuple[Trace, ...], tuple[FreeRunErrors, ...]]:
    """Return the free run (open-loop simulation) of each flight of a fit, and its errors."""
    flights = range(len(fit.problem.records))
    return tuple(trace(fit, index) for index in flights), tuple(check(fit, index) for index in flights)


def _start_values(problem: Problem) -> dict[str, float] | None:
    """Find start values of the free parameters from which long windows do not diverge; None if those of the
    rig file will do.
    """
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
            ).params
    return None


def first_rig_name(rig: Rig) -> str:
    """Return the name of the rig with which the identification of a rig began; its own name if it was not
    identified.
    """
    first_name, marker, _ = rig.description.partition(_IDENTIFIED)
    return first_name if marker else rig.name


def is_fitted_flight(rig: Rig, label: str) -> bool:
    """Return whether `rig` was identified from a flight with the file name `label`."""
    _, _, labels = rig.description.partition(_IDENTIFIED)
    return label in labels.split(", ")
