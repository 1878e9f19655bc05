"""Scores of the answers of one run, case by case, with predictions of the validation flights.

The model of an answer has its rig parameters, and the causes that it names, with their sizes. It starts each
half second at the measured angles, and predicts the angles one second later from the voltages alone. If an
answer has predicted flights, their angles at the same times are used instead.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats, Integers
from heli_host.data.flight import Flight
from heli_host.errors import HeliError
from heli_sim.model import Model, MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.model.plant import runge_kutta_step
from heli_sim.rig import Rig
from heli_sim.rig.rig import count_rad
from scipy.signal import savgol_filter

from heli_benchmark.entries import read_run
from heli_benchmark.judge import MIN_VISIBILITY_STD
from heli_benchmark.task import (
    NOTHING,
    UNLISTED,
    Answer,
    AxisSeries,
    BenchmarkCase,
    Causes,
    Split,
    check_answer,
    flight_name,
    read_case,
)
from heli_benchmark.visibility import torque_correlation

HORIZON_s: Final = 1.0
"""Time of a prediction. The rig moves by tens of degrees in it, and disturbances do not yet decide alone."""
WORST_RATIO: Final = 10.0
"""Ratio of a model that diverges, or whose parameters are invalid."""
_START_INTERVAL_s: Final = 0.5
_STEP_s: Final = 0.01
_WINDOW_s: Final = 0.4
"""Length of the filter that gives the rates at the start of a prediction, the same for all models."""
_UNKNOWN_PHASE: Final = "periodic_torque"
"""Cause whose phase the truth does not have, so that there is no true model."""


def true_errors(case: BenchmarkCase, truth: Mapping[str, Any]) -> Floats | None:
    """Return the errors of the true model, or None if there is none. Returns shape (3,)."""
    if truth["unlisted"] or "rig" not in truth or any(c.startswith(_UNKNOWN_PHASE) for c in truth["causes"]):
        return None
    causes = {name: cause["model_parameters"] for name, cause in truth["causes"].items()}
    return _model_errors(case, _true_rig(case.rig.replace(**truth["rig"]), causes), causes)


def _true_rig(rig: Rig, causes: Mapping[str, Mapping[str, float]]) -> Rig:
    """Rig whose thrust, with the model of the true causes, is that of the generator."""
    # The generator multiplies the thrust by ``1 + s e`` at a voltage ``e`` above the dead zone. The model has
    # ``1 + q (e - 1)`` with ``q = s / (1 + s)``, so its gain must be ``1 + s = 1 / (1 - q)`` times as large.
    if "thrust_quadratic" not in causes:
        return rig
    share = causes["thrust_quadratic"]["thrust_quadratic_share"]
    return rig.replace(thrust_gain=rig["thrust_gain"].value / (1.0 - share))


def prediction_ratio(case: BenchmarkCase, answer: Answer, named: Sequence[str], reference: Floats) -> float:
    """Return the error of the model of an answer relative to that of the true model, `reference`, rad,
    shape (3,).
    """
    estimates = {name: estimate.value for name, estimate in answer.parameters.items()}
    rig_values = {name: value for name, value in estimates.items() if name in case.rig}
    causes = {}
    for name in named:
        values = {
            parameter: estimates[parameter]
            for parameter in case.causes.parameters[name]
            if parameter in estimates
        }
        if values:
            causes[name] = values  # a cause without estimates stays out of the model
    try:
        errors = (
            _errors_of_predicted_flights(case, answer.predicted_flights)
            if answer.predicted_flights
            else _model_errors(case, case.rig.replace(**rig_values), causes)
        )
    except HeliError:  # the estimates are invalid as parameters
        return WORST_RATIO
    if errors is None or not np.isfinite(errors).all():
        return WORST_RATIO  # diverged, or flights without a prediction
    # A count is the smallest error that an encoder shows. The axes have a geometric mean.
    floor = count_rad(case.rig)
    ratio = np.exp(np.mean(np.log(np.maximum(errors, floor) / np.maximum(reference, floor))))
    return float(min(ratio, WORST_RATIO))


def _model_errors(case: BenchmarkCase, rig: Rig, causes: Mapping[str, Mapping[str, float]]) -> Floats | None:
    """Return the RMS prediction errors of the model with a rig and causes, as `true_errors` does."""
    model = MultibodyModel(tuple(catalogue()[name].make(values) for name, values in causes.items()))
    predictor = _OpenLoopPredictor(model, rig)
    return _rms_by_axis([predictor.errors(flight) for flight in case.validation])


def _errors_of_predicted_flights(case: BenchmarkCase, predicted: Mapping[str, AxisSeries]) -> Floats | None:
    """RMS errors of flights that an answer predicts; NaN if a flight is missing or does not last as long."""
    errors = []
    for number, flight in enumerate(case.validation):
        t_s, _, end_steps = _prediction_rows(flight)
        series = predicted.get(flight_name(number))
        measured = _interpolated(t_s[end_steps], flight.t_s, flight.angles_rad)
        errors.append(
            np.full(measured.shape, np.nan) if series is None else series.at(t_s[end_steps]) - measured
        )
    return _rms_by_axis(errors)


def _rms_by_axis(errors: Sequence[Floats]) -> Floats | None:
    """Root mean square of the errors of all flights by axis, or None if the flights are too short."""
    pooled = np.concatenate(errors)
    return np.sqrt(np.mean(pooled**2, axis=0)) if len(pooled) else None


def _prediction_rows(flight: Flight) -> tuple[Floats, Integers, Integers]:
    """Return the times of the steps of a flight, and the steps at which predictions start and end."""
    t_s = np.arange(flight.t_s[0], flight.t_s[-1] - 2.0 * _STEP_s, _STEP_s)
    horizon = round(HORIZON_s / _STEP_s)
    edge_steps = round(_WINDOW_s / _STEP_s)
    # A flight that is shorter than the filter has no start.
    last_start = len(t_s) - horizon - edge_steps if _window_rows(flight) <= len(flight) else 0
    start_steps = np.arange(edge_steps, last_start, round(_START_INTERVAL_s / _STEP_s))
    return t_s, start_steps, start_steps + horizon


def _mean_step_s(flight: Flight) -> float:
    return float(flight.t_s[-1] - flight.t_s[0]) / (len(flight) - 1)


def _window_rows(flight: Flight) -> int:
    """Length of the filter of the rates, an odd number of rows."""
    return 2 * round(_WINDOW_s / 2.0 / _mean_step_s(flight)) + 1


class _OpenLoopPredictor:
    """Open-loop predictions by a model with given parameters."""

    def __init__(self, model: Model, rig: Rig) -> None:
        self._parameters = model.parameter_values(rig)
        names = model.parameter_names
        self._delay_s = float(self._parameters[names.index(model.delay)]) if model.delay else 0.0
        x, u, t = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2), ca.SX.sym("t")
        p = ca.SX(ca.DM(self._parameters))
        self._states = len(model.states)
        rates = ca.Function("rates", [x, u, t], [model.dynamics(x, u, p, t)])
        next_state = runge_kutta_step(lambda state, later_s: rates(state, u, t + later_s), x, _STEP_s)
        next_state = model.reset_map(next_state, u, p, t + _STEP_s)
        self._step = ca.Function("step", [x, u, t], [ca.densify(next_state)])
        self._encoders = ca.Function("seen", [x, u, t], [ca.densify(model.measurement(x, u, p, t))])

    def errors(self, flight: Flight) -> Floats:
        """Return predicted minus measured angles at the end of each prediction, rad, shape (k, 3)."""
        t_s, start_steps, end_steps = _prediction_rows(flight)
        if not len(start_steps):
            return np.empty((0, 3))
        window, sample_s = _window_rows(flight), _mean_step_s(flight)
        smooth_angles, rate = (
            savgol_filter(flight.angles_rad, window, 3, deriv=deriv, delta=sample_s, axis=0)
            for deriv in (0, 1)
        )
        measured, rates, angles = (
            _interpolated(t_s, flight.t_s, signal) for signal in (smooth_angles, rate, flight.angles_rad)
        )
        volts = self._mean_volts(flight, t_s)
        states = self._all_states(measured, rates, volts, t_s)[start_steps].T
        for k in range(end_steps[0] - start_steps[0]):
            states = np.asarray(self._step(states, volts[start_steps + k].T, t_s[start_steps + k][None]))
        predicted = np.asarray(self._encoders(states, volts[end_steps].T, t_s[end_steps][None])).T
        return np.asarray(predicted - angles[end_steps])

    def _mean_volts(self, flight: Flight, t_s: Floats) -> Floats:
        """Return the means of the voltages over each step, late by the delay."""
        volt_seconds = np.vstack(
            [np.zeros(2), np.cumsum(flight.voltages_V[:-1] * np.diff(flight.t_s)[:, None], axis=0)]
        )
        delayed_s = t_s - self._delay_s
        start, end = (
            _interpolated(times_s, flight.t_s, volt_seconds) for times_s in (delayed_s, delayed_s + _STEP_s)
        )
        return np.asarray((end - start) / _STEP_s)

    def _all_states(self, angles: Floats, rates: Floats, volts: Floats, t_s: Floats) -> Floats:
        """Return the state at each step, shape (n, states): measured angles and rates, then effects'
        states.
        """
        states = np.zeros((len(t_s), self._states))
        states[:, :3], states[:, 3:6] = angles, rates
        if self._states > 6:
            for k in range(len(t_s) - 1):
                states[k + 1, 6:] = np.asarray(self._step(states[k], volts[k], t_s[k])).ravel()[6:]
        # True angles: subtract what play or eccentricity adds to them in the encoders.
        encoder_rad = np.asarray(self._encoders(states.T, volts.T, t_s[None])).T
        states[:, :3] -= encoder_rad - angles
        return states


def _interpolated(t_s: Floats, grid_s: Floats, values: Floats) -> Floats:
    """Interpolate each column of `values`, shape (m, columns), given at `grid_s`, to the times `t_s`."""
    return np.stack([np.interp(t_s, grid_s, column) for column in values.T], axis=1)


MIN_PROBABILITY: Final = 1e-3
"""Lowest probability of what was true, in the log score. With 0, one wrong certainty would decide the table;
at 0.01 a method that is 99.9 % sure would gain nothing."""
NAMED: Final = 0.5
"""Probability from which an answer names a cause: more likely hidden than not."""
_NO_SIZE: Final = ("_at_s", "_rest_rad", "_Hz")
"""Endings of parameters that are no size: moments, angles of rest and frequencies."""
INTERVAL: Final = 0.05
"""Probability outside the interval of the interval score, which is the estimate with 1.96 standard errors."""
_NORMAL: Final = 1.959964
"""Quantile of the standard normal distribution with 2.5 % above it."""


@dataclass(frozen=True)
class Truth:
    """Hidden causes of a case, by what an answer can be expected to know about them."""

    causes: frozenset[str]  # Visible causes, with `unlisted`; `nothing` if no cause is hidden
    invisible: frozenset[str]
    """Names that the case does not score: hidden causes below the limit of visibility, and `nothing` if no
    hidden cause is visible."""
    sizes: Mapping[str, float]  # Sizes of the visible causes by parameter


class SizeScore(NamedTuple):
    """Score of an estimated size."""

    is_within: bool  # Whether the true size is within two standard errors
    interval_score: float  # Relative to the true size


@dataclass(frozen=True)
class CaseScore:
    """Scores of an answer."""

    case: str  # Name of the case
    log_loss: float
    """log_loss, base_loss: Negative log-likelihood of the truth under the answer and under the base rates,
    nats."""
    base_loss: float
    first_right: bool  # Whether the most probable name is true
    all_named: bool | None  # Whether every visible cause is named; None without a visible cause
    false_names: int  # Named causes that are not hidden
    false_alarm: bool | None  # Whether a cause is named although nothing is hidden; None if something is
    sizes: tuple[SizeScore, ...]  # One per estimated size
    sizes_asked: int  # Number of true sizes
    prediction: float | None
    """Prediction error on the validation flights relative to that of the true model; None if the true model
    is not in the catalogue."""
    equation: float | None
    """Correlation of the equation of the answer with the true torques; None if no unlisted cause is visible.
    """
    calibration: tuple[tuple[float, bool], ...]  # Probability and truth of each name
    cpu_s: float | None  # cpu_s, peak_MB: Cost of the answer
    peak_MB: float | None
    failure: str  # Why there is no answer; empty if there is one


def score_runs(split: Split, folders: Sequence[Path]) -> list[list[CaseScore]]:
    """Score runs; each case is read once, and its true model predicts once."""
    runs = [read_run(folder, split) for folder in folders]
    scores: list[list[CaseScore]] = [[] for _ in folders]
    for case_folder in split.cases:
        reference = _case_with_truth(split, case_folder)
        for folder, run, scored in zip(folders, runs, scores, strict=True):
            name = case_folder.name
            scored.append(_score_result(reference, run[name], f"{folder / name}.json"))
    return scores


def score_run(split: Split, folder: Path) -> list[CaseScore]:
    """Score one run, as in `score_runs`."""
    return score_runs(split, [folder])[0]


@dataclass(frozen=True)
class _CaseReference:
    """What the answers to a case are compared with."""

    case: BenchmarkCase  # The case as a method sees it
    truth: Truth  # Its scored causes
    errors: Floats | None  # (3,): Prediction errors of the true model
    torques_Nm: Mapping[str, AxisSeries]  # Torques of visible unlisted causes by flight


def _case_with_truth(split: Split, case_folder: Path) -> _CaseReference:
    """Read a case with its truth, and let the true model predict."""
    content = split.truth(case_folder.name)
    case, truth = read_case(case_folder), scored_truth(content)
    torques_Nm = split.unlisted_torques_Nm(case.name) if UNLISTED in truth.causes else {}
    return _CaseReference(case, truth, true_errors(case, content), torques_Nm)


def _score_result(reference: _CaseReference, result: Mapping[str, Any], where: str) -> CaseScore:
    """Score the result of a case; `where` is its file."""
    case, causes = reference.case, reference.case.causes
    failure = str(result.get("failure", ""))
    answer = Answer(causes.base_rates) if failure else check_answer(result["answer"], causes, where)
    prediction = (
        None
        if reference.errors is None
        else prediction_ratio(case, answer, listed_names(answer), reference.errors)
    )
    return score_answer(
        case.name,
        answer,
        reference.truth,
        causes,
        failure,
        cpu_s=result.get("cpu_s"),
        peak_MB=result.get("peak_MB"),
        prediction=prediction,
        equation=equation_correlation(answer, reference.torques_Nm),
    )


def equation_correlation(answer: Answer, torques_Nm: Mapping[str, AxisSeries]) -> float | None:
    """Return the correlation of the equation of an answer with the true torques, mean of the flights; None
    without a visible unlisted cause.
    """
    if not torques_Nm:
        return None
    correlations = []
    for name, true in torques_Nm.items():
        proposed = answer.equation_torques.get(name)
        if proposed is None or proposed.t_s[-1] < true.t_s[0] or proposed.t_s[0] > true.t_s[-1]:
            correlations.append(0.0)  # no torque is proposed along this flight
            continue
        _, correlation = torque_correlation(true.t_s, true.values, proposed.t_s, proposed.values)
        correlations.append(correlation)
    return sum(correlations) / len(correlations)


def scored_truth(content: Mapping[str, Any]) -> Truth:
    """Return the scored truth of a case."""
    listed = {name: float(cause["visibility_std"]) for name, cause in content["causes"].items()}
    unlisted = [float(std) for std in content["unlisted"].values()]
    hidden = listed | ({UNLISTED: max(unlisted)} if unlisted else {})
    visible = {name for name, std in hidden.items() if std >= MIN_VISIBILITY_STD}
    invisible = set(hidden) - visible
    if not hidden:
        visible = {NOTHING}
    elif not visible:
        invisible.add(NOTHING)
    sizes = {
        name: float(value)
        for cause in visible & set(content["causes"])
        for name, value in content["causes"][cause]["parameters"].items()
        if not name.endswith(_NO_SIZE)
    }
    return Truth(frozenset(visible), frozenset(invisible), sizes)


def score_answer(
    case: str,
    answer: Answer,
    truth: Truth,
    causes: Causes,
    failure: str = "",
    *,
    cpu_s: float | None = None,
    peak_MB: float | None = None,
    prediction: float | None = None,
    equation: float | None = None,
) -> CaseScore:
    """Score an answer; numbers that were not measured or do not apply are None."""
    # To name a cause that no method can see is neither right nor wrong.
    scored = [name for name in causes.names if name not in truth.invisible]
    probabilities = {name: answer.probabilities.get(name, 0.0) for name in causes.names}
    calibration = tuple((probabilities[name], name in truth.causes) for name in scored)
    named = {name for name in probabilities if probabilities[name] >= NAMED and name != NOTHING}
    if failure:
        named = set()  # the base rates stand for the missing answer, and name nothing
    most_probable = max(probabilities, key=probabilities.__getitem__)
    visible = truth.causes - {NOTHING}
    return CaseScore(
        case,
        log_loss=_negative_log_likelihood(calibration),
        base_loss=_negative_log_likelihood(
            tuple((causes.base_rates[name], name in truth.causes) for name in scored)
        ),
        first_right=not failure and (most_probable in truth.causes or most_probable in truth.invisible),
        all_named=visible <= named if visible else None,
        false_names=len(named - truth.causes - truth.invisible),
        false_alarm=bool(named) if NOTHING in truth.causes else None,
        sizes=tuple(
            SizeScore(
                abs(estimate.value - truth.sizes[name]) <= 2.0 * estimate.std,
                _interval_score(estimate.value, estimate.std, truth.sizes[name]),
            )
            for name, estimate in answer.parameters.items()
            if name in truth.sizes
        ),
        sizes_asked=len(truth.sizes),
        prediction=prediction,
        equation=equation,
        calibration=calibration,
        cpu_s=cpu_s,
        peak_MB=peak_MB,
        failure=failure,
    )


def listed_names(answer: Answer) -> list[str]:
    """Return the causes of the list that an answer names."""
    named = (name for name, probability in answer.probabilities.items() if probability >= NAMED)
    return [name for name in named if name not in (NOTHING, UNLISTED)]


def _negative_log_likelihood(pairs: tuple[tuple[float, bool], ...]) -> float:
    """Return the negative log-likelihood of pairs of a probability and whether its name is true, nats."""
    return sum(-math.log(max(p if is_true else 1.0 - p, MIN_PROBABILITY)) for p, is_true in pairs)


def _interval_score(value: float, std: float, truth: float) -> float:
    """Interval score of Gneiting and Raftery (2007), relative to the true size; lower is better."""
    low, high = value - _NORMAL * std, value + _NORMAL * std
    outside = max(low - truth, 0.0) + max(truth - high, 0.0)
    return (high - low + 2.0 / INTERVAL * outside) / abs(truth)
