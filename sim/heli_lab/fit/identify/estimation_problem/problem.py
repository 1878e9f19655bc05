"""The estimation problem: a model with its free parameters, and the windows of the flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats, Integers
from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.fit.estimation.parameter_vector import FreeParameter, ParameterVector, Prior
from heli_lab.fit.identify import thresholds
from heli_lab.fit.identify.estimation_problem.grid import Grid, WindowGrids
from heli_lab.fit.identify.free import PER_FLIGHT, free_parameters, parameter_values
from heli_lab.fit.identify.free_run import kernel
from heli_lab.fit.identify.record import Record, prepare_all

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
    priors : Mapping[str, Prior], optional
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
        priors: Mapping[str, Prior] | None = None,
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

    def delay_and_dead_zone(self, parameters: Floats) -> tuple[tuple[str, float] | None, float | None]:
        """Return the delay and the dead zone of the motors, which change the voltages before they act.

        Parameters
        ----------
        parameters : ndarray (p,)
            All parameters of the model.

        Returns
        -------
        delay : (str, float) or None
            As in `delay_of`.
        dead_zone_V : float or None
            Voltage below which there is no thrust; None if voltages below it also give thrust, as with rotors
            that reverse.
        """
        return delay_of(self.model, parameters), self.model.dead_zone_V(parameters, self.names)


def delay_of(model: Model, parameters: Floats) -> tuple[str, float] | None:
    """Find the parameter that delays the voltages of a model. Shapes: `parameters` (p,); returns (str,
    float).
    """
    if not model.delay:
        return None
    return model.delay, float(parameters[model.parameter_names.index(model.delay)])


def _check_records(records: Sequence[Record]) -> None:
    """Raise an IdentifyError if there is no flight, or if two flights have the same label."""
    if not records:
        raise IdentifyError("there is no flight to identify from", "give at least one")
    if len({record.label for record in records}) < len(records):
        raise IdentifyError("two flights have the same label", "give each flight a label of its own")


def _state_stds(model: Model, rig: Rig) -> dict[str, float]:
    """Return the prior standard deviation of each effect's state at the beginning of a window, by name."""
    thrust_N = thresholds.STATE_STD_V * rig["thrust_gain"].value
    by_unit = {**thresholds.STATE_STD, "V": thresholds.STATE_STD_V, "N": thrust_N}
    return {state.name: by_unit.get(state.unit, 1.0) for state in model.states[RIGID_STATES:]}
