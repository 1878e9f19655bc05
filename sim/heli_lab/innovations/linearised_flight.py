"""A model linearised along the course of a flight.

Let x_k be the state that a filter predicts for the beginning of step k and y_k the one after its measurement,
u_k the mean voltages of the step. With f and its Jacobian A in the middle, (y_k + x_k+1) / 2, the implicit
midpoint rule gives for the deviation e_k of the true state from x_k

    e_k+1 = Phi_k (e_k + x_k - y_k) + Gamma_k (f - (x_k+1 - y_k) / h + w),

Phi = (I - h A / 2)^-1 (I + h A / 2), Gamma = (I - h A / 2)^-1 h. What a parameter or an effect changes of f
enters as w does.
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
from heli_sim.model.base import Effect, Model
from heli_sim.model.parts import AXES

from heli_lab.identify.grid import make_grid
from heli_lab.innovations import _kalman
from heli_lab.innovations.evaluate import EFFECT_SUBSTEPS, AlongTrajectory, EffectStates, Trajectory
from heli_lab.innovations.reference_trajectory import ReferenceTrajectory
from heli_lab.threads import default_thread_count, parallel_map

BLOCK_s: Final = 0.04
"""Time from one measurement of the filter to the next. Encoders at rest repeat a count for tens of
milliseconds: taken every 10 ms their errors are correlated (0.15 to 0.43 from one to the next on simulated
flights, 2026-11), and weather of no memory is found; every 40 ms they are white to 0.05. Longer: rotor
lags and delays blur."""
_TOGETHER: Final = 4096
"""Steps that are linearised together: derivatives by all parameters take 2 kB each. The result does not
depend on it, memory does."""

_HELD: Final = 1e-6
"""Share of the nimblest axis' response to a torque below which an axis is held. Moments of inertia differ by
a factor of 100 at most; rounding leaves 1e-15."""


class ModelFunctions:
    """Rates and angles of a `model` with their derivatives, by state, `free` parameters and torques, as
    CasADi functions.
    """

    def __init__(self, model: Model, free: Sequence[str]) -> None:
        self.model = model = with_measured_angles(model)
        self.free = tuple(free)
        names = [quantity.name for quantity in model.parameters]
        self.names = names
        self.places = [names.index(name) for name in free]
        torques = [names.index(f"torque_{axis}") for axis in AXES]
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
        t, p = ca.SX.sym("t"), ca.SX.sym("p", len(names))
        rates, angles = model.dynamics(x, u, p, t), model.measurement(x, u, p, t)

        def by_free(value: ca.SX) -> ca.SX:
            if not self.places:
                return ca.SX(value.numel(), 0)
            return ca.jacobian(value, ca.vertcat(*(p[i] for i in self.places)))

        # With the opposite sign the filter gives what a parameter takes off the innovations.
        wanted = [
            ca.horzcat(rates, -by_free(rates)),
            ca.jacobian(rates, x),
            ca.jacobian(rates, ca.vertcat(*(p[i] for i in torques))),
            ca.jacobian(rates, u),
            ca.horzcat(angles, by_free(angles)),
            ca.jacobian(angles, x),
        ]
        self.along = AlongTrajectory(ca.Function("along", [x, u, t, p], [ca.densify(w) for w in wanted]))
        self.own_states = len(model.states) - 6
        if self.own_states:
            z, y = ca.SX.sym("z", self.own_states), ca.SX.sym("y", 6)
            both, inputs = ca.vertcat(y, z), [z, t, y, u, p]
            self.own = EffectStates(
                ca.Function("rates", inputs, [ca.densify(model.dynamics(both, u, p, t)[6:])]),
                ca.Function("resets", inputs, [ca.densify(model.reset_map(both, u, p, t)[6:])]),
            )

    def __reduce__(self) -> tuple[type[ModelFunctions], tuple[Model, tuple[str, ...]]]:
        # Compiled programs do not pickle; they are made again.
        return ModelFunctions, (self.model, self.free)

    def integrate(self, trajectory: Trajectory, directions: Floats) -> Floats:
        """Integrate the effects' own states along a course from rest.

        Parameters
        ----------
        trajectory : Trajectory
            The course.
        directions : ndarray (n, 3)
            Direction in which each axis has moved last, at the beginning of each step.

        Returns
        -------
        ndarray (n + 1, own states)
            At the beginning of each step, and at the end of the last.
        """
        ends = self.own.integrate(
            [trajectory.state[:, :6], trajectory.volts_V],
            trajectory.t_s,
            trajectory.parameters,
            trajectory.step_s,
            EFFECT_SUBSTEPS,
        )
        every: Floats = np.vstack((np.zeros(self.own_states), ends))
        for place, axis in known_directions(self.model.effects):
            every[:, place] = np.append(directions[:, axis], directions[-1, axis])
        return every


def with_measured_angles(model: Model) -> Model:
    """The same model where the angles of a flight have been measured."""
    return type(model)(tuple(effect.with_measured_angles() for effect in model.effects))


def known_directions(effects: Sequence[Effect]) -> list[tuple[int, int]]:
    """Those of the effects' own states, counted from the first, that are directions of an axis, and which."""
    names = [state.name for effect in effects for state in effect.states]
    axes = {name: axis for effect in effects for name, axis in effect.direction_of.items()}
    return [(names.index(name), AXES.index(axis)) for name, axis in axes.items()]


@dataclass(frozen=True)
class Derivatives:
    """A model linearised in some steps of a course.

    Parameters
    ----------
    Phi, Gamma : ndarray (n, states, states)
        Transition of the deviation over a step, and its response to rates changed during it.
    rates : ndarray (n, states, 1 + f)
        The model's error first: rates that it adds to those of the course. Then what a unit of each free
        parameter takes off them.
    by_torque : ndarray (n, states, 3)
        Derivatives of the rates by torques about the axes.
    C : ndarray (n, 3, states)
        Derivatives of the measured angles by the state.
    angles_rad : ndarray (n, 3, 1 + f)
        Measured angles minus those of the course first, then what a unit of each free parameter takes off
        that.
    """

    Phi: Floats
    Gamma: Floats
    rates: Floats
    by_torque: Floats
    C: Floats
    angles_rad: Floats


@dataclass(frozen=True)
class Blocks:
    """A window in steps of a block.

    Parameters
    ----------
    rows : ndarray (m,)
        First step of each block.
    transition : ndarray (m, states, states)
        Of the deviation over a block.
    part_input : ndarray (steps of a block, m, states, 3)
        What a torque about each axis during one step of the block has moved at its end.
    measurement : ndarray (m, 3, states)
        Derivatives of the measured angles by the state.
    variance_rad2 : ndarray (m, 3)
        Of the measurements' quantisation.
    drive : ndarray (m, states, 1 + f)
        What moves the deviation over a block: the model's error first, then what a unit of each free
        parameter takes off it.
    measured_rad : ndarray (m, 3, 1 + f)
        The same of the measured angles.
    """

    rows: Integers
    transition: Floats
    part_input: Floats
    measurement: Floats
    variance_rad2: Floats
    drive: Floats
    measured_rad: Floats


@dataclass(frozen=True)
class Steps:
    """A flight in steps of its course.

    Parameters
    ----------
    Phi, Gamma, by_torque, C : ndarray
        As in `Derivatives`.
    drive : ndarray (n, states, 1)
        What the model's error moves in each step.
    angle_error_rad : ndarray (n, 3, 1)
        Measured angles minus those of the course.
    """

    Phi: Floats
    Gamma: Floats
    by_torque: Floats
    C: Floats
    drive: Floats
    angle_error_rad: Floats


class LinearisedFlight:
    """A model with all its `parameters`, shape (p,), linearised along a `reference`.

    Attributes
    ----------
    rows : int
        Steps in free flight, one window after the other.
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
    variance_rad2 : ndarray (n, 3)
        Variance of the quantisation errors.
    """

    def __init__(self, reference: ReferenceTrajectory, functions: ModelFunctions, parameters: Floats) -> None:
        self.reference, self.functions, self.model = reference, functions, functions.model
        self.block = max(1, round(BLOCK_s / reference.step_s))
        lengths = [window.stop - window.start for window in reference.windows]
        edges = np.concatenate(([0], np.cumsum(lengths))).astype(int)
        self.windows = [slice(int(low), int(high)) for low, high in itertools.pairwise(edges)]
        self._place(parameters)
        self.states = 6 + functions.own_states

    def _place(self, parameters: Floats) -> None:
        """Lay out the points of the course about which the model is linearised."""
        reference, functions, h = self.reference, self.functions, self.reference.step_s
        names = functions.names
        model = self.model
        delay = (model.delay, float(parameters[names.index(model.delay)])) if model.delay else None
        count = len(reference.predicted)
        grid = make_grid(
            reference.record,
            [(0, count * reference.every)],
            reference.every,
            delay=delay,
            dead_zone_V=model.dead_zone_V(parameters, functions.free),
        )
        t_s = np.asarray((np.arange(count) + 0.5) * h, float)
        after = np.vstack((reference.predicted[1:], reference.predicted[-1:]))
        middle = 0.5 * (reference.filtered + after)
        volts_V = grid.inputs.mean_V
        nodes = reference.predicted
        if functions.own_states:
            effect_states = functions.integrate(
                Trajectory(t_s, middle, volts_V, h, parameters), reference.directions
            )
            middle = np.hstack((middle, 0.5 * (effect_states[:-1] + effect_states[1:])))
            nodes = np.hstack((nodes, effect_states[:-1]))
        rows = reference.rows
        self.rows = len(rows)
        self.trajectory = Trajectory(t_s[rows], middle[rows], volts_V[rows], h, parameters)
        self.nodes = Trajectory(t_s[rows] - 0.5 * h, nodes[rows], volts_V[rows], h, parameters)
        self._change: Floats = ((after - reference.filtered) / h)[rows]
        self._surprise: Floats = (reference.predicted - reference.filtered)[rows]
        self._measured: Floats = reference.measured_rad[rows]
        self.variance_rad2: Floats = reference.variance_rad2[rows]
        self._shaped_by = [
            (functions.free.index(name), mean[rows])
            for name, mean, _ in grid.inputs.shaped_by
            if name in functions.free
        ]

    def derivatives(self, rows: slice) -> Derivatives:
        """Linearise in the steps `rows`."""
        here, h = self.trajectory.part(rows), self.reference.step_s
        rates, a, by_torque, by_volts, angles, c = self.functions.along(here)
        for place, mean in self._shaped_by:
            rates[:, :, 1 + place] -= np.einsum("nij,nj->ni", by_volts, mean[rows])
        rates[:, :6, 0] -= self._change[rows]
        # A direction is known: no state of the filter strays from it.
        for place, _ in known_directions(self.model.effects):
            c[:, :, 6 + place] = 0.0
        # Own states are integrated more finely than by the midpoint rule: the course keeps to them exactly.
        rates[:, 6:, 0] = 0.0
        # Angles are measured at the beginning of a step, the model's are taken in its middle.
        ahead = self.nodes.state[rows] - here.state
        at_node = angles[:, :, 0] + np.einsum("nij,nj->ni", c, ahead)
        angles[:, :, 0] = self._measured[rows] - at_node
        return Derivatives(*_kalman.midpoint(a, h), rates, by_torque, c, angles)

    @cached_property
    def blocks(self) -> list[Blocks]:
        """The windows, as the filter takes them; once asked for they are kept, until `release`."""
        size, states, n = 1 + len(self.functions.free), self.states, self.block
        together = max(1, min(_TOGETHER, -(-self.rows // default_thread_count())) // n) * n
        result: list[Blocks] = []
        parts: list[tuple[Blocks, slice, slice]] = []
        for window in self.windows:
            firsts = np.arange(window.start, window.stop - n + 1, n)
            count = len(firsts)
            blocks = Blocks(
                firsts,
                np.empty((count, states, states)),
                np.empty((n, count, states, 3)),
                np.empty((count, 3, states)),
                self.variance_rad2[firsts],
                np.empty((count, states, size)),
                np.empty((count, 3, size)),
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
            derivatives.Phi, derivatives.Phi, self._moved(rows), n
        )
        blocks.measured_rad[into], blocks.measurement[into] = derivatives.angles_rad[::n], derivatives.C[::n]
        over, parts = _kalman.block_response(derivatives.Phi, derivatives.Gamma, derivatives.by_torque, n)
        blocks.transition[into], blocks.part_input[:, into] = over, parts.reshape(n, *over.shape[:2], 3)

    def _moved(self, rows: slice) -> Floats:
        """What a step's measurement has moved of the course before it, shape (n, states, 1)."""
        moved = np.zeros((rows.stop - rows.start, self.states, 1))
        moved[:, :6, 0] = self._surprise[rows]
        return moved

    @cached_property
    def steps(self) -> Steps:
        """The model in every step; once asked for it is kept, until `release`."""
        n, nx = self.rows, self.states
        kept = Steps(
            *(np.empty((n, *shape)) for shape in ((nx, nx), (nx, nx), (nx, 3), (3, nx), (nx, 1), (3, 1)))
        )
        for low in range(0, n, _TOGETHER):
            rows = slice(low, min(low + _TOGETHER, n))
            derivatives = self.derivatives(rows)
            kept.Phi[rows], kept.Gamma[rows] = derivatives.Phi, derivatives.Gamma
            kept.by_torque[rows], kept.C[rows] = derivatives.by_torque, derivatives.C
            kept.drive[rows] = derivatives.Gamma @ derivatives.rates[
                :, :, :1
            ] + derivatives.Phi @ self._moved(rows)
            kept.angle_error_rad[rows] = derivatives.angles_rad[:, :, :1]
        return kept

    def release(self) -> None:
        """Give back what `steps` and `blocks` keep: 110 and 70 MB of ten minutes; they are laid out again
        when asked for.
        """
        self.__dict__.pop("steps", None)
        self.__dict__.pop("blocks", None)

    def torque_for(self, accelerations_rad_s2: Floats) -> Floats:
        """Torques about the axes that make accelerations along the course, shape (n, 3).

        An axis that friction holds obeys no torque: there the torque is zero.

        Parameters
        ----------
        accelerations_rad_s2 : ndarray (n, 3)
            Accelerations of elevation, pitch and travel in each step.
        """
        inverse = np.linalg.pinv(self.steps.by_torque[:, 3:6], rcond=_HELD)
        return np.asarray(inverse @ accelerations_rad_s2[:, :, None], float)[:, :, 0]

    def over_blocks(self, rates: Floats) -> list[Floats]:
        """What changes of the `rates`, shape (n, states, s), move in each block of each window."""
        Phi, Gamma = self.steps.Phi, self.steps.Gamma
        return [
            _kalman.over_blocks(Phi[window], Gamma[window], np.ascontiguousarray(rates[window]), self.block)
            for window in self.windows
        ]
