"""Score tests of the terms of equations: predicts how much each of thousands of terms would improve a model.

Terms are evaluated along the filtered states, and scored in batches that limit memory.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.explain.discover.equation import (
    Equation,
    EquationTerm,
    TermGroup,
    equation_effect,
    rotor_signs,
)
from heli_lab.explain.discover.terms import SYMBOLS, Factor, Term
from heli_lab.explain.search.regressors import ExtendedModel
from heli_lab.explain.search.score_test import score_of
from heli_lab.explain.search.screening import Screening
from heli_lab.fit.flight_model import model_along
from heli_lab.fit.linearised_flight import LinearisedFlight
from heli_lab.fit.model_functions import Trajectory
from heli_lab.threads import batches, parallel_map

_PRIOR_RMS: Final[Mapping[str, float]] = {
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
_CONSTANT_RANGE: Final = 1e-6
"""Relative range of a term below which it is a constant; constants are estimated per flight anyway."""


@dataclass(frozen=True)
class ScoredTermGroup:
    """Score test of a group of terms."""

    group: TermGroup  # The terms
    log_likelihood_gain: float  # Gain that the score test predicts, nats
    coefficients: Floats  # (g,): Estimated coefficients of the terms
    prior_std: tuple[float, ...]  # Prior standard deviations of the coefficients


class TermSignals:
    """Evaluates terms along the flights of a `screening`, and how they change rates and measured angles.

    Factors and influences are computed once. In all shapes, n is the number of steps of the flight.
    """

    def __init__(self, screening: Screening) -> None:
        self.linearised_flights = screening.filtered.linearised_flights
        # By quantity, shape (n,) or (n, 2): in the middle of the steps, and at their ends.
        self._middle = [_quantities_along(linear, linear.trajectory) for linear in self.linearised_flights]
        self._nodes = [_quantities_along(linear, linear.nodes) for linear in self.linearised_flights]
        # By flight, factor and whether at the ends of the steps: shape (n, 1) or (n, 2).
        self._factors: dict[tuple[int, Factor, bool], Floats] = {}
        # By flight and channel: shape (n, states, 1) or (n, 3, 1).
        self._influences: dict[tuple[int, str], Floats] = {}
        # By channel: the model with a term that is 1 on that channel.
        self._extended: dict[str, ExtendedModel] = {}

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each quantity over all flights, SI units, by name."""
        all_values = {
            name: np.concatenate([quantities[name] for quantities in self._middle])
            for name in self._middle[0]
        }
        return {name: (float(values.min()), float(values.max())) for name, values in all_values.items()}

    def quantity(self, index: int, name: str) -> Floats:
        """Return values of the quantity `name` in the middle of each step of the flight `index`.

        The shape is (n,), or (n, 2) if each rotor has its own.
        """
        return self._middle[index][name]

    def values(self, index: int, term: EquationTerm) -> Floats:
        """Return values of a `term` along the flight `index`, shape (n, 1), or (n, 2) if each rotor has its
        own.

        A term on an encoder is evaluated at the end of each step, any other in the middle.
        """
        at_nodes = term.channel.startswith("measurement")
        product = np.ones((len(self._middle[index]["time"]), 1))
        for factor in term.term.factors:
            product = product * self._factor_values(index, factor, at_nodes)
        return product

    def _factor_values(self, index: int, factor: Factor, at_nodes: bool) -> Floats:
        """Return values of a factor along a flight, shape (n, 1), or (n, 2) if each rotor has its own."""
        key = index, factor, at_nodes
        if key not in self._factors:
            quantities = (self._nodes if at_nodes else self._middle)[index]
            x = self._lagged_values(index, quantities[factor.quantity], factor)
            self._factors[key] = factor.value(np, x[:, None] if x.ndim == 1 else x)
        return self._factors[key]

    def _lagged_values(self, index: int, x: Floats, factor: Factor) -> Floats:
        """Return the values `x` of a quantity, (n,) or (n, 2), behind the lag of a factor.

        The lag starts at rest in each window.
        """
        if not factor.lag_filter:
            return x
        # Takes most of a second to import, and few diagnoses search for an equation.
        from scipy.signal import lfilter

        linear = self.linearised_flights[index]
        pole = math.exp(-linear.trajectory.step_s / dict(factor.parameters)["s"])
        lagged = np.empty_like(x)
        for window in linear.windows:
            window_values = x[window]
            # The initial condition `zi` is that of a constant input equal to the first value.
            lagged[window] = lfilter(
                [1.0 - pole], [1.0, -pole], window_values, axis=0, zi=pole * window_values[:1]
            )[0]
        return lagged if factor.lag_filter == "lag" else lagged - x

    def signal(self, index: int, term: EquationTerm, value: Floats) -> Floats:
        """Change by one unit of a term's coefficient. Shapes: `value` (n, 1); returns (n, states, 1)."""
        if term.channel.startswith(("torque", "measurement")):
            influence = self._influence_of_channel(index, term.channel)
            return influence * value[:, None, :]
        kind = term.channel.partition(".")[0]
        total = np.zeros((len(value), self.linearised_flights[index].states))
        for rotor, sign in enumerate(rotor_signs(term.channel)):
            if sign:
                rotor_value = value[:, min(rotor, value.shape[1] - 1)]
                influence = self._influence_of_channel(index, f"{kind}.{('front', 'back')[rotor]}")
                total += sign * influence[:, :, 0] * rotor_value[:, None]
        return total[:, :, None]

    def _influence_of_channel(self, index: int, channel: str) -> Floats:
        """Return what one unit on a channel changes along a flight.

        This is the change of the rates, shape (n, states, 1), or for an encoder the change of the measured
        angles, shape (n, 3, 1).
        """
        if (index, channel) not in self._influences:
            linear = self.linearised_flights[index]
            if channel not in self._extended:
                equation = Equation((EquationTerm(channel, Term(())),))
                effect = equation_effect(
                    equation, dict.fromkeys(equation.coefficients, 1.0), name="unit_term"
                )
                self._extended[channel] = ExtendedModel(linear.model.source, effect, tuple(effect.priors))
            extended_model = self._extended[channel]
            rates, angles = extended_model.run(linear.trajectory, extended_model.effect.values)
            self._influences[index, channel] = angles if channel.startswith("measurement") else rates
        return self._influences[index, channel]


def score(screening: Screening, signals: TermSignals, groups: Sequence[TermGroup]) -> list[ScoredTermGroup]:
    """Score groups of terms, each by itself."""
    channel_batches = [
        (channel, batch)
        for channel, channel_groups in itertools.groupby(groups, lambda group: group.terms[0].channel)
        for batch in batches(channel_groups, lambda group: len(group.terms), screening.batch)
    ]
    scores_by_batch = parallel_map(
        lambda channel_and_batch: _score_batch(screening, signals, *channel_and_batch),
        channel_batches,
        screening.threads,
    )
    scores = itertools.chain.from_iterable(scores_by_batch)
    return sorted(scores, key=lambda scored: -scored.log_likelihood_gain)


def _score_batch(
    screening: Screening, signals: TermSignals, channel: str, batch: Sequence[TermGroup]
) -> list[ScoredTermGroup]:
    """Score groups of terms of one channel, which are filtered together; constant terms are left out."""
    flights = range(len(signals.linearised_flights))
    varying_groups, prior_stds = [], []
    values_by_term: list[list[Floats]] = []
    for group in batch:
        group_values = [[signals.values(i, term) for i in flights] for term in group.terms]
        all_values = [np.concatenate(by_flight) for by_flight in group_values]
        if any(_is_constant(term_values) for term_values in all_values):
            continue
        varying_groups.append(group)
        values_by_term += group_values
        rms_values = [float(np.sqrt(np.mean(term_values**2))) for term_values in all_values]
        prior_stds.append(np.array(list(map(term_coefficient_std, group.terms, rms_values))))
    if not varying_groups:
        return []
    terms = [term for group in varying_groups for term in group.terms]
    regressors = _regressors(screening, signals, channel, terms, values_by_term)
    score_statistics = screening.projected(regressors, [len(group.terms) for group in varying_groups])
    scores = []
    for group, std, (information, gradient) in zip(varying_groups, prior_stds, score_statistics, strict=True):
        gain, coefficients = _gain_and_coefficients(information, gradient, std)
        scores.append(ScoredTermGroup(group, gain, coefficients, tuple(map(float, std))))
    return scores


def _is_constant(values: Floats) -> bool:
    """Whether values along all flights hardly vary relative to their size."""
    return float(np.ptp(values)) <= _CONSTANT_RANGE * float(np.abs(values).max())


def _regressors(
    screening: Screening,
    signals: TermSignals,
    channel: str,
    terms: Sequence[EquationTerm],
    values: Sequence[Sequence[Floats]],
) -> Iterator[Floats]:
    """Yield for each flight the derivative of the innovations by each term's coefficient, shape (m, terms).

    `values` are those of each term along each flight.
    """
    flights = range(len(signals.linearised_flights))
    disturbances = screening.estimate.disturbances
    kind, _, place = channel.partition(".")
    if kind == "torque":
        torques = [np.concatenate([by_flight[i] for by_flight in values], axis=1) for i in flights]
        return screening.filtered.disturbance_regressors(disturbances, AXES.index(place), torques)
    changes: list[tuple[Floats, Floats | None]] = []
    for i in flights:
        columns = np.concatenate(
            [signals.signal(i, term, value[i]) for term, value in zip(terms, values, strict=True)], axis=2
        )
        if kind == "measurement":
            no_rates = np.zeros((len(columns), signals.linearised_flights[i].states, columns.shape[2]))
            changes.append((no_rates, columns))
        else:
            changes.append((columns, None))
    return screening.filtered.regressors(disturbances, changes)


def _gain_and_coefficients(information: Floats, gradient: Floats, std: Floats) -> tuple[float, Floats]:
    """Maximise the quadratic log-likelihood of a score test with a normal prior. Returns shape (g,).

    A single coefficient is solved directly, because most of the thousands of groups have only one.
    """
    if len(std) == 1:
        value = gradient / (information[0, 0] + std[0] ** -2.0)
        return float(0.5 * gradient[0] * value[0]), value
    gain, coefficients, _ = score_of(information, gradient, std)
    return gain, coefficients


def term_coefficient_std(term: EquationTerm, rms: float) -> float:
    """Prior standard deviation of the coefficient of a `term` of root mean square `rms` along the flights."""
    kind = term.channel.partition(".")[0]
    return _PRIOR_RMS.get(term.channel, _PRIOR_RMS.get(kind, 1.0)) / rms


def _quantities_along(linear: LinearisedFlight, trajectory: Trajectory) -> dict[str, Floats]:
    """Return every quantity along a trajectory by name, shape (n,), or (n, 2) if each rotor has its own."""
    model = linear.model.source

    def expressions(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> list[ca.SX]:
        operands = model.driven(x, u, p, t)
        return [quantity.value(operands) for quantity in SYMBOLS.values()]

    values = model_along(model, expressions)(trajectory)
    return {
        name: value[:, :, 0] if quantity.per_rotor else value[:, 0, 0]
        for (name, quantity), value in zip(SYMBOLS.items(), values, strict=True)
    }
