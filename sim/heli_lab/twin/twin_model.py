"""The model of a twin: equations of a rig with their derivatives by the state and by possible changes."""

from __future__ import annotations

from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.base import Effect, Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.estimation import AlongTrajectory, Trajectory
from heli_lab.identify.flight_model import model_functions
from heli_lab.twin.changes import SCALES, SUPPLY, Change, changes_of, extended, free_numbers
from heli_lab.twin.parameter_uncertainty import EXACT, ParameterUncertainty

ZEROS: Final = ("offset_elevation", "offset_pitch")
"""Encoders with an observable zero. The zero of travel cannot be distinguished from a constant torque."""


class TwinModel:
    """Equations of a rig with their derivatives by the state and by possible changes.

    Parameters
    ----------
    model : Model
        Equations with the rig's effects; effects with driving noise are left out, as the filter models the
        disturbances.
    rig : Rig
        Parameters of the rig.
    uncertainty : ParameterUncertainty
        Errors of these parameters; exact without it.

    Attributes
    ----------
    changes : tuple of Change
        Possible changes of this rig.
    parameters : ndarray (p,)
        Values of all parameters of the extended model.
    """

    def __init__(self, model: Model, rig: Rig, uncertainty: ParameterUncertainty = EXACT) -> None:
        calm = type(model)(tuple(effect for effect in model.effects if not effect.noise_inputs))
        self.rig, self.model = rig, calm
        self.changes: tuple[Change, ...] = changes_of(calm)
        more = extended(calm)
        free = tuple(dict.fromkeys((*free_numbers(self.changes), *uncertainty.names)))
        self.functions = model_functions(more, free)
        self.uncertainty = uncertainty
        self.directions: Floats = uncertainty.directions(free)
        """Amount of each free parameter per standard deviation of each unknown error, (parameters + 1,
        errors); the last row is the supply."""
        more = self.functions.model.source
        self.plain = model_functions(more, ())
        """The same functions without derivatives by changes, which is faster."""
        self.parameters: Floats = more.parameter_values(rig)
        names = self.functions.names
        self.delay_s = float(self.parameters[names.index(more.delay)]) if more.delay else 0.0
        dead_zone_V = more.dead_zone_V(self.parameters)
        self.least_V = -np.inf if dead_zone_V is None else dead_zone_V
        """Voltage below which a motor gives no thrust, V."""
        self.states = len(more.states)
        self.frictions = [
            (place, axis)
            for axis, name in enumerate(AXES)
            for place, free in enumerate(self.functions.free)
            if free == f"coulomb_friction_{name}_Nm"
        ]
        """For each axis with dry friction: its place among the free parameters, and the axis."""
        self.measure = self._measurement(more)
        resets = any(type(effect).reset_map is not Effect.reset_map for effect in calm.effects)
        self.resets = self._resets(more) if resets else None
        self.weights: Floats = self._weights()
        """Amount of each free parameter per unit of each number of the changes, (parameters + 1, columns);
        the last row is the supply."""
        entries = [entry for change in self.changes for entry in change.numbers]
        self.prior_sizes: Floats = np.array([size for change in self.changes for size in change.sizes])
        """Prior standard deviation of each number of the changes, (columns,)."""
        self.prior_changes: Floats = self.weights * self.prior_sizes
        self.scales = [
            (column, AXES.index(SCALES[entry])) for column, entry in enumerate(entries) if entry in SCALES
        ]
        """For each encoder scale: its column among the numbers of the changes, and its axis."""
        tolerances = [rig[name].tolerance for name in ZEROS]
        self.zero_tolerance_rad: Floats = np.deg2rad(tolerances)

    def _weights(self) -> Floats:
        free = self.functions.free
        columns = [entry for change in self.changes for entry in change.numbers]
        weights = np.zeros((len(free) + 1, len(columns)))
        for column, entry in enumerate(columns):
            for name in entry.split("+"):
                if name not in SCALES:
                    weights[len(free) if name == SUPPLY else free.index(name), column] = 1.0
        return weights

    def _symbols(self, model: Model) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        return (
            ca.SX.sym("x", len(model.states)),
            ca.SX.sym("u", 2),
            ca.SX.sym("t"),
            ca.SX.sym("p", len(model.parameters)),
        )

    def _measurement(self, model: Model) -> AlongTrajectory:
        x, u, t, p = self._symbols(model)
        angles = model.measurement(x, u, p, t)
        by = ca.vertcat(*(p[i] for i in self.functions.places))
        wanted = [angles, ca.jacobian(angles, x), ca.jacobian(angles, by)]
        return AlongTrajectory(ca.Function("measure", [x, u, t, p], [ca.densify(w) for w in wanted]))

    def _resets(self, model: Model) -> AlongTrajectory:
        x, u, t, p = self._symbols(model)
        return AlongTrajectory(ca.Function("resets", [x, u, t, p], [ca.densify(model.reset_map(x, u, p, t))]))

    def at(self, t_s: float, state: Floats, volts_V: Floats, step_s: float) -> Trajectory:
        """Return the point at which the functions are evaluated: time `t_s`, `state` of shape (n,) or (k, n),
        voltages `volts_V`, (2,), in a step of `step_s`.
        """
        rows = np.atleast_2d(state)
        return Trajectory(
            np.full(len(rows), t_s),
            rows,
            np.broadcast_to(volts_V, (len(rows), 2)),
            step_s,
            self.parameters,
        )


def start_state(twin: TwinModel, t_s: Floats, angles_rad: Floats, volts_V: Floats, step_s: float) -> Floats:
    """Return the state at the end of some measured steps, (states,).

    Parameters
    ----------
    twin : TwinModel
        Equations of the rig.
    t_s : ndarray (n,)
        Beginning of each step [s].
    angles_rad : ndarray (n, 3)
        Measured angles at these times [rad].
    volts_V : ndarray (n, 2)
        Mean voltages of each step [V].
    step_s : float
        Length of a step [s].
    """
    span = min(10, len(t_s) - 1)
    rates = np.gradient(angles_rad, step_s, axis=0) if len(t_s) > 1 else np.zeros_like(angles_rad)
    rate = (angles_rad[-1] - angles_rad[-1 - span]) / (span * step_s) if span else np.zeros(3)
    state = np.concatenate((angles_rad[-1], rate))
    offset = np.deg2rad([twin.rig[name].value for name in ZEROS])
    state[: len(ZEROS)] -= offset
    if twin.functions.extra_states:
        course = Trajectory(
            t_s + 0.5 * step_s, np.hstack((angles_rad, rates)), volts_V, step_s, twin.parameters
        )
        state = np.concatenate((state, twin.functions.integrate(course, np.sign(rates))[-2]))
    return state
