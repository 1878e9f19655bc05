"""Score tests of terms: predicts how much each of thousands of terms would improve a model.

The grammar says which terms are tried on which channel, the simplest first. Terms are evaluated along the
filtered states, and scored in batches that limit memory.
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
from heli_sim.evaluate.trajectories import Trajectory
from heli_sim.model.effect import AXES

from heli_lab.explain.candidates import CandidateSignals, ExtendedModel, channel_kind, channel_place
from heli_lab.explain.screening import Screening, score_of
from heli_lab.explain.terms import (
    CHANNELS,
    SYMBOLS,
    Equation,
    EquationTerm,
    Factor,
    Term,
    TermGroup,
    equation_effect,
    rotor_signs,
)
from heli_lab.fit.flight_model import model_along
from heli_lab.fit.linearised_flight import LinearisedFlight
from heli_lab.threads import batches, parallel_map

_MULTIPLICITIES: Final[Mapping[str, tuple[float, ...]]] = {
    "elevation": (1.0, 4.0, 8.0, 16.0),
    "pitch": (1.0, 2.0, 4.0, 7.0, 11.0, 16.0, 22.0),
    "travel": (1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0),
}
"""Periods per revolution to start from; refits find those between. Over the range of elevation, a few
periods are a polynomial."""
_LAGS_s: Final = (0.05, 0.15, 0.5, 1.5)
"""Time constants, a factor of three apart: a score test loses at most a tenth between two of them."""
_BUMP_PLACES: Final = 9
"""Places of a bump over the range of an angle."""
_BUMP_WIDTHS: Final = (0.06, 0.15)
"""Widths of a bump, shares of the range."""
_SLACKS: Final = (0.3, 0.55, 0.8)
"""Where a term with slack begins, as shares of the largest angle: a stop at the end of an axis, a cable that
hangs. Refits find the place between two of them."""


def _make_factor(form: str, quantity: str, lag_filter: str = "", **numbers: float) -> Factor:
    """Return a factor; the keywords are its parameters."""
    return Factor(form, quantity, tuple(numbers.items()), lag_filter)


def _sign_factor(quantity: str, lag_filter: str = "", **numbers: float) -> Factor:
    """Return a sign that is smoothed close to zero, over the width of its quantity."""
    return _make_factor("sign", quantity, lag_filter, width=SYMBOLS[quantity].near_zero, **numbers)


_RATES: Final = tuple(f"{axis}_rate" for axis in AXES)
_RIG_QUANTITIES: Final = (*AXES, *_RATES, "thrust", "thrust_difference")
"""Quantities of the whole rig."""


def groups(spans: Mapping[str, tuple[float, float]]) -> list[TermGroup]:
    """List all groups of terms on all channels."""
    single_factors = list(_single_factor_products(spans))
    two_factors = list(_two_factor_products())
    three_factors = list(_three_factor_products())
    result: list[TermGroup] = []
    for axis in AXES:
        channel = f"torque.{axis}"
        result += [_term_group(channel, terms) for terms in (*single_factors, *two_factors, *three_factors)]
    for channel in CHANNELS:
        if channel.startswith("thrust") or channel == "voltage.both":
            result += [_term_group(channel, terms) for terms in _rotor_products(channel, single_factors)]
        if channel.startswith("measurement"):
            result += [
                _term_group(channel, terms)
                for terms in _encoder_products(channel_place(channel), single_factors)
            ]
    return result


def _term_group(channel: str, products: Sequence[tuple[Factor, ...]]) -> TermGroup:
    """Return a group of terms on a channel with its complexity: factors, non-linear functions and lags."""
    complexity = sum(1 + (factor.form != "linear") + bool(factor.lag_filter) for factor in products[0])
    return TermGroup(tuple(EquationTerm(channel, Term(factors)) for factors in products), complexity)


_GroupProducts = tuple[tuple[Factor, ...], ...]
"""Products that belong to one group."""


def _single_factor_products(spans: Mapping[str, tuple[float, float]]) -> Iterator[_GroupProducts]:
    """Yield the products of a single factor: every function of every quantity of the whole rig."""
    for quantity in _RIG_QUANTITIES:
        power_forms = ["linear", "square", "cube", "abs", "signed_square"]
        yield from (((_make_factor(form, quantity),),) for form in power_forms)
        yield ((_sign_factor(quantity),),)
        if quantity in AXES:
            for k in _MULTIPLICITIES[quantity]:
                yield (_make_factor("sin", quantity, k=k),), (_make_factor("cos", quantity, k=k),)
            yield from (((bump,),) for bump in _gaussian_bumps(quantity, spans))
            furthest = max(abs(bound) for bound in spans[quantity])
            for share in _SLACKS:
                yield ((_make_factor("beyond", quantity, slack=round(share * furthest, 3)),),)
        for s in _LAGS_s:
            yield ((_make_factor("linear", quantity, "lag", s=s),),)
            yield ((_sign_factor(quantity, "washout", s=s),),)
    yield ((_make_factor("linear", "time"),),)


def _gaussian_bumps(quantity: str, spans: Mapping[str, tuple[float, float]]) -> Iterator[Factor]:
    """Yield Gaussian bumps of several widths, evenly spaced over the range of a quantity in the flights."""
    low, high = spans[quantity]
    for share in _BUMP_WIDTHS:
        for i in range(_BUMP_PLACES):
            place = low + (high - low) * i / (_BUMP_PLACES - 1)
            yield _make_factor("bump", quantity, place=round(place, 3), width=round(share * (high - low), 3))


def _functions_for_pairs(quantity: str) -> list[tuple[Factor, ...]]:
    """Return the functions of a quantity that products of two consist of, each as the factors of a group."""
    powers: list[tuple[Factor, ...]] = [
        (_make_factor("linear", quantity),),
        (_make_factor("square", quantity),),
    ]
    if quantity == "thrust":
        return powers[:1]
    if quantity == "travel":
        waves = [(_make_factor("sin", quantity, k=k), _make_factor("cos", quantity, k=k)) for k in (1.0, 2.0)]
        return [*powers, *waves]
    if quantity in AXES:
        return [*powers, (_make_factor("abs", quantity),), (_sign_factor(quantity),)]
    return [
        *powers,
        (_make_factor("abs", quantity),),
        (_sign_factor(quantity),),
        (_make_factor("signed_square", quantity),),
    ]


def _two_factor_products() -> Iterator[_GroupProducts]:
    """Yield the products of functions of two different quantities."""
    for quantity, other_quantity in itertools.combinations(_RIG_QUANTITIES, 2):
        for first, second in itertools.product(
            _functions_for_pairs(quantity), _functions_for_pairs(other_quantity)
        ):
            yield tuple((a, b) for a in first for b in second)


def _three_factor_products() -> Iterator[_GroupProducts]:
    """Yield products of three quantities, and of a squared rate with elevation and pitch."""
    for quantities in itertools.combinations(_RIG_QUANTITIES, 3):
        if {"thrust", "thrust_difference"} <= set(quantities):
            continue
        yield (tuple(_make_factor("linear", quantity) for quantity in quantities),)
    for rate in _RATES:
        yield (
            (
                _make_factor("square", rate),
                _make_factor("linear", "elevation"),
                _make_factor("linear", "pitch"),
            ),
        )


def _rotor_products(channel: str, singles: Sequence[_GroupProducts]) -> Iterator[_GroupProducts]:
    """Yield terms of a rotor's thrust or voltage proportional to its own, or to the other rotor's."""
    rotor_quantity = "own_thrust" if channel.startswith("thrust") else "own_voltage"
    own_factor = _make_factor("linear", rotor_quantity)
    for products in singles:
        # The terms after this loop are those of thrust that depends on thrust.
        if not any(SYMBOLS[f.quantity].kind == "thrust" for factors in products for f in factors):
            yield tuple((own_factor, *factors) for factors in products)
    yield ((_make_factor("square", rotor_quantity),),)
    yield ((own_factor, _make_factor("linear", "voltage" if rotor_quantity == "own_voltage" else "thrust")),)
    if rotor_quantity == "own_voltage":
        return
    yield ((_make_factor("linear", "other_thrust"),),)
    for s in _LAGS_s:
        yield ((_make_factor("linear", rotor_quantity, "washout", s=s),),)
        yield ((_sign_factor(rotor_quantity, "washout", s=s),),)
        yield ((_make_factor("linear", "other_thrust", "lag", s=s),),)


def _encoder_products(axis: str, singles: Sequence[_GroupProducts]) -> Iterator[_GroupProducts]:
    """Yield those of the products of single factors, `singles`, that may be an encoder's error."""
    # These are functions of its own angle, and sines and multiples of another angle.
    # An error that depends on thrust would be significant in any flight, because the controller feeds the
    # quantisation error back; so would half a sample of the axis' own rate.
    for products in singles:
        factor = products[0][0]
        is_angle = SYMBOLS[factor.quantity].kind == "angle" and not factor.lag_filter
        if is_angle and (factor.quantity == axis or factor.form in ("sin", "linear")):
            yield products


def count_by_complexity(all_groups: Sequence[TermGroup]) -> dict[int, int]:
    """Return the number of groups in `all_groups` of each complexity or less, by complexity."""
    complexities = sorted({group.complexity for group in all_groups})
    return {
        complexity: sum(group.complexity <= complexity for group in all_groups) for complexity in complexities
    }


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
    """Evaluates terms along the flights of a `screening`, and how they change rates and measured angles."""

    # Factors and influences are computed once. In all shapes, n is the number of steps of the flight.

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
        """Return values of the quantity `name` in the middle of each step of the flight `index`."""
        # The shape is (n,), or (n, 2) if each rotor has its own.
        return self._middle[index][name]

    def values(self, index: int, term: EquationTerm) -> Floats:
        """Return values of a `term` along the flight `index`, shape (n, 1), or (n, 2) if each rotor has its
        own.
        """
        # A term on an encoder is evaluated at the end of each step, any other in the middle.
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
        """Return the values `x` of a quantity, (n,) or (n, 2), behind the lag of a factor."""
        # The lag starts at rest in each window.
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
        kind = channel_kind(term.channel)
        total = np.zeros((len(value), self.linearised_flights[index].states))
        for rotor, sign in enumerate(rotor_signs(term.channel)):
            if sign:
                rotor_value = value[:, min(rotor, value.shape[1] - 1)]
                influence = self._influence_of_channel(index, f"{kind}.{('front', 'back')[rotor]}")
                total += sign * influence[:, :, 0] * rotor_value[:, None]
        return total[:, :, None]

    def _influence_of_channel(self, index: int, channel: str) -> Floats:
        """Return what one unit on a channel changes along a flight."""
        # This is the change of the rates, shape (n, states, 1), or for an encoder the change of the measured
        # angles, shape (n, 3, 1).
        if (index, channel) not in self._influences:
            linear = self.linearised_flights[index]
            if channel not in self._extended:
                equation = Equation((EquationTerm(channel, Term(())),))
                effect = equation_effect(
                    equation, dict.fromkeys(equation.coefficient_names, 1.0), name="unit_term"
                )
                self._extended[channel] = ExtendedModel(linear.model.source, effect, tuple(effect.priors))
            extended_model = self._extended[channel]
            rates, angles = extended_model.run(linear.trajectory, extended_model.effect.values)
            self._influences[index, channel] = angles if channel.startswith("measurement") else rates
        return self._influences[index, channel]


def score_groups(
    screening: Screening, signals: TermSignals, groups: Sequence[TermGroup]
) -> list[ScoredTermGroup]:
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


@dataclass(frozen=True)
class _Column:
    """A group of terms along all flights."""

    group: TermGroup
    values: Sequence[Sequence[Floats]]
    """By term and flight, shape (n, 1), or (n, 2) if each rotor has its own."""
    prior_std: Floats  # (g,): Prior standard deviations of the coefficients


def _score_batch(
    screening: Screening, signals: TermSignals, channel: str, batch: Sequence[TermGroup]
) -> list[ScoredTermGroup]:
    """Score groups of terms of one channel, which are filtered together; constant terms are left out."""
    columns = [column for group in batch if (column := _varying_column(signals, group))]
    if not columns:
        return []
    regressors = _regressors(screening, signals, channel, columns)
    score_statistics = screening.projected(regressors, [len(column.group.terms) for column in columns])
    return [
        _scored(column, information, gradient)
        for column, (information, gradient) in zip(columns, score_statistics, strict=True)
    ]


def _varying_column(signals: TermSignals, group: TermGroup) -> _Column | None:
    """Evaluate a group of terms along all flights; None if one of its terms hardly varies."""
    flights = range(len(signals.linearised_flights))
    values = [[signals.values(i, term) for i in flights] for term in group.terms]
    prior_std = []
    for term, by_flight in zip(group.terms, values, strict=True):
        all_values = np.concatenate(by_flight)
        if float(np.ptp(all_values)) <= _CONSTANT_RANGE * float(np.abs(all_values).max()):
            return None
        prior_std.append(term_coefficient_std(term, float(np.sqrt(np.mean(all_values**2)))))
    return _Column(group, values, np.array(prior_std))


def _regressors(
    screening: Screening, signals: TermSignals, channel: str, columns: Sequence[_Column]
) -> Iterator[Floats]:
    """Yield for each flight the derivatives of the innovations by the coefficients, shape (m, terms)."""
    flights = range(len(signals.linearised_flights))
    terms = [
        (term, by_flight)
        for column in columns
        for term, by_flight in zip(column.group.terms, column.values, strict=True)
    ]
    disturbances = screening.estimate.disturbances
    # The columns of all terms side by side, which are the last axis of their arrays.
    if channel_kind(channel) == "torque":
        torques = [np.concatenate([by_flight[i] for _, by_flight in terms], axis=-1) for i in flights]
        axis = AXES.index(channel_place(channel))
        return screening.filtered.disturbance_regressors(disturbances, axis, torques)
    changes: list[CandidateSignals] = []
    for i in flights:
        change = np.concatenate([signals.signal(i, term, by_flight[i]) for term, by_flight in terms], axis=-1)
        if channel_kind(channel) == "measurement":
            no_rates = np.zeros((len(change), signals.linearised_flights[i].states, change.shape[2]))
            changes.append(CandidateSignals(no_rates, measured_rad=change))
        else:
            changes.append(CandidateSignals(rates=change, measured_rad=None))
    return screening.filtered.regressors(disturbances, changes)


def _scored(column: _Column, information: Floats, gradient: Floats) -> ScoredTermGroup:
    """Maximise the quadratic log-likelihood of a score test with a normal prior of the coefficients."""
    # A single coefficient is solved directly, because most of the thousands of groups have only one.
    std = column.prior_std
    if len(std) == 1:
        coefficients = gradient / (information[0, 0] + std[0] ** -2.0)
        gain = float(0.5 * gradient[0] * coefficients[0])
    else:
        gain, coefficients, _ = score_of(information, gradient, std)
    return ScoredTermGroup(column.group, gain, coefficients, tuple(map(float, std)))


def term_coefficient_std(term: EquationTerm, rms: float) -> float:
    """Prior standard deviation of the coefficient of a `term` of root mean square `rms` along the flights."""
    rms_of_kind = _PRIOR_RMS.get(channel_kind(term.channel), 1.0)
    return _PRIOR_RMS.get(term.channel, rms_of_kind) / rms


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
