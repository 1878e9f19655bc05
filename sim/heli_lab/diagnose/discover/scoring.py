"""Score tests of thousands of terms along the filtered states, in batches that limit memory."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.diagnose.discover.equation import (
    Equation,
    EquationTerm,
    Group,
    equation_effect,
    rotor_signs,
)
from heli_lab.diagnose.discover.terms import SYMBOLS, Factor, Term
from heli_lab.diagnose.search import ExtendedModel, Screening, score_of
from heli_lab.estimation import AlongTrajectory, LinearisedFlight, Trajectory
from heli_lab.threads import parallel_map

_LARGEST: Final[Mapping[str, float]] = {
    "torque.elevation": 0.3,
    "torque.pitch": 0.1,
    "torque.travel": 0.15,
    "thrust": 0.5,
    "voltage": 0.5,
    "measurement": 0.03,
}
"""Prior standard deviation of a term's root mean square along the flights, in its channel's unit: of the
size of what holds the arm up. Smaller: large terms are underestimated. Larger: no effect, the flights
determine the size."""
_STEADY: Final = 1e-6
"""Relative range of a term below which it is a constant; constants are estimated per flight anyway."""


@dataclass(frozen=True)
class ScoredGroup:
    """Score test of a group of terms.

    Parameters
    ----------
    group : Group
        The terms.
    log_likelihood_gain : float
        Gain that the score test predicts, nats.
    coefficients : ndarray (g,)
        Estimated coefficients of the terms.
    prior_std : tuple of float
        Prior standard deviations of the coefficients.
    """

    group: Group
    log_likelihood_gain: float
    coefficients: Floats
    prior_std: tuple[float, ...]


class TermSignals:
    """Values of terms along the flights of a `screening`, and their influence on rates and measured
    angles.
    """

    def __init__(self, screening: Screening) -> None:
        self.linearised_flights = screening.filtered.linearised_flights
        self._middle = [_quantities(linear, linear.trajectory) for linear in self.linearised_flights]
        self._nodes = [_quantities(linear, linear.nodes) for linear in self.linearised_flights]
        self._factors: dict[tuple[int, Factor, bool], Floats] = {}
        self._influences: dict[tuple[int, str], Floats] = {}
        self._extended: dict[str, ExtendedModel] = {}

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each quantity over all flights, SI units, by name."""
        values_by_name = {
            name: np.concatenate([quantities[name] for quantities in self._middle])
            for name in self._middle[0]
        }
        return {name: (float(values.min()), float(values.max())) for name, values in values_by_name.items()}

    def quantity(self, index: int, name: str) -> Floats:
        """Values of the quantity `name` in the middle of each step of the flight `index`, shape (n,), or (n,
        2) if each rotor has its own.
        """
        return self._middle[index][name]

    def values(self, index: int, term: EquationTerm) -> Floats:
        """Values of a `term` along the flight `index`, shape (n, 1), or (n, 2) if each rotor has its own."""
        nodes = term.channel.startswith("measurement")
        value = np.ones((len(self._middle[index]["time"]), 1))
        for factor in term.term.factors:
            value = value * self._factor(index, factor, nodes)
        return value

    def _factor(self, index: int, factor: Factor, nodes: bool) -> Floats:
        """Values of a factor along flight number `index`, at the `nodes` or in the middle of each step;
        cached.
        """
        key = index, factor, nodes
        if key not in self._factors:
            at = (self._nodes if nodes else self._middle)[index]
            x = self._remembered(index, at[factor.quantity], factor)
            self._factors[key] = factor.value(np, x[:, None] if x.ndim == 1 else x)
        return self._factors[key]

    def _remembered(self, index: int, x: Floats, factor: Factor) -> Floats:
        """Values `x` of a quantity after the lag or washout of a `factor`, if it has one, at rest before
        each window.
        """
        if not factor.memory:
            return x
        # Takes most of a second to import, and few diagnoses search for an equation.
        from scipy.signal import lfilter

        linear = self.linearised_flights[index]
        keep = math.exp(-linear.trajectory.step_s / dict(factor.numbers)["s"])
        late = np.empty_like(x)
        for window in linear.windows:
            part = x[window]
            late[window] = lfilter([1.0 - keep], [1.0, -keep], part, axis=0, zi=keep * part[:1])[0]
        return late if factor.memory == "lag" else late - x

    def signal(self, index: int, term: EquationTerm, value: Floats) -> Floats:
        """Change by one unit of a term's coefficient.

        Parameters
        ----------
        index : int
            Number of the flight, from 0.
        term : EquationTerm
            Determines the channel.
        value : ndarray (n, 1) or (n, 2)
            Its values, from `values`.

        Returns
        -------
        ndarray (n, states, 1) or (n, 3, 1)
            Change of the rates, or of the measured angles if the term acts on an encoder.
        """
        if term.channel.startswith(("torque", "measurement")):
            influence = self._influence(index, term.channel)
            return influence * value[:, None, :]
        kind = term.channel.partition(".")[0]
        total = np.zeros((len(value), self.linearised_flights[index].states))
        for rotor, sign in enumerate(rotor_signs(term.channel)):
            if sign:
                rotor_value = value[:, min(rotor, value.shape[1] - 1)]
                influence = self._influence(index, f"{kind}.{('front', 'back')[rotor]}")
                total += sign * influence[:, :, 0] * rotor_value[:, None]
        return total[:, :, None]

    def _influence(self, index: int, channel: str) -> Floats:
        """Change of the rates, or of the measured angles, by one unit on a channel: (n, states or 3, 1)."""
        if (index, channel) not in self._influences:
            linear = self.linearised_flights[index]
            if channel not in self._extended:
                equation = Equation((EquationTerm(channel, Term(())),))
                effect = equation_effect(
                    equation, dict.fromkeys(equation.coefficients, 1.0), name="unit_term"
                )
                self._extended[channel] = ExtendedModel(linear.model.source, effect, tuple(effect.priors))
            extended = self._extended[channel]
            rates, angles = extended.run(linear.trajectory, extended.effect.values)
            self._influences[index, channel] = angles if channel.startswith("measurement") else rates
        return self._influences[index, channel]


def score(screening: Screening, signals: TermSignals, groups: Sequence[Group]) -> list[ScoredGroup]:
    """Score groups of terms, each by itself.

    Parameters
    ----------
    screening : Screening
        Scores about the present estimate.
    signals : TermSignals
        Values of the terms along the flights.
    groups : sequence of Group
        The groups, those of a channel one after the other.

    Returns
    -------
    list of ScoredGroup
        The highest score first, without groups that are constant along the flights.
    """
    batches = [
        (channel, batch)
        for channel, channel_groups in itertools.groupby(groups, lambda group: group.terms[0].channel)
        for batch in _batches(list(channel_groups), screening.batch)
    ]
    scored = parallel_map(
        lambda arguments: _scored(screening, signals, *arguments), batches, screening.threads
    )
    return sorted(
        (group for channel_groups in scored for group in channel_groups),
        key=lambda group: -group.log_likelihood_gain,
    )


def _scored(
    screening: Screening, signals: TermSignals, channel: str, batch: Sequence[Group]
) -> list[ScoredGroup]:
    """Score groups of terms of one channel, which are filtered together."""
    flights = range(len(signals.linearised_flights))
    kept, prior_std, values = [], [], []
    for group in batch:
        by_term = [[signals.values(i, term) for i in flights] for term in group.terms]
        together = [np.concatenate(by_flight) for by_flight in by_term]
        if any(
            float(np.ptp(term_value)) <= _STEADY * float(np.abs(term_value).max()) for term_value in together
        ):
            continue
        kept.append(group)
        values += by_term
        prior_std.append(
            np.array(
                [
                    term_coefficient_std(term, float(np.sqrt(np.mean(value**2))))
                    for term, value in zip(group.terms, together, strict=True)
                ]
            )
        )
    if not kept:
        return []
    terms = [term for group in kept for term in group.terms]
    only = _regressors(screening, signals, channel, terms, values)
    parts = screening.projected(only, [len(group.terms) for group in kept])
    scores = []
    for group, std, (information, gradient) in zip(kept, prior_std, parts, strict=True):
        gain, coefficients = _solved(information, gradient, std)
        scores.append(ScoredGroup(group, gain, coefficients, tuple(map(float, std))))
    return scores


def _batches(groups: Sequence[Group], most: int) -> Iterator[list[Group]]:
    """Groups in their order, in batches of at most `most` terms."""
    batch: list[Group] = []
    for group in groups:
        if batch and sum(len(member.terms) for member in batch) + len(group.terms) > most:
            yield batch
            batch = []
        batch.append(group)
    yield batch


def _regressors(
    screening: Screening,
    signals: TermSignals,
    channel: str,
    terms: Sequence[EquationTerm],
    values: Sequence[Sequence[Floats]],
) -> Iterator[Floats]:
    """Derivative of the innovations to each term's coefficient, shape (m, s) for each flight."""
    flights = range(len(signals.linearised_flights))
    disturbances = screening.estimate.disturbances
    kind, _, where = channel.partition(".")
    if kind == "torque":
        torques = [np.concatenate([by_flight[i] for by_flight in values], axis=1) for i in flights]
        return screening.filtered.disturbance_regressors(disturbances, AXES.index(where), torques)
    changes: list[tuple[Floats, Floats | None]] = []
    for i in flights:
        columns = np.concatenate(
            [signals.signal(i, term, value[i]) for term, value in zip(terms, values, strict=True)], axis=2
        )
        if kind == "measurement":
            none = np.zeros((len(columns), signals.linearised_flights[i].states, columns.shape[2]))
            changes.append((none, columns))
        else:
            changes.append((columns, None))
    return screening.filtered.regressors(disturbances, changes)


def _solved(information: Floats, gradient: Floats, std: Floats) -> tuple[float, Floats]:
    if len(std) == 1:
        value = gradient / (information[0, 0] + std[0] ** -2.0)
        return float(0.5 * gradient[0] * value[0]), value
    gain, coefficients, _ = score_of(information, gradient, std)
    return gain, coefficients


def term_coefficient_std(term: EquationTerm, rms: float) -> float:
    """Prior standard deviation of the coefficient of a `term` of root mean square `rms` along the flights."""
    kind = term.channel.partition(".")[0]
    return _LARGEST.get(term.channel, _LARGEST.get(kind, 1.0)) / rms


def _quantities(linear: LinearisedFlight, trajectory: Trajectory) -> dict[str, Floats]:
    """Values of every quantity along a trajectory, (n,), or (n, 2) if each rotor has its own."""
    model = linear.model.source
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
    t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
    at = model.driven(x, u, p, t)
    results = [ca.densify(ca.SX(quantity.value(at))) for quantity in SYMBOLS.values()]
    values = AlongTrajectory(ca.Function("quantities", [x, u, t, p], results))(trajectory)
    return {
        name: value[:, :, 0] if quantity.each else value[:, 0, 0]
        for (name, quantity), value in zip(SYMBOLS.items(), values, strict=True)
    }
