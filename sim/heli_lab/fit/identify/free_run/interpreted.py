"""The kernel for computers without a C compiler: a loop in NumPy around compiled expressions."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats, Integers
from typing_extensions import override

from heli_lab.fit.estimation.trajectory_functions import AlongTrajectory, Trajectory
from heli_lab.fit.identify.free_run.functions import Functions, Inputs
from heli_lab.fit.identify.free_run.interface import Kernel


@dataclass(frozen=True)
class _States:
    """States of some windows at one instant, with their sensitivities."""

    value: Floats  # (w, states): States
    sensitivity: Floats
    """(w, states, states + f): Derivatives of the states to the window's initial state and to the free
    parameters. The last axis has length 0 if no derivatives are computed."""

    def moved(self, rate: _States, time_s: float) -> _States:
        """Return the states after `time_s` [s] at a constant `rate`; sensitivities change likewise."""
        return _States(self.value + time_s * rate.value, self.sensitivity + time_s * rate.sensitivity)


class InterpretedKernel(Kernel):
    """Simulates all windows step by step in NumPy, with one array row per window."""

    def __init__(self, functions: Functions) -> None:
        self.functions = functions
        self._programs: dict[str, AlongTrajectory] = {}

    def program(self, name: str) -> AlongTrajectory:
        """Return the function `name` of the model with dense results, compiled for many windows together."""
        if name not in self._programs:
            function: ca.Function = getattr(self.functions, name)
            arguments = [ca.SX.sym("a", function.size1_in(i)) for i in range(function.n_in())]
            results = function.call(arguments)
            dense = ca.Function(name, arguments, [ca.densify(result) for result in results])
            self._programs[name] = AlongTrajectory(dense)
        return self._programs[name]

    @override
    def predict(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        angles, _, end = self._simulate(inputs, start, parameters, derivatives=False)
        return angles, end

    @override
    def jacobian(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        return self._simulate(inputs, start, parameters, derivatives=True)[:2]

    @override
    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        angles, jacobian = self.jacobian(inputs, start, parameters)
        # Shape (n, 3, states + free + 1).
        columns = np.concatenate((jacobian, (measured_rad - angles)[:, :, None]), axis=2)
        columns /= sigma_rad[:, None]
        edges = np.append(inputs.first, inputs.rows)
        # Shape (3, steps, states + free + 1) for each window: a product of matrices for each axis.
        by_window = [columns[start:stop].transpose(1, 0, 2) for start, stop in itertools.pairwise(edges)]
        return angles, np.array([window.transpose(0, 2, 1) @ window for window in by_window])

    def _simulate(
        self, inputs: Inputs, start: Floats, parameters: Floats, derivatives: bool
    ) -> tuple[Floats, Floats, Floats]:
        """Simulate all windows step by step. Returns shape `angles_rad` (n, 3), `jacobian` (n, 3, states +
        f), `end` (w, states).
        """
        state_count = self.functions.state_count
        column_count = state_count + len(self.functions.free_index) if derivatives else 0
        angles = np.empty((inputs.rows, 3))
        jacobian = np.empty((inputs.rows, 3, column_count))
        value = np.array(start, float)
        sensitivity = np.zeros((len(inputs.steps), state_count, column_count))
        if derivatives:
            sensitivity[:, range(state_count), range(state_count)] = 1.0
        for step in range(int(inputs.steps.max())):
            # Shorter windows have ended.
            running = np.flatnonzero(inputs.steps > step)
            rows = inputs.first[running] + step
            states = _States(value[running], sensitivity[running])
            start_s = inputs.start_s[running] + step * inputs.step_s
            this_step = _Step(self, inputs, rows, start_s, parameters)
            measured = this_step.evaluate("angles", 0.0, states)
            angles[rows], jacobian[rows] = measured.value, measured.sensitivity
            states = this_step.advance(states)
            value[running], sensitivity[running] = states.value, states.sensitivity
        return angles, jacobian, value


@dataclass(frozen=True)
class _Step:
    """One step of the windows that still run."""

    kernel: InterpretedKernel
    inputs: Inputs
    rows: Integers  # (w,): Row of this step in `inputs`, for each window
    start_s: Floats  # (w,): Time at the beginning of the step since the flight's first sample
    parameters: Floats  # (p,): All parameters of the model

    def evaluate(self, name: str, share: float, states: _States) -> _States:
        """Evaluate a function of the model within the step, and its sensitivities by the chain rule."""
        inputs, functions = self.inputs, self.kernel.functions
        # Each voltage is linear within a step.
        from_middle = share - 0.5
        volts_V = inputs.mean_V[self.rows] + from_middle * inputs.change_V[self.rows]
        t_s = self.start_s + share * inputs.step_s
        at = Trajectory(t_s, states.value, volts_V, 0.0, self.parameters)
        if states.sensitivity.shape[2] == 0:
            (result,) = self.kernel.program(name)(at)
            return _States(result[:, :, 0], np.zeros((*result.shape[:2], 0)))
        result, by_state, by_free, by_voltage = self.kernel.program(f"{name}_jacobian")(at)
        sensitivity: Floats = by_state @ states.sensitivity
        sensitivity[:, :, functions.state_count :] += by_free
        for derivative in inputs.voltage_derivatives:
            if derivative.parameter in functions.voltage_parameters:
                column = functions.state_count + functions.free.index(derivative.parameter)
                voltage_rate = derivative.of_mean[self.rows] + from_middle * derivative.of_change[self.rows]
                sensitivity[:, :, column] += np.einsum("wij,wj->wi", by_voltage, voltage_rate)
        return _States(result[:, :, 0], sensitivity)

    def advance(self, states: _States) -> _States:
        """Integrate the states to the end of the step, by Runge-Kutta steps of fourth order."""
        share = 1.0 / self.inputs.substeps
        substep_s = self.inputs.step_s * share
        for substep in range(self.inputs.substeps):
            start_share, middle_share, end_share = (
                substep * share,
                (substep + 0.5) * share,
                (substep + 1) * share,
            )
            k1 = self.evaluate("rates", start_share, states)
            k2 = self.evaluate("rates", middle_share, states.moved(k1, substep_s / 2))
            k3 = self.evaluate("rates", middle_share, states.moved(k2, substep_s / 2))
            k4 = self.evaluate("rates", end_share, states.moved(k3, substep_s))
            rate_sum = _States(
                k1.value + 2 * k2.value + 2 * k3.value + k4.value,
                k1.sensitivity + 2 * k2.sensitivity + 2 * k3.sensitivity + k4.sensitivity,
            )
            states = states.moved(rate_sum, substep_s / 6)
            if self.kernel.functions.has_reset:
                states = self.evaluate("reset_map", end_share, states)
        return states
