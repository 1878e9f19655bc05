"""Grammar of equations: which terms are tried on which channel, the simplest first.

A term is a product of at most three factors. A term pays for the number of terms that were tried up to its
size: a long list of complex terms does not make simple ones expensive.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from heli_sim.model.parts import AXES

from heli_lab.explain.discover.equation import CHANNELS, EquationTerm, TermGroup
from heli_lab.explain.discover.terms import SYMBOLS, Factor, Term

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
                for terms in _encoder_products(channel.partition(".")[2], single_factors)
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
    """Return the functions of a quantity that products of two consist of, each as the factors of a group.

    Sine and cosine of travel are one group.
    """
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
    """Yield those of the products of single factors, `singles`, that may be an encoder's error.

    These are functions of its own angle, and sines and multiples of another angle.

    An error that depends on thrust would be significant in any flight, because the controller feeds the
    quantisation error back; so would half a sample of the axis' own rate.
    """
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
