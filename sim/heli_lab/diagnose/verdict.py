"""From what was found to what is said: the verdict, and how sure it is. All thresholds of it are here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from heli_lab.diagnose.residual_analysis import ResidualAnalysis
from heli_lab.diagnose.search import AMBIGUOUS
from heli_lab.diagnose.search_record import SETTLED, Cause, Search

LEFT_SHARE: Final = 0.01
"""Share of the excess of the mean square that causes may leave: models of large causes are not exact."""
CHANCE_ELSEWHERE: Final = 0.003
"""Share of its evidence that a random torque about one axis alone may lose against torques about all."""
CHANCE_LOSES: Final = 15.0
"""The same as a logarithm of a likelihood ratio, for small torques."""
CHANCE_OVER_ERROR: Final = 1.0
"""It must stand out of its estimate's error by this factor."""
OFF_LIST_SHARE: Final = 0.3
"""Patterns that account for more than this share of what was explained make the verdict `unexplained`."""
CONFIDENCE_CHANCE: Final = 0.8
"""Of a random torque: a rare structure is foretold by nothing that is tried."""
CONFIDENCE_BESIDE_UNKNOWN: Final = 0.5
"""Factor on the confidence of causes beside which something unknown remains, which they may imitate."""
CONFIDENCE_NATS: Final = 15.0
"""Lead, as a logarithm of a likelihood ratio, over which the doubt falls by a factor e."""


@dataclass(frozen=True)
class Verdict:
    """What is said.

    Parameters
    ----------
    word : str
        ``explained``, ``cause_found``, ``ambiguous`` or ``unexplained``.
    causes : tuple of Cause
        Effects of the catalogue, strongest first.
    off_list : tuple of Cause
        Patterns in their place.
    chance : bool
        Whether a random torque was found.
    """

    word: str
    causes: tuple[Cause, ...]
    off_list: tuple[Cause, ...]
    chance: bool


def judge(search: Search, left: ResidualAnalysis, removed: bool = False) -> Verdict:
    """Decide what to say.

    Parameters
    ----------
    search : Search
        What was found.
    left : ResidualAnalysis
        What remains.
    removed : bool
        Whether the fit itself found a term of the baseline to be gone: a cause like any other.

    Returns
    -------
    Verdict
        The decision.
    """
    causes = tuple(one for one in search.found if not one.candidate.is_spline)
    off_list = tuple(one for one in search.found if one.candidate.is_spline)
    chance = (
        remains(search)
        and not off_list
        and not left.depends
        and left.over_error > CHANCE_OVER_ERROR
        and left.lost < max(CHANCE_LOSES, CHANCE_ELSEWHERE * left.gained)
    )
    if off_list:
        spline_term, effect = (sum(one.evidence.raw for one in group) for group in (off_list, causes))
        if not causes or spline_term > OFF_LIST_SHARE * (spline_term + effect):
            return Verdict("unexplained", causes, off_list, False)
    if remains(search) and not chance:
        return Verdict("unexplained", causes, off_list, False)
    if causes:
        unclear = any(ambiguous_with(one) for one in causes)
        return Verdict("ambiguous" if unclear else "cause_found", causes, off_list, chance)
    return Verdict("cause_found" if chance or removed else "explained", (), off_list, chance)


def remains(search: Search) -> bool:
    """Whether the final model leaves more than rounding.

    Parameters
    ----------
    search : Search
        What was found.

    Returns
    -------
    bool
        Whether something is still missing.
    """
    train, held = search.final.train.normalised, search.final.held.normalised
    # The held-out flight alone may be worse by what differs from flight to flight.
    if min(train, held) < SETTLED:
        return False
    before = search.baseline.train.normalised**2 + search.baseline.held.normalised**2 - 2.0
    return train**2 + held**2 - 2.0 > LEFT_SHARE * before


def ambiguous_with(found: Cause) -> list[str]:
    """Other effects that would do as well.

    Parameters
    ----------
    found : Cause
        An effect that was found.

    Returns
    -------
    list of str
        Their ids, closest first.
    """
    return [rival.id for rival in found.rivals if rival.behind < AMBIGUOUS]


def confidence(found: Cause, search: Search, unexplained: bool = False) -> float:
    """How sure a cause is.

    Parameters
    ----------
    found : Cause
        The cause.
    search : Search
        Everything that was found.
    unexplained : bool
        Whether something remains that is none of the causes known: it may be all of this one, too.

    Returns
    -------
    float
        Between 0 and 1.
    """
    margin = min([found.evidence.total - found.penalty, *(rival.behind for rival in found.rivals)])
    sure = 1.0 - 0.5 * math.exp(-max(margin, 0.0) / CONFIDENCE_NATS)
    before = max(search.baseline.held.normalised**2 - 1.0, 1e-9)
    after = max(search.final.held.normalised**2 - 1.0, 0.0)
    open_share = min(1.0, after / before)
    beside = CONFIDENCE_BESIDE_UNKNOWN if unexplained else 1.0
    return float(min(0.99, sure) * (1.0 - 0.5 * open_share) * beside)
