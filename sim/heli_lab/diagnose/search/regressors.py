"""Regressors of the innovations: what a candidate changes in the rates and in the measured angles of a
flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.base import Effect, Model

from heli_lab.diagnose.search.candidate import Candidate
from heli_lab.diagnose.search.splines import (
    KNOTS,
    SplineTerm,
    bspline_basis,
    channel_quantity_pairs,
    knot_span,
    quantity_values,
    spline_term,
)
from heli_lab.estimation import EFFECT_SUBSTEPS, AlongTrajectory, EffectStates, LinearisedFlight, Trajectory
from heli_lab.identify.flight_model import known_directions
from heli_lab.identify.model_along import model_along

_MIN_RANGE: Final = 1e-6
"""Range of a quantity, in its SI unit, below which it is constant and no curve over it is tried."""


class ChangeFunctions:
    """Changes of a `model` by candidates, as compiled functions that all flights share: to make one takes
    longer than to evaluate it along a flight of one minute.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._extended_models: dict[str, ExtendedModel] = {}

    def extended(self, name: str, effect: Effect, linear: Sequence[str]) -> ExtendedModel:
        """Return the model extended by an effect.

        Parameters
        ----------
        name : str
            Key under which it is cached.
        linear : sequence of str
            Parameters that enter linearly; the change is that of one unit of each. If there is none, it is
            the change by the whole effect.
        """
        if name not in self._extended_models:
            self._extended_models[name] = ExtendedModel(self.model, effect, linear)
        return self._extended_models[name]

    @cached_property
    def rates(self) -> AlongTrajectory:
        """Rates of the model without any candidate."""
        return model_along(self.model, lambda x, u, p, t: [self.model.dynamics(x, u, p, t)])


class Regressors:
    """Regressors of candidates along the `linear` trajectory of one flight, by `functions` of its model."""

    def __init__(self, linear: LinearisedFlight, functions: ChangeFunctions) -> None:
        self.linear = linear
        self.model = linear.model.source
        self._functions = functions
        # By channel: rates (n, states, 1), measured angles (n, 3, 1).
        self._channels: dict[str, tuple[Floats, Floats]] = {}
        # By whether at the nodes or in the middle of steps, and by quantity: shape (n,).
        self._quantities: dict[str, dict[str, Floats]] = {}
        self._directions: Floats = linear.reference.directions[linear.reference.rows]  # (n, 3)

    def release(self) -> None:
        """Free the memory of cached channels and quantities; they are computed again when needed."""
        self._channels.clear()
        self._quantities.clear()

    def spline_signals(self, candidate: Candidate) -> tuple[Floats, Floats | None]:
        """Compute the changes by a spline term, as `signals` does: influence of its channel times B-spline
        basis.

        Returns
        -------
        rates : ndarray (n, states, g)
            Change of the rate of each state.
        measured_rad : ndarray (n, 3, g) or None
            Direct change of the measured angles; None if there is none.
        """
        effect = candidate.effect
        assert isinstance(effect, SplineTerm)
        rates, measured = self.influence(effect)
        instant = "nodes" if effect.channel.startswith("measurement") else "middle"
        if instant not in self._quantities:
            trajectory = self.linear.nodes if instant == "nodes" else self.linear.trajectory
            self._quantities[instant] = quantity_values(self.model, trajectory)
        basis = bspline_basis(self._quantities[instant][effect.on], *effect.knots)[:, None, :]
        return rates * basis, measured * basis if np.any(measured) else None

    def influence(self, effect: SplineTerm) -> tuple[Floats, Floats]:
        """Return the changes by one unit on the channel of a spline term; all terms of a channel share them.

        Parameters
        ----------
        effect : SplineTerm
            Any term of the channel.

        Returns
        -------
        rates : ndarray (n, states, 1)
            Changes of the rates.
        measured_rad : ndarray (n, 3, 1)
            Direct changes of the measured angles.
        """
        if effect.channel not in self._channels:
            function = self._functions.extended(f"spline:{effect.channel}", effect, ())
            # With all coefficients 1 the basis functions of any term of the channel add up to 1.
            values = {**function.effect.values, **dict.fromkeys(function.effect.priors, 1.0)}
            self._channels[effect.channel] = function.run(self.linear.trajectory, values, self._directions)
        return self._channels[effect.channel]

    def signals(self, candidate: Candidate) -> tuple[Floats, Floats | None]:
        """Compute the changes of rates and measured angles by one unit of each coefficient of a candidate.

        Returns
        -------
        rates : ndarray (n, states, g)
            Change of the rate of each state.
        measured_rad : ndarray (n, 3, g) or None
            Direct change of the measured angles; None if there is none.
        """
        if candidate.is_spline:
            return self.spline_signals(candidate)
        trajectory = self.linear.trajectory
        if candidate.effect.delay:
            return self._delayed_rates(candidate), None
        function = self._functions.extended(candidate.id, candidate.effect, candidate.linear_parameters)
        values = candidate.effect.values_in(self.linear.reference.record.label, candidate.effect.values)
        rates, measured = function.run(trajectory, values, self._directions)
        if not np.any(measured):
            return rates, None
        # Encoders are read at the beginning of a step.
        return rates, function.run(self.linear.nodes, values, self._directions)[1]

    def _delayed_rates(self, candidate: Candidate) -> Floats:
        """Return the changes of the rates by delayed voltages, shape (n, states, 1).

        The voltages are averaged over a step of the trajectory, and then interpolated.
        """
        trajectory, record = self.linear.trajectory, self.linear.reference.record
        row_middle_s = record.t_s - record.t_s[0] + 0.5 * record.step_s
        window = np.ones(max(1, round(trajectory.step_s / record.step_s)))
        mean_inputs = [np.convolve(column, window / len(window), mode="same") for column in record.inputs.T]

        def rates_with_delay(delay_s: float) -> Floats:
            times_s = trajectory.t_s - delay_s
            inputs = np.column_stack([np.interp(times_s, row_middle_s, column) for column in mean_inputs])
            (rates,) = self._functions.rates(replace(trajectory, inputs=inputs))
            return rates

        delay_s = candidate.effect.values[candidate.effect.delay]
        return rates_with_delay(delay_s) - rates_with_delay(0.0)


class ExtendedModel:
    """A `model` with one more `effect`, and the change of rates and measured angles by its `linear`
    parameters, or by the whole effect if there are none.

    Attributes
    ----------
    extended_model : Model
        The model with the effect.
    model_parameters : list of int
        Indices of the model's parameters among those of the extended model.
    effect_parameters : dict of int
        Indices of the effect's parameters among them, by full name.
    effect_state_count : int
        Number of states of the effect.
    change : AlongTrajectory
        Function of a trajectory with two results: derivatives of rates and measured angles by each linear
        parameter, or their changes by the whole effect.
    effect_states : EffectStates
        Integrator of the effect's states, if it has any.
    """

    def __init__(self, model: Model, effect: Effect, linear: Sequence[str]) -> None:
        effect = effect.with_measured_angles()
        self.effect, self.linear_parameters = effect, linear
        self.extended_model = type(model)((*model.effects, effect))
        names = self.extended_model.parameter_names
        self.model_parameters = [names.index(quantity.name) for quantity in model.parameters]
        self.effect_parameters = {quantity.name: names.index(quantity.name) for quantity in effect.parameters}
        state_names = [state.name for state in self.extended_model.states]
        model_states = [state_names.index(state.name) for state in model.states]
        effect_states = [state_names.index(state.name) for state in effect.states]
        self.effect_state_count = len(effect_states)

        x, z = ca.SX.sym("x", len(model_states)), ca.SX.sym("z", len(effect_states))
        u, t, p = ca.SX.sym("u", 2), ca.SX.sym("t"), ca.SX.sym("p", len(names))
        extended_x = ca.SX(len(state_names), 1)
        for i, row in enumerate(model_states):
            extended_x[row] = x[i]
        for i, row in enumerate(effect_states):
            extended_x[row] = z[i]
        rates = self.extended_model.dynamics(extended_x, u, p, t)
        angles = self.extended_model.measurement(extended_x, u, p, t)
        model_rates = _rows(rates, model_states)
        if linear:
            coefficients = _rows(p, [self.effect_parameters[name] for name in linear])
            changes = [ca.jacobian(model_rates, coefficients), ca.jacobian(angles, coefficients)]
        else:
            model_p = _rows(p, self.model_parameters)
            changes = [
                model_rates - model.dynamics(x, u, model_p, t),
                angles - model.measurement(x, u, model_p, t),
            ]
        inputs = [ca.vertcat(x, z), u, t, p]
        self.change = AlongTrajectory(ca.Function("change", inputs, [ca.densify(c) for c in changes]))
        if effect_states:
            reset_x = self.extended_model.reset_map(extended_x, u, p, t)
            inputs = [z, t, x, u, p]
            self.effect_states = EffectStates(
                ca.Function("rates", inputs, [ca.densify(_rows(rates, effect_states))]),
                ca.Function("resets", inputs, [ca.densify(_rows(reset_x, effect_states))]),
            )

    def run(
        self, trajectory: Trajectory, values: Mapping[str, float], directions: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Evaluate the changes along a trajectory.

        Parameters
        ----------
        trajectory : Trajectory
            States, voltages and parameters of the model without the effect.
        values : Mapping[str, float]
            Parameters of the effect by full name.
        directions : ndarray (n, 3), optional
            Direction in which each axis was last seen to turn, for effects that depend on it.

        Returns
        -------
        rates : ndarray (n, states, g)
            Changes of the rates.
        measured_rad : ndarray (n, 3, g)
            Changes of the measured angles.
        """
        parameters = np.empty(len(self.extended_model.parameters))
        parameters[self.model_parameters] = trajectory.parameters
        for name, index in self.effect_parameters.items():
            parameters[index] = values[name]
        state = trajectory.state
        if self.effect_state_count:
            effect_states = self._simulate_effect_states(trajectory, parameters)
            for column, axis in known_directions([self.effect]):
                if directions is not None:
                    effect_states[:, column] = directions[:, axis]
            state = np.column_stack((state, effect_states))
        rates, measured = self.change(
            Trajectory(trajectory.t_s, state, trajectory.inputs, trajectory.step_s, parameters)
        )
        return rates, measured

    def _simulate_effect_states(self, trajectory: Trajectory, parameters: Floats) -> Floats:
        """Return the states of the effect in the middle of each step, shape (n, effect states), from rest at
        the beginning of the flight.
        """
        middle_substep = EFFECT_SUBSTEPS // 2 - 1
        return self.effect_states.integrate(replace(trajectory, parameters=parameters), middle_substep)


def _rows(column: ca.SX, rows: Sequence[int]) -> ca.SX:
    """Return some rows of a column of symbols."""
    return ca.vertcat(*(column[row] for row in rows))


def spline_candidates(linearised_flights: Sequence[LinearisedFlight], number: int = 0) -> list[Candidate]:
    """Make the spline terms of all channels on all quantities.

    Parameters
    ----------
    linearised_flights : sequence of LinearisedFlight
        The flights, whose range of each quantity the knots cover.
    number : int
        Distinguishes spline terms of one model.
    """
    model = linearised_flights[0].model.source
    values_by_quantity: dict[str, list[Floats]] = {}
    for linear in linearised_flights:
        for name, values in quantity_values(model, linear.trajectory).items():
            values_by_quantity.setdefault(name, []).append(values)
    candidates = []
    for channel, quantity in channel_quantity_pairs():
        low, step = knot_span(np.concatenate(values_by_quantity[quantity]))
        if step * (KNOTS - 1) < _MIN_RANGE:
            continue
        candidates.append(spline_candidate(spline_term(channel, quantity, low, step, number)))
    return candidates


def spline_candidate(term: SplineTerm) -> Candidate:
    """Make a candidate of a spline `term`."""
    return Candidate(f"spline:{term.channel}:{term.on}", term, tuple(term.priors))
