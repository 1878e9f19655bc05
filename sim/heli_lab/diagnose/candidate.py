"""Candidates as columns: what an effect of the catalogue, or a pattern, would do to a fit's predictions."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import casadi as ca
import numpy as np
from heli_sim.model.base import Effect, Model
from heli_sim.model.effects.kind import EffectKind

from heli_lab.diagnose.linearisation import Linearisation, MapEvaluator, Path
from heli_lab.diagnose.spline_term import (
    KNOTS,
    SplineTerm,
    bspline_basis,
    choices,
    quantity_values,
    span_of,
    spline_term,
)
from heli_lab.identify.functions import Floats

_LEAST_SPAN: Final = 1e-6


@dataclass(frozen=True)
class Candidate:
    """One candidate at one place of what must be searched.

    Parameters
    ----------
    id : str
        Id of the effect, or ``pattern:CHANNEL:QUANTITY``.
    effect : Effect
        The effect at the values at which its influence is computed.
    size : tuple of str
        Parameters that enter linearly: one column each. Without any there is one column, the difference
        between the effect at these values and none.
    scanned : Mapping[str, float]
        Values of the numbers that are searched.
    """

    id: str
    effect: Effect
    size: tuple[str, ...]
    scanned: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_spline(self) -> bool:
        """Whether it is a pattern, not an effect of the catalogue."""
        return isinstance(self.effect, SplineTerm)

    def started(self, coefficients: Floats) -> dict[str, float]:
        """Values to start a fit from.

        Parameters
        ----------
        coefficients : ndarray (g,)
            Coefficient of each column.

        Returns
        -------
        dict of float
            By full name, within the priors' bounds.
        """
        values = {**self.effect.values}
        if self.size:
            for name, change in zip(self.size, coefficients, strict=True):
                values[name] += float(change)
        for name, prior in self.effect.priors.items():
            margin = 1e-3 * prior.std
            values[name] = float(np.clip(values[name], prior.low + margin, prior.high - margin))
        return values


class Regressors:
    """Makes the columns of trials around a fit.

    Parameters
    ----------
    tangent : Linearisation
        The fit's prediction of one flight.
    """

    def __init__(self, tangent: Linearisation) -> None:
        self.tangent = tangent
        self.model = tangent.fit.problem.model
        self._functions: dict[str, _Extended] = {}
        self._channels: dict[str, tuple[Floats, Floats]] = {}
        self._quantities: dict[str, Floats] = {}
        self._rates: MapEvaluator | None = None

    def spline_signals(self, candidate: Candidate) -> tuple[Floats, Floats | None]:
        """The same as `signals` for a pattern: its channel's influence times the bumps of its curve.

        Parameters
        ----------
        candidate : Candidate
            The pattern.

        Returns
        -------
        rates : ndarray (n, states, g)
            As `Linearisation.answer` takes them.
        seen_rad : ndarray (n, 3, g) or None
            The same of the measured angles, None where they do not change.
        """
        effect = candidate.effect
        assert isinstance(effect, SplineTerm)
        if effect.channel not in self._channels:
            values = {**effect.values, **dict.fromkeys(candidate.size, 1.0)}
            self._channels[effect.channel] = _Extended(self.model, effect, ()).run(self.tangent.path, values)
        rates, seen = self._channels[effect.channel]
        if not self._quantities:
            self._quantities = quantity_values(self.model, self.tangent.path)
        low, step = effect.values[f"{effect.name}_low"], effect.values[f"{effect.name}_step"]
        weights = bspline_basis(self._quantities[effect.on], low, step)[:, None, :]
        return rates * weights, seen * weights if np.any(seen) else None

    def signals(self, candidate: Candidate) -> tuple[Floats, Floats | None]:
        """Changes of the rates and of the measured angles for one unit of each size.

        Parameters
        ----------
        candidate : Candidate
            The candidate.

        Returns
        -------
        rates : ndarray (n, states, g)
            As `Linearisation.answer` takes them.
        seen_rad : ndarray (n, 3, g) or None
            The same of the measured angles, None where they do not change.
        """
        if candidate.is_spline:
            return self.spline_signals(candidate)
        if candidate.id not in self._functions and not candidate.effect.delay:
            self._functions[candidate.id] = _Extended(self.model, candidate.effect, candidate.size)
        path = self.tangent.path
        if candidate.effect.delay:
            return self._delayed(candidate), None
        rates, seen = self._functions[candidate.id].run(path, candidate.effect.values)
        return rates, seen if np.any(seen) else None

    def _delayed(self, candidate: Candidate) -> Floats:
        """What later voltages change: the model itself is the same."""
        if self._rates is None:
            model = self.model
            x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
            t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
            function = ca.Function("rates", [x, u, t, p], [ca.densify(model.dynamics(x, u, p, t))])
            self._rates = MapEvaluator(function, self.tangent.rows)
        path, record = self.tangent.path, self.tangent.record
        delay_s = candidate.effect.values[candidate.effect.delay]
        middle_s = record.t_s - record.t_s[0] + 0.5 * record.step_s
        kernel = np.ones(max(1, round(path.step_s / record.step_s)))
        smooth = [np.convolve(v, kernel / len(kernel), mode="same") for v in record.voltages_V.T]
        now, late = (
            np.column_stack([np.interp(path.t_s - d, middle_s, v) for v in smooth]) for d in (0.0, delay_s)
        )
        (after,) = self._rates(replace(path, volts_V=late))
        (before,) = self._rates(replace(path, volts_V=now))
        return after - before


class _Extended:
    """A model with one more effect, and the same without it."""

    def __init__(self, model: Model, effect: Effect, size: Sequence[str]) -> None:
        self.model, self.size = model, size
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
        if size:
            by = ca.vertcat(*(p[self.own_places[name]] for name in size))
            outputs = [ca.jacobian(ca.vertcat(*(rates[i] for i in base)), by), ca.jacobian(angles, by)]
        else:
            outputs = [
                ca.vertcat(*(rates[i] for i in base)) - model.dynamics(x, u, p_base, t),
                angles - model.measurement(x, u, p_base, t),
            ]
        self.state_count = len(own)
        self._along: tuple[int, MapEvaluator] | None = None
        self._course: tuple[int, ca.Function] | None = None
        inputs = [ca.vertcat(x, z), u, t, p]
        self.function = ca.Function("change", inputs, ca.cse([ca.densify(o) for o in outputs]))
        if own:
            now = ca.Function("z", [z, x, u, t, p], [ca.vertcat(*(rates[i] for i in extra))])
            settled = ca.Function("zs", [z, x, u, t, p], [ca.vertcat(*(after[i] for i in extra))])
            h = ca.SX.sym("h")
            k1 = now(z, x, u, t, p)
            k2 = now(z + 0.5 * h * k1, x, u, t, p)
            k3 = now(z + 0.5 * h * k2, x, u, t, p)
            k4 = now(z + h * k3, x, u, t, p)
            end = settled(z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), x, u, t + h, p)
            self.step = ca.Function("step", [z, x, u, t, p, h], [end])

    def run(self, path: Path, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        parameters = np.empty(len(self.more.parameters))
        parameters[self.places] = path.parameters
        for name, place in self.own_places.items():
            parameters[place] = values[name]
        state = path.state
        if self.state_count:
            state = np.column_stack((state, self._own_states(path, parameters)))
        if self._along is None or self._along[0] != len(state):
            self._along = len(state), MapEvaluator(self.function, len(state))
        rates, seen = self._along[1](Path(path.t_s, state, path.volts_V, path.step_s, parameters))
        return rates, seen

    def _own_states(self, path: Path, parameters: Floats) -> Floats:
        """Own states in the middle of each step, from rest at the beginning of the flight."""
        n = len(path.t_s)
        # Four short steps in each: lags of a few milliseconds stay stable.
        substeps = 4
        h = path.step_s / substeps
        if self._course is None or self._course[0] != n:
            self._course = n, self.step.mapaccum("along", n * substeps)
        result = self._course[1](
            np.zeros(self.state_count),
            np.repeat(path.state, substeps, axis=0).T,
            np.repeat(path.volts_V, substeps, axis=0).T,
            (np.repeat(path.t_s, substeps) + h * np.tile(np.arange(substeps) - 2.0, n))[None],
            np.broadcast_to(parameters[:, None], (len(parameters), n * substeps)),
            np.full((1, n * substeps), h),
        )
        found: Floats = np.asarray(result).T.reshape(n, substeps, self.state_count)[:, substeps // 2 - 1]
        return found


def effect_candidates(kind: EffectKind, seconds: float) -> list[Candidate]:
    """Lay out what must be searched of an effect.

    Parameters
    ----------
    kind : EffectKind
        The effect.
    seconds : float
        Length of the flight.

    Returns
    -------
    list of Candidate
        One for each combination of the searched numbers.
    """
    scan = kind.grid_values(seconds)
    candidates = []
    for point in itertools.product(*scan.values()):
        scanned = dict(zip(scan, point, strict=True))
        values = kind.neutral if kind.size else kind.typical
        candidates.append(Candidate(kind.id, kind.make({**values, **scanned}), kind.size, scanned))
    return candidates


def spline_candidates(tangents: Sequence[Linearisation], number: int = 0) -> list[Candidate]:
    """Every pattern over what the flights have.

    Parameters
    ----------
    tangents : sequence of Linearisation
        Predictions of the flights.
    number : int
        Tells patterns of one model apart.

    Returns
    -------
    list of Candidate
        One for each channel and quantity.
    """
    model = tangents[0].fit.problem.model
    together: dict[str, list[Floats]] = {}
    for tangent in tangents:
        for name, values in quantity_values(model, tangent.path).items():
            together.setdefault(name, []).append(values)
    candidates = []
    for channel, on in choices():
        low, step = span_of(np.concatenate(together[on]))
        if step * (KNOTS - 1) < _LEAST_SPAN:
            continue
        made = spline_term(channel, on, low, step, number)
        size = tuple(made.priors)
        candidates.append(Candidate(f"pattern:{channel}:{on}", made, size))
    return candidates
