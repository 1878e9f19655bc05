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

_MIN_SPAN: Final = 1e-6
"""Range of a quantity, in its SI unit, below which it is constant and no curve over it is tried."""


class ChangeFunctions:
    """Changes of a `model` by candidates, as compiled functions that all flights share: to make one takes
    longer than to evaluate it along a flight of one minute.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._made: dict[str, ExtendedModel] = {}

    def of(self, name: str, effect: Effect, linear: Sequence[str]) -> ExtendedModel:
        """Return the model extended by an effect.

        Parameters
        ----------
        name : str
            Key under which it is cached.
        linear : sequence of str
            Parameters that enter linearly; the change is that of one unit of each. If there is none, it is
            the change by the whole effect.
        """
        if name not in self._made:
            self._made[name] = ExtendedModel(self.model, effect, linear)
        return self._made[name]

    @cached_property
    def rates(self) -> AlongTrajectory:
        """Rates of the model without any candidate."""
        model = self.model
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
        t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
        return AlongTrajectory(ca.Function("rates", [x, u, t, p], [ca.densify(model.dynamics(x, u, p, t))]))


class Regressors:
    """Regressors of candidates along the `linear` trajectory of one flight, by `functions` of its model."""

    def __init__(self, linear: LinearisedFlight, functions: ChangeFunctions) -> None:
        self.linear = linear
        self.model = linear.model.source
        self._functions = functions
        self._channels: dict[str, tuple[Floats, Floats]] = {}
        self._quantities: dict[str, dict[str, Floats]] = {}
        self._directions: Floats = linear.reference.directions[linear.reference.rows]

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
        where = "nodes" if effect.channel.startswith("measurement") else "middle"
        if where not in self._quantities:
            at = self.linear.nodes if where == "nodes" else self.linear.trajectory
            self._quantities[where] = quantity_values(self.model, at)
        low, step = effect.values[f"{effect.name}_low"], effect.values[f"{effect.name}_step"]
        weights = bspline_basis(self._quantities[where][effect.on], low, step)[:, None, :]
        return rates * weights, measured * weights if np.any(measured) else None

    def influence(self, effect: SplineTerm) -> tuple[Floats, Floats]:
        """Changes of rates, (n, states, 1), and of measured angles, (n, 3, 1), by one unit on the channel of
        a spline term `effect`; cached for all terms of the channel.
        """
        if effect.channel not in self._channels:
            function = self._functions.of(f"spline:{effect.channel}", effect, ())
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
            return self._delayed(candidate), None
        function = self._functions.of(candidate.id, candidate.effect, candidate.linear_parameters)
        values = candidate.effect.values_in(self.linear.reference.record.label, candidate.effect.values)
        rates, measured = function.run(trajectory, values, self._directions)
        if not np.any(measured):
            return rates, None
        # Encoders are read at the beginning of a step.
        return rates, function.run(self.linear.nodes, values, self._directions)[1]

    def _delayed(self, candidate: Candidate) -> Floats:
        """Changes of the rates by delayed voltages; the model itself is unchanged."""
        trajectory, record = self.linear.trajectory, self.linear.reference.record
        delay_s = candidate.effect.values[candidate.effect.delay]
        middle_s = record.t_s - record.t_s[0] + 0.5 * record.step_s
        kernel = np.ones(max(1, round(trajectory.step_s / record.step_s)))
        smooth = [np.convolve(v, kernel / len(kernel), mode="same") for v in record.inputs.T]
        now, late = (
            np.column_stack([np.interp(trajectory.t_s - d, middle_s, v) for v in smooth])
            for d in (0.0, delay_s)
        )
        (after,) = self._functions.rates(replace(trajectory, inputs=late))
        (before,) = self._functions.rates(replace(trajectory, inputs=now))
        return after - before


class ExtendedModel:
    """A `model` with one more `effect`, and the change of rates and measured angles by its `linear`
    parameters, or by the whole effect if there are none.

    Attributes
    ----------
    more : Model
        The model with the effect.
    places : list of int
        Indices of the model's parameters among those of `more`.
    own_places : dict of int
        Indices of the effect's parameters among them, by full name.
    state_count : int
        Number of states of the effect.
    change : AlongTrajectory
        Function of a trajectory with two results: derivatives of rates and measured angles by each linear
        parameter, or their changes by the whole effect.
    own : EffectStates
        Integrator of the effect's states, if it has any.
    """

    def __init__(self, model: Model, effect: Effect, linear: Sequence[str]) -> None:
        effect = effect.with_measured_angles()
        self.model, self.linear_parameters = model, linear
        self.more = type(model)((*model.effects, effect))
        self.effect = effect
        names = [quantity.name for quantity in self.more.parameters]
        state_names = [state.name for state in effect.states]
        self.places = [names.index(q.name) for q in model.parameters]
        self.own_places = {q.name: names.index(q.name) for q in effect.parameters}
        states = [state.name for state in self.more.states]
        base = [states.index(state.name) for state in model.states]
        extra = [states.index(name) for name in state_names]
        x, z = ca.SX.sym("x", len(model.states)), ca.SX.sym("z", len(state_names))
        u, t, p = ca.SX.sym("u", 2), ca.SX.sym("t"), ca.SX.sym("p", len(names))
        both = ca.SX(len(states), 1)
        for i, place in enumerate(base):
            both[place] = x[i]
        for i, place in enumerate(extra):
            both[place] = z[i]
        rates, angles = self.more.dynamics(both, u, p, t), self.more.measurement(both, u, p, t)
        after = self.more.reset_map(both, u, p, t)
        p_base = ca.vertcat(*(p[i] for i in self.places))
        if linear:
            by = ca.vertcat(*(p[self.own_places[name]] for name in linear))
            outputs = [ca.jacobian(ca.vertcat(*(rates[i] for i in base)), by), ca.jacobian(angles, by)]
        else:
            outputs = [
                ca.vertcat(*(rates[i] for i in base)) - model.dynamics(x, u, p_base, t),
                angles - model.measurement(x, u, p_base, t),
            ]
        self.state_count = len(state_names)
        inputs = [ca.vertcat(x, z), u, t, p]
        self.change = AlongTrajectory(ca.Function("change", inputs, [ca.densify(o) for o in outputs]))
        if state_names:
            inputs = [z, t, x, u, p]
            self.own = EffectStates(
                ca.Function("rates", inputs, [ca.densify(ca.vertcat(*(rates[i] for i in extra)))]),
                ca.Function("resets", inputs, [ca.densify(ca.vertcat(*(after[i] for i in extra)))]),
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
            Changes of the rates, per unit of each of g linear parameters or by the whole effect.
        angles : ndarray (n, 3, g)
            Changes of the measured angles.
        """
        parameters = np.empty(len(self.more.parameters))
        parameters[self.places] = trajectory.parameters
        for name, place in self.own_places.items():
            parameters[place] = values[name]
        state = trajectory.state
        if self.state_count:
            effect_states = self._own_states(trajectory, parameters)
            for place, axis in known_directions([self.effect]):
                if directions is not None:
                    effect_states[:, place] = directions[:, axis]
            state = np.column_stack((state, effect_states))
        rates, measured = self.change(
            Trajectory(trajectory.t_s, state, trajectory.inputs, trajectory.step_s, parameters)
        )
        return rates, measured

    def _own_states(self, trajectory: Trajectory, parameters: Floats) -> Floats:
        """States of the effect in the middle of each step, from rest at the beginning of the flight."""
        return self.own.integrate(
            [trajectory.state, trajectory.inputs],
            trajectory.t_s,
            parameters,
            trajectory.step_s,
            EFFECT_SUBSTEPS,
            EFFECT_SUBSTEPS // 2 - 1,
        )


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
    together: dict[str, list[Floats]] = {}
    for linear in linearised_flights:
        for name, values in quantity_values(model, linear.trajectory).items():
            together.setdefault(name, []).append(values)
    candidates = []
    for channel, on in channel_quantity_pairs():
        low, step = knot_span(np.concatenate(together[on]))
        if step * (KNOTS - 1) < _MIN_SPAN:
            continue
        effect = spline_term(channel, on, low, step, number)
        candidates.append(Candidate(f"spline:{channel}:{on}", effect, tuple(effect.priors)))
    return candidates
