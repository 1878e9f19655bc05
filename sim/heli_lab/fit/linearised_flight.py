"""A model linearised along the reference trajectory of a flight.

Let x_k be the state that a filter predicts for the beginning of step k, y_k the state after the measurement
there, and h the length of a step. The rates f and their Jacobian A are evaluated in the middle of the step,
at the state (y_k + x_k+1) / 2 and the mean inputs. The implicit midpoint rule then gives for the deviation
e_k of the true state from x_k

    e_k+1 = Phi_k (e_k + x_k - y_k) + Gamma_k (f - (x_k+1 - y_k) / h + w),

with Phi = (I - h A / 2)^-1 (I + h A / 2), Gamma = (I - h A / 2)^-1 h, and the disturbances w. The change of f
by a parameter enters in the same way as w.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_sim.evaluate.trajectories import Trajectory

from heli_lab.fit import _kalman
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.reference_trajectory import ReferenceTrajectory
from heli_lab.threads import default_thread_count, parallel_map

BLOCK_s: Final = 0.04
"""Time from one measurement of the filter to the next. An axis that moves slowly repeats a count for tens of
milliseconds. With a measurement every 10 ms, successive errors are correlated (0.15 to 0.43 on simulated
flights, 2026-11), and would be estimated as a fast disturbance. Every 40 ms, the correlation is 0.05. Longer:
lags and delays are blurred."""
_CHUNK_STEPS: Final = 4096
"""Number of steps that are linearised together; derivatives by all parameters take 2 kB per step. Memory
depends on this number, the result does not."""

_HELD: Final = 1e-6
"""If the response of a position to its disturbance is below this share of the largest response, friction
holds the position. Moments of inertia differ by a factor of 100 at most; rounding gives 1e-15."""


@dataclass(frozen=True)
class Derivatives:
    """A model linearised in some steps of a reference trajectory.

    Parameters
    ----------
    Phi, Gamma : ndarray (n, states, states)
        Transition of the deviation over a step, and its response to a change of the rates during the step.
    rates : ndarray (n, states, 1 + f)
        Column 0: the model's error, its rates minus those of the trajectory. Further columns: the reduction
        of this error per unit of each free parameter.
    by_disturbance : ndarray (n, states, m + g)
        Derivatives of the rates by the disturbances.
    C : ndarray (n, m, states)
        Derivatives of the outputs by the state.
    outputs : ndarray (n, m, 1 + f)
        Column 0: the measured outputs minus the model's at the trajectory. Further columns: the reduction of
        this difference per unit of each free parameter.
    variance : ndarray (n, m)
        Variance of a measurement, of which there is one per block: because of quantisation, and because the
        position of an output within its play is unknown.
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
    """A window as the input of the filter: b blocks of steps, with one measurement per block."""

    rows: Integers  # (b,): First step of each block
    transition: Floats  # (b, states, states): Transition matrix of the deviation over a block
    part_input: Floats
    """(steps of a block, b, states, m + g): Change of the deviation at the end of a block by a disturbance of
    1 during one of its steps."""
    measurement: Floats  # (b, m, states): Derivatives of the outputs by the state
    variance: Floats  # (b, m): Variance of each measurement, as in `Derivatives`
    drive: Floats
    """(b, states, 1 + f): Change of the deviation over a block. Column 0: the change by the model's error.
    Further columns: the reduction of this change per unit of each free parameter."""
    measured: Floats  # (b, m, 1 + f): Errors of the measured outputs, in the same columns as `drive`


@dataclass(frozen=True)
class Steps:
    """A model linearised in each step of a flight, with its errors."""

    Phi: Floats  # Phi, Gamma, by_disturbance, C: As in `Derivatives`
    Gamma: Floats
    by_disturbance: Floats
    C: Floats
    drive: Floats  # (n, states, 1): Change of the deviation in each step by the model's error
    output_error: Floats  # (n, m, 1): Measured outputs minus the model's at the trajectory


class LinearisedFlight:
    """A model linearised along the reference trajectory of one flight, as the input of the Kalman filter.

    The n steps of a flight are those of all its windows, one window after the other. The filter takes one
    measurement per block of steps.

    Parameters
    ----------
    reference : ReferenceTrajectory
        States about which the model is linearised.
    functions : ModelFunctions
        The model with its derivatives.
    parameters : ndarray (p,)
        Values of all parameters of the model.

    Attributes
    ----------
    rows : int
        Number n of steps of all windows.
    trajectory : Trajectory
        Times, states and inputs in the middle of each step.
    nodes : Trajectory
        Times, predicted states and inputs at the beginning of each step.
    windows : list of slice
        Steps of each window.
    states : int
        Number of states of the model.
    block : int
        Number of steps in a block.
    variance : ndarray (n, m)
        Variance of the quantisation errors of each output.
    at_rest : ndarray (n, m)
        Whether each output is at rest.
    repeats : ndarray (n, m)
        Number of successive measurements in which the count of each output stays the same; at least 1.
    """

    def __init__(self, reference: ReferenceTrajectory, functions: ModelFunctions, parameters: Floats) -> None:
        self.reference, self.functions, self.model = reference, functions, functions.model
        self.block = max(1, round(BLOCK_s / reference.step_s))
        lengths = [window.stop - window.start for window in reference.windows]
        edges = np.concatenate(([0], np.cumsum(lengths))).astype(int)
        self.windows = [slice(int(low), int(high)) for low, high in itertools.pairwise(edges)]
        self._set_linearisation_points(parameters)
        self.states = len(self.model.states)

    def _set_linearisation_points(self, parameters: Floats) -> None:
        """Set the states and inputs about which the model is linearised, and the measurements there."""
        reference, functions, h = self.reference, self.functions, self.reference.step_s
        count = len(reference.predicted)
        acting = self.model.acting_inputs(
            reference.record, reference.every, count, parameters, functions.free
        )
        inputs = acting.mean
        middle_s = np.asarray((np.arange(count) + 0.5) * h, float)
        # A step goes from the state after a measurement to the prediction of the next one; at its middle, the
        # model is linearised. The nodes are the states before each measurement.
        after = np.vstack((reference.predicted[1:], reference.predicted[-1:]))
        middle = 0.5 * (reference.filtered + after)
        nodes = reference.predicted
        if functions.extra_states:
            trajectory = Trajectory(middle_s, middle, inputs, h, parameters)
            extra = functions.integrate(trajectory, reference.directions)
            middle = np.hstack((middle, 0.5 * (extra[:-1] + extra[1:])))
            nodes = np.hstack((nodes, extra[:-1]))
        rows = reference.rows
        self.rows = len(rows)
        self.trajectory = Trajectory(middle_s[rows], middle[rows], inputs[rows], h, parameters)
        self.nodes = Trajectory(middle_s[rows] - 0.5 * h, nodes[rows], inputs[rows], h, parameters)
        self._change: Floats = ((after - reference.filtered) / h)[rows]
        self._correction: Floats = (reference.predicted - reference.filtered)[rows]
        self._measured: Floats = reference.measured[rows]
        self.variance: Floats = reference.variance[rows]
        self._direction_variance: Floats = reference.direction_variance[rows]
        self.at_rest: Booleans = reference.at_rest[rows]
        self.repeats: Floats = np.maximum(reference.pause_s[rows] / (self.block * h), 1.0)
        self._input_derivatives = [
            (functions.free.index(name), derivative[rows])
            for name, derivative in acting.input_derivatives
            if name in functions.free
        ]

    def derivatives(self, rows: slice) -> Derivatives:
        """Linearise the model in the steps `rows`."""
        middle, followed = self.trajectory.part(rows), self.model.followed
        at = self.functions.along(middle)
        rates, outputs, c = at.rates, at.outputs, at.outputs_by_state
        # Column 0 of `rates` and `outputs` is the value, column 1 + i the derivative by free parameter i.
        # Parameters that change the inputs also act through them (chain rule).
        for number, derivative in self._input_derivatives:
            rates[:, :, 1 + number] -= np.einsum("nij,nj->ni", at.by_input, derivative[rows])
        # The value becomes the model's error.
        rates[:, :followed, 0] -= self._change[rows]
        # All measurements of a rest have the same rounding error, so that together they count as one.
        variance = self.variance[rows] * np.where(self.at_rest[rows], self.repeats[rows], 1.0)
        # The filter does not correct a state that is a known direction; its error adds to the measurement's.
        for number, output in self.model.known_directions:
            noise = self._direction_variance[rows, output] * self.repeats[rows, output]
            variance = variance + c[:, :, followed + number] ** 2 * noise[:, None]
            c[:, :, followed + number] = 0.0
        # Extra states are integrated more finely than by the midpoint rule: they have no error in a step.
        rates[:, followed:, 0] = 0.0
        # Outputs are measured at the beginning of a step, but the model is evaluated in the middle.
        to_beginning = self.nodes.state[rows] - middle.state
        at_beginning = outputs[:, :, 0] + np.einsum("nij,nj->ni", c, to_beginning)
        outputs[:, :, 0] = self._measured[rows] - at_beginning
        Phi, Gamma = _kalman.midpoint(at.by_state, self.reference.step_s)
        return Derivatives(Phi, Gamma, rates, at.by_disturbance, c, outputs, variance)

    @cached_property
    def blocks(self) -> list[Blocks]:
        """Each window as the input of the filter, cached until `release`."""
        n = self.block
        # A chunk has whole blocks, and is short enough that every thread has work.
        steps_per_thread = math.ceil(self.rows / default_thread_count())
        chunk_steps = max(1, min(_CHUNK_STEPS, steps_per_thread) // n) * n
        windows: list[Blocks] = []
        chunks: list[tuple[Blocks, slice, slice]] = []
        for window in self.windows:
            blocks = self._empty_blocks(np.arange(window.start, window.stop - n + 1, n))
            windows.append(blocks)
            step_count = len(blocks.rows) * n
            for low in range(0, step_count, chunk_steps):
                high = min(low + chunk_steps, step_count)
                steps = slice(window.start + low, window.start + high)
                chunks.append((blocks, slice(low // n, high // n), steps))
        parallel_map(lambda chunk: self._fill_blocks(*chunk), chunks)
        return windows

    def _empty_blocks(self, rows: Integers) -> Blocks:
        """Allocate the blocks that begin at the steps `rows`, shape (b,); the arrays are not filled yet."""
        b, states, m, columns = len(rows), self.states, len(self.model.outputs), 1 + len(self.functions.free)
        return Blocks(
            rows=rows,
            transition=np.empty((b, states, states)),
            part_input=np.empty((self.block, b, states, len(self.model.disturbed))),
            measurement=np.empty((b, m, states)),
            variance=np.empty((b, m)),
            drive=np.empty((b, states, columns)),
            measured=np.empty((b, m, columns)),
        )

    def _fill_blocks(self, blocks: Blocks, into: slice, rows: slice) -> None:
        """Linearise the model in the steps `rows`, and fill the elements `into` of `blocks` with them."""
        n, steps = self.block, self.derivatives(rows)
        Phi, Gamma = steps.Phi, steps.Gamma
        # The two terms of e_k+1 in the module's equation, without Phi e_k, added up over each block.
        blocks.drive[into] = _kalman.over_blocks(Phi, Gamma, steps.rates, n)
        blocks.drive[into, :, :1] += _kalman.over_blocks(Phi, Phi, self._corrections(rows), n)
        # A block is measured at its first step.
        blocks.measured[into], blocks.measurement[into] = steps.outputs[::n], steps.C[::n]
        blocks.variance[into] = steps.variance[::n]
        # Shape (n b, states, m + g): the first step of each block, then the second of each, and so on.
        blocks.transition[into], responses = _kalman.block_response(Phi, Gamma, steps.by_disturbance, n)
        blocks.part_input[:, into] = responses.reshape(n, -1, *responses.shape[1:])

    def _corrections(self, rows: slice) -> Floats:
        """Return x_k - y_k in the steps `rows`: predicted minus filtered states, shape (n, states, 1)."""
        corrections = np.zeros((rows.stop - rows.start, self.states, 1))
        corrections[:, : self.model.followed, 0] = self._correction[rows]
        return corrections

    @cached_property
    def steps(self) -> Steps:
        """The model linearised in every step, cached until `release`."""
        n, states, m = self.rows, self.states, len(self.model.outputs)
        steps = Steps(
            Phi=np.empty((n, states, states)),
            Gamma=np.empty((n, states, states)),
            by_disturbance=np.empty((n, states, len(self.model.disturbed))),
            C=np.empty((n, m, states)),
            drive=np.empty((n, states, 1)),
            output_error=np.empty((n, m, 1)),
        )
        for low in range(0, n, _CHUNK_STEPS):
            rows = slice(low, min(low + _CHUNK_STEPS, n))
            derivatives = self.derivatives(rows)
            rate_error = derivatives.rates[:, :, :1]
            steps.Phi[rows], steps.Gamma[rows] = derivatives.Phi, derivatives.Gamma
            steps.by_disturbance[rows], steps.C[rows] = derivatives.by_disturbance, derivatives.C
            steps.drive[rows] = derivatives.Gamma @ rate_error + derivatives.Phi @ self._corrections(rows)
            steps.output_error[rows] = derivatives.outputs[:, :, :1]
        return steps

    def release(self) -> None:
        """Release the memory of `steps` and `blocks`, 110 and 70 MB for ten minutes of flight; both are
        computed again at their next use.
        """
        self.__dict__.pop("steps", None)
        self.__dict__.pop("blocks", None)

    def disturbance_for(self, accelerations: Floats) -> Floats:
        """Compute the disturbances that would cause given accelerations along the trajectory, shape (n, m).

        While friction holds a position, no disturbance moves it; the result there is 0.

        Parameters
        ----------
        accelerations : ndarray (n, m)
            Accelerations of the positions in each step, in the outputs' unit per s2.
        """
        m = len(self.model.outputs)
        inverse = np.linalg.pinv(self.steps.by_disturbance[:, m : 2 * m, :m], rcond=_HELD)
        return np.asarray(inverse @ accelerations[:, :, None], float)[:, :, 0]

    def over_blocks(self, rates: Floats) -> list[Floats]:
        """Compute the change of the deviation over each block by additional rates of the state.

        Parameters
        ----------
        rates : ndarray (n, states, s)
            Additional rates in each step, for s signals.

        Returns
        -------
        list of ndarray (b, states, s)
            Change over each block of each window.
        """
        Phi, Gamma = self.steps.Phi, self.steps.Gamma
        return [
            _kalman.over_blocks(Phi[window], Gamma[window], np.ascontiguousarray(rates[window]), self.block)
            for window in self.windows
        ]
