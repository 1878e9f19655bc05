"""Residuals of a rig's equations of motion along a flight, in the weak form, with scaled encoders.

The equation is in `estimate.py`.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_host.flight.flown import flown_rows
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.encoder_scale.weak_form import TestFunctions, gap_free_parts
from heli_lab.estimation import ModelFunctions, Trajectory
from heli_lab.identify.flight_model import TORQUE_STD_Nm, model_functions
from heli_lab.identify.free import FLIGHT_CONSTANTS, free_parameters

CLEAR_deg: Final = 8.0
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


@cache
def _functions_of(kind: type[Model], free: tuple[str, ...]) -> ModelFunctions:
    """Compile the functions of a model without effects, and keep them for the next flight."""
    return model_functions(kind(), free)


class FlightInWeakForm:
    """Residuals of a rig's equations of motion along a flight, in weak form.

    The unknowns are, in this order: the logarithms of three scales, the lag of the thrust, the zeros of the
    elevation and the pitch encoder, rig parameters, and a constant torque about each axis.

    Parameters
    ----------
    flight : Flight
        Any flight of a board, gaps allowed.
    rig : Rig
        Values and tolerances of the rig parameters.
    model : Model
        Equations of motion. Effects that have states, and random effects, are left out.

    Attributes
    ----------
    seconds : float
        Duration of the free flight that is used [s].
    mean, std : ndarray
        Prior means and standard deviations of the unknowns.
    """

    def __init__(self, flight: Flight, rig: Rig, model: Model) -> None:
        static_effects = tuple(
            effect for effect in model.effects if not effect.states and not effect.noise_inputs
        )
        static = type(model)(static_effects)
        self._parameters = static.parameter_values(rig)
        parameters = free_parameters(static, rig, None, {})
        free = [parameter for parameter in parameters if parameter.quantity not in FLIGHT_CONSTANTS]
        torques = {name: np.hypot(0.5 * rig[name].tolerance, std) for name, std in TORQUE_STD_Nm.items()}
        estimated = (*(parameter.quantity for parameter in free), *torques)
        self._places = [static.parameter_names.index(name) for name in estimated]
        self._functions = (
            _functions_of(type(static), estimated) if static.is_plain else model_functions(static, estimated)
        )
        rest_deg = flight.parameters.get("elevation_rest_deg", rig["elevation_min"].value)
        self._pivot: Floats = np.array([np.radians(rest_deg), 0.0, 0.0])
        tolerances_deg = [
            np.hypot(rig["offset_elevation"].tolerance, rig["elevation_min"].tolerance),
            rig["offset_pitch"].tolerance,
        ]
        zeros_rad = np.radians(0.5 * np.array(tolerances_deg))
        parameter_means = self._parameters[self._places]
        self.mean: Floats = np.concatenate(([0.0] * 3, [_LAG_s, 0.0, 0.0], parameter_means))
        parameter_stds = [parameter.prior.std for parameter in free] + list(torques.values())
        self.std: Floats = np.concatenate(
            ([_SCALE_LOG_STD] * 3, [_LAG_STD_s], np.maximum(zeros_rad, 1e-6), parameter_stds)
        )
        rows = flown_rows(flight) & (flight.elevation_rad > self._pivot[0] + np.radians(CLEAR_deg))
        # It is the thrust that lags, and below the dead zone there is none: lower voltages must not delay it.
        dead_zone_V = static.dead_zone_V(self._parameters)
        parts = gap_free_parts(flight, rows, -np.inf if dead_zone_V is None else dead_zone_V)
        self.seconds = sum(part.seconds for part in parts)
        self._parts = parts
        self._tests = [TestFunctions(part) for part in parts]
        self._measured = [
            test.second_derivative(part.angles_rad) for test, part in zip(self._tests, parts, strict=True)
        ]

    def measured_accelerations(self, axis: int) -> Floats:
        """Mean measured accelerations of an `axis`, 0 to 2, one per test function [rad/s^2]."""
        return np.concatenate([of_part[axis] for of_part in self._measured])

    def residuals(self, unknowns: Floats) -> tuple[list[Floats], list[Floats]]:
        """Compute measured minus predicted mean accelerations, and their derivatives.

        Returns
        -------
        residuals : list of ndarray (k,)
            For each axis, one residual per test function [rad/s^2].
        jacobians : list of ndarray (k, unknowns)
            For each axis, derivatives of its residuals by the unknowns.
        """
        scales, lag_s, zeros = np.exp(unknowns[:3]), unknowns[3], np.array([*unknowns[4:6], 0.0])
        parameters = self._parameters.copy()
        parameters[self._places] = unknowns[6:]
        residuals: list[list[Floats]] = [[], [], []]
        jacobians: list[list[Floats]] = [[], [], []]
        for part, test, measured in zip(self._parts, self._tests, self._measured, strict=True):
            # True angles, relative to those at which the encoders were zeroed, and true rates.
            deflection = (part.angles_rad - self._pivot - zeros) / scales
            rates = part.rates_rad_s / scales
            volts = part.lagged_V(lag_s)
            volts_by_lag = (part.lagged_V(lag_s + _LAG_STEP_s) - volts) / _LAG_STEP_s
            state = np.hstack((self._pivot + deflection, rates))
            trajectory = Trajectory(part.t_s, state, volts, part.step_s, parameters)
            # Shapes (n, states, 1 + parameters), (n, states, states) and (n, states, 2).
            value, by_state, _, by_volts, *_ = self._functions.along(trajectory)
            for axis in range(3):
                # The states are three angles and three rates; the derivative of a rate is an acceleration.
                row = 3 + axis
                predicted = test.mean(axis, value[:, row, 0])
                residuals[axis].append(measured[axis] - scales[axis] * predicted)
                by_angles, by_rates = by_state[:, row, :3], by_state[:, row, 3:6]
                by_scales = -by_angles * deflection - by_rates * rates
                by_lag = np.sum(by_volts[:, row] * volts_by_lag, axis=1, keepdims=True)
                by_zeros = -by_angles[:, :2] / scales[:2]
                # The functions give negative derivatives by the parameters.
                by_parameters = -value[:, row, 1:]
                of_acceleration = np.hstack((by_scales, by_lag, by_zeros, by_parameters))
                jacobian = -scales[axis] * test.mean(axis, of_acceleration)
                jacobian[:, axis] -= scales[axis] * predicted
                jacobians[axis].append(jacobian)
        return (
            [np.concatenate(of_parts) for of_parts in residuals],
            [np.concatenate(of_parts) for of_parts in jacobians],
        )
