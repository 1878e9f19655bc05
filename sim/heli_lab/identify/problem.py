"""What is fitted to what: a model with its free parameters, and the windows of the flights."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Prior, Rig

from heli_lab.errors import IdentifyError
from heli_lab.identify.free import PER_FLIGHT, FreeParameter, free_parameters
from heli_lab.identify.functions import Floats
from heli_lab.identify.grid import Grid, make_grid, window_starts
from heli_lab.identify.kernel import kernel
from heli_lab.identify.record import Record, prepare

_STATE_FIT_S: Final = 0.15
_SHORT_FIT_S: Final = 0.05
_LEAD_IN_S: Final = 1.0
_STATE_STD: Final[Mapping[str, float]] = {"rad": 0.02, "N m": 0.1}
_STATE_STD_V: Final = 0.15
"""How surely the voltages before a window tell its rotors' thrust. Left open, each window of a measured
flight took the thrust that suited it, and a lag of 0.12 s came out as 0.13 to 0.35 s."""
BLOCK_S: Final = 0.01
"""Windows are whole numbers of blocks about this long, whatever the step, so that means over blocks exist."""


@dataclass(frozen=True)
class Evaluation:
    """Residuals of one record at one guess, with their derivatives.

    Parameters
    ----------
    residual : ndarray (m, 3)
        Measured minus predicted angle, in standard deviations of the rounding to counts.
    normal_matrix : ndarray (w, 3, z + 1, z + 1) or None
        For each window and axis, products of the columns of [Jacobian | residual], z being the number of
        states and of the free parameters that the record depends on.
    """

    residual: Floats
    normal_matrix: Floats | None


class Problem:
    """A model with free parameters, and windows of flights that it is to predict.

    Each window is predicted freely from its own initial state, with nothing but the voltages. The error is
    measured against the rounding to encoder counts; numbers of the rig have normal priors whose standard
    deviation is half their tolerance.

    Parameters
    ----------
    model : Model
        The model.
    rig : Rig
        Values of everything fixed, and priors of everything free.
    flights : sequence of Flight or Record
        Flights; prepared ones are taken as they are.
    free : sequence of str, optional
        Names of the free parameters. Without it: every number of the rig that the model uses and that has a
        tolerance, gravity excepted, and every parameter of the model's effects that has a prior.
    per_flight : sequence of str
        Free parameters that each flight has its own value of.
    labels : sequence of str, optional
        Name of each flight, for messages.
    window_s : float
        Length of the windows, nearly.
    step_s : float
        Longest Runge-Kutta step, and distance of the samples compared, of the coarse grid.
    priors : Mapping[str, Prior], optional
        Instead of the rig's and the effects'.
    values : Mapping[str, float], optional
        Values of fixed parameters instead of the rig's and the effects'.
    state_std : Mapping[str, float], optional
        Standard deviation of a state of an effect at the beginning of a window about what the flight before
        it says, in the state's unit; where not given, by its unit: what 0.15 V change, 0.02 rad, 0.1 N m.

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
        labels: Sequence[str] | None = None,
        window_s: float = 2.0,
        step_s: float = 0.01,
        priors: Mapping[str, Prior] | None = None,
        values: Mapping[str, float] | None = None,
        state_std: Mapping[str, float] | None = None,
    ) -> None:
        self.model = model
        self.rig = rig
        wanted = free_parameters(model, rig, free, priors or {})
        self.records = tuple(
            flight
            if isinstance(flight, Record)
            else prepare(flight, rig, labels[i] if labels is not None else f"flight {i + 1}")
            for i, flight in enumerate(flights)
        )
        if not self.records:
            raise IdentifyError("there is no flight to identify from; give at least one")
        if len({record.label for record in self.records}) < len(self.records):
            raise IdentifyError("two flights have the same label; give each its own")
        shared = [one for one in wanted if one.quantity not in per_flight]
        local = [one for one in wanted if one.quantity in per_flight]
        several = len(self.records) > 1
        own = [
            replace(one, record=index, name=f"{one.name}[{record.label}]" if several else one.name)
            for index, record in enumerate(self.records)
            for one in local
        ]
        self.free: tuple[FreeParameter, ...] = (*shared, *own)
        self.columns = tuple(
            np.array([i for i, one in enumerate(self.free) if one.record in (None, index)], int)
            for index in range(len(self.records))
        )
        """For each record, which free parameters it depends on, in the order of the kernel."""
        self.window_s = window_s
        self.step_s = step_s
        self.state_count = len(model.states)
        thrust_N = _STATE_STD_V * rig["thrust_gain"].value
        usual = {**_STATE_STD, "V": _STATE_STD_V, "N": thrust_N}
        self.tied = {s.name: usual.get(s.unit, 1.0) for s in model.states[6:]} | dict(state_std or {})
        """By name, how surely the flight before a window tells an effect's state."""
        self.state_std: Floats = np.array([self.tied[s.name] for s in model.states[6:]])
        names = [quantity.name for quantity in model.parameters]
        self.base: Floats = model.parameter_values(rig)
        for name, value in (values or {}).items():
            if name not in names:
                raise IdentifyError(f"the model has no parameter '{name}'; names are: {', '.join(names)}")
            self.base[names.index(name)] = value
        self._place = np.array([names.index(one.quantity) for one in self.free], int)
        self._delay = names.index(model.delay) if model.delay else None
        self.kernel = kernel(model, tuple(one.quantity for one in (*shared, *local)))
        self._one_way = "reverse_thrust" not in names or not self.base[names.index("reverse_thrust")]
        self._one_way &= "reverse_thrust" not in self.names
        self._dead_zone = names.index("dead_zone")
        self._grids: dict[tuple[int, bool], tuple[object, Grid]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(one.name for one in self.free)

    @property
    def prior_mean(self) -> Floats:
        """Means of the priors, shape (f,)."""
        return np.array([one.prior.mean for one in self.free])

    @property
    def prior_std(self) -> Floats:
        """Standard deviations of the priors, shape (f,)."""
        return np.array([one.prior.std for one in self.free])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest values, each of shape (f,)."""
        return (
            np.array([one.prior.low for one in self.free]),
            np.array([one.prior.high for one in self.free]),
        )

    @property
    def start(self) -> Floats:
        """Values to start from: those of rig and effects, within the bounds; shape (f,)."""
        result: Floats = np.clip(self.base[self._place], *self.bounds)
        return result

    def with_windows(self, window_s: float) -> Problem:
        """Pose the same problem with windows of another length.

        Parameters
        ----------
        window_s : float
            Length of the windows, nearly.

        Returns
        -------
        Problem
            Shares records, parameters and kernel with this one.
        """
        other = copy.copy(self)
        other.window_s = window_s
        other._grids = {}
        return other

    def parameters(self, theta: Floats, index: int = 0) -> Floats:
        """Complete a vector of free parameters.

        Parameters
        ----------
        theta : ndarray (f,)
            Free parameters.
        index : int
            For which record.

        Returns
        -------
        ndarray (p,)
            All parameters of the model.
        """
        full = self.base.copy()
        columns = self.columns[index]
        full[self._place[columns]] = theta[columns]
        return full

    def grid(self, index: int, fine: bool, theta: Floats) -> Grid:
        """Windows of a record.

        Parameters
        ----------
        index : int
            Which record.
        fine : bool
            Every sample, or steps of about `step_s`.
        theta : ndarray (f,)
            Free parameters; a delay among them shifts the voltages.

        Returns
        -------
        Grid
            Windows with inputs. Both grids have the same windows.
        """
        delay, dead_zone_V = self._shape(self.parameters(theta, index))
        key = (index, fine)
        shape = (delay, None if fine else dead_zone_V)
        if key not in self._grids or self._grids[key][0] != shape:
            record = self.records[index]
            coarse = max(1, int(self.step_s / record.step_s + 1e-6))
            windows = self.windows(index)
            grid = make_grid(
                record,
                windows,
                1 if fine else coarse,
                longest_step_s=self.step_s,
                delay=delay,
                dead_zone_V=dead_zone_V,
            )
            self._grids[key] = (shape, grid)
        return self._grids[key][1]

    def block_grid(self, index: int, theta: Floats) -> Grid:
        """The same windows in steps of a block.

        Parameters
        ----------
        index : int
            Which record.
        theta : ndarray (f,)
            Free parameters; a delay among them shifts the voltages.

        Returns
        -------
        Grid
            Windows with inputs.
        """
        delay, dead_zone_V = self._shape(self.parameters(theta, index))
        record = self.records[index]
        return make_grid(
            record,
            self.windows(index),
            max(1, int(BLOCK_S / record.step_s + 1e-6)),
            delay=delay,
            dead_zone_V=dead_zone_V,
        )

    def windows(self, index: int) -> list[tuple[int, int]]:
        """Windows of a record, a whole number of steps and of blocks of `BLOCK_S`.

        Parameters
        ----------
        index : int
            Which record.

        Returns
        -------
        list of (int, int)
            First row and number of rows of each window.
        """
        record = self.records[index]
        coarse = max(1, int(self.step_s / record.step_s + 1e-6))
        block = max(1, int(BLOCK_S / record.step_s + 1e-6))
        return window_starts(record, self.window_s, math.lcm(coarse, block))

    def first_states(self, theta: Floats) -> list[Floats]:
        """Initial states of all windows, as the angles around their beginnings suggest.

        Angles and rates come from a parabola through the first samples. States of effects come from a second
        of free run before the window, where there is one.

        Parameters
        ----------
        theta : ndarray (f,)
            Free parameters.

        Returns
        -------
        list of ndarray (w, states)
            One array a record.
        """
        return [
            self.states_at(index, self._starts(index, theta), theta) for index in range(len(self.records))
        ]

    def states_at(self, index: int, rows: npt.NDArray[np.int64], theta: Floats) -> Floats:
        """States at given rows, from the angles around them.

        Parameters
        ----------
        index : int
            Which record.
        rows : ndarray of int64 (w,)
            Rows.
        theta : ndarray (f,)
            Free parameters.

        Returns
        -------
        ndarray (w, states)
            Angles and rates of parabolas through the samples around each row; states of effects after a
            second of free run that ends there, or what the encoder shows where that is what they are.
        """
        record = self.records[index]
        states = np.zeros((len(rows), self.state_count))
        states[:, :6] = [_parabola(record, int(row)) for row in rows]
        if self.state_count == 6:
            return states
        states[:, 6:] = self._led_in(index, rows, states, theta)
        shown = {state: axis for effect in self.model.effects for state, axis in effect.measured_as.items()}
        for place, state in enumerate(self.model.states):
            if state.name in shown:
                states[:, place] = record.angles_rad[rows, AXES.index(shown[state.name])]
        return states

    def other_starts(self, index: int, theta: Floats, states: Floats) -> list[Floats]:
        """Other initial states of the windows of a record, for those whose own lead to a wrong valley.

        Parameters
        ----------
        index : int
            Which record.
        theta : ndarray (f,)
            Free parameters.
        states : ndarray (w, states)
            Initial states.

        Returns
        -------
        list of ndarray (w, states)
            Where the window before ends, as long as nothing lies between: friction and play remember how
            the arm came there. Then rates of a few samples alone, which no jump of the torque nearby bends,
            and the sides that effects know.
        """
        record, windows = self.records[index], self.windows(index)
        grid = self.grid(index, False, theta)
        ends = self.kernel.end(grid.inputs, states, self.parameters(theta, index))
        before, near = states.copy(), states.copy()
        for number, (first, _) in enumerate(windows):
            if number and sum(windows[number - 1]) == first and np.isfinite(ends[number - 1]).all():
                before[number] = ends[number - 1]
            near[number, :6] = _parabola(record, first, _SHORT_FIT_S)
        places = {state.name: place for place, state in enumerate(self.model.states)}
        values = dict(
            zip((q.name for q in self.model.parameters), self.parameters(theta, index), strict=True)
        )
        sides = []
        for side in (side for effect in self.model.effects for side in effect.alternative_starts(values)):
            shifted = self.states_at(index, self._starts(index, theta), theta)
            for name, shift in side.items():
                shifted[:, places[name]] += shift
            sides.append(shifted)
        return [before, near, *sides]

    def evaluation(
        self, index: int, theta: Floats, states: Floats, *, fine: bool = False, derivatives: bool = True
    ) -> Evaluation:
        """Predict a record and compare.

        Parameters
        ----------
        index : int
            Which record.
        theta : ndarray (f,)
            Free parameters.
        states : ndarray (w, states)
            Initial states of the windows.
        fine : bool
            Compare every sample.
        derivatives : bool
            Whether to compute the products of the Jacobian.

        Returns
        -------
        Evaluation
            Residuals, and what a Gauss-Newton step needs.
        """
        grid = self.grid(index, fine, theta)
        sigma, parameters = grid.record.sigma_rad, self.parameters(theta, index)
        normal_matrix: Floats | None = None
        if derivatives:
            angles, normal_matrix = self.kernel.products(
                grid.inputs, states, parameters, grid.measured_rad, sigma
            )
        else:
            angles, _ = self.kernel.run(grid.inputs, states, parameters, False)
        return Evaluation((grid.measured_rad - angles) / sigma, normal_matrix)

    def jacobian(
        self, index: int, theta: Floats, states: Floats, *, fine: bool = False
    ) -> tuple[Floats, Floats]:
        """Residuals of a record with all their derivatives.

        Parameters
        ----------
        index : int
            Which record.
        theta : ndarray (f,)
            Free parameters.
        states : ndarray (w, states)
            Initial states of the windows.
        fine : bool
            Compare every sample.

        Returns
        -------
        residual : ndarray (m, 3)
            As in `Evaluation`.
        jacobian : ndarray (m, 3, states + f)
            Derivatives of the predicted angles, in the same unit, to the window's initial state and to the
            free parameters.
        """
        grid = self.grid(index, fine, theta)
        angles, jacobian = self.kernel.run(grid.inputs, states, self.parameters(theta, index), True)
        sigma = grid.record.sigma_rad
        assert jacobian is not None
        return (grid.measured_rad - angles) / sigma, jacobian / sigma[:, None]

    def _shape(self, parameters: Floats) -> tuple[tuple[str, float] | None, float | None]:
        """Delay, and the voltage below which there is no thrust."""
        delay = None if self._delay is None else (self.model.delay, float(parameters[self._delay]))
        return delay, float(parameters[self._dead_zone]) if self._one_way else None

    def _starts(self, index: int, theta: Floats) -> npt.NDArray[np.int64]:
        grid = self.grid(index, False, theta)
        return grid.rows[grid.inputs.first]

    def _led_in(self, index: int, rows: npt.NDArray[np.int64], states: Floats, theta: Floats) -> Floats:
        """States of effects after a second of free run that ends at each row, shape (w, states - 6).

        Voltages count from before the free segment too: there the arm may stand on its table, but what its
        rotors do next depends on them all the same. Its run then starts as the segment does.
        """
        record, parameters = self.records[index], self.parameters(theta, index)
        led = np.zeros((len(rows), self.state_count - 6))
        begun = np.array([0, *(gap + 1 for gap in record.gaps)])
        first = begun[np.searchsorted(begun, rows, side="right") - 1]
        back = np.minimum(rows - first, round(_LEAD_IN_S / record.step_s))
        some = np.flatnonzero(back > 0)
        if len(some):
            windows = [(int(rows[i] - back[i]), int(back[i])) for i in some]
            grid = make_grid(record, windows, 1, delay=self._shape(parameters)[0])
            start = np.zeros((len(some), self.state_count))
            for number, i in enumerate(some):
                begins = next(low for low, high in record.segments if low <= rows[i] < high)
                begin = windows[number][0]
                start[number, :6] = _parabola(record, begin) if begin >= begins else states[i, :6]
            led[some] = self.kernel.end(grid.inputs, start, parameters)[:, 6:]
        return np.where(np.isfinite(led), led, 0.0)


def _parabola(record: Record, row: int, reach_s: float = _STATE_FIT_S) -> Floats:
    """Angles and rates at a row, from the samples around it in the same segment."""
    start, stop = next(segment for segment in record.segments if segment[0] <= row < segment[1])
    reach = max(3, round(reach_s / record.step_s))
    low, high = max(start, row - reach), min(stop, row + reach + 1)
    time_s = (np.arange(low, high) - row) * record.step_s
    fit: Floats = np.polynomial.polynomial.polyfit(time_s, record.angles_rad[low:high], 2)
    result: Floats = np.concatenate((fit[0], fit[1]))
    return result
