"""How the windows' predictions answer small changes of the dynamics, to first order and for any signal.

A change g(t) of the state's rates moves a window's state by d/dt dx = A(t) dx + g(t), A being the model's
Jacobian along the prediction. One pass of this linear system tells what any number of candidates would do to
the predicted angles: a candidate is nothing but the signal by which it changes the rates. So screening costs
no fit and no compiler, however many moments, frequencies and angles are tried.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_sim.model.parts import AXES
from scipy.linalg import expm

from heli_lab.identify import Fit
from heli_lab.identify.functions import Floats, Inputs, Integers

_BATCH: Final = 48
"""Signals that are carried along together: as many as the processor's cache holds."""


@dataclass(frozen=True)
class Path:
    """A predicted flight in steps, and what acts in each.

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
    fit : Fit
        The fit.
    index : int
        Which of its records.

    Notes
    -----
    Rows are the steps of the coarse grid; angles and residuals are means over a step.
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
        self.flight_rows: Integers = grid.rows
        parameters = problem.parameters(fit.theta, index)
        evaluation = problem.evaluation(index, fit.theta, fit.states[index], fine=True, derivatives=False)
        self.residual: Floats = evaluation.residual.reshape(self.rows, grid.every, 3).mean(axis=1)
        """Measured minus predicted, in standard deviations of the rounding, mean of each step; (n, 3)."""

        before, after = self._states(fit.states[index], parameters)
        middle = 0.5 * (before + after)
        t_s = np.concatenate(
            [
                start + (np.arange(count) + 0.5) * self.inputs.step_s
                for start, count in zip(self.inputs.start_s, self.steps, strict=True)
            ]
        )
        self.path = Path(t_s, middle, self.inputs.mean_V, self.inputs.step_s, parameters)
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
        model, path = self.fit.problem.model, self.path
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
        function = ca.Function("tangent", [x, u, t, p], ca.cse([ca.densify(w) for w in wanted]))
        a, by_free, by_torque, by_volts, c, c_by_free = MapEvaluator(function, self.rows)(path)
        shaping = {name: mean for name, mean, _ in self.inputs.shaped_by}
        for column, i in enumerate(free):
            if names[i] == model.delay and names[i] in shaping:
                by_free[:, :, column] += np.einsum("nij,nj->ni", by_volts, shaping[names[i]])
        h = path.step_s
        n, nx = len(a), a.shape[1]
        block = np.zeros((n, 2 * nx, 2 * nx))
        block[:, :nx, :nx] = a * h
        block[:, :nx, nx:] = np.eye(nx) * h
        exponential = expm(block)
        self.over: Floats = exponential[:, :nx, :nx]
        self.push: Floats = exponential[:, :nx, nx:]
        self.by_free: Floats = by_free
        """Derivatives of the rates to the free parameters of this record, (n, states, f)."""
        self.by_torque: Floats = by_torque
        """Derivatives of the rates to torques about the three axes, (n, states, 3) in 1/(N m)."""
        self.see: Floats = c
        self._angles_by_free: Floats = c_by_free

    def answer(self, signals: Floats, seen_rad: Floats | None = None) -> Floats:
        """Carry changes of the rates, and of what is measured, to the predicted angles.

        Parameters
        ----------
        signals : ndarray (n, states, s)
            Change of the rates of the state in the middle of each step, one column a candidate.
        seen_rad : ndarray (n, 3, s), optional
            Change of the measured angles.

        Returns
        -------
        ndarray (n, 3, s)
            Change of the predicted angles, mean over each step, in standard deviations of the rounding.
        """
        count = signals.shape[2]
        out = np.empty((self.rows, 3, count))
        for low in range(0, count, _BATCH):
            part = slice(low, min(count, low + _BATCH))
            pushed = np.einsum("nij,njs->nis", self.push, signals[:, :, part])
            state = np.zeros((len(self.steps), signals.shape[1], part.stop - part.start))
            out[:, :, part] = self._carry(state, pushed)
        if seen_rad is not None:
            out += seen_rad
        result: Floats = out / self.record.sigma_rad[:, None]
        return result

    def by_window(self, rows: Floats) -> Floats:
        """Sort rows into windows of equal length, shorter ones filled up with zeros.

        Parameters
        ----------
        rows : ndarray (n, 3, s)
            One entry a step.

        Returns
        -------
        ndarray (w, 3, longest, s)
            Axis before time.
        """
        padded = np.zeros((len(self.steps), int(self.steps.max()), *rows.shape[1:]))
        for number, window in enumerate(self.windows):
            padded[number, : window.stop - window.start] = rows[window]
        return np.ascontiguousarray(padded.transpose(0, 2, 1, 3))

    def initial(self) -> Floats:
        """How the angles follow the windows' initial states, shape (n, 3, states), in units of rounding."""
        nx = self.over.shape[1]
        state = np.broadcast_to(np.eye(nx), (len(self.steps), nx, nx)).copy()
        result: Floats = self._carry(state, None) / self.record.sigma_rad[:, None]
        return result

    def free(self) -> Floats:
        """How the angles follow the free parameters of this record, shape (n, 3, f), in units of rounding."""
        return self.answer(self.by_free, self._angles_by_free)

    def _carry(self, state: Floats, pushed: Floats | None) -> Floats:
        out = np.empty((self.rows, 3, state.shape[2]))
        for k in range(int(self.steps.max())):
            alive = np.flatnonzero(self.steps > k)
            rows = self.first[alive] + k
            now = state[alive]
            after = self.over[rows] @ now
            if pushed is not None:
                after += pushed[rows]
            out[rows] = self.see[rows] @ (0.5 * (now + after))
            state[alive] = after
        return out


class MapEvaluator:
    """Evaluates a function of (x, u, t, p) in every step of a path.

    Parameters
    ----------
    function : casadi.Function
        Its inputs are state, voltages, time and all parameters; its outputs are dense.
    steps : int
        Number of steps.
    """

    def __init__(self, function: ca.Function, steps: int) -> None:
        self._shapes = [function.size_out(i) for i in range(function.n_out())]
        self._steps = steps
        inputs = [ca.MX.sym(name, function.size1_in(i), steps) for i, name in enumerate("xut")]
        parameters = ca.MX.sym("p", function.size1_in(3))
        calls = function.map(steps)(*inputs, ca.repmat(parameters, 1, steps))
        outputs = calls if isinstance(calls, tuple | list) else [calls]
        self._buffer, self._run = ca.Function("along", [*inputs, parameters], outputs).buffer()

    def __call__(self, path: Path) -> list[Floats]:
        """Evaluate.

        Parameters
        ----------
        path : Path
            Where.

        Returns
        -------
        list of ndarray
            One array an output, shape (n, rows, columns).
        """
        arrays = [
            np.ascontiguousarray(a, float) for a in (path.state, path.volts_V, path.t_s, path.parameters)
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
