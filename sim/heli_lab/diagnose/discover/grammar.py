"""Grammar of equations: which terms are tried on which channel, the simplest first.

A term is a product of at most three factors. A term pays for the number of terms that were tried up to its
size: a long list of complex terms does not make simple ones expensive.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from heli_sim.model.parts import AXES

from heli_lab.diagnose.discover.equation import CHANNELS, EquationTerm, Group
from heli_lab.diagnose.discover.terms import SYMBOLS, Factor, Term

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


def _one(form: str, quantity: str, memory: str = "", **numbers: float) -> Factor:
    return Factor(form, quantity, tuple(numbers.items()), memory)


def _sign(quantity: str, memory: str = "", **numbers: float) -> Factor:
    return _one("sign", quantity, memory, width=SYMBOLS[quantity].near_zero, **numbers)


def _rate(axis: str) -> str:
    return f"{axis}_rate"


_RATES: Final = tuple(_rate(axis) for axis in AXES)
_TOGETHER: Final = (*AXES, *_RATES, "thrust", "thrust_difference")
"""Quantities of the whole rig."""


def groups(spans: Mapping[str, tuple[float, float]]) -> list[Group]:
    """List all groups of terms on all channels.

    Parameters
    ----------
    spans : Mapping[str, (float, float)]
        Lowest and highest value of each quantity in the flights, SI units, by name; bumps are placed between
        them.
    """
    singles = list(_singles(spans))
    pairs = list(_pairs())
    triples = list(_triples())
    result: list[Group] = []
    for axis in AXES:
        channel = f"torque.{axis}"
        result += [_group(channel, terms) for terms in (*singles, *pairs, *triples)]
    for channel in CHANNELS:
        if channel.startswith("thrust") or channel == "voltage.both":
            result += [_group(channel, terms) for terms in _of_rotors(channel, singles)]
        if channel.startswith("measurement"):
            result += [_group(channel, terms) for terms in _of_encoder(channel.partition(".")[2], singles)]
    return result


def _group(channel: str, products: Sequence[tuple[Factor, ...]]) -> Group:
    size = sum(1 + (factor.form != "linear") + bool(factor.memory) for factor in products[0])
    return Group(tuple(EquationTerm(channel, Term(factors)) for factors in products), size)


_Products = tuple[tuple[Factor, ...], ...]
"""Products that belong to one group."""


def _singles(spans: Mapping[str, tuple[float, float]]) -> Iterator[_Products]:
    """Yield the products of one factor: all functions of all quantities, with and without lag."""
    for quantity in _TOGETHER:
        forms = ["linear", "square", "cube", "abs", "signed_square"]
        yield from (((_one(form, quantity),),) for form in forms)
        yield ((_sign(quantity),),)
        if quantity in AXES:
            for k in _MULTIPLICITIES[quantity]:
                yield (_one("sin", quantity, k=k),), (_one("cos", quantity, k=k),)
            yield from (((bump,),) for bump in _bumps(quantity, spans))
            furthest = max(abs(bound) for bound in spans[quantity])
            for share in _SLACKS:
                yield ((_one("beyond", quantity, slack=round(share * furthest, 3)),),)
        for s in _LAGS_s:
            yield ((_one("linear", quantity, "lag", s=s),),)
            yield ((_sign(quantity, "washout", s=s),),)
    yield ((_one("linear", "time"),),)


def _bumps(quantity: str, spans: Mapping[str, tuple[float, float]]) -> Iterator[Factor]:
    low, high = spans[quantity]
    for share in _BUMP_WIDTHS:
        for i in range(_BUMP_PLACES):
            place = low + (high - low) * i / (_BUMP_PLACES - 1)
            yield _one("bump", quantity, place=round(place, 3), width=round(share * (high - low), 3))


def _simple(quantity: str) -> list[tuple[Factor, ...]]:
    """Functions of one quantity that products consist of; sine and cosine of travel form one group."""
    plain: list[tuple[Factor, ...]] = [(_one("linear", quantity),), (_one("square", quantity),)]
    if quantity == "thrust":
        return plain[:1]
    if quantity == "travel":
        waves = [(_one("sin", quantity, k=k), _one("cos", quantity, k=k)) for k in (1.0, 2.0)]
        return [*plain, *waves]
    if quantity in AXES:
        return [*plain, (_one("abs", quantity),), (_sign(quantity),)]
    return [*plain, (_one("abs", quantity),), (_sign(quantity),), (_one("signed_square", quantity),)]


def _pairs() -> Iterator[_Products]:
    for factor, other in itertools.combinations(_TOGETHER, 2):
        for first, second in itertools.product(_simple(factor), _simple(other)):
            yield tuple((a, b) for a in first for b in second)


def _triples() -> Iterator[_Products]:
    """Products of three quantities; a squared rate with the two angles of level flight as well."""
    for three in itertools.combinations(_TOGETHER, 3):
        if {"thrust", "thrust_difference"} <= set(three):
            continue
        yield (tuple(_one("linear", quantity) for quantity in three),)
    for quantity in _RATES:
        for angle in ("elevation", "pitch"):
            for other in (q for q in ("elevation", "pitch") if q != angle):
                yield ((_one("square", quantity), _one("linear", angle), _one("linear", other)),)


def _of_rotors(channel: str, singles: Sequence[_Products]) -> Iterator[_Products]:
    """Terms of a rotor's thrust or voltage: a share of its own, or of the other rotor's."""
    rotor_quantity = "own_thrust" if channel.startswith("thrust") else "own_voltage"
    share = _one("linear", rotor_quantity)
    for products in singles:
        # The terms after this loop are those of thrust that depends on thrust.
        if not any(SYMBOLS[f.quantity].kind == "thrust" for factors in products for f in factors):
            yield tuple((share, *factors) for factors in products)
    yield ((_one("square", rotor_quantity),),)
    yield ((share, _one("linear", "voltage" if rotor_quantity == "own_voltage" else "thrust")),)
    if rotor_quantity == "own_voltage":
        return
    yield ((_one("linear", "other_thrust"),),)
    for s in _LAGS_s:
        yield ((_one("linear", rotor_quantity, "washout", s=s),),)
        yield ((_sign(rotor_quantity, "washout", s=s),),)
        yield ((_one("linear", "other_thrust", "lag", s=s),),)


def _of_encoder(axis: str, singles: Sequence[_Products]) -> Iterator[_Products]:
    """Errors of an encoder depend on angles. An error that depends on thrust would be significant in any
    flight, because the controller feeds the quantisation error back; so would half a sample of the axis' own
    rate.
    """
    for products in singles:
        factors = [factor for product in products for factor in product]
        angles = all(SYMBOLS[f.quantity].kind == "angle" and not f.memory for f in factors)
        if angles and (factors[0].quantity == axis or factors[0].form in ("sin", "linear")):
            yield products


def tried_up_to(every: Sequence[Group]) -> dict[int, int]:
    """Count the groups in `every` of each size or smaller, by size."""
    sizes = sorted({group.size for group in every})
    return {size: sum(group.size <= size for group in every) for size in sizes}
