"""From what a search found to the verdict and its confidence; the thresholds are in `thresholds.py`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.residual_analysis import ResidualAnalysis
from heli_lab.diagnose.search_record import Cause, Search


@dataclass(frozen=True)
class Verdict:
    """The verdict.

    Parameters
    ----------
    label : str
        ``explained``, ``cause_found``, ``ambiguous`` or ``unexplained``.
    causes : tuple of Cause
        Effects of the catalogue, strongest first.
    off_list : tuple of Cause
        Spline terms, in the place of causes that are not in the catalogue.
    gust : bool
        Whether a random torque was found.
    """

    label: str
    causes: tuple[Cause, ...]
    off_list: tuple[Cause, ...]
    gust: bool


def judge(search: Search, remaining: ResidualAnalysis, absent: bool = False) -> Verdict:
    """Decide the verdict; with `absent` the fit estimated a term of the baseline as zero, which is a cause as
    well.
    """
    causes = tuple(one for one in search.causes if not one.candidate.is_spline)
    off_list = tuple(one for one in search.causes if one.candidate.is_spline)
    gust = (
        remains(search)
        and not off_list
        and not remaining.dependences
        and remaining.sigma_over_std > thresholds.GUST_MIN_SIGMA_OVER_STD
        and remaining.loss_to_all_axes
        < max(thresholds.GUST_MAX_LOSS, thresholds.GUST_MAX_LOSS_SHARE * remaining.gain_over_none)
    )
    if off_list:
        spline, effect = (sum(one.evidence.iid for one in group) for group in (off_list, causes))
        if not causes or spline > thresholds.OFF_LIST_SHARE * (spline + effect):
            return Verdict("unexplained", causes, off_list, False)
    if remains(search) and not gust:
        return Verdict("unexplained", causes, off_list, False)
    if causes:
        unclear = any(ambiguous_with(one) for one in causes)
        return Verdict("ambiguous" if unclear else "cause_found", causes, off_list, gust)
    return Verdict("cause_found" if gust or absent else "explained", (), off_list, gust)


def remains(search: Search) -> bool:
    """Whether the final model leaves more than quantisation."""
    train, held_out = search.final.train.normalised, search.final.held_out.normalised
    # The held-out flights alone may be worse by what differs from flight to flight.
    if min(train, held_out) < thresholds.AT_NOISE_FLOOR:
        return False
    before = search.baseline.train.normalised**2 + search.baseline.held_out.normalised**2 - 2.0
    return train**2 + held_out**2 - 2.0 > thresholds.UNEXPLAINED_SHARE * before


def ambiguous_with(found: Cause) -> list[str]:
    """Ids of other effects that the flights do not tell from a cause, closest first."""
    return [
        alternative.id
        for alternative in found.alternatives
        if alternative.log_likelihood_ratio < thresholds.AMBIGUOUS
    ]


def confidence(found: Cause, search: Search, unexplained: bool = False) -> float:
    """How sure the name of a cause is, 0 to 1, of the closest alternative and of what remains `unexplained`,
    which this cause may imitate.
    """
    margin = min(
        [
            found.evidence.total - found.penalty,
            *(alternative.log_likelihood_ratio for alternative in found.alternatives),
        ]
    )
    sure = 1.0 - 0.5 * math.exp(-max(margin, 0.0) / thresholds.CONFIDENCE_NATS)
    before = max(search.baseline.held_out.normalised**2 - 1.0, 1e-9)
    after = max(search.final.held_out.normalised**2 - 1.0, 0.0)
    open_share = min(1.0, after / before)
    beside = thresholds.CONFIDENCE_BESIDE_UNKNOWN if unexplained else 1.0
    return float(min(thresholds.MAX_CONFIDENCE, sure) * (1.0 - 0.5 * open_share) * beside)
