"""Forecasts of a flight from its present state, compared with the measured angles.

At each start, a filter that knows the flight only up to there has estimated the state, the encoder zeros
and the torques. From this state the model is simulated with the voltages that acted. Fast disturbances
decay during a forecast, slow ones stay. A free run of `heli_lab.explain.prediction` instead starts from the
state that fits the predicted window best.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats, Integers
from heli_host.data.files import save_figure
from heli_host.data.flight import Flight
from heli_sim.evaluate.trajectories import Trajectory
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.rig import Rig

from heli_lab.errors import TwinError
from heli_lab.explain.prediction import ErrorReduction, WindowErrors, error_reduction
from heli_lab.fit import _kalman
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.watch.kalman_filter import KalmanFilter
from heli_lab.watch.likelihood_ratio import ONSETS
from heli_lab.watch.steps import FreeFlight, InputHistory, Samples, Step, Stepper, count_rad_of, samples_of
from heli_lab.watch.twin_model import EXACT, ZEROS, TwinModel, start_state

HORIZONS_s: Final = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Horizons of the forecasts [s]."""
MAIN_HORIZON_s: Final = 1.0
"""Horizon of the forecasts by which models are compared [s]: long enough to show a lag, too short for slow
terms to dominate."""
_PATH_EVERY_s: Final = 0.1
"""Time between the points of a forecast that are kept [s]; all horizons are multiples of it."""
START_EVERY_s: Final = 0.2
"""Time between the starts of two forecasts [s]: the shortest horizon."""
_SETTLE_s: Final = 5.0
"""Time for which the filter estimates zeros and torques before the first forecast [s]. Shorter: their
errors are errors of the model. Longer: short flights have few forecasts."""
_RESAMPLED_s: Final = 5.0
"""Length of the parts of a flight that the bootstrap resamples [s]: the longest horizon, because forecasts
over the same seconds share their errors."""
_TAIL: Final = 0.01
"""Share of voltages and rates beyond each end of the range that is stated."""
_EXPECTED_STARTS: Final = 40
"""Number of forecasts over which the expected error is averaged. More: minutes for long flights. Fewer: an
unusual moment decides."""
_AXIS_COUNT: Final = 3


@dataclass(frozen=True)
class Forecasts:
    """Forecasts of one flight by one model. A horizon that was not forecast, or at which the flight was not
    measured, is nan.
    """

    label: str  # Name of the flight
    start_s: Floats  # (k,): Time of each start on the clock of the flight [s]
    start_rad: Floats  # (k, 3): Measured angles at each start [rad]
    measured_rad: Floats  # (k, horizons, 3): Measured angles at each horizon [rad]
    path_s: Floats  # (p,): Times of the points of a forecast since its start [s]
    path_rad: Floats  # (k, p, 3): Angles that the model predicts at these times [rad]
    range_V: Floats  # (2, 2): Lowest and highest voltage of both rotors during the forecasts [V]
    range_rad_s: Floats  # (2, 3): Lowest and highest rate of each axis [rad/s]
    start_V: Floats  # (k, 2): Mean voltage of both rotors over `START_EVERY_s` before each start [V]
    start_rad_s: Floats  # (k, 3): Estimated rates at each start [rad/s]
    expected_rad2: Floats
    """(3,): Mean square error at `MAIN_HORIZON_s` that the disturbances, the uncertain state and the rounding
    to counts cause if the model is right [rad2]."""

    def errors_rad(self, horizon: int) -> Floats:
        """Return the errors at a horizon, predicted less measured, (k, 3) [rad]."""
        # Beyond the end of the path, `measured_rad` is nan.
        point = min(round(HORIZONS_s[horizon] / _PATH_EVERY_s), len(self.path_s) - 1)
        return np.asarray(self.path_rad[:, point] - self.measured_rad[:, horizon])

    def squares_rad2(self, horizon: int) -> Floats:
        """Return the squared errors at a horizon, (k, 3) [rad2]."""
        return np.asarray(self.errors_rad(horizon) ** 2)

    def persistence_rad2(self, horizon: int) -> Floats:
        """Return the squared errors of the forecast that nothing changes, (k, 3) [rad2]."""
        return np.asarray((self.start_rad - self.measured_rad[:, horizon]) ** 2)


class _Start(NamedTuple):
    """The present of a forecast, as the filter estimates it."""

    step: int  # Number of the step in which it begins
    state: Floats  # (states,)
    steady_torque_Nm: Floats  # (3,): Drift and constant torque
    gust_Nm: Floats  # (3,): Fast disturbance
    zero_rad: Floats  # (2,): Errors of the encoder zeros
    covariance: Floats
    """(order, order): Covariance of state, gust, drift, constant torque about each axis, and zeros."""


class _FilteredFlight(NamedTuple):
    """A flight in steps, and the starts of its forecasts."""

    step_s: float
    starts: list[_Start]
    motor_time_s: Floats  # (n,): Time since the motors started at each step [s]
    acting_V: Floats  # (n, 2): Acting voltages in each step [V]
    measured_rad: Floats  # (n, 3): Measured angles at the beginning of each step [rad]; nan without samples
    segment: Integers  # (n,): Number of the comparison to which each step belongs; -1 if the arm is not free
    time_s: Floats  # (n,): Time of each step on the clock of the flight [s]


def forecasts_of(
    model: Model,
    rig: Rig,
    disturbances: DisturbanceModel,
    flight: Flight,
    label: str,
    span_s: tuple[float | None, float | None] = (None, None),
    longest_s: float = HORIZONS_s[-1],
) -> Forecasts:
    """Forecast a flight with the equations `model` and the parameters of `rig`, up to `longest_s` ahead."""
    # The `disturbances` decide how much the filter believes a measurement. A TwinError is raised if the part
    # of the flight between the times `span_s` is too short.
    samples, sample_s = samples_of(flight)
    zero_s = float(samples.number[0]) * sample_s - float(flight.t_s[0])
    twin = TwinModel(model, rig, EXACT, changes=())
    count_rad = count_rad_of(flight, rig)
    filtered = _filter_flight(twin, disturbances, count_rad, samples, sample_s, zero_s, span_s)
    if not filtered.starts:
        raise TwinError(
            f"{label} has less than {_SETTLE_s + HORIZONS_s[0]:g} s of uninterrupted free flight to forecast",
            "give a longer flight, or a wider part of it with --from and --to",
        )
    path_s = np.asarray(np.arange(round(longest_s / _PATH_EVERY_s) + 1) * _PATH_EVERY_s, float)
    start_rows = np.array([start.step for start in filtered.starts])
    is_used = filtered.segment >= 0
    # The first states are the angles, the next ones their rates.
    start_rad_s = np.array([start.state[_AXIS_COUNT : 2 * _AXIS_COUNT] for start in filtered.starts])
    recent_steps = round(START_EVERY_s / filtered.step_s)
    ends = [_TAIL, 1.0 - _TAIL]
    return Forecasts(
        label,
        start_s=filtered.time_s[start_rows],
        start_rad=filtered.measured_rad[start_rows],
        measured_rad=_measured_at_horizons(filtered, start_rows, longest_s),
        path_s=path_s,
        path_rad=_simulate(twin, disturbances, filtered, path_s),
        range_V=np.quantile(filtered.acting_V[is_used], ends, axis=0),
        range_rad_s=np.quantile(start_rad_s, ends, axis=0),
        start_V=np.array(
            [filtered.acting_V[max(row - recent_steps, 0) : row].mean(axis=0) for row in start_rows]
        ),
        start_rad_s=start_rad_s,
        expected_rad2=_expected_rad2(twin, disturbances, filtered, count_rad),
    )


def _measured_at_horizons(filtered: _FilteredFlight, start_rows: Integers, longest_s: float) -> Floats:
    """Return the measured angles at the horizons up to `longest_s` after each start, (k, horizons, 3)."""
    measured_rad = np.full((len(start_rows), len(HORIZONS_s), _AXIS_COUNT), np.nan)
    last_row = len(filtered.segment) - 1
    for horizon, horizon_s in enumerate(HORIZONS_s):
        if horizon_s > longest_s:
            continue  # not forecast: stays nan
        rows = start_rows + round(horizon_s / filtered.step_s)
        is_within = rows <= last_row
        rows = np.minimum(rows, last_row)
        # Only a horizon in the same segment as its start was free flight up to there.
        is_free = is_within & (filtered.segment[rows] == filtered.segment[start_rows])
        measured_rad[is_free, horizon] = filtered.measured_rad[rows[is_free]]
    return measured_rad


def _filter_flight(
    twin: TwinModel,
    disturbances: DisturbanceModel,
    count_rad: Floats,
    samples: Samples,
    sample_s: float,
    zero_s: float,
    span_s: tuple[float | None, float | None],
) -> _FilteredFlight:
    """Filter a flight, and keep the estimate of the present every `START_EVERY_s`."""
    # `span_s` is the part of the flight [s]; None: no limit.
    stepper = Stepper(sample_s)
    steps = list(stepper.update(samples))
    step_s = stepper.step_s
    free_flight, inputs = FreeFlight(twin.rig, step_s), InputHistory(twin, step_s)
    from_s, to_s = span_s
    first_s = -np.inf if from_s is None else from_s
    last_s = np.inf if to_s is None else to_s
    # Missing steps stay nan, and belong to no segment.
    count = steps[-1].index - steps[0].index + 1 if steps else 0
    offset = steps[0].index if steps else 0
    filtered = _FilteredFlight(
        step_s,
        [],
        motor_time_s=np.zeros(count),
        acting_V=np.zeros((count, 2)),
        measured_rad=np.full((count, 3), np.nan),
        segment=np.full(count, -1),
        time_s=np.asarray((np.arange(count) + offset) * step_s - zero_s, float),
    )
    runner = _Runner(twin, disturbances, count_rad, step_s, filtered.starts)
    for step in steps:
        row = step.index - offset
        t_s = float(filtered.time_s[row])
        if step.after_gap:
            runner.kalman = None
            inputs.restart()
        inputs.update(step, t_s)
        is_free = free_flight.update(step.measured_rad, step.flying) and not step.landing
        if step.measured_rad is not None:
            inputs.remember(step.measured_rad)
            filtered.measured_rad[row] = step.measured_rad
        elif runner.kalman is None:
            inputs.forget_motion()
        filtered.motor_time_s[row], filtered.acting_V[row] = inputs.motor_time_s, inputs.acting_V
        if is_free and first_s <= t_s < last_s:
            filtered.segment[row] = runner.advance(step, row, inputs)
        else:
            runner.kalman = None
    return filtered


class _Runner:
    """Filters free flight step by step, and keeps the starts of forecasts."""

    def __init__(
        self,
        twin: TwinModel,
        disturbances: DisturbanceModel,
        count_rad: Floats,
        step_s: float,
        starts: list[_Start],
    ) -> None:
        self._twin, self._disturbances, self._count_rad = twin, disturbances, count_rad
        self._step_s, self._starts = step_s, starts
        self._steps_per_block = max(1, round(BLOCK_s / step_s))
        self._blocks_per_start = max(1, round(START_EVERY_s / (self._steps_per_block * step_s)))
        self.kalman: KalmanFilter | None = None
        self._first_row, self._segment = 0, -1

    def advance(self, step: Step, row: int, inputs: InputHistory) -> int:
        """Filter a free step; return the number of its segment, -1 before the filter begins."""
        if self.kalman is None:
            if step.measured_rad is None:
                return -1  # the filter starts from measured angles
            self._begin(row, inputs)
        kalman = self.kalman
        assert kalman is not None
        age = row - self._first_row
        block, step_of_block = divmod(age, self._steps_per_block)
        # The filter begins with a measurement, so it needs none in its first step.
        if age > 0 and step_of_block == 0:
            self._measure(kalman, step, inputs)
            is_settled = age * self._step_s >= _SETTLE_s
            if block % self._blocks_per_start == 0 and is_settled and step.measured_rad is not None:
                self._starts.append(
                    _Start(
                        row,
                        state=kalman.state.copy(),
                        steady_torque_Nm=kalman.steady_torque_Nm,
                        gust_Nm=kalman.torque_Nm - kalman.steady_torque_Nm,
                        zero_rad=kalman.zero_rad.copy(),
                        covariance=kalman.covariance,
                    )
                )
        kalman.predict(inputs.motor_time_s, inputs.acting_V)
        return self._segment

    def _begin(self, row: int, inputs: InputHistory) -> None:
        motion = inputs.initial_motion()
        state = start_state(self._twin, motion.times_s, motion.angles_rad, motion.volts_V, self._step_s)
        self.kalman = KalmanFilter(
            self._twin, self._disturbances, self._count_rad, self._step_s, self._steps_per_block, state
        )
        self._first_row = row
        self._segment += 1

    def _measure(self, kalman: KalmanFilter, step: Step, inputs: InputHistory) -> None:
        no_changes: Floats = np.empty((0, ONSETS))  # a forecast watches for no change of the rig
        kalman.propagate_sensitivity(no_changes, np.empty(0, bool))
        if step.measured_rad is not None:
            kalman.update(
                inputs.motor_time_s,
                step.measured_rad,
                step.samples,
                inputs.acting_V,
                amount=no_changes,
                onset_rad=no_changes,
            )


class _Ensemble:
    """Forecasts that are simulated together, step by step."""

    def __init__(
        self,
        twin: TwinModel,
        disturbances: DisturbanceModel,
        filtered: _FilteredFlight,
        starts: Sequence[_Start],
    ) -> None:
        self._twin, self._filtered = twin, filtered
        self._next_rows = np.array([start.step for start in starts])
        self._states: Floats = np.array([start.state for start in starts])
        self._steady_Nm: Floats = np.array([start.steady_torque_Nm for start in starts])
        self._gust_Nm: Floats = np.array([start.gust_Nm for start in starts])
        zero_rad = np.array([start.zero_rad for start in starts])
        # The zero of travel is arbitrary, so it has no error.
        self._shown_zero_rad = np.hstack((zero_rad, np.zeros((len(starts), 1))))
        self._decay = disturbances.autocorrelation(filtered.step_s)[:_AXIS_COUNT]

    def _trajectory(self, time_s: float) -> Trajectory:
        """Return the present states at a time within the present step [s]."""
        filtered = self._filtered
        # Forecasts beyond the end of the flight continue with its last voltages, and are not compared.
        at = np.minimum(self._next_rows, len(filtered.segment) - 1)
        return Trajectory(
            filtered.motor_time_s[at] + time_s,
            self._states,
            filtered.acting_V[at],
            filtered.step_s,
            self._twin.parameters,
        )

    def measured(self) -> tuple[Floats, Floats]:
        """Return the angles that the encoders would show [rad], (k, 3), and their derivatives by the states,
        (k, 3, states).
        """
        angles, by_state, *_ = self._twin.measure(self._trajectory(0.0))
        return angles[:, :, 0] + self._shown_zero_rad, by_state

    def step(self) -> tuple[Floats, Floats]:
        """Simulate a step; return its derivatives by the states, (k, states, states), and by a constant
        torque about each axis, (k, states, 3).
        """
        h = self._filtered.step_s
        middle = self._twin.functions_without_derivatives.along(self._trajectory(0.5 * h))
        by_torque = middle.by_disturbance
        phi, gamma = _kalman.midpoint(middle.by_state, h)
        torque_Nm = self._steady_Nm + self._gust_Nm
        # k numbers the forecasts, i and j the rows and columns of their matrices.
        driven_rates = middle.rates[:, :, 0] + np.einsum("kij,kj->ki", by_torque, torque_Nm)
        self._states = self._states + np.einsum("kij,kj->ki", gamma, driven_rates)
        if self._twin.resets is not None:
            (reset,) = self._twin.resets(self._trajectory(h))
            self._states = reset[:, :, 0]
        self._gust_Nm = self._gust_Nm * self._decay
        self._next_rows = self._next_rows + 1
        return phi, gamma @ by_torque


def _simulate(
    twin: TwinModel, disturbances: DisturbanceModel, filtered: _FilteredFlight, path_s: Floats
) -> Floats:
    """Simulate all forecasts together; return the angles that the encoders would show at the times `path_s`
    since the start, (k, p, 3).
    """
    steps_at = [round(time_s / filtered.step_s) for time_s in path_s]
    ensemble = _Ensemble(twin, disturbances, filtered, filtered.starts)
    result = np.empty((len(filtered.starts), len(steps_at), _AXIS_COUNT))
    for number in range(max(steps_at) + 1):
        if number in steps_at:
            result[:, steps_at.index(number)], _ = ensemble.measured()
        ensemble.step()
    return result


def _expected_rad2(
    twin: TwinModel, disturbances: DisturbanceModel, filtered: _FilteredFlight, count_rad: Floats
) -> Floats:
    """Return the mean square error at `MAIN_HORIZON_s` that a right model would have, (3,) [rad2]."""
    # The covariance of the filter is propagated without measurements. Its rows are states, then gusts, drift
    # and constant torques about three axes each, then zeros. Shapes: `count_rad` (3,).
    stride = math.ceil(len(filtered.starts) / _EXPECTED_STARTS)
    starts = filtered.starts[::stride]
    ensemble = _Ensemble(twin, disturbances, filtered, starts)
    covariance: Floats = np.array([start.covariance for start in starts])
    nx, order = twin.states, covariance.shape[1]
    gusts_and_drift = slice(nx, nx + 2 * _AXIS_COUNT)
    first_zero = nx + 3 * _AXIS_COUNT
    autocorrelation = disturbances.autocorrelation(filtered.step_s)
    persistence = np.ones(order)
    persistence[gusts_and_drift] = autocorrelation
    noise = np.zeros(order)
    noise[gusts_and_drift] = (1.0 - autocorrelation**2) * disturbances.variance
    transition = np.zeros_like(covariance)
    for _ in range(round(MAIN_HORIZON_s / filtered.step_s)):
        transition[:, :nx, :nx], by_torque = ensemble.step()
        # Gusts, drift and constant torques all act as torques.
        transition[:, :nx, nx:first_zero] = np.tile(by_torque, 3)
        transition[:, np.arange(nx, order), np.arange(nx, order)] = persistence[nx:]
        covariance = transition @ covariance @ transition.transpose(0, 2, 1) + np.diag(noise)
    _, by_state = ensemble.measured()
    output = np.zeros((len(starts), _AXIS_COUNT, order))
    output[:, :, :nx] = by_state
    for axis in range(len(ZEROS)):
        output[:, axis, first_zero + axis] = 1.0
    variance_rad2 = np.einsum("kai,kij,kaj->ka", output, covariance, output)
    return np.asarray(variance_rad2.mean(axis=0) + count_rad**2 / 12.0)


@dataclass(frozen=True)
class HorizonErrors:
    """Errors of forecasts at one horizon, by axis."""

    horizon_s: float
    forecasts: int  # Number of forecasts
    with_causes: Mapping[str, float]  # Root mean square error of the model [deg]
    persistence: Mapping[str, float]  # That of the forecast that nothing changes [deg]
    reduction: Mapping[str, ErrorReduction] | None
    """The model compared with the baseline; None without a baseline."""


def horizon_errors(forecasts: Forecasts, baseline: Forecasts | None) -> list[HorizonErrors]:
    """Compare forecasts with persistence and with a `baseline` of the same flight; a horizon that the
    flight is too short for is left out.
    """
    baselines = None if baseline is None else [baseline]
    rows = (errors_at(horizon_s, [forecasts], baselines) for horizon_s in HORIZONS_s)
    return [row for row in rows if row is not None]


def errors_at(
    horizon_s: float, forecasts: Sequence[Forecasts], baselines: Sequence[Forecasts] | None
) -> HorizonErrors | None:
    """Compare the forecasts of several flights at one of `HORIZONS_s` with persistence and with baselines of
    the same flights; None if all flights are too short.
    """
    horizon = HORIZONS_s.index(horizon_s)
    squares = np.concatenate([flight.squares_rad2(horizon) for flight in forecasts])
    is_compared = np.isfinite(squares).all(axis=1)
    if not is_compared.any():
        return None
    persistence = np.concatenate([flight.persistence_rad2(horizon) for flight in forecasts])
    reduction = None
    if baselines is not None:
        reduction = error_reduction(
            [_by_part(flight, horizon) for flight in baselines if _reaches(flight, horizon)],
            [_by_part(flight, horizon) for flight in forecasts if _reaches(flight, horizon)],
        )
    return HorizonErrors(
        horizon_s,
        forecasts=int(is_compared.sum()),
        with_causes=_rms_deg(squares[is_compared]),
        persistence=_rms_deg(persistence[is_compared]),
        reduction=reduction,
    )


def _reaches(forecasts: Forecasts, horizon: int) -> bool:
    """Whether the flight is long enough for a horizon."""
    return bool(np.isfinite(forecasts.measured_rad[:, horizon]).all(axis=1).any())


def _by_part(forecasts: Forecasts, horizon: int) -> WindowErrors:
    """Sum the squared errors at a horizon over parts of the flight, which a bootstrap resamples."""
    squares = forecasts.squares_rad2(horizon)
    is_compared = np.isfinite(squares).all(axis=1)
    squares = squares[is_compared]
    parts = ((forecasts.start_s - forecasts.start_s[0]) // _RESAMPLED_s)[is_compared]
    sums = [squares[parts == part].sum(axis=0) for part in np.unique(parts)]
    counts = [float((parts == part).sum()) for part in np.unique(parts)]
    return WindowErrors(np.array(sums), np.array(counts))


def _rms_deg(squares_rad2: Floats) -> dict[str, float]:
    """Return the root mean square of each axis, [deg]."""
    return dict(zip(AXES, np.rad2deg(np.sqrt(squares_rad2.mean(axis=0))).tolist(), strict=True))


def errors_json(
    forecasts: Forecasts, rows: Sequence[HorizonErrors], rig: str, baseline_rig: str | None
) -> dict[str, Any]:
    """Write the errors of forecasts as a JSON object; docs/reference/json.md describes its keys."""
    degrees = np.rad2deg(forecasts.range_rad_s)
    return {
        "flight": forecasts.label,
        "rig": rig,
        "baseline": baseline_rig,
        "forecasts": len(forecasts.start_s),
        "range_V": {
            rotor: forecasts.range_V[:, number].tolist() for number, rotor in enumerate(("front", "back"))
        },
        "range_deg_s": {axis: degrees[:, number].tolist() for number, axis in enumerate(AXES)},
        "horizons": [
            {
                "horizon_s": row.horizon_s,
                "forecasts": row.forecasts,
                "axis": {axis: _axis_json(row, axis) for axis in AXES},
            }
            for row in rows
        ],
    }


def _axis_json(row: HorizonErrors, axis: str) -> dict[str, Any]:
    """Return the errors about an axis [deg], and the ratio of the model's error to that of the baseline."""
    reduction = None if row.reduction is None else row.reduction[axis]
    return {
        "model_deg": row.with_causes[axis],
        "nothing_changes_deg": row.persistence[axis],
        "baseline_deg": None if reduction is None else reduction.before_deg,
        "ratio": None if reduction is None else reduction.ratio,
        "interval95": None if reduction is None else list(reduction.interval95),
    }


_DRAWN_EVERY_s: Final = 2.5
"""Time between the forecasts that the figure draws over the measured angles [s]."""


def draw_forecasts(
    forecasts: Forecasts, rows: Sequence[HorizonErrors], baseline_text: str, path: Path
) -> None:
    """Draw the errors over the horizon, and forecasts over the measured angles, for each axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    all_axes = figure.subplots(_AXIS_COUNT, 2, squeeze=False, width_ratios=(1, 2))
    horizons_s = [row.horizon_s for row in rows]
    for axis_index, (axis, (errors_ax, flight_ax)) in enumerate(zip(AXES, all_axes, strict=True)):
        # Errors, color and line style by label; without a baseline, its line has no points and is not drawn.
        lines = {
            "nothing changes": ([row.persistence[axis] for row in rows], "#888888", ":"),
            baseline_text: (
                [row.reduction[axis].before_deg for row in rows if row.reduction is not None],
                "#b45f06",
                "--",
            ),
            "this model": ([row.with_causes[axis] for row in rows], "#0b5394", "-"),
        }
        for label, (errors_deg, color, style) in lines.items():
            if errors_deg:
                errors_ax.loglog(horizons_s, errors_deg, color=color, ls=style, marker="o", ms=3, label=label)
        errors_ax.set_xticks(horizons_s, [f"{horizon_s:g}" for horizon_s in horizons_s])
        errors_ax.set_xticks([], minor=True)
        errors_ax.set_ylabel(f"{axis}: rms error, deg")
        flight_ax.plot(
            forecasts.start_s,
            np.rad2deg(forecasts.start_rad[:, axis_index]),
            color="#888888",
            lw=1.2,
            label="measured",
        )
        # Paths from all starts would cover each other.
        next_drawn_s = forecasts.start_s[0]
        for row, start_s in enumerate(forecasts.start_s):
            if start_s < next_drawn_s:
                continue
            next_drawn_s = start_s + _DRAWN_EVERY_s
            # A path ends with the flight: at the longest horizon that has a measured angle.
            is_measured = np.isfinite(forecasts.measured_rad[row, :, 0])
            longest_s = max(np.array(HORIZONS_s)[is_measured], default=0.0)
            points = slice(0, round(longest_s / _PATH_EVERY_s) + 1)
            path_deg = np.rad2deg(forecasts.path_rad[row, points, axis_index])
            flight_ax.plot(forecasts.path_s[points] + start_s, path_deg, color="#0b5394", lw=0.8)
        flight_ax.set_ylabel(f"{axis}, deg")
    # Below the plots, where it covers no curve.
    figure.legend(*all_axes[0, 0].get_legend_handles_labels(), loc="outside lower left", ncols=3, fontsize=8)
    all_axes[0, 1].set_title(
        f"{forecasts.label}: measured (grey), and forecasts from the present state (blue)", fontsize=9
    )
    all_axes[-1, 0].set_xlabel("horizon, s")
    all_axes[-1, 1].set_xlabel("time, s")
    save_figure(figure, path, dpi=130)
