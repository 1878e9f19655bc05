"""From what a search found to the verdict and its confidence; the thresholds are in `thresholds.py`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from heli_sim.model.effects import EffectKind
from heli_sim.model.parts import AXES

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.prediction import Prediction
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
    unlisted : tuple of Cause
        Spline terms, in the place of causes that are not in the catalogue.
    gust : bool
        Whether chance pushes about one axis alone: a random torque, not the weather of every rig.
    """

    label: str
    causes: tuple[Cause, ...]
    unlisted: tuple[Cause, ...]
    gust: bool


def judge(
    search: Search,
    remaining: ResidualAnalysis,
    after: Prediction,
    kinds: Mapping[str, EffectKind],
    absent: bool,
) -> Verdict:
    """Decide the verdict.

    Parameters
    ----------
    search : Search
        What was found.
    remaining : ResidualAnalysis
        What is left.
    after : Prediction
        Free runs of the model with the causes found: where they leave nothing but quantisation, what is
        left is too small to matter, however significant.
    kinds : Mapping[str, EffectKind]
        The catalogue.
    absent : bool
        Whether the fit estimated a term of the baseline as zero, which is a cause as well.
    """
    causes = tuple(cause for cause in search.causes if not cause.candidate.is_spline)
    unlisted = tuple(cause for cause in search.causes if cause.candidate.is_spline)
    shows = max(after.train.normalised, after.held_out.normalised) > thresholds.AT_NOISE_FLOOR
    gust = shows and not unlisted and not remaining.dependences and gust_alone(remaining, kinds)
    if shows and (unlisted or remaining.dependences):
        return Verdict("unexplained", causes, unlisted, False)
    if causes:
        unclear = any(ambiguous_with(cause) for cause in causes)
        return Verdict("ambiguous" if unclear else "cause_found", causes, (), gust)
    return Verdict("cause_found" if gust or absent else "explained", (), (), gust)


def gust_alone(remaining: ResidualAnalysis, kinds: Mapping[str, EffectKind]) -> bool:
    """Whether torques by chance that last push one axis and no other."""
    order, axis = np.sort(remaining.gains), AXES.index(remaining.axis)
    kind = kinds.get(f"random_torque.{remaining.axis}")
    least_Nm = thresholds.GUST_SHARE * kind.typical[kind.size[0]] if kind else math.inf
    return bool(
        order[-1] > thresholds.GUST_MIN
        and order[-2] < thresholds.GUST_BESIDE
        and remaining.disturbances.fast_std[axis] > least_Nm
        and remaining.disturbances.correlation_time_s[axis] > thresholds.GUST_LEAST_s
    )


def ambiguous_with(cause: Cause) -> list[str]:
    """Ids of other effects that the flights do not tell from a cause, closest first."""
    return [
        alternative.id
        for alternative in cause.alternatives
        if alternative.log_likelihood_ratio < thresholds.AMBIGUOUS
    ]


def confidence(cause: Cause, unexplained: bool = False) -> float:
    """How sure the name of a cause is, 0 to 1: how far it is ahead of nothing, of its closest alternative,
    and whether the flights held out confirm it; less where something `unexplained` remains that it may
    imitate.
    """
    margin = min(
        [
            cause.train - cause.penalty,
            *(alternative.log_likelihood_ratio for alternative in cause.alternatives),
        ]
    )
    sure = 1.0 - 0.5 * math.exp(-max(margin, 0.0) / thresholds.CONFIDENCE_NATS)
    if cause.held_out is not None:
        # A cause that foretells nothing on flights that had no part in its choice is as likely chance.
        sure *= 1.0 / (
            1.0 + math.exp(-(cause.held_out - thresholds.HELD_OUT_EVEN) / thresholds.HELD_OUT_NATS)
        )
    beside = thresholds.CONFIDENCE_BESIDE_UNKNOWN if unexplained else 1.0
    return float(min(thresholds.MAX_CONFIDENCE, sure) * beside)
