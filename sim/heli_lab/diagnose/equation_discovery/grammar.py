"""The grammar: which terms are tried on which channel, simplest first.

A term is a product of at most three factors. How many have been tried up to a size is what a law of that size
pays for: a long list makes no short law dear.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from heli_sim.model.parts import AXES

from heli_lab.diagnose.equation_discovery.equation import CHANNELS, EquationTerm
from heli_lab.diagnose.equation_discovery.terms import QUANTITIES, Factor, Term

_MULTIPLICITIES: Final[Mapping[str, tuple[float, ...]]] = {
    "elevation": (1.0, 4.0, 8.0, 16.0),
    "pitch": (1.0, 2.0, 4.0, 7.0, 11.0, 16.0, 22.0),
    "travel": (1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0),
}
"""Periods a revolution; what lies between is found by the refit. Over the degrees that elevation turns a few
periods are a polynomial."""
_LAGS_s: Final = (0.05, 0.15, 0.5, 1.5)
"""Time constants, a factor of three apart: a score test loses at most a tenth between two of them."""
_BUMP_PLACES: Final = 9
"""Places of a bump over the range of an angle."""
_BUMP_WIDTHS: Final = (0.06, 0.15)
"""Widths of a bump, shares of the range."""
_SLACKS: Final = (0.3, 0.55, 0.8)
"""Where what has a slack begins, shares of the largest angle: a stop at the end of an axis, a cable that
hangs. Between two of them the refit finds the place."""


@dataclass(frozen=True)
class Group:
    """Terms that are scored together, as one.

    Parameters
    ----------
    terms : tuple of EquationTerm
        One, or sine and cosine of one angle: a wave of any phase.
    size : int
        Complexity: factors, and functions other than the quantity itself.
    """

    terms: tuple[EquationTerm, ...]
    size: int

    @property
    def key(self) -> str:
        """The group as text."""
        return "; ".join(term.key for term in self.terms)


def _one(form: str, quantity: str, memory: str = "", **numbers: float) -> Factor:
    return Factor(form, quantity, tuple(numbers.items()), memory)


def _sign(quantity: str, memory: str = "", **numbers: float) -> Factor:
    return _one("sign", quantity, memory, width=QUANTITIES[quantity].near_zero, **numbers)


def _rate(axis: str) -> str:
    return f"{axis}_rate"


_RATES: Final = tuple(_rate(axis) for axis in AXES)
_TOGETHER: Final = (*AXES, *_RATES, "thrust", "thrust_difference")
"""Quantities of the whole rig."""


def groups(spans: Mapping[str, tuple[float, float]]) -> list[Group]:
    """Lay out all terms on all channels.

    Parameters
    ----------
    spans : Mapping[str, (float, float)]
        Lowest and highest value of each quantity in the flights; bumps lie between them.
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
    """Functions of one quantity that products are made of; sine and cosine of travel belong together."""
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
    """Products of three, each as it is; angles of level flight also as their sine and cosine."""
    for three in itertools.combinations(_TOGETHER, 3):
        if {"thrust", "thrust_difference"} <= set(three):
            continue
        yield (tuple(_one("linear", quantity) for quantity in three),)
    for quantity in _RATES:
        for angle in ("elevation", "pitch"):
            for other in (q for q in ("elevation", "pitch") if q != angle):
                yield ((_one("square", quantity), _one("linear", angle), _one("linear", other)),)


def _of_rotors(channel: str, singles: Sequence[_Products]) -> Iterator[_Products]:
    """Changes of a rotor's own thrust or voltage: a share of it, or of the other's."""
    rotor_quantity = "own_thrust" if channel.startswith("thrust") else "own_voltage"
    share = _one("linear", rotor_quantity)
    for products in singles:
        # Thrust that depends on thrust is what follows.
        if not any(QUANTITIES[f.quantity].kind == "thrust" for factors in products for f in factors):
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
    """What an encoder shows wrong depends on angles. One that goes with a thrust is found in any flight,
    because the controller feeds the quantisation error back; and half a sample of the own rate is in any log.
    """
    for products in singles:
        factors = [factor for product in products for factor in product]
        angles = all(QUANTITIES[f.quantity].kind == "angle" and not f.memory for f in factors)
        if angles and (factors[0].quantity == axis or factors[0].form in ("sin", "linear")):
            yield products


def tried_up_to(every: Sequence[Group]) -> dict[int, int]:
    """Number of groups of each size and of all smaller ones."""
    sizes = sorted({group.size for group in every})
    return {size: sum(group.size <= size for group in every) for size in sizes}
