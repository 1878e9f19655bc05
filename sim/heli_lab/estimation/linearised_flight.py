"""A model linearised along the reference trajectory of a flight.

Let x_k be the state that a filter predicts for the beginning of step k and y_k the one after its measurement,
u_k the mean inputs of the step. With f and its Jacobian A in the middle, (y_k + x_k+1) / 2, the implicit
midpoint rule gives for the deviation e_k of the true state from x_k

    e_k+1 = Phi_k (e_k + x_k - y_k) + Gamma_k (f - (x_k+1 - y_k) / h + w),

Phi = (I - h A / 2)^-1 (I + h A / 2), Gamma = (I - h A / 2)^-1 h, w the disturbances. The change of f by a
parameter enters in the same way as w.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats, Integers

from heli_lab.estimation import _kalman
from heli_lab.estimation.grey_box import GreyBoxModel
from heli_lab.estimation.reference_trajectory import ReferenceTrajectory
from heli_lab.estimation.trajectory_functions import (
    EFFECT_SUBSTEPS,
    AlongTrajectory,
    EffectStates,
    Trajectory,
)
from heli_lab.threads import default_thread_count, parallel_map

BLOCK_s: Final = 0.04
"""Time from one measurement of the filter to the next. Encoders at rest repeat a count for tens of
milliseconds. Every 10 ms their errors are correlated (0.15 to 0.43 from one to the next on simulated flights,
2026-11) and pass for a fast disturbance. Every 40 ms they are white to 0.05. Longer: lags and delays blur."""
_CHUNK_STEPS: Final = 4096
"""Steps that are linearised together: derivatives by all parameters take 2 kB each. The result does not
depend on it, memory does."""

_HELD: Final = 1e-6
"""Share of the largest response to a disturbance below which a position is held. Moments of inertia differ by
a factor of 100 at most; rounding leaves 1e-15."""


class ModelFunctions:
    """Rates and outputs of a `model` with their derivatives, by state, `free` parameters and disturbances.

    Attributes
    ----------
    names : tuple of str
        All parameters of the model.
    places : list of int
        Indices of the free parameters among them.
    along : AlongTrajectory
        Function of n points of a trajectory. It returns the rates and their negative derivatives by the free
        parameters, (n, states, 1 + f), and the derivatives of the rates by state, disturbances and inputs. It
        also returns the outputs and their derivatives by the free parameters, (n, m, 1 + f), and by state.
    extra_states : int
        Number of states beyond positions and rates.
    """

    def __init__(self, model: GreyBoxModel, free: Sequence[str]) -> None:
        self.model, self.free, self.names = model, tuple(free), model.parameters
        self.places = [model.parameters.index(name) for name in free]
        disturbed = [model.parameters.index(name) for name in model.disturbed]
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", len(model.inputs))
        p, t = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("t")
        rates, outputs = model.dynamics(x, u, p, t), model.measurement(x, u, p, t)

        def by_free(value: ca.SX) -> ca.SX:
            if not self.places:
                return ca.SX(value.numel(), 0)
            return ca.jacobian(value, ca.vertcat(*(p[i] for i in self.places)))

        # With the opposite sign the filter gives what a parameter subtracts from the innovations.
        wanted = [
            ca.horzcat(rates, -by_free(rates)),
            ca.jacobian(rates, x),
            ca.jacobian(rates, ca.vertcat(*(p[i] for i in disturbed))),
            ca.jacobian(rates, u),
            ca.horzcat(outputs, by_free(outputs)),
            ca.jacobian(outputs, x),
        ]
        self.along = AlongTrajectory(ca.Function("along", [x, u, t, p], [ca.densify(w) for w in wanted]))
        self.extra_states = model.extra_states
        if self.extra_states:
            z, y = ca.SX.sym("z", self.extra_states), ca.SX.sym("y", model.followed)
            both, arguments = ca.vertcat(y, z), [z, t, y, u, p]
            extra = slice(model.followed, None)
            self._integrator = EffectStates(
                ca.Function("rates", arguments, [ca.densify(model.dynamics(both, u, p, t)[extra])]),
                ca.Function("resets", arguments, [ca.densify(model.reset_map(both, u, p, t)[extra])]),
            )

    def __reduce__(self) -> tuple[type[ModelFunctions], tuple[GreyBoxModel, tuple[str, ...]]]:
        # Compiled programs do not pickle; they are made again.
        return ModelFunctions, (self.model, self.free)

    def integrate(self, trajectory: Trajectory, directions: Floats) -> Floats:
        """Integrate the extra states along a trajectory of positions and rates, from zero.

        Parameters
        ----------
        trajectory : Trajectory
            Middle of each step.
        directions : ndarray (n, m)
            Direction in which each output moved last, at the beginning of each step.

        Returns
        -------
        ndarray (n + 1, extra states)
            At the beginning of each step, and at the end of the last.
        """
        ends = self._integrator.integrate(
            [trajectory.state[:, : self.model.followed], trajectory.inputs],
            trajectory.t_s,
            trajectory.parameters,
            trajectory.step_s,
            EFFECT_SUBSTEPS,
        )
        every: Floats = np.vstack((np.zeros(self.extra_states), ends))
        for place, output in self.model.known_directions:
            every[:, place] = np.append(directions[:, output], directions[-1, output])
        return every


@dataclass(frozen=True)
class Derivatives:
    """A model linearised in some steps of a reference trajectory.

    Parameters
    ----------
    Phi, Gamma : ndarray (n, states, states)
        Transition of the deviation over a step, and its response to rates changed during it.
    rates : ndarray (n, states, 1 + f)
        First the model's error: its rates minus those of the trajectory. Then by how much a unit of each free
        parameter reduces it.
    by_disturbance : ndarray (n, states, m + g)
        Derivatives of the rates by the disturbances.
    C : ndarray (n, m, states)
        Derivatives of the outputs by the state.
    outputs : ndarray (n, m, 1 + f)
        First the measured outputs minus the model's at the trajectory, then by how much a unit of each free
        parameter reduces that.
    variance : ndarray (n, m)
        Variance of a measurement, of which there is one per block: by quantisation, and by the unknown place
        of an output within a play.
    """

    Phi: Floats
    Gamma: Floats
    rates: Floats
    by_disturbance: Floats
    C: Floats
    outputs: Floats
    variance: Floats


@dataclass(frozen=True)
class Blocks:
    """A window as the input of the filter: b blocks of steps, with one measurement per block.

    Parameters
    ----------
    rows : ndarray (b,)
        First step of each block.
    transition : ndarray (b, states, states)
        Transition matrix of the deviation over a block.
    part_input : ndarray (steps of a block, b, states, m + g)
        Change of the deviation at the end of a block by a disturbance of 1 during one of its steps.
    measurement : ndarray (b, m, states)
        Derivatives of the outputs by the state.
    variance : ndarray (b, m)
        Variance of each measurement, as in `Derivatives`.
    drive : ndarray (b, states, 1 + f)
        Change of the deviation over a block. Column 0: the change by the model's error. Further columns: by
        how much a unit of each free parameter reduces it.
    measured : ndarray (b, m, 1 + f)
        Errors of the measured outputs, in the same columns as `drive`.
    """

    rows: Integers
    transition: Floats
    part_input: Floats
    measurement: Floats
    variance: Floats
    drive: Floats
    measured: Floats


@dataclass(frozen=True)
class Steps:
    """A flight in steps of its reference trajectory.

    Parameters
    ----------
    Phi, Gamma, by_disturbance, C : ndarray
        As in `Derivatives`.
    drive : ndarray (n, states, 1)
        Change of the deviation in each step by the model's error.
    output_error : ndarray (n, m, 1)
        Measured outputs minus the model's at the trajectory.
    """

    Phi: Floats
    Gamma: Floats
    by_disturbance: Floats
    C: Floats
    drive: Floats
    output_error: Floats


class LinearisedFlight:
    """A model with all its `parameters`, shape (p,), linearised along a `reference`.

    Attributes
    ----------
    rows : int
        Steps of all windows, one window after the other.
    trajectory : Trajectory
        Middle of each step.
    nodes : Trajectory
        Beginning of each step, with the predicted state.
    windows : list of slice
        Steps of each window.
    states : int
        States of the model.
    block : int
        Steps from one measurement of the filter to the next.
    variance : ndarray (n, m)
        Variance of the quantisation errors.
    repeats : ndarray (n, m)
        Number of measurements, 1 at least, for which the count of each output stays the same.
    """

    def __init__(self, reference: ReferenceTrajectory, functions: ModelFunctions, parameters: Floats) -> None:
        self.reference, self.functions, self.model = reference, functions, functions.model
        self.block = max(1, round(BLOCK_s / reference.step_s))
        lengths = [window.stop - window.start for window in reference.windows]
        edges = np.concatenate(([0], np.cumsum(lengths))).astype(int)
        self.windows = [slice(int(low), int(high)) for low, high in itertools.pairwise(edges)]
        self._place(parameters)
        self.states = len(self.model.states)

    def _place(self, parameters: Floats) -> None:
        """Lay out the points of the trajectory about which the model is linearised."""
        reference, functions, h = self.reference, self.functions, self.reference.step_s
        count = len(reference.predicted)
        acting = self.model.acting_inputs(
            reference.record, reference.every, count, parameters, functions.free
        )
        inputs = acting.mean
        t_s = np.asarray((np.arange(count) + 0.5) * h, float)
        after = np.vstack((reference.predicted[1:], reference.predicted[-1:]))
        middle = 0.5 * (reference.filtered + after)
        nodes = reference.predicted
        if functions.extra_states:
            extra = functions.integrate(Trajectory(t_s, middle, inputs, h, parameters), reference.directions)
            middle = np.hstack((middle, 0.5 * (extra[:-1] + extra[1:])))
            nodes = np.hstack((nodes, extra[:-1]))
        rows = reference.rows
        self.rows = len(rows)
        self.trajectory = Trajectory(t_s[rows], middle[rows], inputs[rows], h, parameters)
        self.nodes = Trajectory(t_s[rows] - 0.5 * h, nodes[rows], inputs[rows], h, parameters)
        self._change: Floats = ((after - reference.filtered) / h)[rows]
        self._correction: Floats = (reference.predicted - reference.filtered)[rows]
        self._measured: Floats = reference.measured[rows]
        self.variance: Floats = reference.variance[rows]
        self._direction_variance: Floats = reference.direction_variance[rows]
        self.repeats: Floats = np.maximum(reference.pause_s[rows] / (self.block * h), 1.0)
        self._input_derivatives = [
            (functions.free.index(name), derivative[rows])
            for name, derivative in acting.input_derivatives
            if name in functions.free
        ]

    def derivatives(self, rows: slice) -> Derivatives:
        """Linearise in the steps `rows`."""
        here, h, followed = self.trajectory.part(rows), self.reference.step_s, self.model.followed
        rates, a, by_disturbance, by_inputs, outputs, c = self.functions.along(here)
        for number, derivative in self._input_derivatives:
            rates[:, :, 1 + number] -= np.einsum("nij,nj->ni", by_inputs, derivative[rows])
        rates[:, :followed, 0] -= self._change[rows]
        variance = self.variance[rows]
        # A known direction is not corrected by the filter; its error is one of the measurement.
        for place, output in self.model.known_directions:
            noise = self._direction_variance[rows, output] * self.repeats[rows, output]
            variance = variance + c[:, :, followed + place] ** 2 * noise[:, None]
            c[:, :, followed + place] = 0.0
        # Extra states are integrated more finely than by the midpoint rule: they have no error in a step.
        rates[:, followed:, 0] = 0.0
        # Outputs are measured at the beginning of a step, the model's are evaluated in its middle.
        ahead = self.nodes.state[rows] - here.state
        at_node = outputs[:, :, 0] + np.einsum("nij,nj->ni", c, ahead)
        outputs[:, :, 0] = self._measured[rows] - at_node
        return Derivatives(*_kalman.midpoint(a, h), rates, by_disturbance, c, outputs, variance)

    @cached_property
    def blocks(self) -> list[Blocks]:
        """The windows as the filter takes them, kept until `release`."""
        size, states, n = 1 + len(self.functions.free), self.states, self.block
        m = len(self.model.outputs)
        together = max(1, min(_CHUNK_STEPS, -(-self.rows // default_thread_count())) // n) * n
        result: list[Blocks] = []
        parts: list[tuple[Blocks, slice, slice]] = []
        for window in self.windows:
            firsts = np.arange(window.start, window.stop - n + 1, n)
            count = len(firsts)
            blocks = Blocks(
                firsts,
                np.empty((count, states, states)),
                np.empty((n, count, states, len(self.model.disturbed))),
                np.empty((count, m, states)),
                np.empty((count, m)),
                np.empty((count, states, size)),
                np.empty((count, m, size)),
            )
            result.append(blocks)
            for low in range(0, count * n, together):
                high = min(low + together, count * n)
                rows = slice(window.start + low, window.start + high)
                parts.append((blocks, slice(low // n, high // n), rows))
        parallel_map(lambda part: self._fill(*part), parts)
        return result

    def _fill(self, blocks: Blocks, into: slice, rows: slice) -> None:
        """Linearise in the steps `rows`, which make the blocks `into`."""
        n = self.block
        derivatives = self.derivatives(rows)
        blocks.drive[into] = _kalman.over_blocks(derivatives.Phi, derivatives.Gamma, derivatives.rates, n)
        blocks.drive[into, :, :1] += _kalman.over_blocks(
            derivatives.Phi, derivatives.Phi, self._corrections(rows), n
        )
        blocks.measured[into], blocks.measurement[into] = derivatives.outputs[::n], derivatives.C[::n]
        blocks.variance[into] = derivatives.variance[::n]
        over, parts = _kalman.block_response(
            derivatives.Phi, derivatives.Gamma, derivatives.by_disturbance, n
        )
        blocks.transition[into], blocks.part_input[:, into] = over, parts.reshape(n, *over.shape[:2], -1)

    def _corrections(self, rows: slice) -> Floats:
        """Predicted minus filtered states of the trajectory, shape (n, states, 1)."""
        corrections = np.zeros((rows.stop - rows.start, self.states, 1))
        corrections[:, : self.model.followed, 0] = self._correction[rows]
        return corrections

    @cached_property
    def steps(self) -> Steps:
        """The model in every step, kept until `release`."""
        n, nx, m, inputs = self.rows, self.states, len(self.model.outputs), len(self.model.disturbed)
        kept = Steps(
            *(np.empty((n, *shape)) for shape in ((nx, nx), (nx, nx), (nx, inputs), (m, nx), (nx, 1), (m, 1)))
        )
        for low in range(0, n, _CHUNK_STEPS):
            rows = slice(low, min(low + _CHUNK_STEPS, n))
            derivatives = self.derivatives(rows)
            kept.Phi[rows], kept.Gamma[rows] = derivatives.Phi, derivatives.Gamma
            kept.by_disturbance[rows], kept.C[rows] = derivatives.by_disturbance, derivatives.C
            kept.drive[rows] = derivatives.Gamma @ derivatives.rates[
                :, :, :1
            ] + derivatives.Phi @ self._corrections(rows)
            kept.output_error[rows] = derivatives.outputs[:, :, :1]
        return kept

    def release(self) -> None:
        """Release the memory of `steps` and `blocks`, 110 and 70 MB for ten minutes of flight; both are
        computed again at their next use.
        """
        self.__dict__.pop("steps", None)
        self.__dict__.pop("blocks", None)

    def disturbance_for(self, accelerations: Floats) -> Floats:
        """Disturbances that make accelerations along the trajectory, shape (n, m).

        A position that friction holds obeys no disturbance: there it is zero.

        Parameters
        ----------
        accelerations : ndarray (n, m)
            Accelerations of the positions in each step, in the outputs' unit per s2.
        """
        m = len(self.model.outputs)
        inverse = np.linalg.pinv(self.steps.by_disturbance[:, m : 2 * m, :m], rcond=_HELD)
        return np.asarray(inverse @ accelerations[:, :, None], float)[:, :, 0]

    def over_blocks(self, rates: Floats) -> list[Floats]:
        """Change of the deviation over each block of each window by additional `rates`, shape
        (n, states, s).
        """
        Phi, Gamma = self.steps.Phi, self.steps.Gamma
        return [
            _kalman.over_blocks(Phi[window], Gamma[window], np.ascontiguousarray(rates[window]), self.block)
            for window in self.windows
        ]
