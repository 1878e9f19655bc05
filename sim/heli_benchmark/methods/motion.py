"""Smoothed flights, and the accelerations of a model along them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig
from scipy.signal import fftconvolve, savgol_coeffs

GRID_s: Final = 0.1
"""Step of the regression. The disturbances are correlated over 0.3 s and more."""
_WINDOW_s: Final = 0.4
"""Length of the smoothing filter. Shorter: the counts of the encoders dominate at 100 Hz. Longer: it removes
the excitation, which ends at 4 Hz. By judgement, not tuned."""


class SmoothedFlight:
    """Angles, rates and accelerations of a flight, smoothed by a Savitzky-Golay filter. `t_s, signals` has
    shape (n,). `acceleration, features` has shape (k, 3).
    """

    def __init__(self, flight: Flight, weak_form: bool = False) -> None:
        # The filter loses half a window at each end. The regression loses a further one, because
        # `filtered` passes signals through the filter a second time.
        step_s = float(flight.t_s[-1] - flight.t_s[0]) / (len(flight) - 1)
        half = round(_WINDOW_s / 2.0 / step_s)
        self._kernels = _weak_kernels(half, step_s) if weak_form else _smoothing_kernels(half, step_s)
        self.angles_rad = _convolve(flight.angles_rad, _smoothing_kernels(half, step_s)[0])
        self.rates_rad_s = _convolve(flight.angles_rad, _smoothing_kernels(half, step_s)[1])
        self.volts_V = flight.voltages_V[half : len(flight) - half]
        self.t_s = flight.t_s[half : len(flight) - half] - flight.t_s[0]
        self._grid_rows = slice(half, len(self.t_s) - half, max(1, round(GRID_s / step_s)))
        self._half_window = half
        self.volt_rates_V_s = np.gradient(self.volts_V, step_s, axis=0)
        self.acceleration = _convolve(flight.angles_rad, self._kernels[2])[self._grid_rows]
        self.signals = np.hstack([self.angles_rad, self.rates_rad_s, self.volts_V])
        self.features = self.signals[self._grid_rows]

    def filtered(self, values: Floats) -> Floats:
        """Pass values along the flight through the filter of the accelerations. Shapes: `values` (n, ...);
        returns (k, ...).
        """
        flat = values.reshape(len(values), -1)
        padded = np.pad(_convolve(flat, self._kernels[0]), ((self._half_window, self._half_window), (0, 0)))
        return padded[self._grid_rows].reshape(-1, *values.shape[1:])


class AccelerationModel:
    """Accelerations of a model along a flight, and their derivatives by parameters."""

    def __init__(self, model: Model, rig: Rig) -> None:
        self.names = model.parameter_names
        self._values = np.array(model.parameter_values(rig))
        self._states = len(model.states)
        x, u = ca.SX.sym("x", self._states), ca.SX.sym("u", 2)
        self._p, t = ca.SX.sym("p", len(self.names)), ca.SX.sym("t")
        self._accelerations = model.dynamics(x, u, self._p, t)[3:6]
        self._arguments, self._u = [x, u, self._p, t], u
        self._functions: dict[tuple[str, ...], ca.Function] = {}

    def acceleration(self, flight: SmoothedFlight) -> Floats:
        """Return the accelerations of the three axes along a `flight`, rad/s2, shape (n, 3)."""
        return self._evaluate_along(flight, ("acceleration",), self._accelerations)[:, :, 0]

    def jacobian(
        self, flight: SmoothedFlight, names: Sequence[str], changed_values: Mapping[str, float] | None = None
    ) -> Floats:
        """Return the derivatives of the accelerations by some parameters. Returns shape (n, 3, names)."""
        parameters = ca.vertcat(*(self._p[self.names.index(name)] for name in names))
        derivatives = ca.jacobian(self._accelerations, parameters)
        return self._evaluate_along(flight, tuple(names), derivatives, changed_values)

    def by_torques(self, flight: SmoothedFlight) -> Floats:
        """Return the derivatives along a `flight` by torques about the three axes, shape (n, 3, 3)."""
        return self.jacobian(flight, [f"torque_{axis}" for axis in AXES])

    def by_volts(self, flight: SmoothedFlight) -> Floats:
        """Return the derivatives along a `flight` by the two voltages, shape (n, 3, 2)."""
        return self._evaluate_along(flight, ("volts",), ca.jacobian(self._accelerations, self._u))

    def _evaluate_along(
        self,
        flight: SmoothedFlight,
        key: tuple[str, ...],
        expression: ca.SX,
        changed_values: Mapping[str, float] | None = None,
    ) -> Floats:
        """Evaluate an `expression` of shape (3, m) along a flight, shape (n, 3, m).

        Its compiled function is kept under `key`.
        """
        if key not in self._functions:
            self._functions[key] = ca.Function("f", self._arguments, [ca.densify(expression)])
        n, values = len(flight.t_s), self._values.copy()
        for name, value in (changed_values or {}).items():
            values[self.names.index(name)] = value
        states = np.zeros((self._states, n))
        states[:3], states[3:6] = flight.angles_rad.T, flight.rates_rad_s.T
        # CasADi evaluates all n columns in one call, and puts the n results of shape (3, m) side by side.
        result = self._functions[key](states, flight.volts_V.T, values, flight.t_s[None])
        return np.asarray(result).reshape(3, n, -1).transpose(1, 0, 2)


def _smoothing_kernels(half_window: int, step_s: float) -> tuple[Floats, Floats, Floats]:
    """Return the filters that give a smoothed signal and its first and second derivative.

    They fit a polynomial of degree 3 to the 2 `half_window` + 1 samples around each sample.
    """
    window = 2 * half_window + 1
    smooth, first, second = (savgol_coeffs(window, 3, deriv=order, delta=step_s) for order in range(3))
    return smooth, first, second


def _weak_kernels(half_window: int, step_s: float) -> tuple[Floats, Floats, Floats]:
    """Return the test function (1 - x^2)^4, zeros, and the second derivative of the test function.

    In the weak form, a signal is averaged with the test function as its weight. Integrating by parts twice
    moves the second derivative from the angles, which are noisy, to the test function.
    """
    x = np.arange(-half_window, half_window + 1) / (half_window + 1.0)
    x_per_s = 1.0 / ((half_window + 1.0) * step_s)
    test = (1.0 - x**2) ** 4
    second = 8.0 * (1.0 - x**2) ** 2 * (7.0 * x**2 - 1.0)
    total = test.sum()
    return test / total, np.zeros_like(test), second * x_per_s**2 / total


def _convolve(values: Floats, kernel: Floats) -> Floats:
    """Pass each column of `values`, shape (n, columns), through a filter; the incomplete ends are lost."""
    return np.asarray(fftconvolve(values, kernel[:, None], mode="valid", axes=0))
