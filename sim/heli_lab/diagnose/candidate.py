"""Candidates as regressors: what an effect of the catalogue, or a spline term, would change in a free run."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.base import Effect, Model
from heli_sim.model.effects.kind import EffectKind

from heli_lab.diagnose.spline_term import (
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


@dataclass(frozen=True)
class Candidate:
    """A candidate at one point of its grid.

    Parameters
    ----------
    id : str
        Id of the effect, or ``spline:CHANNEL:QUANTITY``.
    effect : Effect
        The effect at the values at which its influence is computed.
    linear_parameters : tuple of str
        Parameters that enter linearly: one regressor each. Without any there is one regressor, the difference
        between the effect at these values and none.
    grid : Mapping[str, float]
        Values of the parameters in which the likelihood is multimodal, by name.
    """

    id: str
    effect: Effect
    linear_parameters: tuple[str, ...]
    grid: Mapping[str, float] = field(default_factory=dict)

    @property
    def neutral(self) -> dict[str, float]:
        """Values of its sizes at which it does next to nothing, within the priors' bounds, by full name."""
        sizes = self.linear_parameters or tuple(self.effect.priors)[:1]
        values = {}
        for name in sizes:
            prior = self.effect.priors[name]
            values[name] = float(np.clip(0.0, prior.low + 1e-6 * prior.std, prior.high))
        return values

    @property
    def is_spline(self) -> bool:
        """Whether it is a spline term, not an effect of the catalogue."""
        return isinstance(self.effect, SplineTerm)

    def start_values(self, coefficients: Floats) -> dict[str, float]:
        """Values to start a fit from, by full name, within the priors' bounds, from the `coefficients` of the
        regressors, shape (g,).
        """
        values = {**self.effect.values}
        if self.linear_parameters:
            for name, change in zip(self.linear_parameters, coefficients, strict=True):
                values[name] += float(change)
        for name, prior in self.effect.priors.items():
            margin = 1e-3 * prior.std
            values[name] = float(np.clip(values[name], prior.low + margin, prior.high - margin))
        return values


def typical_candidate(kind: EffectKind) -> Candidate:
    """An effect of its typical size, for a refit to start from."""
    return Candidate(kind.id, kind.make(kind.typical), kind.size)


class ChangeFunctions:
    """The changes that candidates make in a `model`, as functions: those of all its flights are the same, and
    making one takes longer than to evaluate it along a flight of a minute.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._made: dict[str, ExtendedModel] = {}

    def of(self, name: str, effect: Effect, linear: Sequence[str]) -> ExtendedModel:
        """The change by an `effect`, known as `name`: for one unit of each of its `linear` parameters, or as
        it is where there are none.
        """
        if name not in self._made:
            self._made[name] = ExtendedModel(self.model, effect, linear)
        return self._made[name]

    @cached_property
    def rates(self) -> AlongTrajectory:
        """Rates of the model itself."""
        model = self.model
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
        t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
        return AlongTrajectory(ca.Function("rates", [x, u, t, p], [ca.densify(model.dynamics(x, u, p, t))]))


class Regressors:
    """Makes the regressors of candidates along a course, by `functions` of its model."""

    def __init__(self, linear: LinearisedFlight, functions: ChangeFunctions) -> None:
        self.linear = linear
        self.model = linear.model.source
        self._functions = functions
        self._channels: dict[str, tuple[Floats, Floats]] = {}
        self._quantities: dict[str, dict[str, Floats]] = {}
        self._directions: Floats = linear.reference.directions[linear.reference.rows]

    def release(self) -> None:
        """Give back what is kept of channels and quantities; it is made again when asked for."""
        self._channels.clear()
        self._quantities.clear()

    def spline_signals(self, candidate: Candidate) -> tuple[Floats, Floats | None]:
        """The same as `signals` for a spline term: its channel's influence times the B-spline basis.

        Returns
        -------
        rates : ndarray (n, states, g)
            For each state, as the filter takes them.
        measured_rad : ndarray (n, 3, g) or None
            Direct change of the measured angles, None where there is none.
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
        """Changes of rates and measured angles by one unit of a term's channel, shapes (n, states, 1) and
        (n, 3, 1). The first term that is asked for makes them for all terms of its channel.
        """
        if effect.channel not in self._channels:
            function = self._functions.of(f"spline:{effect.channel}", effect, ())
            # Any term of the channel will do: with all coefficients 1 the bumps add up to 1.
            values = {**function.effect.values, **dict.fromkeys(function.effect.priors, 1.0)}
            self._channels[effect.channel] = function.run(self.linear.trajectory, values, self._directions)
        return self._channels[effect.channel]

    def signals(self, candidate: Candidate) -> tuple[Floats, Floats | None]:
        """Changes of the rates and of the measured angles for one unit of each coefficient.

        Returns
        -------
        rates : ndarray (n, states, g)
            For each state, as the filter takes them.
        measured_rad : ndarray (n, 3, g) or None
            Direct change of the measured angles, None where there is none.
        """
        if candidate.is_spline:
            return self.spline_signals(candidate)
        trajectory = self.linear.trajectory
        if candidate.effect.delay:
            return self._delayed(candidate), None
        function = self._functions.of(candidate.id, candidate.effect, candidate.linear_parameters)
        rates, measured = function.run(trajectory, candidate.effect.values, self._directions)
        if not np.any(measured):
            return rates, None
        # Encoders are read at the beginning of a step.
        return rates, function.run(self.linear.nodes, candidate.effect.values, self._directions)[1]

    def _delayed(self, candidate: Candidate) -> Floats:
        """What delayed voltages change: the model itself is the same."""
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
    """The change of rates and angles that one more `effect` makes in a `model`, by its `linear` parameters,
    or without any by itself.
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
        """Evaluate along a `trajectory`, with `values` of the effect's parameters, and the `directions` that
        its axes were last seen to turn in, (n, 3), where it asks for them: changes of the rates,
        (n, states, g), and of the measured angles, (n, 3, g).
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
        """Own states in the middle of each step, from rest at the beginning of the flight."""
        return self.own.integrate(
            [trajectory.state, trajectory.inputs],
            trajectory.t_s,
            parameters,
            trajectory.step_s,
            EFFECT_SUBSTEPS,
            EFFECT_SUBSTEPS // 2 - 1,
        )


def effect_candidates(kind: EffectKind, seconds: float) -> list[Candidate]:
    """Lay out the grid of an effect over a flight of `seconds`."""
    scan = kind.grid_values(seconds)
    candidates = []
    for point in itertools.product(*scan.values()):
        grid = dict(zip(scan, point, strict=True))
        values = kind.neutral if kind.size else kind.typical
        candidates.append(Candidate(kind.id, kind.make({**values, **grid}), kind.size, grid))
    return candidates


def spline_candidates(linearised_flights: Sequence[LinearisedFlight], number: int = 0) -> list[Candidate]:
    """Spline terms of every channel on every quantity, over the range that the flights cover; `number`
    distinguishes those of one model.
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
        made = spline_term(channel, on, low, step, number)
        candidates.append(Candidate(f"spline:{channel}:{on}", made, tuple(made.priors)))
    return candidates
