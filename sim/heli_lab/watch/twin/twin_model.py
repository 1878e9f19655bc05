"""Equations of a rig as a twin uses them: derivatives by the state and by possible changes of the rig."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Effect, Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.fit.flight_model import model_along, model_functions
from heli_lab.fit.model_functions import AlongTrajectory, Trajectory
from heli_lab.watch.twin.changes import SCALES, SUPPLY, Change, changes_of, extended, model_parameters
from heli_lab.watch.twin.parameter_uncertainty import EXACT, ParameterUncertainty

ZEROS: Final = ("offset_elevation", "offset_pitch")
"""Encoders with an observable zero. The zero of travel cannot be distinguished from a constant torque."""


_RATE_STEPS: Final = 10
"""Number of steps over which the initial rates are averaged: 0.1 s."""


class TwinModel:
    """Equations of a rig with their derivatives by the state and by possible changes. `parameters` has shape
    (p,). `directions` has shape (free parameters + 1, errors). `weights` has shape (free parameters + 1,
    columns). `prior_sizes` has shape (columns,). `prior_changes` has shape (free parameters + 1,
    columns).
    """

    def __init__(self, model: Model, rig: Rig, uncertainty: ParameterUncertainty = EXACT) -> None:
        # The filter models the disturbances itself.
        deterministic = type(model)(tuple(effect for effect in model.effects if not effect.noise_inputs))
        self.rig, self.model, self.uncertainty = rig, deterministic, uncertainty
        self.changes: tuple[Change, ...] = changes_of(deterministic)
        # Parameters by which derivatives are needed: those of the changes, and the uncertain ones.
        free = tuple(dict.fromkeys((*model_parameters(self.changes), *uncertainty.names)))
        self.functions = model_functions(extended(deterministic), free)
        extended_model = self.functions.model.source
        self.functions_without_derivatives = model_functions(extended_model, ())
        self.parameters: Floats = extended_model.parameter_values(rig)
        self.states = len(extended_model.states)
        self.delay_s = self._delay_of(extended_model)
        dead_zone_V = extended_model.dead_zone_V(self.parameters)
        self.min_thrust_V = -np.inf if dead_zone_V is None else dead_zone_V
        self.measure = self._measurement_function(extended_model)
        self.resets = self._reset_function(extended_model)
        self.directions: Floats = uncertainty.directions(free)
        self._describe_changes()
        self.zero_tolerance_rad: Floats = np.deg2rad([rig[name].tolerance for name in ZEROS])

    def _describe_changes(self) -> None:
        """Set the attributes that state what each change does: weights, priors, frictions and scales."""
        change_parameters = [name for change in self.changes for name in change.parameters]
        self.weights: Floats = self._change_weights(change_parameters)
        self.prior_sizes: Floats = np.array([size for change in self.changes for size in change.sizes])
        self.prior_changes: Floats = self.weights * self.prior_sizes
        self.frictions = [
            (self.functions.free.index(name), axis)
            for axis, name in enumerate(f"coulomb_friction_{axis_name}_Nm" for axis_name in AXES)
            if name in self.functions.free
        ]
        self.scales = [
            (column, AXES.index(SCALES[name]))
            for column, name in enumerate(change_parameters)
            if name in SCALES
        ]

    def _delay_of(self, model: Model) -> float:
        """Return the delay between a voltage and its action [s]; 0 if the model has none."""
        if not model.delay:
            return 0.0
        return float(self.parameters[self.functions.names.index(model.delay)])

    def _reset_function(self, model: Model) -> AlongTrajectory | None:
        """Return the function that sets states at the end of a step; None if no effect sets states."""
        if all(type(effect).reset_map is Effect.reset_map for effect in self.model.effects):
            return None
        return model_along(model, lambda x, u, p, t: [model.reset_map(x, u, p, t)])

    def _change_weights(self, change_parameters: Sequence[str]) -> Floats:
        """Return the amount of each free parameter and, in the last row, of the supply, per unit of each
        parameter of the changes, (free + 1, columns).

        The columns of encoder scales are zero, because they change no parameter of the model.
        """
        free = self.functions.free
        weights = np.zeros((len(free) + 1, len(change_parameters)))
        for column, joined_names in enumerate(change_parameters):
            for name in joined_names.split("+"):
                if name not in SCALES:
                    row = len(free) if name == SUPPLY else free.index(name)
                    weights[row, column] = 1.0
        return weights

    def _measurement_function(self, model: Model) -> AlongTrajectory:
        """Return the measured angles, (3,), with their derivatives by states and by free parameters."""

        # State x, voltages u, parameters p and time t, as symbols.
        def angles_and_derivatives(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> list[ca.SX]:
            angles = model.measurement(x, u, p, t)
            free = ca.vertcat(*(p[i] for i in self.functions.places))
            return [angles, ca.jacobian(angles, x), ca.jacobian(angles, free)]

        return model_along(model, angles_and_derivatives)

    def at(self, t_s: float, state: Floats, volts_V: Floats, step_s: float) -> Trajectory:
        """Return the point at which the functions are evaluated: time `t_s`, `state` of shape (n,) or (k, n),
        voltages `volts_V`, (2,), in a step of `step_s`.
        """
        rows = np.atleast_2d(state)
        return Trajectory(
            np.full(len(rows), t_s), rows, np.broadcast_to(volts_V, (len(rows), 2)), step_s, self.parameters
        )


def start_state(twin: TwinModel, t_s: Floats, angles_rad: Floats, volts_V: Floats, step_s: float) -> Floats:
    """Return the state from which the filter starts, (states,): that at the end of some measured steps.
    Shapes: `t_s` (n,), `angles_rad` (n, 3), `volts_V` (n, 2).
    """
    rate_steps = min(_RATE_STEPS, len(t_s) - 1)
    last_rate_rad_s = np.zeros(3)
    if rate_steps:
        last_rate_rad_s = (angles_rad[-1] - angles_rad[-1 - rate_steps]) / (rate_steps * step_s)
    state = np.concatenate((angles_rad[-1], last_rate_rad_s))
    state[: len(ZEROS)] -= np.deg2rad([twin.rig[name].value for name in ZEROS])
    if twin.functions.extra_states:
        # The states of effects follow from the measured motion.
        rates_rad_s = np.gradient(angles_rad, step_s, axis=0) if len(t_s) > 1 else np.zeros_like(angles_rad)
        motion = np.hstack((angles_rad, rates_rad_s))
        trajectory = Trajectory(t_s + 0.5 * step_s, motion, volts_V, step_s, twin.parameters)
        effect_states = twin.functions.integrate(trajectory, np.sign(rates_rad_s))
        state = np.concatenate((state, effect_states[-2]))
    return state
