"""The estimation problem: a model with its free parameters and their priors, and windows of flights."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats, Integers
from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.rig import Prior, Rig
from heli_sim.rig.schema import ENCODER_COUNTS, UNSTATED

from heli_lab.errors import IdentifyError
from heli_lab.fit import thresholds
from heli_lab.fit.free_run import kernel
from heli_lab.fit.parameters import FreeParameter, ParameterVector, PriorDistribution
from heli_lab.fit.records import Record, prepare_all
from heli_lab.fit.thresholds import MIN_OF_PRIOR, SETTLED_S, SHORT_FIT_S, STATE_FIT_S
from heli_lab.fit.windows import Grid, VoltageDelay, WindowGrids, make_grid

NOT_FREE: Final = frozenset({"g", *ENCODER_COUNTS})
"""Rig parameters that are never estimated by default, even if they have a tolerance: gravity is known better
than any of the masses, and an encoder has a whole number of counts."""

PER_FLIGHT: Final = ("offset_elevation", "offset_pitch")
"""Parameters that differ from flight to flight, because encoders are zeroed each time the board starts."""

FLIGHT_TORQUES: Final = tuple(f"torque_{axis}" for axis in AXES)
"""Constant torque about each axis during one flight, in which cables lie differently than in others."""

FLIGHT_CONSTANTS: Final = (*PER_FLIGHT, *FLIGHT_TORQUES)
"""All parameters that differ from flight to flight."""


def free_parameters(
    model: Model, rig: Rig, free: Sequence[str] | None, priors: Mapping[str, PriorDistribution]
) -> tuple[FreeParameter, ...]:
    """Choose the free parameters of a model, in the order of `free`, or otherwise of the model."""
    known = {quantity.name: quantity for quantity in model.parameters}
    all_priors: dict[str, PriorDistribution] = {
        name: prior for effect in model.effects for name, prior in effect.priors.items()
    }
    all_priors |= priors
    names_with_tolerance = {name for name in known if name in rig and rig[name].tolerance > 0}
    if free is None:
        free = [
            name
            for name in known
            if name in all_priors or (name in names_with_tolerance and name not in NOT_FREE)
        ]
    parameters = []
    for name in dict.fromkeys(free):
        if name not in known:
            raise _unknown_parameter_error(model, name)
        if name not in all_priors and name not in names_with_tolerance:
            raise IdentifyError(
                f"parameter '{name}' has no prior", "give it a tolerance in the rig file, or fix it"
            )
        prior = all_priors.get(name) or rig_prior(rig, name)
        parameters.append(FreeParameter(name, known[name].unit, prior, quantity=name))
    return tuple(parameters)


def parameter_values(model: Model, rig: Rig, values: Mapping[str, float]) -> Floats:
    """Return all parameters of a model, shape (p,): those of the rig, some of them replaced by `values`."""
    result = model.parameter_values(rig)
    for name, value in values.items():
        if name not in model.parameter_names:
            raise _unknown_parameter_error(model, name)
        result[model.parameter_names.index(name)] = value
    return result


def estimated_names(model: Model, rig: Rig, free: Sequence[str] | None, fixed: Sequence[str]) -> list[str]:
    """Return the names of the free parameters without the fixed ones."""
    for name in fixed:
        if name not in model.parameter_names:
            raise _unknown_parameter_error(model, name)
        if name in (free or ()):
            raise IdentifyError(f"'{name}' is in both --free and --fix", "leave one of them out")
    names = [
        parameter.quantity
        for parameter in free_parameters(model, rig, free, {})
        if parameter.quantity not in fixed
    ]
    if not names:
        raise IdentifyError("every parameter is fixed", "estimate at least one with --free")
    return names


def flight_constants(model: Model, rig: Rig, about: Mapping[str, float] | None = None) -> dict[str, Prior]:
    """Return the priors of `FLIGHT_CONSTANTS`, the parameters that differ from flight to flight."""
    # `about` has their values in other flights; None: those of the rig file.
    # The priors are weak: a few seconds of flight outweigh them. The standard deviation of an encoder zero is
    # half its tolerance in the rig file. The standard deviation of a torque is half its tolerance too, where
    # cables add a tolerance of their own, `UNSTATED`: 0.05, 0.02 and 0.1 N m about elevation, pitch and
    # travel.
    known = {**{name: rig[name].value for name in FLIGHT_CONSTANTS}, **(about or {})}
    priors = {}
    for name in model.parameter_names:
        if name not in FLIGHT_CONSTANTS:
            continue
        tolerance = rig[name].tolerance
        if name in FLIGHT_TORQUES:
            cable_tolerance = UNSTATED[name].tolerance
            tolerance = cable_tolerance if about is not None else max(tolerance, cable_tolerance)
        if tolerance > 0:
            priors[name] = Prior(known[name], 0.5 * tolerance)
    return priors


def _unknown_parameter_error(model: Model, name: str) -> IdentifyError:
    """Describe the error that a model has no parameter `name`; suggest a similar name."""
    known = model.parameter_names
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    return IdentifyError(
        f"the model '{model.name}' has no parameter '{name}'", f"{hint}choose from {', '.join(known)}"
    )


def rig_prior(rig: Rig, name: str) -> Prior:
    """Return the prior of the rig parameter `name`: normal, with half the tolerance as standard deviation."""
    # If the parameter cannot be negative, the prior is bounded slightly above 0, because a length or a gain
    # of 0 is impossible.
    number = rig[name]
    low = -np.inf if rig.may_be_negative(name) else MIN_OF_PRIOR * abs(number.value)
    return Prior(mean=number.value, std=0.5 * number.tolerance, low=low)


RIGID_STATES: Final = 6
"""Three angles and their rates are the first states of each model; the states of effects follow."""


@dataclass(frozen=True)
class Evaluation:
    """Residuals of one record for one guess, with the products of their derivatives."""

    residual: Floats  # (m, 3): Measured minus predicted angle, in standard deviations of the quantisation
    normal_matrix: Floats
    """(w, 3, z + 1, z + 1): For each window and axis, products of the columns of [Jacobian | residual]. The
    Jacobian has z columns: one per state, and one per free parameter that the record depends on."""

    @property
    def squares(self) -> Floats:
        """Sum of the squared residuals of each window and axis, shape (w, 3)."""
        # The last column of [Jacobian | residual] is the residual.
        return self.normal_matrix[:, :, -1, -1]


class Problem:
    """Estimation problem of multiple shooting: a model with free parameters, and windows of flights.

    Each window is simulated in open loop, from its own initial state and with the recorded voltages.
    Residuals are in standard deviations of the encoders' quantisation. Rig parameters have normal priors
    whose standard deviation is half their tolerance.

    Parameters
    ----------
    model : Model
        Equations of motion with their effects.
    rig : Rig
        Values of the fixed parameters, and priors of the free ones.
    flights : sequence of Flight or Record
        The flights; a Record is already prepared.
    free : sequence of str, optional
        Names of the free parameters; by default, those that `free_parameters` chooses.
    per_flight : sequence of str
        Free parameters that have a separate value in each flight.
    window_s : float
        Length that the windows approximate [s].
    step_s : float
        Time between compared samples of the coarse grid, and longest Runge-Kutta step [s].
    priors : Mapping[str, PriorDistribution], optional
        Priors that replace those of the rig and of the effects.
    values : Mapping[str, float], optional
        Values of fixed parameters instead of the rig's and the effects'.
    state_std : Mapping[str, float], optional
        Prior standard deviation of an effect's state at the beginning of a window, in the state's unit; by
        default that of `thresholds.STATE_STD`. The prior mean is the end of a free run over the flight before
        the window.
    threads : int, optional
        Threads of the predictions, by default `default_thread_count`. The result does not depend on it.

    Raises
    ------
    IdentifyError
        When a parameter is unknown or lacks a prior, or a flight cannot be used.
    """

    def __init__(
        self,
        model: Model,
        rig: Rig,
        flights: Sequence[Flight | Record],
        *,
        free: Sequence[str] | None = None,
        per_flight: Sequence[str] = PER_FLIGHT,
        window_s: float = 2.0,
        step_s: float = 0.01,
        priors: Mapping[str, PriorDistribution] | None = None,
        values: Mapping[str, float] | None = None,
        state_std: Mapping[str, float] | None = None,
        threads: int | None = None,
    ) -> None:
        self.model = model
        self.rig = rig
        all_free = free_parameters(model, rig, free, priors or {})
        self.records = prepare_all(flights, rig)
        _check_records(self.records)
        shared_parameters = [parameter for parameter in all_free if parameter.quantity not in per_flight]
        per_flight_parameters = [parameter for parameter in all_free if parameter.quantity in per_flight]
        labels = [record.label for record in self.records]
        all_values = parameter_values(model, rig, values or {})
        self.parameter_vector = ParameterVector(
            model.parameter_names, all_values, shared_parameters, per_flight_parameters, labels
        )
        self.grids = WindowGrids(self.records, window_s, step_s)
        self.state_count = len(model.states)
        self.state_std_by_name = _state_stds(model, rig) | dict(state_std or {})
        """Prior standard deviation of each effect's state at the beginning of a window."""
        self.state_std: Floats = np.array(
            [self.state_std_by_name[state.name] for state in model.states[RIGID_STATES:]]
        )
        self._kernel_free = self.parameter_vector.quantities
        self.threads = threads
        self.kernel = kernel(model, self._kernel_free, threads)

    def __getstate__(self) -> dict[str, Any]:
        """Return everything except the kernel, for pickling."""
        # A kernel is code that is loaded into this process: the process that unpickles builds its own.
        return {**self.__dict__, "kernel": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Build the kernel again after unpickling."""
        self.__dict__.update(state)
        self.kernel = kernel(self.model, self._kernel_free, self.threads)

    def _with_grids(self, grids: WindowGrids) -> Problem:
        """Return the same problem with other `grids`; both share one kernel."""
        # copy.copy uses the pickled state, and would build the kernel again.
        other = Problem.__new__(Problem)
        other.__dict__.update(self.__dict__, grids=grids)
        return other

    @property
    def free(self) -> tuple[FreeParameter, ...]:
        """Free parameters: first those that all flights share, then those of single flights."""
        return self.parameter_vector.free

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.parameter_vector.names

    @property
    def columns(self) -> tuple[Integers, ...]:
        """For each record, numbers of the free parameters that it depends on, in the order of the kernel."""
        return self.parameter_vector.columns

    def with_windows(self, window_s: float) -> Problem:
        """Return the same problem with windows of about `window_s` [s]; both share flights, parameters and
        kernel.
        """
        return self._with_grids(self.grids.copy(window_s=window_s))

    def with_free(self, free: Sequence[FreeParameter]) -> Problem:
        """Return the same problem with other free parameters, for predictions without derivatives.

        The kernel has no derivatives to the new parameters.

        Parameters
        ----------
        free : sequence of FreeParameter
            Parameters that all flights share, then those of single flights.
        """
        other = self._with_grids(self.grids.copy())
        other.parameter_vector = self.parameter_vector.with_free(free)
        return other

    def with_split_windows(self, parts: int) -> Problem:
        """Return the same problem with each window divided into `parts` shorter windows of about equal
        length.

        The samples stay the same, but are predicted over a shorter time, because each part has its own
        initial state.
        """
        return self._with_grids(self.grids.copy(parts=parts))

    def parameters(self, theta: Floats, index: int = 0) -> Floats:
        """Return all parameters of the model in flight `index`, shape (p,), for the free parameters `theta`,
        shape (f,).
        """
        values = self.parameter_vector.parameters(theta, index)
        return self.model.values_in(self.records[index].label, values)

    def grid(self, index: int, fine: bool, theta: Floats) -> Grid:
        """Return the windows of a record with their voltages; the coarse and the fine grid have the same
        windows.

        Parameters
        ----------
        index : int
            Number of the flight.
        fine : bool
            True for every sample, False for samples about `step_s` apart.
        theta : ndarray (f,)
            Free parameters; a delay among them shifts the voltages.
        """
        return self.grids.grid(index, fine, *self.delay_and_dead_zone(self.parameters(theta, index)))

    def windows(self, index: int) -> list[tuple[int, int]]:
        """First row and number of rows of each window of record `index`."""
        return self.grids.windows(index)

    def first_rows(self, index: int) -> Integers:
        """First row of each window of record `index`, shape (w,)."""
        return np.array([first for first, _ in self.windows(index)], np.int64)

    def residual(self, index: int, theta: Floats, states: Floats, *, fine: bool = False) -> Floats:
        """Predict a flight, and return its residuals alone, shape (m, 3), as in `Evaluation`.

        Parameters
        ----------
        index, theta, states, fine
            As in `evaluation`.
        """
        grid = self.grid(index, fine, theta)
        angles_rad, _ = self.kernel.predict(grid.inputs, states, self.parameters(theta, index))
        return (grid.measured_rad - angles_rad) / grid.record.sigma_rad

    def evaluation(self, index: int, theta: Floats, states: Floats, *, fine: bool = False) -> Evaluation:
        """Predict a flight, and return its residuals and the products of their derivatives, from which a
        Gauss-Newton step is computed.

        Parameters
        ----------
        index : int
            Number of the flight.
        theta : ndarray (f,)
            Free parameters.
        states : ndarray (w, states)
            Initial states of the windows.
        fine : bool
            Compare every sample.
        """
        return self.evaluate_grid(self.grid(index, fine, theta), states, self.parameters(theta, index))

    def evaluate_grid(self, grid: Grid, states: Floats, parameters: Floats) -> Evaluation:
        """Predict the windows of a `grid`, and compare them with the measured angles.

        Parameters
        ----------
        states : ndarray (w, states)
            Initial states of the windows.
        parameters : ndarray (p,)
            All parameters of the model.
        """
        measured_rad, sigma_rad = grid.measured_rad, grid.record.sigma_rad
        angles_rad, normal_matrix = self.kernel.products(
            grid.inputs, states, parameters, measured_rad, sigma_rad
        )
        return Evaluation((measured_rad - angles_rad) / sigma_rad, normal_matrix)

    def delay_and_dead_zone(self, parameters: Floats) -> tuple[VoltageDelay | None, float | None]:
        """Return the delay and the dead zone of the motors, which change the voltages before they act.

        Parameters
        ----------
        parameters : ndarray (p,)
            All parameters of the model.

        Returns
        -------
        delay : VoltageDelay or None
            None if no parameter delays the voltages.
        dead_zone_V : float or None
            Voltage below which there is no thrust; None if voltages below it also give thrust, as with rotors
            that reverse.
        """
        return delay_of(self.model, parameters), self.model.dead_zone_V(parameters, self.names)


def delay_of(model: Model, parameters: Floats) -> VoltageDelay | None:
    """Find the parameter that delays the voltages of a model; None without one. Shapes: `parameters` (p,)."""
    if not model.delay:
        return None
    return VoltageDelay(model.delay, float(parameters[model.parameter_names.index(model.delay)]))


def _check_records(records: Sequence[Record]) -> None:
    """Raise an IdentifyError if there is no flight, or if two flights have the same label."""
    if not records:
        raise IdentifyError("there is no flight to identify from", "give at least one")
    if len({record.label for record in records}) < len(records):
        raise IdentifyError("two flights have the same label", "give each flight a label of its own")


def _state_stds(model: Model, rig: Rig) -> dict[str, float]:
    """Return the prior standard deviation of each effect's state at the beginning of a window, by name."""
    thrust_N = thresholds.STATE_STD_V * rig["thrust_gain"].value
    # A state of an unlisted unit has the standard deviation 1 in its unit.
    by_unit = {**thresholds.STATE_STD, "V": thresholds.STATE_STD_V, "N": thrust_N}
    return {state.name: by_unit.get(state.unit, 1.0) for state in model.states[RIGID_STATES:]}


def initial_state_guess(problem: Problem, theta: Floats) -> list[Floats]:
    """Guess the initial states of all windows from the measured angles; see `states_at`. Shapes: `theta`
    (f,); returns (w, states).
    """
    return [
        states_at(problem, index, problem.first_rows(index), theta) for index in range(len(problem.records))
    ]


def states_at(problem: Problem, index: int, rows: Integers, theta: Floats) -> Floats:
    """Estimate the states of the model at given rows of a flight from the measured angles. Shapes: `rows`
    (w,), `theta` (f,); returns (w, states).
    """
    # Angles and rates come from parabolas through the samples around each row. States of effects come from a
    # free run (open-loop simulation) that ends at the row; a state that an encoder measures is the measured
    # angle.
    record = problem.records[index]
    states = np.zeros((len(rows), problem.state_count))
    states[:, :RIGID_STATES] = _angles_and_rates_by_parabola(record, rows, STATE_FIT_S)
    if problem.state_count == RIGID_STATES:
        return states
    states[:, RIGID_STATES:] = _effect_states_after_run_in(problem, index, rows, states, theta)
    measured = {state: axis for effect in problem.model.effects for state, axis in effect.measured_as.items()}
    for column, state in enumerate(problem.model.states):
        if state.name in measured:
            states[:, column] = record.angles_rad[rows, AXES.index(measured[state.name])]
    return states


def alternative_states(problem: Problem, index: int, theta: Floats, states: Floats) -> list[Floats]:
    """List other initial states to try for windows whose optimisation ended in a wrong local minimum. Shapes:
    `theta` (f,), `states` (w, states); returns (w, states).
    """
    # The first alternative is the end of the previous window, if the two windows adjoin: friction and
    # backlash depend on the motion before. The second has rates from a few samples only, which a jump of the
    # torque nearby does not distort. The others are the alternatives that effects define.
    short_fit = states.copy()
    short_fit[:, :RIGID_STATES] = _angles_and_rates_by_parabola(
        problem.records[index], problem.first_rows(index), SHORT_FIT_S
    )
    ends_of_previous = _ends_of_previous_windows(problem, index, theta, states)
    return [ends_of_previous, short_fit, *_starts_of_effects(problem, index, theta)]


def _ends_of_previous_windows(problem: Problem, index: int, theta: Floats, states: Floats) -> Floats:
    """Predict the state at the end of the window before each window, shape (w, states)."""
    # The state of a window stays as in `states` if no window ends just before it, or if that prediction
    # diverges.
    grid, parameters = problem.grid(index, fine=False, theta=theta), problem.parameters(theta, index)
    _, ends = problem.kernel.predict(grid.inputs, states, parameters)
    first, count = np.array(problem.windows(index)).T
    # A window that follows a gap or a diverged window keeps its own states.
    adjoins = first[:-1] + count[:-1] == first[1:]
    previous = np.flatnonzero(adjoins & np.isfinite(ends[:-1]).all(axis=1))
    result = states.copy()
    result[previous + 1] = ends[previous]
    return result


def _starts_of_effects(problem: Problem, index: int, theta: Floats) -> list[Floats]:
    """Return the first guess of the initial states of flight `index`, shape (w, states), shifted by the
    offsets of each alternative that an effect defines.
    """
    # The angles do not show every state, such as the end of a play at which an axis is: each end is tried.
    model = problem.model
    values = dict(zip(model.parameter_names, problem.parameters(theta, index), strict=True))
    columns = {state.name: column for column, state in enumerate(model.states)}
    starts = []
    for effect in model.effects:
        for offsets in effect.alternative_starts(values):
            start = states_at(problem, index, problem.first_rows(index), theta)
            for name, offset in offsets.items():
                start[:, columns[name]] += offset
            starts.append(start)
    return starts


def _effect_states_after_run_in(
    problem: Problem, index: int, rows: Integers, states: Floats, theta: Floats
) -> Floats:
    """Estimate the states of effects at given rows by simulations that end there. Shapes: `rows` (w,),
    `states` (w, states); returns (w, states - 6).
    """
    # A simulation begins `SETTLED_S` before its row, with effects at rest. It may begin before the segment of
    # free flight, because the voltages drive the rotors also while the arm lies on its table. There, angles
    # and rates are not those of free flight, and the simulation starts with the ones at its end instead.
    record, parameters = problem.records[index], problem.parameters(theta, index)
    effect_states = np.zeros((len(rows), problem.state_count - RIGID_STATES))
    # No simulation may cross a gap of the log.
    starts_after_gaps = np.array([0, *(gap + 1 for gap in record.gaps)])
    earliest = starts_after_gaps[np.searchsorted(starts_after_gaps, rows, side="right") - 1]
    lengths = np.minimum(rows - earliest, round(SETTLED_S / record.step_s))
    simulated = np.flatnonzero(lengths > 0)
    if len(simulated):
        first_rows = rows[simulated] - lengths[simulated]
        windows = list(zip(first_rows.tolist(), lengths[simulated].tolist(), strict=True))
        grid = make_grid(record, windows, every=1, delay=delay_of(problem.model, parameters))
        start = states[simulated].copy()
        start[:, RIGID_STATES:] = 0.0
        segment_first_rows, _ = _segment_of_rows(record, rows[simulated]).T
        in_segment = first_rows >= segment_first_rows
        start[in_segment, :RIGID_STATES] = _angles_and_rates_by_parabola(
            record, first_rows[in_segment], STATE_FIT_S
        )
        _, end = problem.kernel.predict(grid.inputs, start, parameters)
        effect_states[simulated] = end[:, RIGID_STATES:]
    # After a simulation that diverges, effects start at rest.
    return np.where(np.isfinite(effect_states), effect_states, 0.0)


def _segment_of_rows(record: Record, rows: Integers) -> Integers:
    """Return first row, and last row plus one, of the free segment that contains each row, shape (w, 2)."""
    segments = np.array(record.segments)
    return segments[np.searchsorted(segments[:, 0], rows, side="right") - 1]


def _angles_and_rates_by_parabola(record: Record, rows: Integers, reach_s: float) -> Floats:
    """Fit a parabola to the angles around each row, and return its value and slope there. Shapes: `rows`
    (w,); returns (w, 6).
    """
    reach = max(3, round(reach_s / record.step_s))
    segments = _segment_of_rows(record, rows)
    low, high = np.maximum(segments[:, 0], rows - reach), np.minimum(segments[:, 1], rows + reach + 1)
    angles_and_rates = np.empty((len(rows), RIGID_STATES))
    # Rows with as many samples before and after them share one least-squares problem. Only rows near the edge
    # of a segment have fewer samples on one side.
    reaches, group = np.unique(np.column_stack((low - rows, high - rows)), axis=0, return_inverse=True)
    for number, (before, after) in enumerate(reaches):
        members = np.flatnonzero(group.ravel() == number)
        # Shape (members, samples, axes), then (samples, members * axes): one parabola per column.
        samples = record.angles_rad[rows[members, None] + np.arange(before, after)]
        columns = samples.transpose(1, 0, 2).reshape(after - before, -1)
        coefficients = np.polynomial.polynomial.polyfit(np.arange(before, after) * record.step_s, columns, 2)
        # The first two coefficients are the value and the slope: shape (members, 2 * axes) in the end.
        value_and_slope = coefficients[:2].reshape(2, len(members), 3).transpose(1, 0, 2)
        angles_and_rates[members] = value_and_slope.reshape(len(members), -1)
    return angles_and_rates


@dataclass(frozen=True)
class Budget:
    """Limits of a fit.

    Parameters
    ----------
    max_evaluations : int
        Largest number of predictions of all flights with derivatives.
    max_time_s : float
        Longest time on this computer [s].
    """

    max_evaluations: int = 80
    max_time_s: float = math.inf


@dataclass(frozen=True)
class FitProgress:
    """Progress of a fit.

    Parameters
    ----------
    stage : str
        Name of the present stage, in a few words.
    done : float
        Share of the work done, 0 to 1; an estimate.
    cost : float
        Weighted sum of squares.
    """

    stage: str
    done: float
    cost: float


@dataclass(frozen=True)
class Fit:
    """Estimates with their covariance.

    Parameters
    ----------
    theta : ndarray (f,)
        Free parameters.
    covariance : ndarray (f, f)
        Posterior covariance: flights and priors.
    information : ndarray (f, f)
        Fisher information of the flights alone: inverse covariance without priors.
    states : tuple of ndarray (w, states)
        Initial states of the windows of each record.
    variance : tuple of ndarray (3,)
        For each record, the variance by which the squared residuals of each axis were divided, in variances
        of the quantisation: 1 if the residuals are quantisation alone.
    weights : tuple of ndarray (w,)
        Robust weights of the windows of each record, 0 to 1.
    cost : float
        Weighted sum of squares plus priors.
    at_bound : tuple of str
        Names of parameters that lie on a bound.
    evaluations : int
        Predictions of all flights with derivatives.
    elapsed_s : float
        Time that the fit took [s].
    converged : bool
        Whether further steps would not change the estimates noticeably. False when the budget, or the largest
        number of steps or rounds, ended the fit before.
    """

    problem: Problem
    theta: Floats
    covariance: Floats
    information: Floats
    states: tuple[Floats, ...]
    variance: tuple[Floats, ...]
    weights: tuple[Floats, ...]
    cost: float
    at_bound: tuple[str, ...]
    evaluations: int
    elapsed_s: float
    converged: bool

    @property
    def params(self) -> dict[str, float]:
        """Free parameters by name."""
        return self.problem.parameter_vector.by_name(self.theta)

    @property
    def std(self) -> dict[str, float]:
        """Standard errors by name."""
        return self.problem.parameter_vector.by_name(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> Floats:
        """Correlations of the free parameters, shape (f, f)."""
        std = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(std, std))
