"""Signals of candidates: how a flight's rates and measured angles change if a candidate joins the model.

A score test filters these signals, which makes them regressors of the innovations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final, NamedTuple

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Effect, Model

from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.search.splines import (
    KNOTS,
    SplineTerm,
    bspline_basis,
    channel_quantity_pairs,
    knot_span,
    quantity_values,
    spline_term,
)
from heli_lab.fit.flight_model import known_directions, model_along
from heli_lab.fit.linearised_flight import LinearisedFlight
from heli_lab.fit.model_functions import (
    EFFECT_SUBSTEPS,
    AlongTrajectory,
    EffectStates,
    Trajectory,
)

_MIN_RANGE: Final = 1e-6
"""Range of a quantity, in its SI unit, below which it is constant and no curve over it is tried."""


class CandidateSignals(NamedTuple):
    """Changes of a flight by one unit of each coefficient of a candidate, or of several candidates."""

    rates: Floats  # (n, states, g): Change of the rate of each state; g counts the coefficients
    measured_rad: Floats | None  # (n, 3, g): Direct change of the measured angles; None if there is none


class ChangeAlongTrajectory(NamedTuple):
    """Changes that an effect makes along a trajectory.

    `rates` has the shape (n, states, g), and `measured_rad` the shape (n, 3, g), where g counts coefficients.
    Entries are zero if the effect does not change them.
    """

    rates: Floats
    measured_rad: Floats


class ChangeFunctions:
    """Cache of the functions that compute how candidates change a `model`.

    All flights share them, because compiling one takes longer than evaluating it along a flight of one
    minute.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._extended_models: dict[str, ExtendedModel] = {}

    def extended(self, name: str, effect: Effect, linear_parameters: Sequence[str]) -> ExtendedModel:
        """Return the model extended by an effect."""
        if name not in self._extended_models:
            self._extended_models[name] = ExtendedModel(self.model, effect, linear_parameters)
        return self._extended_models[name]

    @cached_property
    def rates(self) -> AlongTrajectory:
        """Rates of the model without any candidate."""
        return model_along(self.model, lambda x, u, p, t: [self.model.dynamics(x, u, p, t)])


class Regressors:
    """Computes the signals of candidates along one flight."""

    def __init__(self, linear: LinearisedFlight, functions: ChangeFunctions) -> None:
        self.linear = linear
        self.model = linear.model.source
        self._functions = functions
        # Change by one unit on a channel of spline terms, by channel; each has one column (g = 1).
        self._channel_changes: dict[str, ChangeAlongTrajectory] = {}
        # Quantities of spline terms by name, shape (n,) each: at the "nodes" and in the "middle" of steps.
        self._quantities: dict[str, dict[str, Floats]] = {}
        # Direction in which each axis was last seen to turn, (n, 3).
        self._directions: Floats = linear.reference.directions[linear.reference.rows]

    def release(self) -> None:
        """Free the memory of cached channels and quantities; they are computed again when needed."""
        self._channel_changes.clear()
        self._quantities.clear()

    def signals(self, candidate: Candidate) -> CandidateSignals:
        """Compute the change of the flight by one unit of each coefficient of a candidate."""
        if candidate.is_spline:
            return self.spline_signals(candidate)
        if candidate.effect.delay:
            return CandidateSignals(self._delayed_rates(candidate), None)
        extended_model = self._functions.extended(candidate.id, candidate.effect, candidate.linear_parameters)
        values = candidate.effect.values_in(self.linear.reference.record.label, candidate.effect.values)
        rates, measured_rad = extended_model.run(self.linear.trajectory, values, self._directions)
        if not np.any(measured_rad):
            return CandidateSignals(rates, None)
        # Encoders are read at the beginning of a step, rates change in its middle.
        at_nodes = extended_model.run(self.linear.nodes, values, self._directions)
        return CandidateSignals(rates, at_nodes.measured_rad)

    def spline_signals(self, candidate: Candidate) -> CandidateSignals:
        """Compute the change of the flight by one unit of each coefficient of a spline term.

        This is the change by one unit on the channel of the term, times each B-spline basis function.
        """
        term = candidate.effect
        assert isinstance(term, SplineTerm)
        rates, measured_rad = self.influence(term)
        instant = "nodes" if term.channel.startswith("measurement") else "middle"
        if instant not in self._quantities:
            trajectory = self.linear.nodes if instant == "nodes" else self.linear.trajectory
            self._quantities[instant] = quantity_values(self.model, trajectory)
        basis = bspline_basis(self._quantities[instant][term.on], *term.knots)[:, None, :]  # (n, 1, KNOTS)
        return CandidateSignals(rates * basis, measured_rad * basis if np.any(measured_rad) else None)

    def influence(self, term: SplineTerm) -> ChangeAlongTrajectory:
        """Return the change of the flight by one unit on a channel, such as 1 N m about pitch.

        It is computed once per channel, because all spline terms of a channel share it.
        """
        if term.channel not in self._channel_changes:
            extended_model = self._functions.extended(f"spline:{term.channel}", term, ())
            # The basis functions add up to 1: with all coefficients 1 the term is 1, whatever its quantity.
            values = {**extended_model.effect.values, **dict.fromkeys(extended_model.effect.priors, 1.0)}
            self._channel_changes[term.channel] = extended_model.run(
                self.linear.trajectory, values, self._directions
            )
        return self._channel_changes[term.channel]

    def _delayed_rates(self, candidate: Candidate) -> Floats:
        """Return the changes of the rates by delayed voltages, shape (n, states, 1).

        The logged voltages are averaged over a step of the trajectory, then interpolated at delayed times.
        The change is taken between two interpolations, so that averaging itself changes nothing.
        """
        trajectory, record = self.linear.trajectory, self.linear.reference.record
        # A logged voltage is held over its row, so it counts at the middle of the row.
        row_middle_s = record.t_s - record.t_s[0] + 0.5 * record.step_s
        rows_per_step = max(1, round(trajectory.step_s / record.step_s))
        moving_mean = np.ones(rows_per_step) / rows_per_step
        mean_inputs = [np.convolve(column, moving_mean, mode="same") for column in record.inputs.T]

        def rates_with_delay(delay_s: float) -> Floats:
            """Return the rates if the voltages act later by `delay_s`."""
            times_s = trajectory.t_s - delay_s
            inputs = np.column_stack([np.interp(times_s, row_middle_s, column) for column in mean_inputs])
            (rates,) = self._functions.rates(replace(trajectory, inputs=inputs))
            return rates

        delay_s = candidate.effect.values[candidate.effect.delay]
        return rates_with_delay(delay_s) - rates_with_delay(0.0)


class _Symbols(NamedTuple):
    """CasADi symbols on which the equations of an extended model depend.

    The states of the model, `x`, and those of the effect, `z`, are separate symbols. Trajectories contain `x`
    only; `z` is integrated along them. `extended_x` has the symbols of both, in the order of the extended
    model. `u` are the voltages, `p` the parameters of the extended model, and `t` is the time.
    """

    x: ca.SX
    z: ca.SX
    u: ca.SX
    p: ca.SX
    t: ca.SX
    extended_x: ca.SX


class ExtendedModel:
    """A model with one more effect, which computes how the effect changes rates and measured angles.

    An effect that is linear in some parameters is described by derivatives: the change by one unit of each.
    Any other effect is described by a difference: the model with it less the model without it.
    """

    def __init__(self, model: Model, effect: Effect, linear_parameters: Sequence[str]) -> None:
        self.model, self.linear_parameters = model, linear_parameters
        self.effect = effect = effect.with_measured_angles()
        self.extended_model = type(model)((*model.effects, effect))
        # Places of parameters and states of the model and of the effect among those of the extended model.
        names = self.extended_model.parameter_names
        self._model_parameters = [names.index(quantity.name) for quantity in model.parameters]
        self._effect_parameters = {
            quantity.name: names.index(quantity.name) for quantity in effect.parameters
        }
        state_names = [state.name for state in self.extended_model.states]
        self._model_states = [state_names.index(state.name) for state in model.states]
        self._effect_states = [state_names.index(state.name) for state in effect.states]
        symbols = self._symbols()
        self._change = self._compiled_change(symbols)
        self.effect_states = self._compiled_effect_states(symbols) if effect.states else None

    def _symbols(self) -> _Symbols:
        """Return symbols for states, voltages, parameters and time."""
        x, z = ca.SX.sym("x", len(self._model_states)), ca.SX.sym("z", len(self._effect_states))
        extended_x = ca.SX(len(self.extended_model.states), 1)
        for symbol, places in ((x, self._model_states), (z, self._effect_states)):
            for i, place in enumerate(places):
                extended_x[place] = symbol[i]
        p = ca.SX.sym("p", len(self.extended_model.parameters))
        return _Symbols(x, z, ca.SX.sym("u", 2), p, ca.SX.sym("t"), extended_x)

    def _compiled_change(self, symbols: _Symbols) -> AlongTrajectory:
        """Compile the changes of the rates of the model's states, and of the measured angles."""
        x, z, u, p, t, extended_x = symbols
        rates = _rows(self.extended_model.dynamics(extended_x, u, p, t), self._model_states)
        angles = self.extended_model.measurement(extended_x, u, p, t)
        if self.linear_parameters:
            coefficients = _rows(p, [self._effect_parameters[name] for name in self.linear_parameters])
            changes = [ca.jacobian(rates, coefficients), ca.jacobian(angles, coefficients)]
        else:
            model_p = _rows(p, self._model_parameters)
            changes = [
                rates - self.model.dynamics(x, u, model_p, t),
                angles - self.model.measurement(x, u, model_p, t),
            ]
        arguments = [ca.vertcat(x, z), u, t, p]
        return AlongTrajectory(ca.Function("change", arguments, [ca.densify(change) for change in changes]))

    def _compiled_effect_states(self, symbols: _Symbols) -> EffectStates:
        """Compile the rates of the effect's states, and their jumps at the end of a step."""
        x, z, u, p, t, extended_x = symbols
        rates = _rows(self.extended_model.dynamics(extended_x, u, p, t), self._effect_states)
        resets = _rows(self.extended_model.reset_map(extended_x, u, p, t), self._effect_states)
        arguments = [z, t, x, u, p]
        return EffectStates(
            ca.Function("rates", arguments, [ca.densify(rates)]),
            ca.Function("resets", arguments, [ca.densify(resets)]),
        )

    def run(
        self, trajectory: Trajectory, values: Mapping[str, float], directions: Floats | None = None
    ) -> ChangeAlongTrajectory:
        """Evaluate the changes by the effect along a trajectory. Shapes: `directions` (n, 3)."""
        parameters = np.empty(len(self.extended_model.parameters))
        parameters[self._model_parameters] = trajectory.parameters
        for name, place in self._effect_parameters.items():
            parameters[place] = values[name]
        state = trajectory.state
        if self.effect_states is not None:
            # States in the middle of each step, (n, effect states), from rest at the beginning of the flight.
            middle_substep = EFFECT_SUBSTEPS // 2 - 1
            effect_states = self.effect_states.integrate(
                replace(trajectory, parameters=parameters), middle_substep
            )
            for column, axis in known_directions([self.effect]):
                if directions is not None:
                    effect_states[:, column] = directions[:, axis]
            state = np.column_stack((state, effect_states))
        rates, measured_rad = self._change(
            Trajectory(trajectory.t_s, state, trajectory.inputs, trajectory.step_s, parameters)
        )
        return ChangeAlongTrajectory(rates, measured_rad)


def _rows(column: ca.SX, rows: Sequence[int]) -> ca.SX:
    """Return some rows of a column of symbols, in the order of `rows`."""
    return ca.vertcat(*(column[row] for row in rows))


def spline_candidates(linearised_flights: Sequence[LinearisedFlight], number: int = 0) -> list[Candidate]:
    """Make the spline terms of all channels on all quantities."""
    model = linearised_flights[0].model.source
    quantities_by_flight = [quantity_values(model, linear.trajectory) for linear in linearised_flights]
    candidates = []
    for channel, quantity in channel_quantity_pairs():
        low, step = knot_span(np.concatenate([values[quantity] for values in quantities_by_flight]))
        if step * (KNOTS - 1) < _MIN_RANGE:
            continue
        candidates.append(spline_candidate(spline_term(channel, quantity, low, step, number)))
    return candidates


def spline_candidate(term: SplineTerm) -> Candidate:
    """Make a candidate of a spline `term`."""
    return Candidate(f"spline:{term.channel}:{term.on}", term, tuple(term.priors))
