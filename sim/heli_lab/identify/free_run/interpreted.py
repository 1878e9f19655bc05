"""The kernel without a C compiler: NumPy around the laboratory's expression programs."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import casadi as ca
import numpy as np
from heli_host.arrays import Floats, Integers
from typing_extensions import override

from heli_lab.estimation.trajectory_functions import AlongTrajectory, Trajectory
from heli_lab.identify.free_run.functions import Functions, Inputs
from heli_lab.identify.free_run.interface import Kernel


class InterpretedKernel(Kernel):
    """Windows run in NumPy, all of them in parallel; rates and Jacobians by `estimation`'s programs."""

    def __init__(self, functions: Functions) -> None:
        self._functions = functions
        self._programs: dict[str, AlongTrajectory] = {}

    def _program(self, name: str) -> AlongTrajectory:
        """The program of one of the model's functions, with dense results."""
        if name not in self._programs:
            function: ca.Function = getattr(self._functions, name)
            arguments = [ca.SX.sym("a", function.size1_in(i)) for i in range(function.n_in())]
            results = function.call(arguments)
            dense = ca.Function(name, arguments, [ca.densify(result) for result in results])
            self._programs[name] = AlongTrajectory(dense)
        return self._programs[name]

    @override
    def run(
        self, inputs: Inputs, start: Floats, parameters: Floats, derivatives: bool = True
    ) -> tuple[Floats, Floats | None]:
        angles, jacobian, _ = self._loop(inputs, start, parameters, derivatives)
        return angles, jacobian

    @override
    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        angles, jacobian, _ = self._loop(inputs, start, parameters, True)
        assert jacobian is not None
        columns = np.concatenate((jacobian, (measured_rad - angles)[:, :, None]), axis=2)
        columns /= sigma_rad[:, None]
        edges = np.append(inputs.first, inputs.rows)
        parts = [columns[low:high].transpose(1, 0, 2) for low, high in itertools.pairwise(edges)]
        return angles, np.array([part.transpose(0, 2, 1) @ part for part in parts])

    @override
    def end(self, inputs: Inputs, start: Floats, parameters: Floats) -> Floats:
        return self._loop(inputs, start, parameters, False)[2]

    def _loop(
        self, inputs: Inputs, start: Floats, parameters: Floats, derivatives: bool
    ) -> tuple[Floats, Floats | None, Floats]:
        nx = self._functions.state_count
        nz = nx + len(self._functions.free_index)
        windows = len(inputs.steps)
        angles = np.empty((inputs.rows, 3))
        jacobian = np.empty((inputs.rows, 3, nz)) if derivatives else None
        x = np.array(start, float)
        s = np.zeros((windows, nx, nz if derivatives else 0))
        if derivatives:
            s[:, range(nx), range(nx)] = 1.0
        share = 1.0 / inputs.substeps
        h = inputs.step_s * share
        for k in range(int(inputs.steps.max())):
            here = np.flatnonzero(inputs.steps > k)
            rows = inputs.first[here] + k
            time_s = inputs.start_s[here] + k * inputs.step_s

            def evaluate(
                which: str, c: float, y: Floats, ys: Floats, rows: Integers = rows, time_s: Floats = time_s
            ) -> tuple[Floats, Floats]:
                u = inputs.mean_V[rows] + (c - 0.5) * inputs.change_V[rows]
                du = {
                    name: mean_by[rows] + (c - 0.5) * change_by[rows]
                    for name, mean_by, change_by in inputs.shaped_by
                }
                return self._evaluate(
                    which, Trajectory(time_s + c * inputs.step_s, y, u, 0.0, parameters), ys, du
                )

            angles[rows], evaluation = evaluate("angles", 0.0, x[here], s[here])
            if jacobian is not None:
                jacobian[rows] = evaluation
            for m in range(inputs.substeps):
                y, ys = x[here], s[here]
                k1, s1 = evaluate("rates", m * share, y, ys)
                k2, s2 = evaluate("rates", (m + 0.5) * share, y + h / 2 * k1, ys + h / 2 * s1)
                k3, s3 = evaluate("rates", (m + 0.5) * share, y + h / 2 * k2, ys + h / 2 * s2)
                k4, s4 = evaluate("rates", (m + 1) * share, y + h * k3, ys + h * s3)
                x[here] += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                s[here] += h / 6 * (s1 + 2 * s2 + 2 * s3 + s4)
                if self._functions.has_reset:
                    x[here], s[here] = evaluate("reset_map", (m + 1) * share, x[here], s[here])
        return angles, jacobian, x

    def _evaluate(
        self,
        which: str,
        at: Trajectory,
        s: Floats,
        du: Mapping[str, Floats],
    ) -> tuple[Floats, Floats]:
        """Value (w, rows) and its derivatives through the chain (w, rows, columns)."""
        if s.shape[2] == 0:
            (value,) = self._program(which)(at)
            return value[:, :, 0], np.zeros((*value.shape[:2], 0))
        nx = at.state.shape[1]
        value, fx, fp, fu = self._program(f"{which}_jacobian")(at)
        chained: Floats = fx @ s
        chained[:, :, nx:] += fp
        for name in self._functions.shaping:
            if name in du:
                column = nx + self._functions.free.index(name)
                chained[:, :, column] += np.einsum("wij,wj->wi", fu, du[name])
        return value[:, :, 0], chained
