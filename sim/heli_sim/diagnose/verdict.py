"""From what was found to what is said: the verdict, and how sure it is. All thresholds of it are here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from heli_sim.diagnose.leftover import Leftover
from heli_sim.diagnose.search import AMBIGUOUS, Found, Search

EXPLAINED: Final = 1.04
"""A normalised error up to here is nothing but rounding: practice flights reach 1.00 to 1.02."""
CHANCE_REPEATS: Final = 0.25
"""A missing torque of which less than this share repeats in another flight is chance."""
CHANCE_BURSTS: Final = 2.0
"""Excess kurtosis up to which it is steady enough to be chance."""
CHANCE_OVER_ERROR: Final = 1.0
"""It must stand out of its estimate's error by this factor."""
OFF_LIST_SHARE: Final = 0.3
"""Patterns that account for more than this share of what was explained make the verdict `unexplained`."""
CONFIDENCE_NATS: Final = 15.0
"""Lead, as a logarithm of a likelihood ratio, over which the doubt falls by a factor e."""


@dataclass(frozen=True)
class Verdict:
    """What is said.

    Parameters
    ----------
    word : str
        ``explained``, ``cause_found``, ``ambiguous`` or ``unexplained``.
    causes : tuple of Found
        Effects of the catalogue, strongest first.
    off_list : tuple of Found
        Patterns in their place.
    chance : bool
        Whether a random torque was found.
    """

    word: str
    causes: tuple[Found, ...]
    off_list: tuple[Found, ...]
    chance: bool


def judge(search: Search, left: Leftover, removed: bool = False) -> Verdict:
    """Decide what to say.

    Parameters
    ----------
    search : Search
        What was found.
    left : Leftover
        What remains.
    removed : bool
        Whether the fit itself found a term of the baseline to be gone: a cause like any other.

    Returns
    -------
    Verdict
        The decision.
    """
    causes = tuple(one for one in search.found if not one.trial.is_pattern)
    off_list = tuple(one for one in search.found if one.trial.is_pattern)
    # The held-out flight alone may be worse by what differs from flight to flight.
    remains = search.final.train.normalised > EXPLAINED and search.final.held.normalised > EXPLAINED
    remains |= min(search.final.train.normalised, search.final.held.normalised) > EXPLAINED
    chance = (
        remains
        and not off_list
        and left.repeats < CHANCE_REPEATS
        and left.over_error > CHANCE_OVER_ERROR
        and left.bursts < CHANCE_BURSTS
    )
    if off_list:
        pattern, effect = (sum(one.evidence.raw for one in group) for group in (off_list, causes))
        if not causes or pattern > OFF_LIST_SHARE * (pattern + effect):
            return Verdict("unexplained", causes, off_list, False)
    if causes:
        unclear = any(ambiguous_with(one) for one in causes)
        return Verdict("ambiguous" if unclear else "cause_found", causes, off_list, chance)
    if not remains:
        return Verdict("cause_found" if removed else "explained", (), off_list, False)
    return Verdict("cause_found" if chance else "unexplained", (), off_list, chance)


def ambiguous_with(found: Found) -> list[str]:
    """Other effects that would do as well.

    Parameters
    ----------
    found : Found
        An effect that was found.

    Returns
    -------
    list of str
        Their ids, closest first.
    """
    return [rival.id for rival in found.rivals if rival.behind < AMBIGUOUS]


def confidence(found: Found, search: Search) -> float:
    """How sure a cause is.

    Parameters
    ----------
    found : Found
        The cause.
    search : Search
        Everything that was found.

    Returns
    -------
    float
        Between 0 and 1.
    """
    lead = min([found.evidence.total - found.price, *(rival.behind for rival in found.rivals)])
    sure = 1.0 - 0.5 * math.exp(-max(lead, 0.0) / CONFIDENCE_NATS)
    before = max(search.baseline.held.normalised**2 - 1.0, 1e-9)
    after = max(search.final.held.normalised**2 - 1.0, 0.0)
    open_share = min(1.0, after / before)
    off_list = any(one.trial.is_pattern for one in search.found)
    return float(min(0.99, sure) * (1.0 - 0.5 * open_share) * (0.6 if off_list else 1.0))
