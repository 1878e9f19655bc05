"""Which parameters are estimated, and their priors."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.base import Model
from heli_sim.rig import Prior, Rig

from heli_lab.errors import IdentifyError
from heli_lab.identify.thresholds import LEAST_OF_PRIOR

NOT_FREE: Final = frozenset({"g"})
"""Numbers with a tolerance that are never estimated: gravity is known better than any of the masses."""

PER_FLIGHT: Final = ("offset_elevation", "offset_pitch")
"""Numbers that differ from flight to flight, because encoders are zeroed each time the board starts."""


@dataclass(frozen=True)
class FreeParameter:
    """A parameter to be estimated.

    Parameters
    ----------
    name : str
        Its name; one that differs between several flights has the flight's label in brackets.
    unit : str
        As the rig file spells it, SI.
    quantity : str
        Its name in the model.
    record : int or None
        The flight that it belongs to; None for all.
    """

    name: str
    unit: str
    prior: Prior
    quantity: str
    record: int | None = None


def free_parameters(
    model: Model, rig: Rig, free: Sequence[str] | None, priors: Mapping[str, Prior]
) -> tuple[FreeParameter, ...]:
    """Choose the free parameters of a model, in the order given, or in the model's.

    Parameters
    ----------
    free : sequence of str or None
        Names; None for every number of the rig that the model uses and that has a tolerance, gravity
        excepted, and every parameter of the model's effects that has a prior.
    priors : Mapping[str, Prior]
        Instead of the rig's and the effects'.

    Raises
    ------
    IdentifyError
        When a name is unknown, or nothing is known of it beforehand.
    """
    known = {quantity.name: quantity for quantity in model.parameters}
    given = {name: prior for effect in model.effects for name, prior in effect.priors.items()} | dict(priors)
    if free is None:
        free = [
            name
            for name in known
            if name in given or (name in rig and rig[name].tolerance > 0 and name not in NOT_FREE)
        ]
    parameters = []
    for name in dict.fromkeys(free):
        if name not in known:
            raise _unknown(model, name)
        if name not in given and (name not in rig or rig[name].tolerance == 0):
            raise IdentifyError(
                f"nothing is known of '{name}' beforehand", "give it a tolerance in the rig file, or fix it"
            )
        parameters.append(
            FreeParameter(name, known[name].unit, given.get(name) or rig_prior(rig, name), name)
        )
    return tuple(parameters)


def estimated_names(model: Model, rig: Rig, free: Sequence[str] | None, fixed: Sequence[str]) -> list[str]:
    """Take the `fixed` parameters out of the `free` ones, those of `free_parameters`; return the names of
    what is left. An IdentifyError when a name is unknown, asked for and fixed at once, or nothing is left.
    """
    known = [quantity.name for quantity in model.parameters]
    for name in fixed:
        if name not in known:
            raise _unknown(model, name)
        if name in (free or ()):
            raise IdentifyError(f"'{name}' is asked for and fixed at once", "leave one of them out")
    names = [one.quantity for one in free_parameters(model, rig, free, {}) if one.quantity not in fixed]
    if not names:
        raise IdentifyError("every number is fixed", "free at least one")
    return names


def _unknown(model: Model, name: str) -> IdentifyError:
    known = [quantity.name for quantity in model.parameters]
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    return IdentifyError(
        f"the model '{model.name}' has no parameter '{name}'", f"{hint}names: {', '.join(known)}"
    )


def rig_prior(rig: Rig, name: str) -> Prior:
    """Prior of the number `name` of a rig: normal, with half the tolerance as its standard deviation; where
    the number cannot be negative it is bounded just above 0, because a rig without a length or a gain cannot
    be.
    """
    number = rig[name]
    low = -np.inf if rig.may_be_negative(name) else LEAST_OF_PRIOR * abs(number.value)
    return Prior(number.value, 0.5 * number.tolerance, low)
