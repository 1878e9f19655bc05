"""From what a search found to the verdict and its confidence; the thresholds are in `thresholds.py`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from heli_sim.model.effects import EffectKind
from heli_sim.model.parts import AXES

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.cause_parameters import CauseParameter, cause_parameters
from heli_lab.diagnose.prediction import Prediction
from heli_lab.diagnose.residual_analysis import ResidualAnalysis
from heli_lab.diagnose.search_record import Cause, Search
from heli_lab.identify import Fit


@dataclass(frozen=True)
class NamedCause(Cause):
    """A cause that the verdict names; its attributes have the names of the JSON.

    ``effect`` and ``ambiguous_with`` come from the search.

    Parameters
    ----------
    train, held_out, penalty : float, float or None, float
        Log-likelihood ratios on the flights fitted and held out, and the BIC penalty, nats.
    parameters : Mapping[str, CauseParameter]
        By full name, such as ``rotor_lag_s``: ``value``, ``std`` and ``unit``.
    confidence : float
        How sure the name is, 0 to 1.
    sentence : str
        The cause with its parameters in a sentence without its full stop.
    equation : str
        What the effect adds to the model, in LaTeX.
    """

    parameters: Mapping[str, CauseParameter]
    confidence: float
    sentence: str
    equation: str


@dataclass(frozen=True)
class Verdict:
    """The verdict.

    Parameters
    ----------
    label : str
        ``explained``, ``cause_found``, ``ambiguous`` or ``unexplained``.
    causes : tuple of NamedCause
        Effects of the catalogue, strongest first.
    unlisted : tuple of Cause
        Spline terms, in the place of causes that are not in the catalogue.
    gust : bool
        Whether chance pushes about one axis alone: a random torque, not the weather of every rig.
    """

    label: str
    causes: tuple[NamedCause, ...]
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
    effects = tuple(cause for cause in search.causes if not cause.candidate.is_spline)
    unlisted = tuple(cause for cause in search.causes if cause.candidate.is_spline)
    shows = max(after.train.normalised, after.held_out.normalised) > thresholds.AT_NOISE_FLOOR
    gust = shows and not unlisted and not remaining.dependences and gust_alone(remaining, kinds)
    unexplained = shows and bool(unlisted or remaining.dependences)
    causes = tuple(_named(cause, kinds[cause.effect], after.fit, unexplained) for cause in effects)
    if unexplained:
        return Verdict("unexplained", causes, unlisted, False)
    if causes:
        unclear = any(cause.ambiguous_with for cause in causes)
        return Verdict("ambiguous" if unclear else "cause_found", causes, (), gust)
    return Verdict("cause_found" if gust or absent else "explained", (), (), gust)


def _named(cause: Cause, kind: EffectKind, fit: Fit, unexplained: bool) -> NamedCause:
    """Give a cause what the final fit and the verdict say of it."""
    parameters = cause_parameters(cause.candidate, kind, fit)
    return NamedCause(
        cause.candidate,
        cause.train,
        cause.held_out,
        cause.penalty,
        cause.alternatives,
        parameters,
        confidence(cause, unexplained),
        kind.describe(
            {name: number.value for name, number in parameters.items()},
            {name: number.std for name, number in parameters.items()},
        ),
        kind.equation,
    )


def gust_alone(remaining: ResidualAnalysis, kinds: Mapping[str, EffectKind]) -> bool:
    """Whether torques by chance that last push one axis and no other."""
    order, axis = np.sort(remaining.gains), AXES.index(remaining.axis)
    kind = kinds.get(f"random_torque.{remaining.axis}")
    least_Nm = thresholds.GUST_SHARE * kind.typical[kind.size[0]] if kind else math.inf
    return bool(
        order[-1] > thresholds.GUST_MIN
        and order[-2] < thresholds.GUST_BESIDE
        and remaining.disturbances.fast_std_Nm[axis] > least_Nm
        and remaining.disturbances.correlation_time_s[axis] > thresholds.GUST_LEAST_s
    )


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
