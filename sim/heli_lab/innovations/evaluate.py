"""Functions of state, voltages, time and parameters, evaluated along a course."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from heli_lab.identify.functions import Floats


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
