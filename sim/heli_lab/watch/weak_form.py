"""A rig's equations of motion along a flight in weak form, with scaled encoders.

Multiplied by a smooth test function and integrated by parts, an equation of motion needs no second derivative
of a measured angle. `encoder_scale.py` has the equation.
"""

from __future__ import annotations

import copy
import math
import re
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_host.data.flight import Flight
from heli_host.data.response import flown_rows
from heli_sim.evaluate.trajectories import Trajectory
from heli_sim.model.base import Effect, Model
from heli_sim.model.effect import AXES
from heli_sim.rig import Rig

from heli_lab.fit.flight_model import TORQUE_STD_Nm, model_functions
from heli_lab.fit.problem import FLIGHT_CONSTANTS, free_parameters

GRID_s: Final = 0.02
"""Step of the grid [s]. Twice as long: blurred rates give scales an error of 2 %, twice as much. Half as
long: a fit takes twice the time."""
_WIDTHS_s: Final = (3.0, 1.5, 3.0)
"""Length of the test functions of elevation, pitch and travel [s]. Shorter: errors by the encoders' rounding
grow with the inverse square. Longer: the sines of a flight average out."""
_OVERLAP: Final = 0.5
"""Distance between two test functions, as a share of their length."""
_BLOCK: Final = 64
"""Number of rows that the low-pass filter computes together."""
_MIN_LAG_s: Final = 1e-3
"""Smallest lag [s]; a shorter one has no effect on the grid."""
_SMOOTH_s: Final = 0.1
"""Standard deviation of the Gaussian that smooths the rates [s]."""


@dataclass(frozen=True)
class Part:
    """Consecutive steps of free flight."""

    t_s: Floats  # (n,): Beginning of each step
    angles_rad: Floats
    """angles_rad, rates_rad_s: (n, 3): Mean of the measured angles in each step, and their smoothed rates."""
    rates_rad_s: Floats
    volts_V: Floats  # (n, 2): Mean of the voltages in each step
    step_s: float  # Length of a step [s]

    @property
    def seconds(self) -> float:
        """Length of the part [s]."""
        return len(self.angles_rad) * self.step_s

    def lagged_V(self, lag_s: float) -> Floats:
        """Pass the voltages through a first-order lag that is settled at the first voltage. Returns shape
        (n, 2).
        """
        lag_s = max(lag_s, _MIN_LAG_s)
        decay = math.exp(-self.step_s / lag_s)
        at_start = _low_passed(self.volts_V, decay)
        # Within a step, the output decays exponentially from its value at the start to the step's voltage.
        mean_share = lag_s / self.step_s * (1.0 - decay)
        return np.asarray(self.volts_V + mean_share * (at_start - self.volts_V))


def _low_passed(values: Floats, decay: float) -> Floats:
    """Pass the columns of `values` through a first-order low-pass filter that is settled at the first row.
    Returns shape (n, k).
    """
    # The filter is computed in blocks of rows, as a product of matrices for each block. SciPy has such a
    # filter, but importing SciPy takes as long as filtering half a minute of flight.
    rows, columns = values.shape
    blocks = -(-rows // _BLOCK)
    padded = np.zeros((blocks * _BLOCK, columns))
    padded[:rows] = values
    powers = decay ** np.arange(_BLOCK + 1)
    # Impulse response: how an input row of a block acts on each output row after it.
    distance = np.subtract.outer(np.arange(_BLOCK + 1), np.arange(_BLOCK)) - 1
    response = (1.0 - decay) * np.where(distance >= 0, powers[np.maximum(distance, 0)], 0.0)
    result = response @ padded.reshape(blocks, _BLOCK, columns)
    # Add the decaying output at the start of each block; its last row is the start of the next block.
    start = values[0]
    for number in range(blocks):
        result[number] += np.outer(powers, start)
        start = result[number, -1]
    return np.asarray(result[:, :-1].reshape(-1, columns)[:rows])


def _gap_free_parts(flight: Flight, rows: Booleans, min_V: float) -> list[Part]:
    """Cut a flight into parts without gaps, each longer than the longest test function, on a coarse grid.
    Shapes: `rows` (n,).
    """
    step_s = flight.step_s
    if not step_s > 0.0:
        return []
    rows_per_point = max(1, round(GRID_s / step_s))
    grid_s = rows_per_point * step_s
    is_usable = rows & np.isfinite(flight.angles_rad).all(axis=1) & np.isfinite(flight.voltages_V).all(axis=1)
    # A part begins at each gap, and where usable rows begin or end.
    is_start = np.ones(len(is_usable), bool)
    is_start[1:] = (np.diff(flight.t_s) > 1.5 * step_s) | (is_usable[1:] != is_usable[:-1])
    starts = np.flatnonzero(is_start)
    parts = []
    for start, stop in zip(starts, [*starts[1:], len(is_usable)], strict=True):
        count = (stop - start) // rows_per_point
        is_long = count * rows_per_point * step_s >= max(_WIDTHS_s)
        if not is_usable[start] or not is_long:
            continue
        part_rows = slice(start, start + count * rows_per_point)
        angles = flight.angles_rad[part_rows].reshape(count, rows_per_point, 3).mean(axis=1)
        volts = np.maximum(flight.voltages_V[part_rows], min_V).reshape(count, rows_per_point, 2).mean(axis=1)
        t_s = flight.t_s[part_rows][::rows_per_point]
        parts.append(Part(t_s, angles, _smoothed_rates(angles, grid_s), volts, grid_s))
    return parts


def _smoothed_rates(values: Floats, step_s: float) -> Floats:
    """Differentiate the columns of `values`, shape (n, k), after smoothing them by a Gaussian."""
    # Three standard deviations on either side.
    reach = max(1, round(3.0 * _SMOOTH_s / step_s))
    gaussian = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_s / _SMOOTH_s) ** 2)
    gaussian /= gaussian.sum()
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    smooth = np.column_stack([np.convolve(column, gaussian, mode="valid") for column in padded.T])
    return np.asarray(np.gradient(smooth, step_s, axis=0))


class _AxisTests(NamedTuple):
    """The test functions of an axis, on the grid of a part."""

    weights: Floats  # Of w, which all test functions share
    second_derivative: Floats  # Weights of the second derivative of w
    starts: Integers  # First step of each test function


class TestFunctions:
    """Test functions of the weak form, at even distances over a part of a flight."""

    # A test function is w(t) = c (1 - x^2)^4 for |x| < 1, with integral 1; each axis has its own width. After
    # integration by parts, the mean of an acceleration weighted by w is the mean of the angle weighted by the
    # second derivative of w.

    __test__ = False

    def __init__(self, part: Part) -> None:
        self._of_axes: list[_AxisTests] = []
        for width_s in _WIDTHS_s:
            count = round(width_s / part.step_s)
            x = (np.arange(count) + 0.5) / count * 2.0 - 1.0
            scale = 2.0 / width_s
            w = (1.0 - x**2) ** 4
            w_second = scale**2 * (-8.0 * (1.0 - x**2) ** 3 + 48.0 * x**2 * (1.0 - x**2) ** 2)
            # On the grid, the weights must be exact for angles that are polynomials of second order: a
            # constant and a line have the acceleration 0, and t^2 / 2 has 1.
            w_second -= w_second.mean()
            t_s = x / scale
            parabola = float(w_second @ (0.5 * t_s**2))
            starts = np.arange(0, len(part.angles_rad) - count + 1, max(1, round(_OVERLAP * count)))
            self._of_axes.append(_AxisTests(w / w.sum(), w_second / parabola, starts))

    def second_derivative(self, angles_rad: Floats) -> list[Floats]:
        """Compute the mean acceleration of each axis [rad/s^2], weighted by each of its test functions.
        Shapes: `angles_rad` (n, 3); returns (k,).
        """
        return [
            _weighted_sums(tests.second_derivative, tests.starts, angles_rad[:, axis])
            for axis, tests in enumerate(self._of_axes)
        ]

    def mean(self, axis: int, values: Floats) -> Floats:
        """Average `values`, shape (n,) or (n, k), weighted by each test function of an `axis`, 0 to 2."""
        tests = self._of_axes[axis]
        return _weighted_sums(tests.weights, tests.starts, values)


def _weighted_sums(weights: Floats, starts: Integers, values: Floats) -> Floats:
    """Sum up `values`, shape (n,) or (n, k), multiplied by the `weights` from each of the `starts` on."""
    windows = np.lib.stride_tricks.sliding_window_view(values, len(weights), axis=0)[starts]
    return np.asarray(windows @ weights)


_CLEAR_deg: Final = 8.0
"""Elevation above the table from which on neither the table nor the air cushion over it pushes the arm [deg].
Lower: the table counts as thrust. Higher: flights near the table give no estimate."""
_LAG_s: Final = 0.05
_LAG_STD_s: Final = 0.05
"""Prior mean and standard deviation of the first-order lag of the thrust [s]: rotors of this size have 0
to 0.15 s."""
_SCALE_LOG_STD: Final = 3.0
"""Prior standard deviation of the logarithm of a scale: a factor of 20. It costs a scale of one half only
0.03 nats. It matters only if a flight is not informative about a scale, as a hover is about that of
travel: the search then stays finite."""
_LAG_STEP_s: Final = 1e-4
"""Step of the numerical derivative by the lag [s]."""
_DEAD_ENCODER: Final = re.compile(rf"({'|'.join(AXES)})_motionless")
"""Name of a fault of the board whose cause is an encoder that does not count."""
LOG_SCALES: Final = slice(0, 3)
VOLTAGE_FACTOR: Final = 3
_LAG: Final = 4
_ZEROS: Final = slice(5, 7)
_PARAMETERS: Final = slice(7, None)
"""Places in the vector of unknowns: logarithms of the three scales and of the factor on the voltages, the lag
of the thrust, and the zeros of the elevation and the pitch encoder. The parameters of the rig and of effects
follow, and a constant torque about each axis."""
SCALES_AND_FACTOR: Final = 4
"""Count of unknowns that are free only on request: three scales and the factor on the voltages."""


class _Prior(NamedTuple):
    """Mean and standard deviation of an unknown."""

    mean: float
    std: float


class _Accelerations(NamedTuple):
    """True accelerations at the rows of a part."""

    values: Floats  # (n, 3) [rad/s^2]
    derivatives: Floats  # (n, 3, unknowns): By the unknowns


class _ActingVoltages(NamedTuple):
    """Voltages of both motors that act on the rotors, at the rows of a part."""

    values: Floats  # (n, 2) [V]
    derivatives: Floats  # (n, 2, 2): By the logarithm of the factor on the voltages, and by the lag


class FlightInWeakForm:
    """Residuals of a rig's equations of motion along a flight, in weak form."""

    def __init__(self, flight: Flight, rig: Rig, model: Model) -> None:
        self._rig = rig
        self._set_model(_without_random_and_lagged_effects(model))
        rest_deg = flight.parameters.get("elevation_rest_deg", rig["elevation_min"].value)
        # Angles at which the encoders were zeroed: an encoder with a wrong scale is right there.
        self._pivot: Floats = np.array([np.radians(rest_deg), 0.0, 0.0])
        rows = flown_rows(flight) & (flight.elevation_rad > self._pivot[0] + np.radians(_CLEAR_deg))
        rows &= _rows_with_live_encoders(flight)
        # It is the thrust that lags, and below the dead zone there is none: lower voltages must not delay it.
        dead_zone_V = self._model.dead_zone_V(self._parameters)
        self._min_V = -np.inf if dead_zone_V is None else dead_zone_V
        parts = _gap_free_parts(flight, rows, self._min_V)
        self.seconds = sum(part.seconds for part in parts)
        self._parts = parts
        self._tests = [TestFunctions(part) for part in parts]
        self._measured = [
            test.second_derivative(part.angles_rad) for test, part in zip(self._tests, parts, strict=True)
        ]

    def _set_model(self, static: Model) -> None:
        """Set equations of motion without lagged effects, and the priors of their unknowns."""
        self._model = static
        self._parameters = static.parameter_values(self._rig)
        priors = _priors(static, self._rig)
        self.names: tuple[str, ...] = tuple(priors)
        """Names of the last unknowns: rig parameters, parameters of effects and torques."""
        self._places = [static.parameter_names.index(name) for name in priors]
        self._functions = model_functions(static, self.names)
        scale_count = SCALES_AND_FACTOR
        self.mean: Floats = np.array(
            [0.0] * scale_count + [_LAG_s, 0.0, 0.0] + [p.mean for p in priors.values()]
        )
        self.std: Floats = np.concatenate(
            (
                [_SCALE_LOG_STD] * scale_count,
                [_LAG_STD_s],
                _zero_stds_rad(self._rig),
                [p.std for p in priors.values()],
            )
        )

    def with_effect(self, effect: Effect) -> FlightInWeakForm:
        """Return the same flight with one more effect in the equations, whose parameters are unknown too."""
        other = copy.copy(self)
        other._set_model(type(self._model)((*self._model.effects, effect)))
        return other

    @property
    def duration_s(self) -> float:
        """Time from the beginning of the first to the end of the last part of free flight [s]."""
        return self.end_s - float(self._parts[0].t_s[0]) if self._parts else 0.0

    @property
    def end_s(self) -> float:
        """End of the last part of free flight [s]."""
        return float(self._parts[-1].t_s[-1]) if self._parts else 0.0

    def measured_accelerations(self, axis: int) -> Floats:
        """Mean measured accelerations of an `axis`, 0 to 2, one per test function [rad/s^2]."""
        return np.concatenate([of_part[axis] for of_part in self._measured])

    def residuals(self, unknowns: Floats) -> tuple[list[Floats], list[Floats]]:
        """Compute measured minus predicted mean accelerations, and their derivatives by the `unknowns`.
        Returns shape `residuals` (k,), `jacobians` (k, unknowns).
        """
        scales = np.exp(unknowns[LOG_SCALES])
        residuals: list[list[Floats]] = [[], [], []]
        jacobians: list[list[Floats]] = [[], [], []]
        for part, test, measured in zip(self._parts, self._tests, self._measured, strict=True):
            accelerations = self._true_accelerations(part, unknowns)
            for axis in range(3):
                # The encoder shows the true acceleration times its scale.
                predicted = scales[axis] * test.mean(axis, accelerations.values[:, axis])
                residuals[axis].append(measured[axis] - predicted)
                jacobian = -scales[axis] * test.mean(axis, accelerations.derivatives[:, axis])
                # The unknown is the logarithm of the scale: by it, the product has itself as derivative.
                jacobian[:, axis] -= predicted
                jacobians[axis].append(jacobian)
        return (
            [np.concatenate(of_parts) for of_parts in residuals],
            [np.concatenate(of_parts) for of_parts in jacobians],
        )

    def _true_accelerations(self, part: Part, unknowns: Floats) -> _Accelerations:
        """Compute the true accelerations by the equations of motion at every row of a part."""
        scales = np.exp(unknowns[LOG_SCALES])
        zeros_rad = np.array([*unknowns[_ZEROS], 0.0])  # Nothing depends on the zero of travel
        parameters = self._parameters.copy()
        parameters[self._places] = unknowns[_PARAMETERS]
        # True angles, relative to those at which the encoders were zeroed, and true rates.
        deflections = (part.angles_rad - self._pivot - zeros_rad) / scales
        rates = part.rates_rad_s / scales
        voltages = self._acting_voltages(part, unknowns[VOLTAGE_FACTOR], unknowns[_LAG])
        states = np.hstack((self._pivot + deflections, rates))
        trajectory = Trajectory(part.t_s, states, voltages.values, part.step_s, parameters)
        at = self._functions.along(trajectory)
        # The states are three angles and three rates; the derivative of a rate is an acceleration.
        angle_states, rate_states = slice(0, 3), slice(3, 6)
        by_angles = at.by_state[:, rate_states, angle_states]
        by_rates = at.by_state[:, rate_states, rate_states]
        by_scales = -by_angles * deflections[:, None] - by_rates * rates[:, None]
        # Products of (n, 3, 2) by (n, 2, 2): by the factor on the voltages, and by the lag.
        by_factor_and_lag = at.by_input[:, rate_states] @ voltages.derivatives
        by_zeros = -by_angles[:, :, :2] / scales[:2]
        # Column 0 has the accelerations, the others their negative derivatives by the parameters.
        accelerations, by_parameters = at.rates[:, rate_states, 0], -at.rates[:, rate_states, 1:]
        derivatives = np.concatenate((by_scales, by_factor_and_lag, by_zeros, by_parameters), axis=2)
        return _Accelerations(accelerations, derivatives)

    def _acting_voltages(self, part: Part, log_factor: float, lag_s: float) -> _ActingVoltages:
        """Return the lagged voltages times the unknown factor; below the dead zone, those of its edge act."""
        factor = np.exp(log_factor)
        lagged_V = part.lagged_V(lag_s)
        by_lag = factor * (part.lagged_V(lag_s + _LAG_STEP_s) - lagged_V) / _LAG_STEP_s
        # The derivative of the factor by its logarithm is the factor itself.
        by_unknowns = np.stack((factor * lagged_V, by_lag), axis=2)
        # In the dead zone, neither the factor nor the lag changes the voltage.
        is_effective = factor * lagged_V > self._min_V
        return _ActingVoltages(
            np.maximum(factor * lagged_V, self._min_V), np.where(is_effective[:, :, None], by_unknowns, 0.0)
        )


def _without_random_and_lagged_effects(model: Model) -> Model:
    """Return a model without its random effects and without effects that have states."""
    effects = tuple(effect for effect in model.effects if not effect.states and not effect.noise_inputs)
    return type(model)(effects)


def _rows_with_live_encoders(flight: Flight) -> Booleans:
    """Return the rows before an encoder stopped counting, for which the board has ended the flight; (n,)."""
    # The board needs seconds to notice a plug that fell off. Until then, the other axes respond to an angle
    # that nobody measures.
    rows = np.ones(len(flight), bool)
    for event in flight.events:
        dead = _DEAD_ENCODER.search(event.text) if event.name == "fault" else None
        if dead is not None:
            count = flight.angles_rad[:, AXES.index(dead[1])]
            before = np.flatnonzero(flight.t_s[1:] <= event.t_s)
            changes = before[np.diff(count)[before] != 0.0]
            rows[changes[-1] + 1 if changes.size else 0 :] = False
    return rows


def _priors(model: Model, rig: Rig) -> dict[str, _Prior]:
    """Prior of each estimated parameter of a model: of the rig, of the effects, and then a constant torque
    about each axis.
    """
    free = free_parameters(model, rig, free=None, priors={})
    parameters = {
        parameter.quantity: _Prior(parameter.prior.mean, parameter.prior.std)
        for parameter in free
        if parameter.quantity not in FLIGHT_CONSTANTS
    }
    torques = {
        name: _Prior(rig[name].value, float(np.hypot(0.5 * rig[name].tolerance, std_Nm)))
        for name, std_Nm in TORQUE_STD_Nm.items()
    }
    return parameters | torques


def _zero_stds_rad(rig: Rig) -> Floats:
    """Prior standard deviations of the zeros of the elevation and the pitch encoder, shape (2,)."""
    tolerances_deg = [
        # Elevation is zeroed on the table, whose angle is uncertain too.
        np.hypot(rig["offset_elevation"].tolerance, rig["elevation_min"].tolerance),
        rig["offset_pitch"].tolerance,
    ]
    return np.maximum(np.radians(0.5 * np.array(tolerances_deg)), 1e-6)
