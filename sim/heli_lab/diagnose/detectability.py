"""What flights could not have shown: effects that drown in their error, numbers that stay as they were."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from heli_sim.model.effects import EffectKind

from heli_lab.diagnose.screening import Scored
from heli_lab.identify import Fit
from heli_lab.identify.uncertainty import uninformed_parameters

_STANDS_OUT: Final = 5.0
"""Standard errors that an effect must measure to be seen among all that are tried."""


def undetectable_effects(screened: Sequence[Scored], kinds: Mapping[str, EffectKind]) -> tuple[str, ...]:
    """Find the effects that would not stand out of their standard error at a typical size.

    Parameters
    ----------
    screened : sequence of Scored
        Scores of the effects.
    kinds : Mapping[str, EffectKind]
        The catalogue.

    Returns
    -------
    tuple of str
        Their ids.
    """
    unseen = []
    for one in screened:
        kind = kinds[one.candidate.id]
        # Without columns for each size, the unit of the only coefficient is the size tried.
        name = kind.size[0]
        unit = 1.0 if one.candidate.size else one.candidate.effect.values[name]
        if one.answer.std[0] * abs(unit) * _STANDS_OUT > abs(kind.typical[name]):
            unseen.append(kind.id)
    return tuple(sorted(unseen))


def unidentifiable_parameters(fit: Fit) -> tuple[str, ...]:
    """Find the numbers of the rig of which the flights said nothing that was not known.

    Parameters
    ----------
    fit : Fit
        The refitted baseline.

    Returns
    -------
    tuple of str
        Their names.
    """
    return tuple(uninformed_parameters(fit.problem.names, fit.covariance, fit.problem.prior_std))
