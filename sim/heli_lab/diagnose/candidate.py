"""Candidates as regressors: what an effect of the catalogue, or a spline term, would change in a free run."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import casadi as ca
import numpy as np
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
from heli_lab.identify.functions import Floats
from heli_lab.innovations import Linear, MapEvaluator, Trajectory

_MIN_SPAN: Final = 1e-6
"""Range of a quantity, in its SI unit, below which it is constant and no curve over it is tried."""
_OWN_SUBSTEPS: Final = 4
"""Runge-Kutta steps of an effect's own states in each step of 10 ms: lags of a few milliseconds stay
stable."""


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
        found = {}
        for name in sizes:
            prior = self.effect.priors[name]
            found[name] = float(np.clip(0.0, prior.low + 1e-6 * prior.std, prior.high))
        return found

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


class Regressors:
    """Makes the regressors of candidates along a course."""

    def __init__(self, linear: Linear) -> None:
        self.linear = linear
        self.model = linear.model
        self._functions: dict[str, _ExtendedModel] = {}
        self._channels: dict[str, tuple[Floats, Floats]] = {}
        self._quantities: dict[str, dict[str, Floats]] = {}
        self._rates: MapEvaluator | None = None

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
        if effect.channel not in self._channels:
            values = {**effect.values, **dict.fromkeys(candidate.linear_parameters, 1.0)}
            self._channels[effect.channel] = _ExtendedModel(self.model, effect, ()).run(
                self.linear.trajectory, values
            )
        rates, measured = self._channels[effect.channel]
        where = "nodes" if effect.channel.startswith("measurement") else "middle"
        if where not in self._quantities:
            at = self.linear.nodes if where == "nodes" else self.linear.trajectory
            self._quantities[where] = quantity_values(self.model, at)
        low, step = effect.values[f"{effect.name}_low"], effect.values[f"{effect.name}_step"]
        weights = bspline_basis(self._quantities[where][effect.on], low, step)[:, None, :]
        return rates * weights, measured * weights if np.any(measured) else None

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
        if candidate.id not in self._functions and not candidate.effect.delay:
            self._functions[candidate.id] = _ExtendedModel(
                self.model, candidate.effect, candidate.linear_parameters
            )
        trajectory = self.linear.trajectory
        if candidate.effect.delay:
            return self._delayed(candidate), None
        function = self._functions[candidate.id]
        rates, measured = function.run(trajectory, candidate.effect.values)
        if not np.any(measured):
            return rates, None
        # Encoders are read at the beginning of a step.
        return rates, function.run(self.linear.nodes, candidate.effect.values)[1]

    def _delayed(self, candidate: Candidate) -> Floats:
        """What delayed voltages change: the model itself is the same."""
        if self._rates is None:
            model = self.model
            x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
            t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
            function = ca.Function("rates", [x, u, t, p], [ca.densify(model.dynamics(x, u, p, t))])
            self._rates = MapEvaluator(function, self.linear.rows)
        trajectory, record = self.linear.trajectory, self.linear.course.record
        delay_s = candidate.effect.values[candidate.effect.delay]
        middle_s = record.t_s - record.t_s[0] + 0.5 * record.step_s
        kernel = np.ones(max(1, round(trajectory.step_s / record.step_s)))
        smooth = [np.convolve(v, kernel / len(kernel), mode="same") for v in record.voltages_V.T]
        now, late = (
            np.column_stack([np.interp(trajectory.t_s - d, middle_s, v) for v in smooth])
            for d in (0.0, delay_s)
        )
        (after,) = self._rates(replace(trajectory, volts_V=late))
        (before,) = self._rates(replace(trajectory, volts_V=now))
        return after - before


class _ExtendedModel:
    """The change of rates and angles that one more effect makes in a model."""

    def __init__(self, model: Model, effect: Effect, linear: Sequence[str]) -> None:
        self.model, self.linear_parameters = model, linear
        self.more = type(model)((*model.effects, effect))
        self.effect = effect
        names = [quantity.name for quantity in self.more.parameters]
        own = [state.name for state in effect.states]
        self.places = [names.index(q.name) for q in model.parameters]
        self.own_places = {q.name: names.index(q.name) for q in effect.parameters}
        states = [state.name for state in self.more.states]
        base = [states.index(state.name) for state in model.states]
        extra = [states.index(name) for name in own]
        x, z = ca.SX.sym("x", len(model.states)), ca.SX.sym("z", len(own))
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
        self.state_count = len(own)
        self._evaluator: tuple[int, MapEvaluator] | None = None
        self._integrator: tuple[int, ca.Function] | None = None
        inputs = [ca.vertcat(x, z), u, t, p]
        self.function = ca.Function("change", inputs, ca.cse([ca.densify(o) for o in outputs]))
        if own:
            now = ca.Function("z", [z, x, u, t, p], [ca.vertcat(*(rates[i] for i in extra))])
            reset = ca.Function("zs", [z, x, u, t, p], [ca.vertcat(*(after[i] for i in extra))])
            h = ca.SX.sym("h")
            k1 = now(z, x, u, t, p)
            k2 = now(z + 0.5 * h * k1, x, u, t, p)
            k3 = now(z + 0.5 * h * k2, x, u, t, p)
            k4 = now(z + h * k3, x, u, t, p)
            end = reset(z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), x, u, t + h, p)
            self.step = ca.Function("step", [z, x, u, t, p, h], [end])

    def run(self, trajectory: Trajectory, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        parameters = np.empty(len(self.more.parameters))
        parameters[self.places] = trajectory.parameters
        for name, place in self.own_places.items():
            parameters[place] = values[name]
        state = trajectory.state
        if self.state_count:
            state = np.column_stack((state, self._own_states(trajectory, parameters)))
        if self._evaluator is None or self._evaluator[0] != len(state):
            self._evaluator = len(state), MapEvaluator(self.function, len(state))
        rates, measured = self._evaluator[1](
            Trajectory(trajectory.t_s, state, trajectory.volts_V, trajectory.step_s, parameters)
        )
        return rates, measured

    def _own_states(self, trajectory: Trajectory, parameters: Floats) -> Floats:
        """Own states in the middle of each step, from rest at the beginning of the flight."""
        n = len(trajectory.t_s)
        substeps = _OWN_SUBSTEPS
        h = trajectory.step_s / substeps
        if self._integrator is None or self._integrator[0] != n:
            self._integrator = n, self.step.mapaccum("integrated", n * substeps)
        result = self._integrator[1](
            np.zeros(self.state_count),
            np.repeat(trajectory.state, substeps, axis=0).T,
            np.repeat(trajectory.volts_V, substeps, axis=0).T,
            (np.repeat(trajectory.t_s, substeps) + h * np.tile(np.arange(substeps) - 2.0, n))[None],
            np.broadcast_to(parameters[:, None], (len(parameters), n * substeps)),
            np.full((1, n * substeps), h),
        )
        found: Floats = np.asarray(result).T.reshape(n, substeps, self.state_count)[:, substeps // 2 - 1]
        return found


def effect_candidates(kind: EffectKind, seconds: float) -> list[Candidate]:
    """Lay out the grid of an effect over a flight of `seconds`."""
    scan = kind.grid_values(seconds)
    candidates = []
    for point in itertools.product(*scan.values()):
        grid = dict(zip(scan, point, strict=True))
        values = kind.neutral if kind.size else kind.typical
        candidates.append(Candidate(kind.id, kind.make({**values, **grid}), kind.size, grid))
    return candidates


def spline_candidates(linears: Sequence[Linear], number: int = 0) -> list[Candidate]:
    """Spline terms of every channel on every quantity, over the range that the flights cover; `number`
    distinguishes those of one model.
    """
    model = linears[0].model
    together: dict[str, list[Floats]] = {}
    for linear in linears:
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
