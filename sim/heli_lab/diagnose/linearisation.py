"""The free run linearised about its prediction: first-order responses to changes of the dynamics.

A change g(t) of the state's rates moves a window's state by d/dt dx = A(t) dx + g(t), A being the model's
Jacobian along the prediction; in discrete time, dx[k+1] = Phi[k] dx[k] + Gamma[k] g[k], dy[k] = C[k] dx[k].
A candidate effect enters as the signal g by which it changes the rates, so one pass of this linear system
gives the response to any number of candidates, without a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_sim.model.parts import AXES
from scipy.linalg import expm

from heli_lab.identify import Fit
from heli_lab.identify.functions import Floats, Inputs, Integers

_BATCH: Final = 48
"""Signals that are propagated together. Any number gives the same result; a step's matrices and so many
columns fit in a processor's cache."""


@dataclass(frozen=True)
class Trajectory:
    """A predicted flight in steps, and the inputs of each.

    Parameters
    ----------
    t_s : ndarray (n,)
        Middle of each step since the flight's first sample.
    state : ndarray (n, states)
        State in the middle of each step.
    volts_V : ndarray (n, 2)
        Mean front and back voltage over the step, late where the model delays them.
    step_s : float
        Length of a step.
    parameters : ndarray (p,)
        All parameters of the model.
    """

    t_s: Floats
    state: Floats
    volts_V: Floats
    step_s: float
    parameters: Floats


class Linearisation:
    """The linear system around a fit's prediction of one flight.

    Parameters
    ----------
    index : int
        Which of its records.

    Notes
    -----
    n rows are the steps of the coarse grid (10 ms), all windows one after the other; angles and residuals are
    means over a step.
    """

    def __init__(self, fit: Fit, index: int = 0) -> None:
        problem = fit.problem
        self.fit, self.index = fit, index
        self.record = problem.records[index]
        grid = problem.block_grid(index, fit.theta)
        self.inputs: Inputs = grid.inputs
        self.steps: Integers = grid.inputs.steps
        self.first: Integers = grid.inputs.first
        self.windows: tuple[slice, ...] = tuple(grid.slices)
        self.rows = grid.inputs.rows
        parameters = problem.parameters(fit.theta, index)
        evaluation = problem.evaluation(index, fit.theta, fit.states[index], fine=True, derivatives=False)
        self.residual: Floats = evaluation.residual.reshape(self.rows, grid.every, 3).mean(axis=1)
        """Measured minus predicted, in standard deviations of the quantisation, mean of each step; (n, 3)."""

        before, after = self._states(fit.states[index], parameters)
        middle = 0.5 * (before + after)
        t_s = np.concatenate(
            [
                start + (np.arange(count) + 0.5) * self.inputs.step_s
                for start, count in zip(self.inputs.start_s, self.steps, strict=True)
            ]
        )
        self.trajectory = Trajectory(t_s, middle, self.inputs.mean_V, self.inputs.step_s, parameters)
        self._linearise()

    def _states(self, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        """States at the beginning and at the end of each step, by the kernel itself."""
        inputs, kernel = self.inputs, self.fit.problem.kernel
        before = np.empty((self.rows, start.shape[1]))
        after = np.empty_like(before)
        state = start.copy()
        for k in range(int(self.steps.max())):
            alive = np.flatnonzero(self.steps > k)
            rows = self.first[alive] + k
            one = Inputs(
                np.ones(len(alive), np.int64),
                inputs.start_s[alive] + k * inputs.step_s,
                inputs.step_s,
                inputs.mean_V[rows],
                inputs.change_V[rows],
                inputs.substeps,
            )
            before[rows] = state[alive]
            state[alive] = kernel.end(one, state[alive], parameters)
            after[rows] = state[alive]
        return before, after

    def _linearise(self) -> None:
        model, trajectory = self.fit.problem.model, self.trajectory
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
        t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
        names = [quantity.name for quantity in model.parameters]
        problem = self.fit.problem
        free = [names.index(problem.free[i].quantity) for i in problem.columns[self.index]]
        torques = [names.index(f"torque_{axis}") for axis in AXES]
        rates, angles = model.dynamics(x, u, p, t), model.measurement(x, u, p, t)
        wanted = [
            ca.jacobian(rates, x),
            ca.jacobian(rates, ca.vertcat(*(p[i] for i in free))) if free else ca.SX(x.numel(), 0),
            ca.jacobian(rates, ca.vertcat(*(p[i] for i in torques))),
            ca.jacobian(rates, u),
            ca.jacobian(angles, x),
            ca.jacobian(angles, ca.vertcat(*(p[i] for i in free))) if free else ca.SX(3, 0),
        ]
        function = ca.Function("linearisation", [x, u, t, p], ca.cse([ca.densify(w) for w in wanted]))
        a, rates_by_parameters, rates_by_torque, by_volts, c, c_by_free = MapEvaluator(function, self.rows)(
            trajectory
        )
        shaping = {name: mean for name, mean, _ in self.inputs.shaped_by}
        for column, i in enumerate(free):
            if names[i] == model.delay and names[i] in shaping:
                rates_by_parameters[:, :, column] += np.einsum("nij,nj->ni", by_volts, shaping[names[i]])
        h = trajectory.step_s
        n, nx = len(a), a.shape[1]
        block = np.zeros((n, 2 * nx, 2 * nx))
        block[:, :nx, :nx] = a * h
        block[:, :nx, nx:] = np.eye(nx) * h
        exponential = expm(block)
        self.Phi: Floats = exponential[:, :nx, :nx]
        """Transition of the state over each step, (n, states, states)."""
        self.Gamma: Floats = exponential[:, :nx, nx:]
        """Response of the state at a step's end to rates changed by 1 during it, (n, states, states)."""
        self.rates_by_parameters: Floats = rates_by_parameters
        """Derivatives of the rates by the free parameters of this record, (n, states, f)."""
        self.rates_by_torque: Floats = rates_by_torque
        """Derivatives of the rates by torques about the three axes, (n, states, 3) in 1/(N m)."""
        self.C: Floats = c
        """Derivatives of the measured angles by the state, (n, 3, states) in rad."""
        self._angles_by_free: Floats = c_by_free

    def response(self, signals: Floats, measured_rad: Floats | None = None) -> Floats:
        """Change of the predicted angles, mean over each step, in standard deviations of the quantisation,
        shape (n, 3, s), for changes of the rates and of what the encoders measure.

        Parameters
        ----------
        signals : ndarray (n, states, s)
            Change of the rates of the state in the middle of each step, one column a regressor.
        measured_rad : ndarray (n, 3, s), optional
            Direct change of the measured angles.
        """
        count = signals.shape[2]
        out = np.empty((self.rows, 3, count))
        for low in range(0, count, _BATCH):
            part = slice(low, min(count, low + _BATCH))
            driven = np.einsum("nij,njs->nis", self.Gamma, signals[:, :, part])
            state = np.zeros((len(self.steps), signals.shape[1], part.stop - part.start))
            out[:, :, part] = self._propagate(state, driven)
        if measured_rad is not None:
            out += measured_rad
        result: Floats = out / self.record.sigma_rad[:, None]
        return result

    def stack_windows(self, rows: Floats) -> Floats:
        """Stack `rows`, shape (n, 3, s), one a step, by window, shape (w, 3, longest, s), all of the longest
        one's length, zeros after a window's end.
        """
        padded = np.zeros((len(self.steps), int(self.steps.max()), *rows.shape[1:]))
        for number, window in enumerate(self.windows):
            padded[number, : window.stop - window.start] = rows[window]
        return np.ascontiguousarray(padded.transpose(0, 2, 1, 3))

    def unstack_windows(self, stacked: Floats) -> Floats:
        """Undo `stack_steps` for this flight: from `stacked`, shape (k, w, s), to shape (n, s), one row a
        step.
        """
        out = np.empty((self.rows, stacked.shape[2]))
        for number, window in enumerate(self.windows):
            out[window] = stacked[: window.stop - window.start, number]
        return out

    def initial_state_response(self) -> Floats:
        """Response to a window's initial state, (n, 3, states), in the unit of `response`."""
        nx = self.Phi.shape[1]
        state = np.broadcast_to(np.eye(nx), (len(self.steps), nx, nx)).copy()
        result: Floats = self._propagate(state, None) / self.record.sigma_rad[:, None]
        return result

    def parameter_response(self) -> Floats:
        """Response to the free parameters of this record, (n, 3, f), in the unit of `response`."""
        return self.response(self.rates_by_parameters, self._angles_by_free)

    def _propagate(self, state: Floats, driven: Floats | None) -> Floats:
        out = np.empty((self.rows, 3, state.shape[2]))
        for k in range(int(self.steps.max())):
            alive = np.flatnonzero(self.steps > k)
            rows = self.first[alive] + k
            now = state[alive]
            after = self.Phi[rows] @ now
            if driven is not None:
                after += driven[rows]
            out[rows] = self.C[rows] @ (0.5 * (now + after))
            state[alive] = after
        return out


def stack_steps(linearisations: Sequence[Linearisation], arrays: Sequence[Floats], block: int = 1) -> Floats:
    """Stack the rows of `arrays`, one of shape (n, ...) for each flight, as filters run over them, shape (k,
    w, block, ...): `block` of the window, window of any flight, step of the block; zeros after a window's
    end. A window's last incomplete block is left out.
    """
    longest = max(int(one.steps.max()) for one in linearisations) // block
    windows = sum(len(one.windows) for one in linearisations)
    out = np.zeros((longest, windows, block, *arrays[0].shape[1:]))
    place = 0
    for one, array in zip(linearisations, arrays, strict=True):
        for window in one.windows:
            count = (window.stop - window.start) // block
            rows = array[window.start : window.start + count * block]
            out[:count, place] = rows.reshape(count, block, *array.shape[1:])
            place += 1
    return out


class MapEvaluator:
    """Evaluates a `function` of state, voltages, time and all parameters in each of the `steps` of a
    trajectory; its outputs are dense.
    """

    def __init__(self, function: ca.Function, steps: int) -> None:
        self._shapes = [function.size_out(i) for i in range(function.n_out())]
        self._steps = steps
        inputs = [ca.MX.sym(name, function.size1_in(i), steps) for i, name in enumerate("xut")]
        parameters = ca.MX.sym("p", function.size1_in(3))
        calls = function.map(steps)(*inputs, ca.repmat(parameters, 1, steps))
        outputs = calls if isinstance(calls, tuple | list) else [calls]
        self._buffer, self._run = ca.Function("mapped", [*inputs, parameters], outputs).buffer()

    def __call__(self, trajectory: Trajectory) -> list[Floats]:
        """Evaluate: one array an output, shape (n, rows, columns)."""
        arrays = [
            np.ascontiguousarray(a, float)
            for a in (trajectory.state, trajectory.volts_V, trajectory.t_s, trajectory.parameters)
        ]
        for i, array in enumerate(arrays):
            # CasADi's own stubs ask for a size that set_arg and set_res do not take.
            self._buffer.set_arg(i, memoryview(array.reshape(-1)))  # type: ignore[call-arg,arg-type]
        # CasADi stores columns one after the other.
        results = [np.zeros((self._steps, columns, rows)) for rows, columns in self._shapes]
        for i, result in enumerate(results):
            self._buffer.set_res(i, memoryview(result.reshape(-1)))  # type: ignore[call-arg,arg-type]
        self._run()
        return [result.transpose(0, 2, 1) for result in results]
