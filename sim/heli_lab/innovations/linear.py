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
from typing import Final

import casadi as ca
import numpy as np
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES

from heli_lab.identify.functions import Floats
from heli_lab.identify.grid import make_grid
from heli_lab.innovations.course import Course
from heli_lab.innovations.evaluate import MapEvaluator, Trajectory

_OWN_SUBSTEPS: Final = 4
"""Runge-Kutta steps of an effect's own states in each step of 10 ms: lags of a few milliseconds stay
stable."""


class ModelFunctions:
    """Rates and angles of a `model` with their derivatives, by state, `free` parameters and torques, as
    CasADi functions.
    """

    def __init__(self, model: Model, free: Sequence[str]) -> None:
        self.model, self.free = model, tuple(free)
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

        wanted = [
            rates,
            ca.jacobian(rates, x),
            by_free(rates),
            ca.jacobian(rates, ca.vertcat(*(p[i] for i in torques))),
            ca.jacobian(rates, u),
            angles,
            ca.jacobian(angles, x),
            by_free(angles),
        ]
        self.function = ca.Function("along", [x, u, t, p], ca.cse([ca.densify(w) for w in wanted]))
        self.evaluators: dict[int, MapEvaluator] = {}
        self.own_states = len(model.states) - 6
        if self.own_states:
            z, y, h = ca.SX.sym("z", self.own_states), ca.SX.sym("y", 6), ca.SX.sym("h")
            both = ca.vertcat(y, z)
            now = ca.Function("z", [z, y, u, t, p], [model.dynamics(both, u, p, t)[6:]])
            reset = ca.Function("r", [z, y, u, t, p], [model.reset_map(both, u, p, t)[6:]])
            k1 = now(z, y, u, t, p)
            k2 = now(z + 0.5 * h * k1, y, u, t, p)
            k3 = now(z + 0.5 * h * k2, y, u, t, p)
            k4 = now(z + h * k3, y, u, t, p)
            end = reset(z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), y, u, t + h, p)
            self.step = ca.Function("step", [z, y, u, t, p, h], [end])
            self.integrators: dict[int, ca.Function] = {}

    def evaluate(self, trajectory: Trajectory) -> list[Floats]:
        """Evaluate in each step of a trajectory."""
        count = len(trajectory.t_s)
        if count not in self.evaluators:
            self.evaluators[count] = MapEvaluator(self.function, count)
        return self.evaluators[count](trajectory)

    def integrate(self, trajectory: Trajectory) -> Floats:
        """Integrate the effects' own states along a course from rest, shape (n + 1, own states): at the
        beginning of each step, and at the end of the last.
        """
        count, substeps = len(trajectory.t_s), _OWN_SUBSTEPS
        if count not in self.integrators:
            self.integrators[count] = self.step.mapaccum("integrated", count * substeps)
        h = trajectory.step_s / substeps
        late_s = h * (np.tile(np.arange(substeps), count) - substeps / 2)
        parameters = trajectory.parameters
        result = self.integrators[count](
            np.zeros(self.own_states),
            np.repeat(trajectory.state[:, :6], substeps, axis=0).T,
            np.repeat(trajectory.volts_V, substeps, axis=0).T,
            (np.repeat(trajectory.t_s, substeps) + late_s)[None],
            np.broadcast_to(parameters[:, None], (len(parameters), count * substeps)),
            np.full((1, count * substeps), h),
        )
        ends = np.asarray(result).T[substeps - 1 :: substeps]
        every: Floats = np.vstack((np.zeros(self.own_states), ends))
        return every


class Linear:
    """A model with all its `parameters`, shape (p,), linearised along a `course`.

    Attributes
    ----------
    trajectory : Trajectory
        Middle of each step in free flight, n of them.
    Phi, Gamma : ndarray (n, states, states)
        Transition of the deviation over a step, and its response to rates changed during it.
    defect : ndarray (n, states)
        Rates that the model adds to those of the course.
    surprise : ndarray (n, states)
        Predicted minus filtered state of the course at the beginning of each step.
    nodes : Trajectory
        Beginning of each step, with the predicted state.
    by_parameters : ndarray (n, states, f)
        Derivatives of the rates by the free parameters.
    by_torque : ndarray (n, states, 3)
        Derivatives of the rates by torques about the axes.
    C : ndarray (n, 3, states)
        Derivatives of the measured angles by the state.
    angle_error_rad : ndarray (n, 3)
        Measured angles minus those of the course.
    angles_by_parameters : ndarray (n, 3, f)
        Derivatives of the measured angles by the free parameters.
    """

    def __init__(self, course: Course, functions: ModelFunctions, parameters: Floats) -> None:
        self.course, self.functions = course, functions
        model, h = functions.model, course.step_s
        self.model = model
        names = functions.names
        delay = (model.delay, float(parameters[names.index(model.delay)])) if model.delay else None
        dead_zone = float(parameters[names.index("dead_zone")])
        one_way = not parameters[names.index("reverse_thrust")] and "reverse_thrust" not in functions.free
        one_way &= not any(effect.pushes_below_dead_zone for effect in model.effects)
        count = len(course.predicted)
        grid = make_grid(
            course.record,
            [(0, count * course.every)],
            course.every,
            delay=delay,
            dead_zone_V=dead_zone if one_way else None,
        )
        t_s = np.asarray((np.arange(count) + 0.5) * h, float)
        after = np.vstack((course.predicted[1:], course.predicted[-1:]))
        middle = 0.5 * (course.filtered + after)
        whole = Trajectory(t_s, middle, grid.inputs.mean_V, h, parameters)
        nodes = course.predicted
        own = None
        if functions.own_states:
            own = functions.integrate(whole)
            middle = np.hstack((middle, 0.5 * (own[:-1] + own[1:])))
            nodes = np.hstack((nodes, own[:-1]))
        rows = course.rows
        self.rows = len(rows)
        self.trajectory = Trajectory(t_s[rows], middle[rows], whole.volts_V[rows], h, parameters)
        rates, a, by_free, by_torque, by_volts, angles, c, angles_by_free = functions.evaluate(
            self.trajectory
        )
        for name, mean, _ in grid.inputs.shaped_by:
            if name in functions.free:
                by_free[:, :, functions.free.index(name)] += np.einsum("nij,nj->ni", by_volts, mean[rows])
        nx = a.shape[1]
        eye = np.eye(nx)
        inverse = np.linalg.inv(eye - 0.5 * h * a)
        self.Phi: Floats = inverse @ (eye + 0.5 * h * a)
        self.Gamma: Floats = np.asarray(inverse * h, float)
        change = np.zeros((self.rows, nx))
        change[:, :6] = ((after - course.filtered) / h)[rows]
        defect = rates[:, :, 0] - change
        # Own states are integrated more finely than by the midpoint rule: the course keeps to them exactly.
        defect[:, 6:] = 0.0
        self.defect: Floats = defect
        self.by_parameters: Floats = by_free
        self.by_torque: Floats = by_torque
        self.C: Floats = c
        surprise = np.zeros((self.rows, nx))
        surprise[:, :6] = (course.predicted - course.filtered)[rows]
        self.surprise: Floats = surprise
        self.nodes = Trajectory(t_s[rows] - 0.5 * h, nodes[rows], whole.volts_V[rows], h, parameters)
        # Angles are measured at the beginning of a step, the model's are taken in its middle.
        at_node = angles[:, :, 0] + np.einsum("nij,nj->ni", c, self.nodes.state - self.trajectory.state)
        self.angle_error_rad: Floats = course.measured_rad[rows] - at_node
        self.angles_by_parameters: Floats = angles_by_free
        self.variance_rad2: Floats = course.variance_rad2[rows]
        lengths = [one.stop - one.start for one in course.windows]
        edges = np.concatenate(([0], np.cumsum(lengths))).astype(int)
        self.windows = [slice(int(low), int(high)) for low, high in itertools.pairwise(edges)]
